"""Two people, or one and the computer, play sessions that become events."""

from __future__ import annotations

import dataclasses
import functools
import random
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from starlette.testclient import TestClient, WebSocketDenialResponse, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

import phase_ppl as ppl
from phase_ppl.physics.actions import ACTION_NAMES
from phase_study import play, sockets
from phase_study.exports import played, replayed
from phase_study.room import KEYS, Room
from phase_study.store import trajectory_sha256
from phase_study.study import Study
from tests.study.players import (
    Message,
    Player,
    React,
    both_play,
    drives,
    make_study,
    near_goals,
    press,
    together,
)
from tests.study.studies import serving, table

Made = Callable[..., Study]
QUICK = ppl.PlannerConfig(particles=6, simulations=8)


@pytest.fixture(autouse=True)
def _in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "_PING", 0.05)
    for name, seconds in (("COUNTDOWN", 0), ("_SAVED_EVERY", 0.1)):
        monkeypatch.setattr(play, name, seconds)


@pytest.fixture
def made(tmp_path: Path) -> Made:
    return functools.partial(make_study, tmp_path / "study", [near_goals()])


def recorded(study: Study) -> list[dict[str, Any]]:
    with study.store() as store:
        return store.sessions()


def assert_replays(session: dict[str, Any]) -> None:
    """The actions of a session give its trajectory again."""
    again = replayed(session, near_goals()).observation.trajectory
    assert trajectory_sha256(again) == session["sha256"]


def outcomes(players: Sequence[Player]) -> list[str | None]:
    return [player.state().get("outcome") for player in players]


def of_kind(messages: Sequence[Message], kind: str) -> list[Message]:
    return [message for message in messages if message["t"] == kind]


# --- sessions -------------------------------------------------------------------------------------


def test_two_people_play_until_both_goals_hold(made: Made) -> None:
    study = made(trials=2, limit=300)
    with serving(study) as client:
        players, both = both_play(client, drives("forward"))
        assert outcomes(players) == ["finished"] * 2
    for messages in both:
        assert [one["outcome"] for one in of_kind(messages, "end")] == ["goals", "goals"]
        scenes = of_kind(messages, "scene")
        assert [scene["session"] for scene in scenes] == [1, 2]
        assert {scene["agent"] for scene in scenes} == {0, 1}  # the agents are exchanged
        assert scenes[0]["goals"] == ["Get red agent to blue lm", "Get green agent to green lm"]
        assert scenes[1]["last"] == "goals"
    for session in recorded(study):
        assert session["outcome"] == "goals"
        assert {one["participant"] for one in session["players"]} == {one.id for one in players}
        steps = session["steps"]
        assert [step["number"] for step in steps] == [*range(1, len(steps) + 1)]
        assert steps[-1]["keys"] == '[["forward"], ["forward"]]'
    trips = [one["rtt_ms"] for session in recorded(study) for one in session["players"]]
    assert any(trips)
    assert all(trip is None or 0 < trip < 10_000 for trip in trips)


def scribbles(seed: int) -> React:
    """React as somebody who presses keys at random."""
    rng = random.Random(seed)

    def react(message: Message) -> Sequence[Message]:
        if message["t"] == "scene":
            return [{"t": "ready"}]
        if message["t"] == "frame" and rng.random() < 0.5:
            return [press(rng.choice(KEYS), rng.random() < 0.6)]
        return []

    return react


