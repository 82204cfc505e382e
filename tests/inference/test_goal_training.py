from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.tables import bottom_up_tables, goal_features, joint_logits
from phase_ppl.models.sites import ALPHA_PROBABILITIES, SELF_REFERRING
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import GOALS, N_GOALS, effective_goals, goal_index
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import AGENTS, LANDMARKS
from phase_ppl.world.scene import Scene
from tests.inference.toy import SCENE, START, moving

RED, GREEN = 0, 1
N_FRAMES = 21


def most_probable(observation: Observation, agent: int) -> str:
    tables = bottom_up_tables(SCENE, observation, SimpleSettings())
    alone = np.asarray(tables.goal_logits)[-1, ALPHAS.index((0, 0)), agent]
    return GOALS[int(alone.argmax())]


def test_one_frame_of_motion_is_enough() -> None:
    short = Observation(moving(_0=(16.0, 12.0)).trajectory[:2])
    tables = bottom_up_tables(SCENE, short, SimpleSettings())
    assert np.isfinite(np.asarray(tables.goal_logits)).all()


def test_features_do_not_depend_on_which_landmark_it_is() -> None:
    # the scene turned by half a circle has landmarks 0 and 2, 1 and 3 exchanged; on the middle
    # line a body is in one room before and after
    off_the_line = np.array([[0], [0], [0], [-1]]) * [0, 1, 0]
    start = START + off_the_line
    given, scene = (Scene(s, SCENE.radius) for s in (start, start * [-1, -1, 1] + [32, 24, 0]))
    there = moving(_0=(15.7, 12.6), _2=(12.3, 12.7)).trajectory + off_the_line
    back = there * np.array([-1, -1, 1]) + np.array([32, 24, 0])
    first, last = np.array([0]), np.array([N_FRAMES - 1])
    one = goal_features(given, Observation(there), first, last)
    other = goal_features(scene, Observation(back), first, last)
    landmarks = SCENE.landmark_centres
    partner = [int(np.argmin(np.abs(landmarks - ([32, 24] - c)).sum(axis=1))) for c in landmarks]
    for number, goal in enumerate(GOALS):
        twin = number
        for name, place in zip(LANDMARKS, partner, strict=True):
            if goal.endswith(name):
                twin = goal_index(goal.removesuffix(name) + LANDMARKS[place])
        np.testing.assert_allclose(one[0, :, number], other[0, :, twin], atol=1e-9)


@pytest.mark.parametrize("agent", [RED, GREEN])
def test_an_agent_that_walks_to_a_landmark_and_stays_is_taken_to_want_that(agent: int) -> None:
    place = 23.5, 19.5
    nearest = np.linalg.norm(SCENE.landmark_centres - place, axis=1).argmin()
    wanted = f"Get {AGENTS[agent]} to {LANDMARKS[nearest]}"
    assert most_probable(moving(**{f"_{agent}": place}), agent) == wanted


def test_tables_are_those_of_the_joint_distribution() -> None:
    scores = np.random.default_rng(0).normal(0, 2, (2, N_GOALS))
    goal, alpha = joint_logits(scores)
    expected = np.zeros((N_GOALS, N_GOALS, len(ALPHAS)))
    for red, green, index in np.ndindex(expected.shape):
        if not (SELF_REFERRING[RED, red] or SELF_REFERRING[GREEN, green]):
            goals = effective_goals(red, green, ALPHAS[index])
            together = scores[RED, goals[0]] + scores[GREEN, goals[1]]
            expected[red, green, index] = ALPHA_PROBABILITIES[index] * np.exp(together)
    alpha = np.array(ALPHA_PROBABILITIES) * np.exp(alpha)
    goal = np.exp(goal - goal.max(axis=-1, keepdims=True))
    goal /= goal.sum(axis=-1, keepdims=True)
    found = np.einsum("a,ar,ag->rga", alpha / alpha.sum(), goal[:, RED], goal[:, GREEN])
    np.testing.assert_allclose(found, expected / expected.sum(), atol=1e-12)
