"""Somebody steers an agent in the browser, and the model says what they want."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import phase_ppl as ppl
from phase_study import reader
from phase_study.live import Live
from phase_study.simulate import serving
from tests.browser import needs_browser, running_browser
from tests.simulator.toys import wait_until
from tests.study.players import near_goals, press
from tests.study.test_browser import AXE, RULES

HOST = "http://localhost"
Message = dict[str, Any]


@contextlib.contextmanager
def client_of(game: Live) -> Iterator[TestClient]:
    with TestClient(game.app(), base_url=HOST) as client:
        yield client


def connected(client: TestClient, seat: int = 0) -> Any:
    return client.websocket_connect(f"ws://localhost/socket/{seat}", headers={"origin": HOST})


def until(socket: Any, kind: str, fits: Callable[[Message], bool] = lambda found: True) -> Message:
    while True:
        found: Message = socket.receive_json()
        if found["t"] == kind and fits(found):
            return found


def wishes(**changes: Any) -> Message:
    asked = {"agent": 0, "goal": "Get red agent to blue lm", "partner": "nobody",
             "strengths": [600, 600], **changes}  # fmt: skip
    return {"t": "begin", "wishes": asked}


def test_a_reading_is_that_of_the_saved_event_and_going_back_repeats_it(tmp_path: Path) -> None:
    with client_of(Live(near_goals().scene)) as client, connected(client) as socket:
        socket.send_json(wishes(partner="planner"))
        until(socket, "waiting")
        for message in (press("forward"), {"t": "hurry"}):
            socket.send_json(message)
        until(socket, "read", lambda found: found["frame"] == 5)
        socket.send_json({"t": "pause"})
        until(socket, "paused")
        (tmp_path / "saved.json").write_bytes(client.get("/event.json").content)
        event = ppl.load_event(tmp_path / "saved.json")
        track = event.observation.trajectory
        socket.send_json({"t": "look", "frame": 4})
        found = until(socket, "reading", lambda one: one["frame"] == 4)
        socket.send_json({"t": "back", "frame": 4})
        again = [until(socket, "read")["poses"] for _ in range(5)]
        with contextlib.closing(socket):
            socket.send_json({"t": "steps", "red": 2})
            with pytest.raises(WebSocketDisconnect):
                until(socket, "never")
    assert track[-1][0, 0] < track[0][0, 0] - 0.1, "it drives ahead, to the left"
    assert event.truth.goal_red == "Get red agent to blue lm"
    np.testing.assert_allclose(again, track[:5], atol=1e-3)
    post = ppl.infer(event, reader.MODEL).at(4)
    np.testing.assert_allclose(found["goals"][0], post.marginal("goal_red"), atol=1e-3)


def test_a_game_goes_on_without_its_reader_and_the_next_one_has_a_new_one() -> None:
    game = Live(near_goals().scene)
    with client_of(game) as client:
        with connected(client) as socket:
            socket.send_json(wishes())
            until(socket, "reading")
            socket.send_json({"t": "hurry"})
            until(socket, "read", lambda found: found["frame"] == 2)
            socket.send_json({"t": "film"})
            until(socket, "making")
            socket.send_json({"t": "film"})
            assert "is being made" in until(socket, "refused")["text"]
            pid = game._process.pid
            assert pid is not None
            os.kill(pid, signal.SIGKILL)
            until(socket, "failed")
            until(socket, "unread")
            until(socket, "read", lambda found: found["frame"] > 2)
            socket.send_json({"t": "film"})
            until(socket, "refused")
        with connected(client) as socket:
            until(socket, "unread")  # a page that is opened later is told
            socket.send_json(wishes())
            until(socket, "reading")


def test_a_refused_game_leaves_the_scene_of_the_one_before() -> None:
    game = Live()
    with client_of(game) as client, connected(client) as socket:
        before = game.room.scene
        socket.send_json(wishes(goal="get to red agent", new_scene=True))
        assert "names the red agent itself" in until(socket, "refused")["text"]
        socket.send_json(wishes())
        until(socket, "waiting", lambda found: game._wishes.partner == "nobody")
        assert game.room.scene is before


def test_a_film_that_fails_does_not_end_the_reader(tmp_path: Path) -> None:
    here, there = multiprocessing.Pipe()
    thread = threading.Thread(target=reader.serve, args=(there,))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(signal, "signal", lambda *given: None)  # for a thread it is not allowed
        here.send(("make", 1, "film", {"path": tmp_path / "early.mp4"}))
        here.send(("begin", 0, near_goals().scene, 0))
        here.send(("make", 2, "film", {"path": None}))
        here.send(("frame", 0, near_goals().scene.start))
        thread.start()
        told = [here.recv() for _ in range(3)]
    here.close()
    thread.join()
    assert [one[0] for one in told] == ["failed", "failed", "reading"]
    assert [one[1] for one in told[:2]] == [1, 2]


def test_a_second_player_steers_another_agent_of_any_world() -> None:
    with (
        client_of(Live(ppl.worlds.TRIO)) as client,
        connected(client) as first,
        connected(client, 1) as second,
    ):
        assert until(second, "nobody")
        first.send_json(wishes(goal="", partner="player"))
        until(first, "waiting")
        assert until(first, "scene")["agent"] == 0
        assert until(second, "scene")["agent"] == 1
        begun = until(first, "read", lambda found: found["frame"] == 0)["poses"]
        for message in (press("turn left"), {"t": "hurry"}):
            second.send_json(message)
        after = until(first, "read", lambda found: found["frame"] == 3)["poses"]
    turned = np.abs(np.array(after) - begun)[:, 2]
    assert turned[1] > 0.1
    assert turned[[0, 2]].max() == 0, "who waits for keys, and who is nobody, stand still"


@needs_browser
def test_the_page_shows_what_is_believed_as_keys_are_pressed() -> None:
    scene = near_goals(start=[[12, 14, 0], [20, 19.5, -1.5], [12, 7, 0], [20, 7, 0]]).scene
    faults: list[str] = []
    with serving(Live(scene)) as address, running_browser() as browser:
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(address)
        wait_until(lambda: page.evaluate("Boolean(window.live?.readings.length)"), 120)
        first = page.evaluate("live.readings[0].goals[0]")
        page.keyboard.down("w")
        wait_until(lambda: page.evaluate("live.readings.length > 4"), 60)
        page.keyboard.up("w")
        page.get_by_role("button", name="Pause").click()
        page.get_by_text("What if").first.click()
        page.get_by_text("Paused.").wait_for()
        now = page.evaluate("live.readings.at(-1).goals[0]")
        assert np.abs(np.subtract(first, now)).sum() > 0.1, "it has learnt something"
        assert sum(now) == pytest.approx(1, abs=0.01)
        assert page.evaluate("live.latency.reading.length") > 0
        page.evaluate(AXE)
        found = page.evaluate("tags => axe.run({ runOnly: tags })", RULES)["violations"]
        assert [(one["id"], one["nodes"][0]["html"]) for one in found] == []
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert faults == []