def test_a_session_replays_bit_for_bit_and_is_an_event(tmp_path: Path) -> None:
    scene = near_goals(start=[[12, 10, 0], [20, 10, 0], [12, 12, 0], [20, 12, 0]], walls=[])
    study = make_study(tmp_path / "study", [scene], hold=100, steps_per_second=24)
    with serving(study) as client:
        players = [Player(client), Player(client)]
        together(*(lambda k=k: players[k].play(scribbles(k)) for k in range(2)))
    (session,) = recorded(study)
    assert (session["outcome"], len(session["steps"])) == ("time", 18)
    replay = replayed(session, scene)
    assert trajectory_sha256(replay.observation.trajectory) == session["sha256"]
    assert len({(step["red"], step["green"]) for step in session["steps"]}) > 5

    study.export(tmp_path / "out")
    (event,) = ppl.load_events(tmp_path / "out" / "sessions.json")
    np.testing.assert_array_equal(event.observation.trajectory, replay.observation.trajectory)
    assert event.scene.resets_velocity
    assert event.observation.n_frames == 19
    assert event.truth == dataclasses.replace(scene.truth, relation="neutral")
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1), planner=QUICK)
    draws: Any = {"kernel": "prior_mh", "planner": QUICK, "chains": 2, "iterations": 2}
    read, simulated = ppl.infer(event, model), ppl.infer(event, workers=1, progress=False, **draws)
    for post in (read, simulated):  # by the rule of the session
        assert post.settings["resets_velocity"] is post.scene.resets_velocity is True
    # whoever drives from rest in each step goes no further than the strongest can
    way = abs(simulated.replay()[:, :2, :2] - event.scene.start[:2, :2]).max()
    assert way < 0.9 * event.observation.n_frames
    (row,) = table(tmp_path / "out" / "sessions.csv")
    assert (row["session"], row["scene"], row["outcome"]) == (event.id, "near", "time")
    agents = {of_kind(one.messages, "scene")[0]["agent"]: one.id for one in players}
    assert (row["red"], row["green"]) == (agents[0], agents[1])
    assert (row["steps"], row["resets_velocity"], row["view"]) == ("18", "1", "own")
    assert float(row["seconds"]) == 18 / 24
    steps = table(tmp_path / "out" / "steps.csv")
    assert [step["red"] for step in steps] == [ACTION_NAMES[s["red"]] for s in session["steps"]]
    readme = (tmp_path / "out" / "README.md").read_text()
    assert "`resets_velocity`" in readme
    assert "sessions 1, goals 0, time 1" in readme
    with study.store() as store:
        store._db.execute("UPDATE step SET red=(red + 1) % 2 WHERE number=2")
        found, counts = played(store, study.events)
    assert (found, counts["replay differs"]) == ([], 1), "what replays otherwise is no event"


@pytest.mark.parametrize("view", ["own", "all"])
def test_players_are_sent_what_their_agents_see_and_nothing_else(made: Made, view: str) -> None:
    with serving(made(view=view, limit=3)) as client:
        _, both = both_play(client, drives())
    for messages in both:
        # back to back, with a wall between them, and the items behind them
        agent = of_kind(messages, "scene")[0]["agent"]
        for frame in of_kind(messages, "frame"):
            known = [entity for entity, pose in enumerate(frame["poses"]) if pose is not None]
            assert known == ([agent] if view == "own" else [0, 1, 2, 3])
            assert (frame["sight"] is None) is (view == "all")
    assert ("12.0, 7.0" in str(both)) is (view == "all")


# --- partners -------------------------------------------------------------------------------------


@pytest.mark.parametrize("partner", ["computer", "either"])
def test_one_person_alone_plays_with_the_computer_by_either_rule(made: Made, partner: str) -> None:
    resets = partner == "either"
    study = made(partner=partner, wait_at_most=0.1, limit=300, resets_velocity=resets)
    with serving(study) as client:
        player = Player(client)
        messages = player.play(drives("forward"))
        assert outcomes([player]) == ["finished"]
    assert of_kind(messages, "scene")[0]["partner"] == "computer"
    assert bool(of_kind(messages, "wait")) is (partner == "either")
    (session,) = recorded(study)
    assert session["outcome"] == "goals"  # the computer drives to its own goal
    assert [one["participant"] for one in session["players"]].count(None) == 1
    assert replayed(session, near_goals()).scene.resets_velocity is resets
    assert_replays(session)


def test_who_waits_in_vain_is_thanked(made: Made) -> None:
    study = made(partner="person", wait_at_most=0.1)
    with serving(study) as client:
        player = Player(client)
        player.play(drives())
        state = player.state()
    assert (state["outcome"], state["code"]) == ("waited", study.settings.codes["waited"])
    assert state["code"]
    assert recorded(study) == []


def test_when_a_player_leaves_the_other_is_told(made: Made, tmp_path: Path) -> None:
    study = made(hold=100, limit=2000, rejoin_within=0.3)

    def after_some_steps(message: Message) -> bool:
        return message["t"] == "frame" and message["left"] < 33.2  # of 33.3 s

    with serving(study) as client:
        stays, leaves = Player(client), Player(client)
        both = [lambda: stays.play(drives()), lambda: leaves.play(drives(), after_some_steps)]
        told, _ = together(*both)
        assert outcomes([stays, leaves]) == ["partner_left", "left"]
        assert stays.state()["code"]
        assert not leaves.state()["code"]
    assert of_kind(told, "end")[0]["outcome"] == "left"
    (session,) = recorded(study)
    assert session["outcome"] == "left"
    assert 1 < len(session["steps"]) < 2000
    study.export(tmp_path / "out")
    assert not (tmp_path / "out" / "sessions.json").exists()
    study.export(tmp_path / "all", include=["unfinished"])
    (event,) = ppl.load_events(tmp_path / "all" / "sessions.json")
    assert event.observation.n_frames == len(session["steps"]) + 1


