"""The joint simulator: agents that want things do them, in a physical world."""

from __future__ import annotations

import itertools
import math

import numpy as np

import phase_ppl as ppl
from phase_ppl.physics.actions import Action
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.geometry import is_on
from tests.agents.scenes import scene

QUICK = ppl.PlannerConfig(simulations=150)
RED_LANDMARK = scene().landmark_centres[2], scene().landmark_half_width
GO = ppl.Hypothesis("Get red agent to red lm", "Get green agent to blue lm")


def frames(where: ppl.Scene, hypothesis: ppl.Hypothesis, n: int, seed: int = 0) -> np.ndarray:
    event = ppl.simulate(where, hypothesis, frames=n, seed=seed, planner=QUICK)
    return event.observation.trajectory


def test_the_same_seed_gives_the_same_event_from_the_start_and_another_seed_another() -> None:
    first, again, other = (frames(scene(), GO, 12, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first[0], scene().start)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_an_agent_reaches_its_landmark_and_stops_there() -> None:
    where = scene(red=(23.5, 16.0, math.pi), green=(9.0, 18.0, 0.0))
    path = frames(where, GO, 40)
    assert is_on(path[-1, 0, :2], *RED_LANDMARK)
    assert np.abs(np.diff(path[-5:, 0, :2], axis=0)).max() < 0.3


def test_a_chaser_closes_in_on_one_that_stands_still() -> None:
    x, y = scene().landmark_centres[1]
    where = scene(red=(10.0, 8.0, 0.0), green=(x, y, 0.0), blue=(8, 20), pink=(24, 4))
    chase = ppl.Hypothesis("get to green agent", "Get green agent to green lm")
    path = frames(where, chase, 50)
    gap = np.linalg.norm(path[:, 0, :2] - path[:, 1, :2], axis=1)
    assert gap.min() < 4.0 < gap[0]
    before = path[: (gap < 4.0).argmax(), 1, :2]
    assert np.linalg.norm(before - before[0], axis=1).max() < 0.1


def test_where_agents_turn_one_way_they_try_both_and_turn_that_way() -> None:
    taken = []
    for seed, (turning, sign) in enumerate((("ccw", 1), ("cw", -1))):
        where = scene(turning=turning, red=(16.0, 8.0, sign * 1.0), blue=(8, 14), pink=(24, 14))
        run = JointSimulator(QUICK).steps(where, GO, np.random.default_rng(seed))
        steps = list(itertools.islice(run, 25))
        actions = [decisions[0].action for _, decisions in steps[1:]]
        turned = np.diff([frame[0, 2] for frame, _ in steps])
        for action, turn in zip(actions, turned, strict=True):
            if action in (Action.TURN_LEFT, Action.TURN_RIGHT):
                assert sign * turn > 0.1
        taken += actions
    assert {Action.TURN_LEFT, Action.TURN_RIGHT} <= set(taken)
