"""Samplers beyond Metropolis-Hastings against exact enumeration, and in whole runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random
from numpyro.infer import ESS

import phase_ppl as ppl
from phase_ppl.inference.kernels.smc import SMC
from phase_ppl.inference.kernels.weighted import (
    Enumeration,
    Importance,
    WeightedState,
    hypothesis_grid,
)
from phase_ppl.inference.registry import info_of, kernel_info
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from tests.inference.toy import (
    ALPHA_CODES,
    GREEN_GOALS,
    RED_GOALS,
    SETTINGS,
    TableRunner,
    exact_log_evidence,
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
PARTICLES, STEPS = 2500, 8
STATED = ("goal_red", "goal_green", "alpha")


def keys(n: int) -> jax.Array:
    return random.split(random.key(0), n)


class OfOnesOwn(ppl.kernels.NumpyroKernel):
    sims_per_step = 20

    def sampler(self) -> ESS:
        return ESS(potential_fn=self.potential, tune_mu=False, randomize_split=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "steps", "allowed"),
    [("sa", 500, 0.12), ("aies", 400, 0.09), ("gibbs", 100, 0.09), (OfOnesOwn, 100, 0.09)],
)
def test_numpyros_samplers_reach_the_enumerated_posterior(
    kernel: Any, steps: int, allowed: float
) -> None:
    """The total variation that is allowed is twice what such a run gives."""
    program, bridge = table_program(TableRunner(ERRORS))
    info = info_of(kernel)
    kernel = info.make(program)
    states = run(kernel, steps, keys(60))
    z = {site: np.asarray(v)[len(v) // 2 :] for site, v in states.z.items()}
    assert total_variation(visited_share(z), EXACT) < allowed
    strength = z["strength_red"]
    assert strength.mean() == pytest.approx(375, abs=25)
    assert strength.std() == pytest.approx(450 / np.sqrt(12), abs=25)
    # compiled code may round a site so differently that its simulation is not known again
    per_step = getattr(kernel, "sims_per_step", info.sims_per_step)
    promised = 60 * (getattr(kernel, "sims_at_start", 1) + steps * per_step)
    assert len(bridge.records) <= 1.001 * promised
    if info.name == "sa":
        assert len(bridge.records) > 0.99 * promised


def test_importance_weights_lead_to_the_enumerated_posterior() -> None:
    program, bridge = table_program(TableRunner(ERRORS))
    z = {name: jnp.zeros(100, int) for name in STATED}
    z |= {name: jnp.zeros(100) for name in ("strength_red", "strength_green")}
    start = jax.vmap(WeightedState.before)(keys(100), z)
    states = run(Importance(program, table_guide(), SETTINGS), 100, keys(100), start)
    assert total_variation(visited_share(states.z, states.log_weight), EXACT) < 0.06
    assert total_variation(visited_share(states.z), EXACT) > 0.1
    assert len(bridge.records) == 100 * 100
    assert all(record.result.completed for record in bridge.records)


@pytest.mark.parametrize("move", ["prior_mh", pytest.param("local_mh", marks=pytest.mark.slow)])
def test_a_population_is_cooled_to_the_posterior_and_estimates_the_evidence(move: Any) -> None:
    program, bridge = table_program(TableRunner(ERRORS))
    states = run(SMC(program, table_guide(), SETTINGS, move=move), STEPS, keys(PARTICLES))
    assert len(bridge.records) == PARTICLES * (1 + STEPS)
    temperature = np.asarray(states.temperature)
    assert (np.diff(temperature, axis=0) >= 0).all()
    assert (temperature == temperature[:, :1]).all()
    assert (temperature[-1] == 1).all()
    first, last = (jax.tree.map(lambda leaf, step=step: leaf[step], states) for step in (0, -1))
    assert (last.log_weight == 0).all()
    assert total_variation(visited_share(last.z), EXACT) < 0.06
    # before temperature one the draws carry the weight that is left
    assert 0 < first.temperature[0] < 1
    assert total_variation(visited_share(first.z, first.log_weight), EXACT) < 0.09
    left = 1 - float(first.temperature[0])
    expected = -left * 0.05 * np.asarray(first.particle.step_error).sum(axis=1)
    np.testing.assert_allclose(first.log_weight, expected, atol=1e-3)
    evidence = [float(state.log_evidence[0]) for state in (first, last)]
    assert evidence == pytest.approx([exact_log_evidence(ERRORS)] * 2, abs=0.1)


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


def narrow() -> None:
    ppl.sites.goals()
    ppl.sites.alpha()
    numpyro.sample("strength_red", dist.Uniform(200.0, 400.0))
    numpyro.sample("strength_green", dist.Uniform(150.0, 600.0))


@pytest.mark.parametrize(
    ("prior", "strengths", "masses"),
    [
        ("uniform", (600.0, 150.0, 300.0, 450.0, 300.0), [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
        (narrow, (200.0, 300.0, 400.0), [1 / 4, 1 / 2, 1 / 4]),
    ],
    ids=["in any order, one of them twice", "cut to the support"],
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "options", "most", "draws"),
    [
        ("enumerate", {"strengths": [300.0, 400.0]}, 44, 8),
        ("gibbs", {"iterations": 2}, 54, 2),
        ("sa", {"iterations": 2}, 300, 2),
        ("aies", {"iterations": 2, "chains": 12}, 36, 2),
        ("smc", {"iterations": 3}, 24, 1),
        ("importance", {"iterations": 2}, 18, 3),
        ("amis", {"iterations": 2}, 18, 3),
    ],
)
def test_whole_run_keeps_its_promise_and_survives_a_file(
    kernel: str, options: dict[str, Any], most: int, draws: int, tmp_path: Any
) -> None:
    model = Model(prior=few_goals, simulator=walkers)
    given: dict[str, Any] = {"chains": 6, "workers": 1, "progress": False, **options}
    post, info = ppl.infer(EVENT, model, kernel=kernel, **given), kernel_info(kernel)
    again = ppl.load_posterior(post.save(tmp_path / "run.nc"))
    assert str(again) == str(post)
    assert post.tree["posterior"].sizes["draw"] == draws
    assert post.cost["simulations"] <= most
    assert post.weights == "count"
    checks = {check["name"] for check in post.diagnostics()["checks"]}
    assert ("weighted draws" in checks) == info.weighted
    weight = post.tree["sample_stats"]["log_weight"].values
    assert (np.ptp(weight) > 0) == (kernel in ("enumerate", "importance", "amis"))
    estimates = kernel in ("smc", "importance", "amis")
    assert np.isfinite(post.log_evidence) == estimates
    assert np.isfinite(post.log_evidence.error) == (estimates and kernel != "smc")
    reason = "other seeds" if kernel == "smc" else "use smc, importance or amis"
    assert (reason in str(post.log_evidence)) == (kernel not in ("importance", "amis"))
    assert post.tree.attrs["validity"] == info.validity
    if kernel == "enumerate":
        assert post.cost["simulations"] == np.isfinite(weight).sum() == 44


def alike_in_strength() -> None:
    ppl.sites.goals()
    ppl.sites.alpha()
    red = numpyro.sample("strength_red", dist.Uniform(150.0, 600.0))
    near = dist.TruncatedNormal(red, 60.0, low=150.0, high=600.0)
    numpyro.sample("strength_green", near)


def test_the_grid_has_the_mass_of_strengths_that_go_together() -> None:
    levels = np.array([150.0, 300.0, 450.0, 600.0])
    grid = hypothesis_grid(Model(prior=alike_in_strength), levels.tolist())
    place = [np.searchsorted(levels, grid.sites[f"strength_{key}"]) for key in ("red", "green")]
    found = np.zeros((4, 4))
    np.add.at(found, tuple(place), np.exp(grid.log_prior))
    ends = np.array([150.0, 225.0, 375.0, 525.0, 600.0])
    red = 150 + 0.1 * (np.arange(4500) + 0.5)
    green = np.diff(np.asarray(dist.Normal(red[:, None], 60.0).cdf(ends)))
    expected = np.zeros((4, 4))
    shares = green / green.sum(axis=1, keepdims=True) / len(red)
    np.add.at(expected, np.searchsorted(ends[1:-1], red), shares)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def counted() -> None:
    ppl.priors.uniform()
    numpyro.sample("mood", dist.Poisson(3.0))


@pytest.mark.parametrize(
    ("kernel", "options", "message"),
    [
        ("aies", {"chains": 15}, r"chains=15: AIES moves 6 .* even .* 12 or more"),
        ("aies", {"chains": 10}, r"chains=10.*12"),
        ("sa", {"prior": counted}, "'mood'.*Poisson.*inverse"),
        ("gibbs", {"prior": counted}, "'mood'.*Poisson"),
        ("enumerate", {"strengths": [*range(150, 600, 40)]}, r"\d+ hypotheses .*more than 50000"),
        ("enumerate", {"prior": counted}, "mood.*enumerated"),
        ("enumerate", {"prior": few_goals, "strengths": [900.0]}, r"no mass.*900"),
        ("enumerate", {"strengths": []}, "strengths="),
        ("smc", {"move": "prior"}, "prior_mh"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_simulated(
    kernel: str, options: dict[str, Any], message: str
) -> None:
    given = {"workers": 1, "progress": False, "prior": "uniform", **options}
    model = Model(given.pop("prior"), simulator=never_called)
    with pytest.raises((InvalidSettingError, UnknownNameError), match=message):
        ppl.infer(EVENT, model, kernel=kernel, **given)
