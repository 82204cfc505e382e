"""Two people, or one and the computer, play sessions that become events."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import phase_ppl as ppl
from phase_ppl.study import play
from phase_ppl.study.study import Study
from tests.study.players import HOST, Player, drives, make_study, near_goals, press, together


@pytest.fixture(autouse=True)
def _begin_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(play, "COUNTDOWN", 0)


@contextlib.contextmanager
def serving(study: Study) -> Iterator[TestClient]:
    with TestClient(study.app(), base_url=HOST) as client:
        yield client


def kinds(messages: list[dict[str, Any]]) -> list[str]:
    """The kinds of messages in their order, each run of them once."""
    found: list[str] = []
    for message in messages:
        if message["t"] != "ping" and message["t"] not in found[-1:]:
            found.append(message["t"])
    return found


def test_two_people_play_until_both_goals_hold(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", [near_goals()], trials=2)
    with serving(study) as client:
        players = [Player(client), Player(client)]
        both = together(*(lambda one=one: one.play(drives("forward")) for one in players))
        assert [player.state()["outcome"] for player in players] == ["finished"] * 2
    for messages in both:
        ends = [message["outcome"] for message in messages if message["t"] == "end"]
        assert ends == ["goals", "goals"]
        scenes = [message for message in messages if message["t"] == "scene"]
        assert [scene["session"] for scene in scenes] == [1, 2]
        assert {scene["agent"] for scene in scenes} == {0, 1}  # the agents are exchanged
        assert scenes[0]["goals"] == ["Get red agent to blue lm", "Get green agent to green lm"]
    with study.store() as store:
        sessions = store.sessions()
    for session in sessions:
        assert session["outcome"] == "goals"
        assert {one["participant"] for one in session["players"]} == {one.id for one in players}
        assert [step["number"] for step in session["steps"]] == [
            *range(1, len(session["steps"]) + 1)
        ]
        assert {step["keys"] for step in session["steps"][1:]} == {'[["forward"], ["forward"]]'}
