"""Simulated agents are asked why: in sentences, and in a film of both minds."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import InvalidEventError
from tests.agents.scenes import FULL_WALL_UP, scene

QUICK = ppl.PlannerConfig(simulations=60, particles=20)
CARRY = ppl.Hypothesis("Get blue item to red lm", "Get green agent to green lm")


@pytest.fixture(scope="module")
def event() -> ppl.Event:
    """Red, who looks away from it, wants an item that lies in the other room."""
    where = scene(
        (18.0, 8.0, 0.0), (23.5, 19.0, 0.0), (18.0, 5.0), walls=[[[16.0, 12.0], [16.0, 6.0]]]
    )
    return ppl.simulate(where, CARRY, frames=30, seed=0, planner=QUICK)


def test_an_event_knows_what_its_agents_thought(event: ppl.Event) -> None:
    thoughts = event.thoughts
    assert len(thoughts.subgoals) == len(thoughts.actions) == 29
    assert thoughts.particles.shape == (29, 2, 20, 4, 3)
    assert thoughts.seen[:, [0, 1], [0, 1]].all()  # itself
    own = thoughts.particles[:, 0, :, 0]
    frames = event.observation.trajectory[:-1, 0]
    assert np.abs(own[0] - event.scene.start[0]).max() < 1e-5
    assert np.linalg.norm(own.mean(axis=1)[:, :2] - frames[:, :2], axis=1).max() < 1.5
    seen = thoughts.seen[:, 0, 2]
    assert not seen[0]
    assert seen.any()
    spread = thoughts.particles[:, 0, :, 2, :2].std(axis=1).max(axis=1)
    assert spread[seen].max() < 1e-5 < 1 < spread[0]


def test_it_is_said_in_sentences_and_shown_in_a_film(event: ppl.Event, tmp_path: Path) -> None:
    words = " ".join(ppl.explain(event).split())
    assert "the red agent goes" in words
    assert "does not see the blue item and believes it" in words
    assert "as it holds the blue item" in words
    assert "the green agent does nothing, as it has what it wants" in words
    brief = ppl.simulate(event.scene, CARRY, frames=3, planner=QUICK)
    ppl.explain(brief, tmp_path / "why.mp4")
    assert (tmp_path / "why.mp4").stat().st_size > 5000


def test_thoughts_that_are_not_known_are_not_made_up(event: ppl.Event) -> None:
    with pytest.raises(InvalidEventError, match="thought"):
        ppl.explain(ppl.load_event("collaborate"))
    shorter = ppl.Observation(event.observation.trajectory[:10])
    with pytest.raises(InvalidEventError, match="29 steps"):
        ppl.explain(dataclasses.replace(event, observation=shorter))


def test_bodies_that_overlap_are_refused_with_how_far() -> None:
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"red": (8, 20, 0), "green": (8.5, 20, 0)}, "the red agent and the green agent .* 1.60"),
        ({"red": (16, 17, 0), "walls": [FULL_WALL_UP]}, "the red agent and an inner wall .* 1.20"),
        ({"blue": (25.6, 4)}, "the blue item and the arena's border overlap by 0.40"),
    )
    for changes, words in wrong:
        with pytest.raises(InvalidEventError, match=words):
            ppl.simulate(scene(**changes), CARRY, frames=2, planner=QUICK)
        ppl.simulate(scene(**changes), CARRY, frames=2, planner=QUICK, overlapping=True)
