"""Priors that look at the video, and what a prior says before a run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random

import phase_ppl as ppl
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event, Observation

MODEL = ppl.Model(
    likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1),
    planner=ppl.PlannerConfig(simulations=14, particles=6),
)


def event(name: str = "collaborate", frames: int = 7) -> Event:
    found = ppl.load_event(name)
    return dataclasses.replace(
        found, observation=Observation(found.observation.trajectory[:frames])
    )


def social(probability: float) -> None:
    each = probability / 4
    probs = jnp.array([1 - probability, each, each, each, each])
    numpyro.sample("alpha", dist.Categorical(probs=probs))
    ppl.sites.goals()
    ppl.sites.strengths()


def share(scene: ppl.Scene, trajectory: Any) -> float:
    """Return a probability that differs from video to video."""
    return float(np.abs(trajectory[-1, :2, 0]).sum() / (4 * max(map(abs, scene.arena))))


def of_scene(scene: ppl.Scene) -> None:
    social(share(scene, scene.start[None]))


def of_event(event: Event) -> None:
    assert event.truth is None
    social(share(event.scene, event.observation.trajectory))


def of_both(observation: Observation, scene: ppl.Scene, scale: float = 1.0) -> None:
    social(scale * share(scene, observation.trajectory))


EVENT = event()
LOOKING = [of_scene, of_both]


def alone(post: Any) -> float:
    return float(post.probability(alpha="(0, 0)"))


@pytest.mark.parametrize("prior", LOOKING)
def test_a_prior_that_looks_is_bound_to_its_event_however_it_is_used(
    prior: Callable[..., None],
) -> None:
    shown = EVENT.scene.start[None] if prior is of_scene else EVENT.observation.trajectory
    expected = pytest.approx(1 - share(EVENT.scene, shown), abs=1e-6)
    model = dataclasses.replace(MODEL, prior=prior)
    assert alone(ppl.priors.summary(prior, EVENT)) == expected
    post = ppl.infer(EVENT, model, workers=1, progress=False)
    assert alone(post.at(0)) == expected
    under = ppl.infer(EVENT, MODEL, workers=1, progress=False).at(3).with_prior(prior)
    np.testing.assert_allclose(under.marginal("relation"), post.at(3).marginal("relation"))
    assert under.settings["model"]["prior"].endswith(prior.__name__)
    if prior is of_both:
        sampled = ppl.infer(post.at(3), kernel="importance", chains=4, iterations=1000, seed=1)
        assert alone(sampled) == pytest.approx(alone(post.at(3)), abs=0.05)


def still(scene: ppl.Scene, hypothesis: Any, rng: Any) -> Iterator[np.ndarray]:
    for _ in range(200):
        yield scene.start


def test_simulations_and_numpyros_own_route_take_one_that_looks() -> None:
    model = ppl.Model(prior=of_event, simulator=still)
    with ppl.program(EVENT, model, workers=1) as program:
        drawn = program.draw_prior(random.key(0))
        assert np.isfinite(program.log_prior(drawn))
        expected = program.model.prior
    post = ppl.infer(EVENT, model, kernel="prior_mh", chains=4, iterations=25, workers=1)
    simulated = post.tree["simulations"].dataset
    goals = np.stack([simulated[name] for name in ("goal_red", "goal_green")], axis=1)
    forces = {n: simulated[n].values for n in ("strength_red", "strength_green")}
    np.testing.assert_allclose(
        simulated["log_prior_effective"],
        log_prior_of_effective(expected, goals, forces),
        rtol=1e-5,
    )
    again = ppl.infer(
        EVENT, ppl.Model(simulator=still), kernel="prior_mh", chains=4, iterations=25, workers=1
    ).with_prior(of_event)
    assert again.settings["model"]["prior"].endswith("of_event")


def test_events_have_priors_of_their_own_and_one_fingerprint() -> None:
    model, other = ppl.Model(prior=of_event), event("independent")
    one, two = (model.in_world(e.scene, e.observation) for e in (EVENT, other))
    assert one.prior == model.in_world(EVENT.scene, EVENT.observation).prior
    assert one.prior != two.prior
    assert one.in_world(other.scene, other.observation).prior == two.prior
    assert one.fingerprint() == two.fingerprint() == model.fingerprint()


def test_watching_takes_a_prior_of_the_scene_and_refuses_one_of_what_is_not_seen_yet() -> None:
    with ppl.watch(EVENT.scene, dataclasses.replace(MODEL, prior=of_scene), threads=1) as watch:
        post = watch.update(EVENT.observation.trajectory[0])
    assert alone(post) == pytest.approx(1 - share(EVENT.scene, EVENT.scene.start[None]), abs=1e-6)
    model = dataclasses.replace(MODEL, prior=of_both)
    with pytest.raises(InvalidSettingError, match="asks for observation and scene, and the whole"):
        ppl.watch(EVENT.scene, model)
    with ppl.watch(EVENT.scene, model, threads=1, observation=EVENT.observation) as watch:
        watch.take(EVENT.observation.trajectory[0])
    for refused in (lambda: ppl.priors.summary(of_event), lambda: ppl.roles.draw(TRIO, 0, in_trio)):
        with pytest.raises(InvalidSettingError, match=r"asks for event|looks at a video"):
            refused()


TRIO = ppl.worlds.TRIO


def in_trio(event: Event) -> None:
    world = event.scene.world
    ppl.roles.goals(world)
    ppl.roles.alpha(world, social=share(event.scene, event.observation.trajectory))
    ppl.roles.strengths(world)


def test_other_worlds_have_priors_that_look_too() -> None:
    scene = TRIO.random_scene(0)
    shown = Event(scene, Observation(np.stack([scene.start] * 3)))
    found = ppl.priors.summary(in_trio, shown)
    nobody = found.probability({}, **{f"alpha_{one}_{other}": "0" for one in TRIO.keys
                                      for other in TRIO.keys if one != other})  # fmt: skip
    # of the hypotheses in which whoever helps or hinders has something to do
    assert 1 > float(nobody) > 1 - share(scene, shown.observation.trajectory)


def test_a_summary_says_what_alpha_comes_to_for_relations() -> None:
    def helping() -> None:
        numpyro.sample("patience", dist.Beta(2.0, 6.0))
        numpyro.sample("alpha", dist.Categorical(probs=jnp.array([4, 3, 3, 1, 1]) / 12))
        ppl.sites.goals()
        ppl.sites.strengths()

    found = ppl.priors.summary(helping)
    odds = found.probability(relation="friendly") / found.probability(relation="adversarial")
    assert 2.5 < odds < 3.0
    assert found.probability(relation="friendly") == pytest.approx(0.495, abs=0.002)
    assert found.probability(relation="friendly").error == 0.0
    assert found.mean("strength_red") == pytest.approx(375.0)
    assert found.marginal("goal_red").sum() == pytest.approx(1.0)
    expected = np.array([4, 3, 3, 1, 1]) / 12
    np.testing.assert_allclose(found.marginal("alpha"), expected, atol=1e-6)
    assert found.query("E[patience]") == pytest.approx(0.25, abs=0.01)
    assert "this is the prior" in str(found)
    alone = ppl.World(agents=["red agent"], items=["blue item"], landmarks={"home": (6, 6)})
    of_one = ppl.priors.summary(ppl.roles.uniform, world=alone).marginal("goal_red")
    np.testing.assert_allclose(of_one.values[of_one.values > 0], 1 / 6, atol=1e-6)
