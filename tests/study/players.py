"""Script players: they come in as people do, and steer by messages of the socket."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

import phase_ppl as ppl
from phase_ppl.study.study import Study
from tests.study.studies import HOST, Person

ALONE = [[16.0, 12.0], [16.0, 22.0]]

Message = dict[str, Any]


def near_goals(name: str = "near", **changes: Any) -> ppl.Event:
    """An event in which both agents have little more than a unit to drive to their goals."""
    start = [
        [12.0, 19.5, math.pi / 2],
        [20.0, 19.5, -math.pi / 2],
        [12.0, 7.0, 0.0],
        [20.0, 7.0, 0],
    ]
    given: dict[str, Any] = {"start": start, "radius": [0.8] * 4, "walls": [ALONE], **changes}
    truth = ppl.Truth(
        "Get red agent to blue lm", "Get green agent to green lm", strength_red=600.0,
        strength_green=600.0,
    )  # fmt: skip
    scene = ppl.Scene(**{name: np.array(value, float) for name, value in given.items()})
    frames = np.repeat(scene.start[None], 2, axis=0)
    return ppl.Event(scene, ppl.Observation(frames), id=name, truth=truth)


def make_study(folder: Path, events: Sequence[ppl.Event], **play: Any) -> Study:
    """A study of play without films, quiz and demographics, whose sessions are short."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phase_ppl.study.study.make_clips", lambda folder, world: None)
        Study.new(folder, events, "play", raters=1000)
    file = folder / "study.toml"
    given = {"steps_per_second": 12, "limit": 18, "hold": 2, "wait_at_most": 60, **play}
    lines = file.read_text().partition("\n[[tutorial]]")[0].splitlines()
    lines = [line for line in lines if not line.startswith(("demographics", "trials"))]
    head = ["quiz = []", "demographics = false", f"trials = {given.pop('trials', 1)}"]
    table = [f"{name} = {json.dumps(value)}" for name, value in given.items()]
    file.write_text("\n".join([*head, *lines, "[play]", *table]))
    return Study(folder)


class Player(Person):
    """Somebody who has read the introduction, and practised unless told otherwise."""

    def __init__(self, client: TestClient, practised: bool = True) -> None:
        super().__init__(client)
        for page, answers in (
            ("consent", {"agree": True}),
            ("device", {}),
            ("tutorial", {"views": [1000]}),
        ):
            assert self.answer(page, answers).status_code == 200
        self.id = self.state()["participant"]
        if practised:
            site = client.app.state.site  # type: ignore[attr-defined]
            client.portal.call(  # type: ignore[union-attr]
                lambda: site.ask(site.store.answer, self.id, "practice", 1, {})
            )
        self.messages: list[Message] = []

    def connect(self, **headers: str) -> WebSocketTestSession:
        given = {"origin": HOST, "cookie": self.cookie, **headers}
        return self.client.websocket_connect("ws://localhost/play/socket", headers=given)

    def play(
        self, react: Callable[[Message], Sequence[Message]], until: str = "go", most: int = 5000
    ) -> list[Message]:
        """Answer each message by ``react``, until one of a kind comes; return all."""
        with self.connect() as socket:
            for _ in range(most):
                try:
                    message = socket.receive_json()
                except WebSocketDisconnect as gone:
                    message = {"t": "closed", "code": gone.code}
                self.messages.append(message)
                if message["t"] in (until, "closed"):
                    return self.messages
                for said in react(message):
                    socket.send_json(said)
        raise AssertionError(f"no {until!r} in {most} messages")


def together(*tasks: Callable[[], Any]) -> list[Any]:
    """Run tasks in threads; return what they return, or raise what one of them raised."""
    found: dict[int, Any] = {}

    def work(number: int, task: Callable[[], Any]) -> None:
        try:
            found[number] = task()
        except BaseException as error:
            found[number] = error

    threads = [threading.Thread(target=work, args=item) for item in enumerate(tasks)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    for number in range(len(tasks)):
        result = found.get(number, TimeoutError(f"player {number} is still at it"))
        if isinstance(result, BaseException):
            raise result
    return [found[number] for number in range(len(tasks))]


def press(key: str, down: bool = True) -> Message:
    return {"t": "key", "key": key, "down": down}


def both_play(
    client: TestClient, react: Callable[[Message], Sequence[Message]], until: str = "go"
) -> tuple[list[Player], list[list[Message]]]:
    """Let two people play, who react alike; return them and what each was told."""
    players = [Player(client), Player(client)]
    return players, together(*(lambda one=one: one.play(react, until) for one in players))


def drives(*keys: str) -> Callable[[Message], Sequence[Message]]:
    """React as somebody who is ready at once, holds keys down and answers pings."""

    def react(message: Message) -> Sequence[Message]:
        if message["t"] == "scene":
            return [{"t": "ready"}]
        if message["t"] == "begun":
            return [press(key) for key in keys]
        return [{"t": "pong"}] if message["t"] == "ping" else []

    return react