def test_who_comes_back_in_time_goes_on(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    study, outcome, is_back = made(hold=100, rejoin_within=30, limit=20), Room.outcome, False
    with serving(study) as client:
        # no way back takes longer than the session
        monkeypatch.setattr(Room, "outcome", lambda room: outcome(room) if is_back else None)
        players = [Player(client), Player(client)]

        def drives_on(message: Message) -> Sequence[Message]:
            nonlocal is_back
            is_back |= message["t"] == "begun"
            return drives("forward")(message)

        def comes_back() -> list[Message]:
            players[0].play(drives("forward"), until="begun")
            before = len(players[0].messages)
            return players[0].play(drives_on)[before:]

        again, _ = together(comes_back, lambda: players[1].play(drives("forward")))
        assert outcomes(players) == ["finished"] * 2
    assert [one["t"] for one in again[:3]] == ["scene", "ready", "begun"]
    (session,) = recorded(study)
    assert session["outcome"] == "time"


def test_whoever_does_not_begin_is_out_and_the_other_goes_back(made: Made) -> None:
    with serving(made(ready_within=60, limit=300)) as client:
        (close,) = client.app.state.site.closing  # type: ignore[attr-defined]
        lobby, agents = close.__self__, []

        def react(message: Message) -> Sequence[Message]:
            if message["t"] == "scene":
                agents.append(message["agent"])
            elif message["t"] == "ready" and message["players"][agents[-1]]:
                # the time is over as soon as one of them is ready
                lobby.settings = dataclasses.replace(
                    lobby.settings, ready_within=0, wait_at_most=0.1
                )
            elif message["t"] == "wait":
                lobby.settings = dataclasses.replace(lobby.settings, ready_within=60)
            return drives("forward")(message)

        willing, absent = Player(client), Player(client)
        messages, _ = together(lambda: willing.play(react), lambda: absent.play(lambda message: []))
        assert outcomes([willing, absent]) == ["finished", "left"]
    assert [scene["partner"] for scene in of_kind(messages, "scene")] == ["person", "computer"]


def test_when_the_server_ends_what_was_played_is_kept(made: Made) -> None:
    study = made(hold=100_000, limit=100_000)
    with serving(study) as client:
        players = [Player(client), Player(client)]
        (stop,) = client.app.state.site.closing  # type: ignore[attr-defined]
        moving = threading.Event()

        def react(message: Message) -> Sequence[Message]:
            if message["t"] == "frame" and message["true"]:
                moving.set()
            return drives("forward")(message)

        def stops() -> None:
            assert moving.wait(60)
            client.portal.call(stop)  # type: ignore[union-attr]

        plays = (lambda one=one: one.play(react, until="error") for one in players)
        told, *_ = together(*plays, stops)
    assert told[-1]["text"] == "the study is being stopped"
    (session,) = recorded(study)
    assert session["outcome"] == "stopped"
    assert_replays(session)


def test_a_session_that_a_crash_broke_off_is_marked(made: Made) -> None:
    study = made()
    with study.store() as store:
        goals = "get to green agent", "get to red agent"
        store.open_session("near", goals, (600.0, 600.0), {}, [None, None])
    with serving(study):
        pass
    assert [session["outcome"] for session in recorded(study)] == ["stopped"]


def test_players_are_told_of_a_fault(
    made: Made, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of the test")

    with serving(made()) as client:
        monkeypatch.setattr(play, "Room", fails)
        _, both = both_play(client, drives(), "error")
    assert [messages[-1]["text"] for messages in both] == ["the server has a problem"] * 2
    assert "ZeroDivisionError: of the test" in capsys.readouterr().err


# --- practice -------------------------------------------------------------------------------------


def practises() -> React:
    """React as somebody who does the tasks of practice one after the other."""
    done, since = 0, 0

    def tap(key: str) -> list[Message]:
        return [press(key), press(key, False)]

    def react(message: Message) -> Sequence[Message]:
        nonlocal done, since
        if message["t"] == "scene":
            return [{"t": "ready"}, press("forward")] if "practice" in message else []
        since += 1
        if message["t"] == "tasks":
            done = message["done"]
            return {
                1: [press("forward", False), *tap("turn left")],
                2: [*tap("turn right")],
                3: [press("forward", False), press("backward")],
                4: [press("backward", False), *tap("grab")],
                5: [{"t": "ready"}],
            }.get(done, [])
        if message["t"] == "frame" and done == 2 and since > 20:
            since = 0
            near = message["poses"][0][1] > 12
            return tap("grab") if near else [press("forward", False), press("forward")]
        return []

    return react


def test_practice_goes_on_until_all_was_done_and_the_player_is_ready(made: Made) -> None:
    study = made(partner="computer", practice_at_most=60, steps_per_second=24)
    with serving(study) as client:
        messages = Player(client, practised=False).play(practises(), until="ready")
    done = [message["done"] for message in of_kind(messages, "tasks")]
    assert sorted(set(done)) == [0, 1, 2, 3, 4, 5]
    scenes = of_kind(messages, "scene")
    assert scenes[0]["goals"] == []
    assert len(scenes[0]["practice"]) == 5
    with study.store() as store:
        (answer,) = store.rows("SELECT answers FROM response WHERE page='practice'")
    assert '"done": 5, "of": 5' in answer["answers"]


def test_practice_ends_at_its_limit(made: Made) -> None:
    with serving(made(practice_at_most=0.2)) as client:
        messages = Player(client, practised=False).play(lambda message: [], until="wait")
    assert of_kind(messages, "tasks")[-1]["done"] == 0


# --- what is refused ------------------------------------------------------------------------------


def closed_with(player: Player, *said: str | bytes, **headers: str) -> int:
    """Return the code with which the server closes after what is said."""
    with player.connect(**headers) as socket:
        for one in said:
            socket.send_text(one) if isinstance(one, str) else socket.send_bytes(one)
        return close_code(socket)


def close_code(socket: WebSocketTestSession) -> int:
    for _ in range(2000):
        try:
            socket.receive_json()
        except WebSocketDisconnect as gone:
            return gone.code
    raise AssertionError("still open")


@pytest.fixture(scope="module")
def lobby(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    folder = tmp_path_factory.mktemp("lobby") / "study"
    with serving(make_study(folder, [near_goals()], partner="person")) as client:
        yield client


@pytest.mark.parametrize(
    ("said", "code"),
    [
        (['{"t":"key","key":"jump","down":true}'], 4400),
        (['{"t":"key","key":"forward","down":"yes"}'], 4400),
        (['{"t":"key","key":["forward"],"down":true}'], 4400),
        (['{"t":"steps","red":2}'], 4400),
        (["[1]"], 4400),
        (["{"], 4400),
        (["[" * 3000], 4400),
        ([b'{"t":"ready"}'], 4400),
        (['{"t":"key","key":"' + "é" * 2100 + '","down":true}'], 1009),
        (['{"t":"key","key":"forward","down":true}', '{"t":"release"}'] * 100, 4429),
    ],
)
@pytest.mark.usefixtures("in_a_moment")
def test_bad_messages_close_sockets(lobby: TestClient, said: list[str | bytes], code: int) -> None:
    assert closed_with(Player(lobby), *said) == code


@pytest.mark.usefixtures("in_a_moment")
def test_too_many_sockets_are_refused(lobby: TestClient) -> None:
    player = Player(lobby)
    codes = [closed_with(player, "{") for _ in range(15)]
    assert (codes[0], codes[-1]) == (4400, 4429)


def test_pages_from_elsewhere_other_names_and_strangers_get_no_socket(lobby: TestClient) -> None:
    player = Player(lobby)
    for origin in ("http://elsewhere.example", "null", ""):
        with pytest.raises(WebSocketDisconnect), player.connect(origin=origin):
            pass
    headers = {"origin": "http://elsewhere.example", "cookie": player.cookie}
    where = "ws://elsewhere.example/play/socket"
    refused = pytest.raises(WebSocketDenialResponse)
    with refused as refusal, lobby.websocket_connect(where, headers=headers):
        pass
    assert refusal.value.status_code == 400
    assert closed_with(player, cookie="") == 4401
    assert closed_with(player, cookie=f"{player.cookie}x") == 4401


def test_nobody_plays_before_the_introduction_or_answers_by_hand(lobby: TestClient) -> None:
    player = Player(lobby)
    content = {"page": "session-1", "attempt": 1, "answers": {"outcome": "goals"}}
    assert player.post("/api/answer", content).status_code == 409
    player.cookie = ""
    player.enter()
    assert [message["t"] for message in player.play(drives()) if message["t"] != "ping"] == ["go"]
