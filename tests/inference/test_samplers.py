"""Samplers beyond Metropolis-Hastings against exact enumeration, and in whole runs."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random

import phase_ppl as ppl
from phase_ppl.inference.kernels.enumeration import Enumeration, hypothesis_grid
from phase_ppl.inference.kernels.importance import Importance
from phase_ppl.inference.kernels.smc import SMC
from phase_ppl.inference.kernels.wrapped import Ensemble, GibbsKernel, SampleAdaptive
from phase_ppl.inference.registry import kernel_info
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from tests.inference.toy import (
    ALPHA_CODES,
    ALPHA_MASS,
    GREEN_GOALS,
    GREEN_MASS,
    N_FRAMES,
    RED_GOALS,
    RED_MASS,
    SETTINGS,
    TableRunner,
    exact_posterior,
    few_goals,
    never_called,
    run,
    table_errors,
    table_guide,
    table_program,
    total_variation,
    visited_share,
    walkers,
    walking_event,
)

ERRORS = table_errors()
EXACT = exact_posterior(ERRORS)
EVENT = walking_event()
SAMPLERS = ("aies", "enumerate", "gibbs", "importance", "sa", "smc")

# kernel class, chains, steps, total variation allowed: twice what such a run gives
REACHES: dict[str, tuple[type[Any], int, int, float]] = {
    "sa": (SampleAdaptive, 60, 500, 0.12),
    "aies": (Ensemble, 60, 400, 0.09),
    "gibbs": (GibbsKernel, 60, 100, 0.09),
}
PARTICLES = 2500


def keys(n: int) -> jax.Array:
    return random.split(random.key(0), n)


def last_half(states: Any) -> dict[str, Any]:
    return {name: np.asarray(v)[len(v) // 2 :] for name, v in states.z.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", REACHES)
def test_numpyros_samplers_reach_the_enumerated_posterior(name: str) -> None:
    kernel_class, chains, steps, allowed = REACHES[name]
    program, bridge = table_program(TableRunner(ERRORS))
    kernel = kernel_class(program)
    states = run(kernel, steps, keys(chains))
    assert total_variation(visited_share(last_half(states)), EXACT) < allowed
    strength = last_half(states)["strength_red"]
    assert strength.mean() == pytest.approx(375, abs=25)
    assert strength.std() == pytest.approx(450 / np.sqrt(12), abs=25)
    per_step = getattr(kernel, "sims_per_step", kernel_info(name).sims_per_step)
    promised = chains * (getattr(kernel, "sims_at_start", 1) + steps * per_step)
    # compiled code may round a site so differently that its simulation is not known again
    assert len(bridge.records) <= 1.001 * promised
    if name == "sa":
        assert len(bridge.records) > 0.99 * promised


def test_importance_weights_lead_to_the_enumerated_posterior() -> None:
    program, bridge = table_program(TableRunner(ERRORS))
    states = run(Importance(program, table_guide(), SETTINGS), 100, keys(100))
    assert total_variation(visited_share(states.z, states.log_weight), EXACT) < 0.06
    assert total_variation(visited_share(states.z), EXACT) > 0.1
    assert len(bridge.records) == 100 * 101
    assert all(record.result.completed for record in bridge.records)


@functools.cache
def population() -> tuple[Any, int]:
    program, bridge = table_program(TableRunner(ERRORS))
    states = run(SMC(program, table_guide(), SETTINGS), 8, keys(PARTICLES))
    return states, len(bridge.records)


def test_large_population_is_close_to_the_enumerated_posterior() -> None:
    states, simulations = population()
    assert simulations == PARTICLES * 9
    temperature = np.asarray(states.temperature)
    assert (np.diff(temperature, axis=0) >= 0).all()
    assert (temperature == temperature[:, :1]).all()
    assert (temperature[-1] == 1).all()
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    assert (last.log_weight == 0).all()
    assert total_variation(visited_share(last.z, last.log_weight), EXACT) < 0.06


def test_population_before_temperature_one_carries_the_weight_that_is_left() -> None:
    states, _ = population()
    first = jax.tree.map(lambda leaf: leaf[0], states)
    assert 0 < first.temperature[0] < 1
    assert total_variation(visited_share(first.z, first.log_weight), EXACT) < 0.09
    left = 1 - float(first.temperature[0])
    expected = -left * 0.05 * np.asarray(first.particle.step_error).sum(axis=1)
    np.testing.assert_allclose(first.log_weight, expected, atol=1e-3)


def test_population_estimates_the_evidence() -> None:
    log_masses = []
    for r, g, a in np.ndindex(EXACT.shape):
        prior = RED_MASS[r] * GREEN_MASS[g] * ALPHA_MASS[a]
        h = Hypothesis(RED_GOALS[r], GREEN_GOALS[g], ALPHAS[ALPHA_CODES[a]])
        by_seed = RadialLikelihood().log_prob(ERRORS[h.effective_goals]).sum(axis=-1)
        log_masses.append(np.log(prior) + np.logaddexp.reduce(by_seed) - np.log(len(by_seed)))
    states, _ = population()
    assert float(states.log_evidence[-1, 0]) == pytest.approx(
        np.logaddexp.reduce(log_masses), abs=0.1
    )


def test_enumeration_visits_every_hypothesis_once_and_weighs_it() -> None:
    runner = TableRunner(np.repeat(ERRORS.mean(axis=2, keepdims=True), 3, axis=2))
    program, bridge = table_program(runner)
    kernel = Enumeration(program, strengths=[300.0, 400])
    assert kernel.n_simulations == 11 * 4
    assert kernel.n_iterations(16) == 2
    step = compiled_quickly(kernel.sample)
    states = [compiled_quickly(lambda keys: kernel.init(keys, 0))(keys(16))]
    for _ in range(2):
        states.append(step(states[-1]))
    hypotheses = [record.result.hypothesis for record in bridge.records]
    assert len({(*h.effective_goals, *h.strengths) for h in hypotheses}) == len(hypotheses) == 44
    log_weight = np.array([state.log_weight for state in states])
    assert np.isneginf(log_weight).sum() == 3 * 16 - 44
    weight = np.exp(log_weight - log_weight.max()).ravel()
    codes = [np.ravel([state.z[name] for state in states]) for name in STATED]
    found = by_effective_goals(zip(*codes, weight / weight.sum(), strict=True))
    exact = by_effective_goals(
        (RED_GOALS[r], GREEN_GOALS[g], ALPHA_CODES[a], share)
        for (r, g, a), share in np.ndenumerate(exact_posterior(runner.errors))
    )
    assert found == pytest.approx(exact, abs=1e-4)


STATED = ("goal_red", "goal_green", "alpha")


def narrow() -> None:
    ppl.sites.goals()
    ppl.sites.alpha()
    numpyro.sample("strength_red", dist.Uniform(200.0, 400.0))
    numpyro.sample("strength_green", dist.Uniform(150.0, 600.0))


@pytest.mark.parametrize(
    ("prior", "strengths", "masses"),
    [
        ("uniform", (150.0, 300.0, 450.0, 600.0), [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
        ("uniform", (400.0, 200.0), [1 / 3, 2 / 3]),
        ("uniform", (300.0, 300.0, 450.0), [1 / 2, 1 / 2]),
        (narrow, (200.0, 300.0, 400.0), [1 / 4, 1 / 2, 1 / 4]),
    ],
    ids=["the default", "in any order", "one of them twice", "cut to the support"],
)
def test_a_strength_of_the_grid_has_the_prior_mass_of_those_nearest_to_it(
    prior: Any, strengths: tuple[float, ...], masses: list[float]
) -> None:
    grid = hypothesis_grid(Model(prior=prior), strengths)
    _, place = np.unique(grid.sites["strength_red"], return_inverse=True)
    found = np.bincount(place, np.exp(grid.log_prior.astype(float)))
    np.testing.assert_allclose(found, masses, atol=1e-4)


def by_effective_goals(rows: Iterable[Any]) -> dict[tuple[int, int], float]:
    found: dict[tuple[int, int], float] = {}
    for red, green, alpha, share in rows:
        pair = Hypothesis(int(red), int(green), ALPHAS[alpha]).effective_goals
        found[pair] = found.get(pair, 0.0) + float(share)
    return found


# --- whole runs --------------------------------------------------------------------------------

OPTIONS: dict[str, dict[str, Any]] = {
    "enumerate": {"strengths": [300.0, 400.0]},
    "gibbs": {"iterations": 2},
    "smc": {"iterations": 3},
    "sa": {"iterations": 2, "pool": 3},
    "aies": {"iterations": 2, "chains": 12},
    "importance": {"iterations": 2},
}
MOST = {"enumerate": 44, "gibbs": 54, "smc": 24, "sa": 30, "aies": 36, "importance": 18}
DRAWS = {"enumerate": 8, "importance": 3, "smc": 1}


def infer(kernel: str, **options: Any) -> ppl.Posterior:
    model = Model(prior=few_goals, simulator=walkers)
    given = {"chains": 6, "workers": 1, "progress": False, **OPTIONS[kernel], **options}
    return ppl.infer(EVENT, model, kernel=kernel, **given)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", SAMPLERS)
def test_whole_run_keeps_its_promise_and_survives_a_file(kernel: str, tmp_path: Any) -> None:
    post = infer(kernel)
    again = ppl.Posterior.load(post.save(tmp_path / "run.nc"))
    assert str(again) == str(post)
    assert "chain" in post.tree["posterior"].sizes
    assert post.tree["posterior"].sizes["draw"] == DRAWS.get(kernel, 2)
    assert post.cost["simulations"] <= MOST[kernel]
    weighted = kernel_info(kernel).weighted
    assert post.weights == "count"
    assert ("weighted draws" in post.diagnostics()["verdict"]) == weighted
    weight = post.tree["sample_stats"]["log_weight"].values
    assert (np.ptp(weight) > 0) == (kernel in ("enumerate", "importance"))
    assert ("log_evidence" in post.tree["sample_stats"]) == (kernel == "smc")
    assert post.tree.attrs["validity"] == kernel_info(kernel).validity
    if kernel == "enumerate":
        assert post.cost["simulations"] == 44
        assert np.isfinite(weight).sum() == 44


# --- what is refused ---------------------------------------------------------------------------


def hidden() -> None:
    ppl.priors.uniform()
    numpyro.sample("mood", dist.MultivariateNormal(jnp.zeros(2), jnp.eye(2)))


def counted() -> None:
    ppl.priors.uniform()
    numpyro.sample("mood", dist.Poisson(3.0))


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "odd": ("aies", {"chains": 15}, r"chains=15.*even.*16"),
    "few": ("aies", {"chains": 10}, r"chains=10.*12"),
    "aies site": ("aies", {"chains": 16, "prior": hidden}, "'mood'.*MultivariateNormal"),
    "sa site": ("sa", {"prior": counted}, "'mood'.*Poisson.*inverse"),
    "pool": ("sa", {"pool": 1}, "pool=1"),
    "gibbs site": ("gibbs", {"prior": counted}, "'mood'.*Poisson"),
    "step": ("gibbs", {"step": 0}, "step=0"),
    "too many": ("enumerate", {"noise_seeds": 10}, r"\d+ simulations, more than .*50000"),
    "own site": ("enumerate", {"prior": counted}, "mood.*enumerated"),
    "strengths": ("enumerate", {"prior": few_goals, "strengths": [900.0]}, r"no mass.*900"),
    "no strength": ("enumerate", {"strengths": []}, "strengths="),
    "seeds": ("enumerate", {"noise_seeds": 2, "noise": "fixed"}, "noise='fixed'"),
    "own length": (
        "enumerate",
        {"prior": few_goals, "iterations": 6, "chains": 16},
        "iterations=6.*takes 10",
    ),
    "target": ("smc", {"target": 1.0}, "target=1.0"),
    "move": ("smc", {"move": "prior"}, "prior_mh"),
}


@pytest.mark.parametrize(("kernel", "options", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_work_is_refused_before_anything_is_simulated(
    kernel: str, options: dict[str, Any], message: str
) -> None:
    given = {"workers": 1, "progress": False, **options}
    model = Model(
        prior=given.pop("prior", ppl.priors.uniform),
        simulator=never_called,
        noise=given.pop("noise", "fresh"),
    )
    with pytest.raises((InvalidSettingError, UnknownNameError), match=message):
        ppl.infer(EVENT, model, kernel=kernel, **given)


@pytest.mark.parametrize("name", SAMPLERS)
def test_a_sampler_says_how_valid_it_is(name: str) -> None:
    info = kernel_info(name)
    assert info.validity == ("exact" if name in ("aies", "gibbs") else "consistent")
    if not info.needs:
        program = EventProgram(Model(prior=few_goals, simulator=never_called), 0, N_FRAMES)
        assert info.make(program).validity == info.validity  # type: ignore[attr-defined]
