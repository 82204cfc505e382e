"""The closed loop as a proposal, against the posterior of the closed loop itself."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from scipy.special import softmax

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_table import table_of
from phase_ppl.inference.closed_loop import filtered_frames
from phase_ppl.inference.tables import BottomUpTables, bottom_up_tables
from phase_ppl.models.closed_loop import ClosedLoopLikelihood
from phase_ppl.models.model import Model
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import SOCIAL
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import space_of
from tests.inference.toy import never_called

PAIR = World(["red agent", "blue agent"], ["ball"], {"home": (9, 6), "field": (20, 18)})
WINDOW = 3
GUIDED = ppl.preset("guided")


@functools.cache
def event_of(world: World) -> Event:
    if world == PHASE:
        whole = ppl.load_event("collaborate")
        return Event(whole.scene, Observation(whole.observation.trajectory[:6]))
    goals = {"red agent": "ball to home"}
    relation = {("blue agent", "red agent"): "help"}
    return ppl.simulate(PAIR.random_scene(1), goals=goals, relation=relation, frames=6, seed=0)


@functools.cache
def tables_of(world: World) -> BottomUpTables:
    settings = ppl.SimpleSettings(proposal="closed_loop", window=WINDOW, strength="analytic")
    event = event_of(world)
    return bottom_up_tables(event.scene, event.observation, settings)


def prior_of_ways(world: World) -> Any:
    """(way,) the paper's prior."""
    if world == PHASE:
        return np.array(ppl.sites.ALPHA_PROBABILITIES)
    rest = len(space_of(world).ways) - 1
    return np.array([1 - SOCIAL, *[SOCIAL / rest] * rest])


def proposed_ways(world: World, stretch: int) -> Any:
    """(way,) probabilities that are proposed."""
    logits = np.asarray(tables_of(world).way_logits)[stretch]
    return softmax(np.log(prior_of_ways(world)) + logits)


@pytest.mark.parametrize("world", [PHASE, PAIR])
def test_it_proposes_goals_as_often_as_the_closed_loop_believes_in_them(world: World) -> None:
    model, space = Model(likelihood=ClosedLoopLikelihood(planner_seeds=1)), space_of(world)
    post = ppl.infer(event_of(world), model, progress=False)
    # of the first window and of the whole, which begin with the first frame
    for stretch, frame in ((0, WINDOW), (-1, 5)):
        goals = softmax(np.asarray(tables_of(world).goal_logits)[stretch], axis=-1)
        for agent, name in enumerate(space.goal_sites):
            expected = np.zeros(space.n_goals)
            for way, share in enumerate(proposed_ways(world, stretch)):
                becomes = space.becomes[way, agent]
                possible = becomes >= 0
                of_owner = goals[way, space.owner[way, agent]]
                np.add.at(expected, becomes[possible], share * of_owner[possible])
            found = post.at(frame).marginal(name).values
            np.testing.assert_allclose(found, expected, atol=2e-3)


def test_a_window_shows_its_own_frames_only() -> None:
    model = Model(likelihood=ClosedLoopLikelihood(planner_seeds=1))
    found = filtered_frames(event_of(PHASE), model, progress=False)
    changed = found["density"].copy(deep=True)
    changed[1, 3] += 1000.0  # one frame decides everything
    tables = table_of(found), table_of(found.assign(density=changed))
    after, with_it = (
        [table.log_masses_within(first, 1 + WINDOW) for table in tables] for first in (1, 0)
    )
    np.testing.assert_allclose(*after)
    possible = np.isfinite(with_it[0])
    assert np.abs(with_it[0][possible] - with_it[1][possible]).max() > 100


def test_a_reading_counts_in_the_cost_of_every_run_also_where_it_was_kept() -> None:
    event = unread(3)
    options: dict[str, Any] = {"chains": 2, "iterations": 1, "workers": 1, "progress": False}
    model = Model(planner=ppl.PlannerConfig(simulations=8, particles=4))
    first, again = (ppl.infer(event, model, **GUIDED, **options) for _ in range(2))
    assert first.cost["searches"] == again.cost["searches"] > 0
    assert again.cost["seconds_reading"] == first.cost["seconds_reading"] > 0
    assert again.cost["seconds"] > again.cost["seconds_reading"]


def test_ctrl_c_while_the_video_is_read_is_an_interrupted_run_without_draws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("phase_ppl.inference.closed_loop.filtered_frames", interrupted)
    with pytest.raises(ppl.Interrupted) as stopped:
        ppl.infer(unread(4), **GUIDED, chains=2, workers=1, progress=False)
    assert stopped.value.posterior is None


def test_what_is_wrong_is_refused_before_the_video_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phase_ppl.inference.closed_loop.filtered_frames", never_called)
    for wrong in ({"budget": ppl.simulations(3)}, {"rule": "papr"}):
        with pytest.raises(ppl.PhasePPLError, match=r"too small|papr"):
            ppl.infer(unread(5), **GUIDED, chains=2, workers=1, progress=False, **wrong)
    table = ppl.Model(likelihood=ppl.ClosedLoopLikelihood())
    for wrong in ({"rull": 1},):
        with pytest.raises(ppl.PhasePPLError, match="rull"):
            ppl.infer(unread(5), table, kernel="prior_mh", progress=False, **wrong)


def unread(n_frames: int) -> Event:
    event = event_of(PHASE)
    return dataclasses.replace(
        event, observation=Observation(event.observation.trajectory[:n_frames])
    )
