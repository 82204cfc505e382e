"""A scene in motion, in which agents of others act beside planned ones."""

from __future__ import annotations

import numpy as np

import phase_ppl as ppl
from tests.world.examples import make_scene


def test_planned_agents_do_what_those_of_the_simulator_do() -> None:
    scene = make_scene(walls=[], turning="ccw")
    hypothesis = ppl.Hypothesis("Get blue item to blue lm", "get to red agent")
    rng = np.random.default_rng(3)
    frames = ppl.JointSimulator()(scene, hypothesis, rng)
    expected = [next(frames) for _ in range(5)]
    rng = np.random.default_rng(3)
    stage = ppl.Stage(scene, hypothesis.strengths)
    agents = [stage.planned(n, hypothesis.effective_goals, rng.spawn(1)[0]) for n in range(2)]
    done = [scene.start, *(stage.step([one.decide() for one in agents]) for _ in range(4))]
    np.testing.assert_array_equal(done, expected)


def test_a_frame_is_the_mean_of_its_substeps() -> None:
    whole, parts = (ppl.Stage(make_scene(), [300, 450]) for _ in range(2))
    actions = ppl.Action.UP, ppl.Action.TURN_LEFT
    poses = [parts.state.pose for _ in parts.substeps(actions)]
    assert len(poses) == ppl.Stage.SUBSTEPS
    np.testing.assert_array_equal(np.mean(poses, axis=0), whole.step(actions))
    np.testing.assert_array_equal(parts.state.velocity, whole.state.velocity)


def test_an_agent_sees_what_is_before_it() -> None:
    start = [[16.0, 12.0, 0.0], [16.0, 4.0, 0.0], [16.0, 18.0, 0.0], [8.0, 4.0, 0.0]]
    stage = ppl.Stage(make_scene(start=start, walls=[]), [300, 300])
    assert stage.sees(0).tolist() == [True, False, True, False]
    assert stage.sees(1)[:2].all()
