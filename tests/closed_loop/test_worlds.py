"""Reading videos of any world, against PHASE and against the whole product of actions."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.closed_loop.hidden_state import HiddenState, Tracking, balanced
from phase_ppl.physics import compiled, inverse
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.event import State

QUICK = PlannerConfig(simulations=10, particles=10)
TRIO = ppl.worlds.TRIO


def model(planner_seeds: int) -> ppl.Model:
    likelihood = ppl.ClosedLoopLikelihood(planner_seeds=planner_seeds)
    return ppl.Model(likelihood=likelihood, planner=QUICK)


@pytest.mark.parametrize("planner_seeds", [1, 2])
def test_phase_under_another_name_is_read_as_phase(planner_seeds: int) -> None:
    event = ppl.load_event("compete")
    scene, known = event.scene, {f.name for f in dataclasses.fields(ppl.Scene)} - {"world"}
    renamed = dataclasses.replace(ppl.worlds.PHASE, name="another")
    other = ppl.Scene(**{name: getattr(scene, name) for name in known}, world=renamed)
    seen = ppl.Observation(event.observation.trajectory[:7])
    phase, own = (
        ppl.infer(ppl.Event(one, seen), model(planner_seeds), workers=1, progress=False)
        for one in (scene, other)
    )
    slack = 1e-6
    for name, theirs in (("goal_red",) * 2, ("relation", "relation_red_green")):
        for one, other in (
            (own.marginal(theirs), phase.marginal(name)),
            (own.over_time()[theirs], phase.over_time()[name]),
        ):
            np.testing.assert_allclose(one.values, other.values, rtol=0, atol=slack)
    helps = phase.probability(alpha=["(1, 0)"])
    assert own.probability(alpha_red_green="1") == pytest.approx(helps, abs=slack)
    assert own.mean("strength_green") == pytest.approx(phase.mean("strength_green"), abs=1)
    assert own.log_evidence == pytest.approx(phase.log_evidence, abs=100 * slack)
    np.testing.assert_allclose(own.surprise(), phase.surprise(), atol=100 * slack)
    for event_of_phase in ("relation=friendly", "strength_red > 400"):
        odds = phase.why(event_of_phase).log_odds.values
        found = own.why(event_of_phase.replace("relation", "relation_red_green")).log_odds.values
        np.testing.assert_allclose(found, odds, atol=100 * slack)
    error = phase.marginal("goal_red").error.values
    np.testing.assert_allclose(own.marginal("goal_red").error.values, error, atol=slack)


def near(distance: float) -> ppl.Scene:
    middle = np.array([18.0, 6.0])
    around = [middle + distance * np.array([np.cos(a), np.sin(a)]) for a in (0.3, 2.4, 4.5)]
    start = {name: (*spot, 0.4) for name, spot in zip(TRIO.agents, around, strict=True)}
    return TRIO.scene({**start, "blue ball": tuple(middle), "pink ball": (4.0, 20.0)}, size=0.8)


@pytest.mark.parametrize(("distance", "tolerance"), [(4.8, 1e-9), (1.9, 0.1)])
def test_joint_actions_of_three_follow_from_few_trials(distance: float, tolerance: float) -> None:
    scene = near(distance)
    state = compiled.from_state(State.at_start(scene), scene.radius)
    params = compiled.make_params(scene, (450.0, 300.0, 600.0), inner_steps=4)
    scratch, trial = compiled.make_scratch(5, 3), inverse.make_trial(5, 3)
    doing = (3, 9, 6)
    trial.actions[:] = doing
    inverse.attempt(*state, params, scratch, trial)
    observed, strengths = trial.frame.copy(), np.array([[450.0, 300.0, 600.0]])
    found = np.empty((1, N_ACTIONS**3))
    batch = [part[None] for part in state]
    scatter = inverse.Scatter(np.full(5, 0.06), np.full(5, 0.06), 3.0)
    inverse.try_all(*batch, strengths, observed, scatter, params, scratch, trial, found)
    table = found.reshape((N_ACTIONS,) * 3)
    assert np.unravel_index(found.argmax(), table.shape) == doing
    deviations = []
    for joint in np.random.default_rng(0).integers(N_ACTIONS, size=(200, 3)):
        trial.actions[:] = joint
        inverse.attempt(*state, params, scratch, trial)
        exact = sum(
            inverse._entity_log_density(trial.frame, observed, e, e < 3, scatter) for e in range(5)
        )
        deviations.append(abs(table[tuple(joint)] - exact))
    assert np.percentile(deviations, 95) < tolerance


def test_strengths_that_are_followed_are_balanced() -> None:
    levels = (150.0, 300.0, 450.0, 600.0)
    for n_agents, n in ((1, 4), (2, 16), (3, 16), (4, 16)):
        found = balanced(levels, n_agents)
        assert found.shape == (n, n_agents)
        for agent in range(n_agents):
            assert np.bincount(np.searchsorted(levels, found[:, agent])).tolist() == [n // 4] * 4
        for one, other in itertools.combinations(range(min(n_agents, 3)), 2):
            assert len({tuple(pair) for pair in found[:, [one, other]].tolist()}) == 16


def test_a_lone_agent_that_pushes_shows_its_strength() -> None:
    scene = ppl.worlds.SOLO.scene({"red agent": (4, 9), "ball": (20, 4), "box": (20, 14)})
    event = ppl.simulate(
        scene, goals={"red agent": "touch ball"}, strength={"red agent": 600.0}, frames=10, seed=0
    )
    hidden = HiddenState(scene, Tracking(strength_weight=1.0))
    for frame in event.observation.trajectory[1:]:
        hidden.advance(frame)
    assert hidden.combinations[hidden.strengths().argmax()].tolist() == [600.0]
