"""The closed loop as a proposal, against the posterior of the closed loop itself."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest
from jax import random
from scipy.special import softmax

import phase_ppl as ppl
from phase_ppl.inference.guide import bottom_up_guide
from phase_ppl.inference.tables import BottomUpTables, bottom_up_tables
from phase_ppl.models import roles
from phase_ppl.models.density import compiled_quickly, draw, log_density
from phase_ppl.models.model import Model
from phase_ppl.models.stepwise import StepwiseLikelihood
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import SOCIAL
from phase_ppl.world.scene import World
from phase_ppl.world.space import space_of
from tests.inference.toy import never_called

PAIR = World(["red agent", "blue agent"], ["ball"], {"home": (9, 6), "field": (20, 18)})
WINDOW = 3


@pytest.fixture(scope="module", params=["PHASE", "another world"])
def event(request: pytest.FixtureRequest) -> Event:
    if request.param == "PHASE":
        whole = ppl.load_event("collaborate")
        return Event(whole.scene, Observation(whole.observation.trajectory[:6]))
    goals = {"red agent": "ball to home"}
    relation = {("blue agent", "red agent"): "help"}
    return ppl.simulate(PAIR.random_scene(1), goals=goals, relation=relation, frames=6, seed=0)


@pytest.fixture(scope="module")
def tables(event: Event) -> BottomUpTables:
    settings = ppl.SimpleSettings(proposal="closed_loop", window=WINDOW, strength="analytic")
    return bottom_up_tables(event.scene, event.observation, settings)


def prior_of_ways(event: Event) -> Any:
    """(way,) the paper's prior."""
    space = space_of(event.scene.world)
    if space.is_phase:
        return np.array(ppl.sites.ALPHA_PROBABILITIES)
    rest = len(space.ways) - 1
    return np.array([1 - SOCIAL, *[SOCIAL / rest] * rest])


def proposed_ways(event: Event, tables: BottomUpTables, stretch: int) -> Any:
    """(way,) probabilities that are proposed."""
    return softmax(np.log(prior_of_ways(event)) + np.asarray(tables.alpha_logits)[stretch])


@pytest.mark.parametrize("stretch", [0, -1])
def test_it_proposes_goals_as_often_as_the_closed_loop_believes_in_them(
    event: Event, tables: BottomUpTables, stretch: int
) -> None:
    post = ppl.infer(event, Model(likelihood=StepwiseLikelihood(planner_seeds=1)), progress=False)
    space, ways = space_of(event.scene.world), proposed_ways(event, tables, stretch)
    goals = softmax(np.asarray(tables.goal_logits)[stretch], axis=-1)
    at = post.at(WINDOW if stretch == 0 else 5)
    for agent, name in enumerate(space.goal_sites):
        expected = np.zeros(space.n_goals)
        for way, share in enumerate(ways):
            owner = space.owner[way, agent]
            becomes = space.becomes[way, agent]
            possible = becomes >= 0
            np.add.at(expected, becomes[possible], share * goals[way, owner][possible])
        np.testing.assert_allclose(at.marginal(name).values, expected, atol=2e-3)


def test_guide_has_its_density_and_draws_what_can_be(event: Event, tables: BottomUpTables) -> None:
    world = event.scene.world
    prior = roles.uniform if world == PAIR else ppl.priors.uniform
    model = Model(prior=prior, simulator=never_called).in_world(world)
    guide = bottom_up_guide(model.prior, model.sites, tables, prior_share=0.1)
    space, n = space_of(world), 4000
    draws = compiled_quickly(jax.vmap(lambda key: draw(guide, key, 0)))
    drawn = draws(random.split(random.key(0), n))
    columns = {name: np.asarray(values) for name, values in drawn.items()}
    assert all((columns[name] < most).all() for name, most in space.limits.items())
    share = np.bincount(columns[space.company_site], minlength=len(space.ways)) / n
    expected = 0.9 * proposed_ways(event, tables, 0) + 0.1 * prior_of_ways(event)
    np.testing.assert_allclose(share, expected, atol=0.03)
    densities = compiled_quickly(jax.vmap(lambda sites: log_density(guide, sites, 0)))
    assert np.isfinite(np.asarray(densities(drawn))).all()


def test_ctrl_c_while_the_video_is_read_is_an_interrupted_run_without_draws(
    event: Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("phase_ppl.inference.stepwise.read_event", interrupted)
    seen = dataclasses.replace(event, observation=Observation(event.observation.trajectory[:4]))
    with pytest.raises(ppl.Interrupted) as stopped:
        ppl.infer(seen, kernel="local_mh", chains=2, workers=1, progress=False)
    assert stopped.value.posterior is None


def test_what_is_wrong_is_refused_before_the_video_is_read(
    event: Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phase_ppl.inference.stepwise.read_event", never_called)
    seen = dataclasses.replace(event, observation=Observation(event.observation.trajectory[:5]))
    for wrong in ({"budget": ppl.simulations(3)}, {"rule": "papr"}, {"burn_in": 7}):
        with pytest.raises(ppl.PhasePPLError, match=r"too small|papr|burn_in=7"):
            ppl.infer(seen, kernel="local_mh", chains=2, workers=1, progress=False, **wrong)
    table = ppl.Model(likelihood=ppl.StepwiseLikelihood())
    with pytest.raises(ppl.PhasePPLError, match="burn_in=7"):
        ppl.infer(seen, table, kernel="prior_mh", iterations=6, burn_in=7, progress=False)
