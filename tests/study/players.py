"""Script players: they come in as people do, and steer by messages of the socket."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

import phase_ppl as ppl
from phase_study.study import Study
from tests.study.studies import HOST, Person

Message = dict[str, Any]
React = Callable[[Message], Sequence[Message]]


def near_goals(name: str = "near", **changes: Any) -> ppl.Event:
    """An event in which both agents have little more than a unit to drive to their goals."""
    start = [[12, 19.5, math.pi / 2], [20, 19.5, -math.pi / 2], [12, 7, 0], [20, 7, 0]]
    wall = [[16, 12], [16, 22]]
    given: dict[str, Any] = {"start": start, "radius": [0.8] * 4, "walls": [wall], **changes}
    goals = "Get red agent to blue lm", "Get green agent to green lm"
    truth = ppl.Truth(*goals, strength_red=600.0, strength_green=600.0)
    scene = ppl.Scene(**{name: np.array(value, float) for name, value in given.items()})
    frames = np.repeat(scene.start[None], 2, axis=0)
    return ppl.Event(scene, ppl.Observation(frames), id=name, truth=truth)


def make_study(folder: Path, events: Sequence[ppl.Event], trials: int = 1, **play: Any) -> Study:
    """A study of play without films, quiz and demographics, of short sessions by a fast clock."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phase_study.study.make_clips", lambda folder, world: None)
        study = Study.new(folder, events, "play", raters=1000)
    short = {"steps_per_second": 60, "limit": 18, "hold": 2, "wait_at_most": 60}
    study.settings = dataclasses.replace(
        study.settings, quiz=(), demographics=False, trials=trials,
        play=dataclasses.replace(study.settings.play, **{**short, **play}),
    )  # fmt: skip
    return study


class Player(Person):
    """Somebody who has read the introduction, and practised unless told otherwise."""

    def __init__(self, client: TestClient, practised: bool = True) -> None:
        super().__init__(client)
        site = client.app.state.site  # type: ignore[attr-defined]
        self.prepare(site)
        self.id = self.state()["participant"]
        if practised:
            client.portal.call(  # type: ignore[union-attr]
                lambda: site.ask(site.store.answer, self.id, "practice", 1, {})
            )
        self.messages: list[Message] = []

    def connect(self, **headers: str) -> WebSocketTestSession:
        given = {"origin": HOST, "cookie": self.cookie, **headers}
        return self.client.websocket_connect("ws://localhost/play/socket", headers=given)

    def play(
        self, react: React, until: str | Callable[[Message], bool] = "go", most: int = 5000
    ) -> list[Message]:
        """Answer each message by ``react``, until one (of a kind) comes; return all."""
        is_last = until if callable(until) else lambda message: message["t"] == until
        with self.connect() as socket:
            for _ in range(most):
                try:
                    message = socket.receive_json()
                except WebSocketDisconnect as gone:
                    message = {"t": "closed", "code": gone.code}
                self.messages.append(message)
                if message["t"] == "closed" or is_last(message):
                    return self.messages
                for said in react(message):
                    socket.send_json(said)
        raise AssertionError(f"no {until!r} in {most} messages")


def together(*tasks: Callable[[], Any]) -> list[Any]:
    """Run tasks in threads; return what they return, or raise what one of them raised."""
    with ThreadPoolExecutor(len(tasks)) as pool:
        return [one.result(60) for one in [pool.submit(task) for task in tasks]]


def press(key: str, down: bool = True) -> Message:
    return {"t": "key", "key": key, "down": down}


def both_play(
    client: TestClient, react: React, until: str = "go"
) -> tuple[list[Player], list[list[Message]]]:
    """Let two people play, who react alike; return them and what each was told."""
    players = [Player(client), Player(client)]
    return players, together(*(lambda one=one: one.play(react, until) for one in players))


def drives(*keys: str) -> React:
    """React as somebody who is ready at once, holds keys down and answers pings."""

    def react(message: Message) -> Sequence[Message]:
        said = {"scene": [{"t": "ready"}], "begun": map(press, keys), "ping": [{"t": "pong"}]}
        return list(said.get(message["t"], ()))

    return react
