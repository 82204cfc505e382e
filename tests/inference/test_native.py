"""NumPyro's own route: its MCMC, handlers and kernels on the program of an event."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import random
from numpyro import handlers
from numpyro.infer import AIES, MCMC, NUTS, SA, DiscreteGibbs, Predictive
from numpyro.infer.util import log_density

import phase_ppl as ppl
from phase_ppl.analysis.tree import simulation_of_draw
from phase_ppl.inference.native import OpenProgram
from phase_ppl.simulator.contract import SimulationResult, Statistics
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, SimulationError
from tests.inference.runs import EVENT, MODEL, OPTIONS
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
    table_errors,
    total_variation,
    visited_share,
    walking_event,
)

ERRORS = table_errors()
TOY = walking_event(N_FRAMES)
FEW = ppl.Model(prior=few_goals, simulator=never_called)
KEY = random.key(0)


class Workers(TableRunner):
    """A runner of the toy whose workers can end; ``broken`` says what happens instead."""

    workers, on_failure = 1, "reject"

    def __init__(self, broken: BaseException | None = None) -> None:
        super().__init__(ERRORS)
        self.statistics = Statistics()
        self.broken, self.closed = broken, False

    def run(self, *requests: Any) -> list[SimulationResult]:
        if self.broken is not None:
            raise self.broken
        return super().run(*requests)

    def close(self) -> None:
        self.closed = True


def opened(model: ppl.Model = FEW, broken: BaseException | None = None) -> OpenProgram:
    return OpenProgram(TOY, model, SETTINGS, Workers(broken))


@pytest.fixture
def program() -> Iterator[OpenProgram]:
    with opened() as program:
        yield program


def sampled(
    kernel: Any,
    n: int,
    chains: int,
    method: Any = "vectorized",
    *,
    warmup: int = 0,
    bar: bool = False,
    keys: jax.Array = KEY,
) -> Any:
    mcmc = MCMC(
        kernel,
        num_warmup=warmup,
        num_samples=n,
        num_chains=chains,
        chain_method=method,
        progress_bar=bar,
    )
    mcmc.run(keys)
    return mcmc


def test_a_trace_is_a_hypothesis_a_seed_and_their_errors(program: OpenProgram) -> None:
    trace = handlers.trace(handlers.seed(program, KEY)).get_trace()
    value = {name: site["value"] for name, site in trace.items()}
    (record,) = program.records
    assert record.result.seed == value["sim_seed"]
    assert all(record.sites[name] == value[name] for name in program.model.sites)
    np.testing.assert_allclose(value["step_error"], record.result.errors, 1e-6)
    log_density(program, (), {}, value)
    assert len(program.records) == 1  # the same point is known


def test_handlers_set_what_is_simulated(program: OpenProgram) -> None:
    given = {"goal_red": jnp.int32(5), "sim_seed": jnp.int32(7), "strength_red": jnp.float32(200)}
    for handler in (handlers.substitute, handlers.condition):
        trace = handlers.trace(handlers.seed(handler(program, given), KEY)).get_trace()
        assert {name: trace[name]["value"] for name in given} == given
    assert [record.result.seed for record in program.records] == [7]
    assert program.records[0].sites["goal_red"] == 5
    out = handlers.substitute(program, {**given, "goal_red": jnp.int32(1)})  # without prior mass
    trace = handlers.trace(handlers.seed(out, KEY)).get_trace()
    assert np.isinf(trace["step_error"]["value"]).all()


def drawn(model: Any, key: jax.Array) -> Any:
    return handlers.trace(handlers.seed(model, key)).get_trace()


METHODS = [("vectorized", True), ("sequential", False)]


@functools.cache
def plain(kernel: Any) -> tuple[OpenProgram, Any]:
    program = opened()
    return program, sampled(kernel(program), 12, 2)


@pytest.mark.parametrize(
    "kernel", [ppl.kernels.PriorMH, pytest.param(ppl.kernels.LocalMH, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(("method", "bar"), METHODS)
def test_every_chain_method_draws_the_same_with_a_bar_and_without(
    kernel: Any, method: str, bar: bool, program: OpenProgram, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CI", "PYTEST_XDIST_WORKER"):  # with which NumPyro shows no bar
        monkeypatch.delenv(name, raising=False)
    again = sampled(kernel(program), 12, 2, method, bar=bar).get_samples(group_by_chain=True)
    first, run = plain(kernel)
    for name, values in run.get_samples(group_by_chain=True).items():
        np.testing.assert_allclose(again[name], values, 1e-5, err_msg=name)
    assert len(program.records) == len(first.records)


def test_a_long_run_is_the_enumerated_posterior(program: OpenProgram) -> None:
    mcmc = sampled(ppl.kernels.LocalMH(program), 110, 60, warmup=10)
    share = visited_share(mcmc.get_samples())
    assert total_variation(share, exact_posterior(ERRORS)) < 0.06
    assert len(program._runner.batches) == 1 + 120


def test_draws_are_those_of_infer() -> None:
    """With the same keys; infer's arrays are longer than the video, so rounding may differ."""
    post = ppl.infer(EVENT, MODEL, **OPTIONS)
    number = int(np.random.SeedSequence(OPTIONS["seed"]).generate_state(1)[0])
    with ppl.program(EVENT, MODEL, workers=1) as program:
        n, chains = OPTIONS["iterations"], OPTIONS["chains"]
        keys = random.split(random.key(number), chains)
        mcmc = sampled(ppl.kernels.PriorMH(program), n, chains, keys=keys)
    again = ppl.Posterior.from_numpyro(mcmc)
    for name, values in post.tree["posterior"].dataset.items():
        np.testing.assert_allclose(again.tree["posterior"][name], values, 1e-5, err_msg=str(name))
    for name in ("sim_seed", "accepted", "log_joint"):
        values = post.tree["sample_stats"][name]
        np.testing.assert_allclose(again.tree["sample_stats"][name], values, 1e-4, err_msg=name)


def test_numpyros_gibbs_visits_goals_by_the_posterior_given_the_rest(program: OpenProgram) -> None:
    given = {"sim_seed": jnp.int32(1)}
    given |= {name: jnp.float32(300.0) for name in ("strength_red", "strength_green")}
    kernel = DiscreteGibbs(handlers.condition(program, given))
    share = visited_share(sampled(kernel, 24, 30, jax.vmap, warmup=2).get_samples())
    mass = np.einsum("r,g,a->rga", RED_MASS, GREEN_MASS, ALPHA_MASS)
    for r, g, a in np.ndindex(mass.shape):
        alpha = ppl.ALPHAS[ALPHA_CODES[a]]
        goals = ppl.Hypothesis(RED_GOALS[r], GREEN_GOALS[g], alpha).effective_goals
        mass[r, g, a] *= np.exp(-0.05 * ERRORS[goals][1].sum())
    assert total_variation(share, mass / mass.sum()) < 0.1
    together, apart = (sampled(kernel, 3, 2, m).get_samples() for m in (jax.vmap, "sequential"))
    assert all((apart[name] == values).all() for name, values in together.items())


def test_aies_runs_on_uniform_numbers(program: OpenProgram) -> None:
    mcmc = sampled(AIES(program.uniform), 60, 60, warmup=30)
    assert total_variation(visited_share(mcmc.get_samples()), exact_posterior(ERRORS)) < 0.15
    post = ppl.Posterior.from_numpyro(mcmc)
    assert post.tree["posterior"].sizes["draw"] == 60
    assert post.settings["kernel"]["name"] == "AIES"
    some = {name: values[:3] for name, values in mcmc.get_samples().items()}
    replayed = Predictive(program.uniform, some, return_sites=["goal_red"])(KEY)["goal_red"]
    np.testing.assert_array_equal(replayed, some["goal_red"])


@pytest.mark.parametrize("handler", [handlers.condition, handlers.substitute, handlers.do])
def test_a_handler_cannot_give_what_no_sampler_asks_for(handler: Any, program: OpenProgram) -> None:
    """NumPyro would ignore it, or show a hypothesis that was not simulated."""
    for name in ("goal_red", "sim_seed"):
        mcmc = MCMC(AIES(handler(program.uniform, {name: jnp.int32(5)})), num_warmup=0,
                    num_samples=1, num_chains=2, chain_method="vectorized")  # fmt: skip
        with pytest.raises(InvalidSettingError, match=rf"{name}, which follows.* DiscreteGibbs"):
            mcmc.run(KEY)
    with pytest.raises(InvalidSettingError, match=r"PriorMH\(.*itself.* DiscreteGibbs"):
        ppl.kernels.PriorMH(handler(program, {"goal_red": jnp.int32(5)}))
    assert not program.records


def test_what_needs_a_gradient_or_to_enumerate_seeds_says_what_runs(program: OpenProgram) -> None:
    for kernel in (NUTS(program), SA(program)):
        with pytest.raises(RuntimeError, match=r"SA or AIES on program\.uniform"):
            sampled(kernel, 1, 1)
    given = {"goal_red": 0, "goal_green": 3, "alpha": 0, "sim_seed": 0}
    for model in (program.uniform, handlers.condition(program, jax.tree.map(jnp.int32, given))):
        with pytest.raises(InvalidSettingError, match="has no gradient, which this sampler asks"):
            sampled(NUTS(model), 1, 1)


def test_the_posterior_counts_the_chains_draws_and_simulates_nothing() -> None:
    program, mcmc = plain(ppl.kernels.PriorMH)
    n, z = len(program.records), mcmc.get_samples()
    post = ppl.Posterior.from_numpyro(mcmc)
    assert len(program.records) == n
    assert len(post.tree["simulations"]["seed"]) == n
    neither = z["alpha"] == 0
    for code, goal in enumerate(ppl.GOALS):
        both = post.probability(goal_red=goal, alpha=(0, 0))
        assert both == pytest.approx(float((neither & (z["goal_red"] == code)).mean()))
    assert (simulation_of_draw(post.tree) >= 0).all()
    assert post.settings["kernel"]["name"] == "prior_mh"
    assert (post.weights, post.burn_in) == ("count", 0)
    assert "2 particles x 12 iterations, prior_mh, weights count" in str(post)
    for answer in (post.marginal("relation"), post.over_time(), post.arviz):
        assert answer is not None


def test_runs_that_make_no_posterior_are_refused(program: OpenProgram) -> None:
    mcmc = MCMC(ppl.kernels.PriorMH(program), num_warmup=0, num_samples=1)
    with pytest.raises(InvalidSettingError, match=r"call mcmc\.run"):
        ppl.Posterior.from_numpyro(mcmc)
    other = MCMC(AIES(lambda: None), num_warmup=0, num_samples=1)
    with pytest.raises(InvalidSettingError, match=r"from_numpyro\(mcmc, program\)"):
        ppl.Posterior.from_numpyro(other)
    _, short = plain(ppl.kernels.PriorMH)
    given = handlers.condition(program, {"goal_red": jnp.int32(0)})
    with pytest.raises(InvalidSettingError, match=r"no phase_ppl\.program"):
        ppl.Posterior.from_numpyro(MCMC(AIES(given), num_warmup=0, num_samples=1))
    del short._states["sim_seed"]
    with pytest.raises(InvalidSettingError, match=r"add extra_fields=\('sim_seed',\) to mcmc.run"):
        ppl.Posterior.from_numpyro(short)
    short._states["z"].pop("alpha")
    with pytest.raises(InvalidSettingError, match="the samples lack alpha"):
        ppl.Posterior.from_numpyro(short)
    plain.cache_clear()


@pytest.mark.parametrize("bar", [False, True])
@pytest.mark.parametrize("broken", [SimulationError("it exploded"), KeyboardInterrupt()])
def test_what_ends_a_simulation_leaves_the_with_block_as_what_it_was(
    broken: BaseException, bar: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CI", "PYTEST_XDIST_WORKER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(type(broken)) as raised, opened() as program:  # noqa: PT012
        kernel = ppl.kernels.PriorMH(program)
        state = kernel.init(random.split(KEY, 2), 0)
        program._runner.broken = broken
        mcmc = MCMC(kernel, num_warmup=0, num_samples=2, num_chains=2,
                    chain_method="vectorized", progress_bar=bar)  # fmt: skip
        mcmc.post_warmup_state = state
        mcmc.run(random.split(KEY, 2))
    assert raised.value is broken
    assert program._runner.closed


def test_workers_end_with_the_block_and_simulations_stay() -> None:
    with ppl.program(EVENT, MODEL, workers=2) as program:
        runner = program._runner
        drawn(program, KEY)
        assert runner._pool is not None
    (record,) = program.records
    assert record.result.completed
    with pytest.raises(InvalidSettingError, match="within its with block"):
        drawn(program, KEY)


def test_what_is_no_event_or_simulates_nothing_is_refused() -> None:
    with pytest.raises(InvalidEventError, match="is no event"):
        ppl.program("collaborate")  # type: ignore[arg-type]
    for message, given in {
        "simulates nothing": {"model": ppl.Model(likelihood=ppl.ClosedLoopLikelihood())},
        "expected a phase_ppl.Model": {"model": 7},
    }.items():
        with pytest.raises(InvalidSettingError, match=message):
            ppl.program(EVENT, **given)  # type: ignore[arg-type]


def test_a_prior_can_be_stepped_through_in_infer_and_in_mcmc() -> None:
    """Without compiling: values are numbers, which a debugger shows."""
    seen: list[int] = []

    def watched() -> None:
        red, _ = ppl.sites.goals()
        ppl.sites.alpha()
        ppl.sites.strengths()
        with contextlib.suppress(jax.errors.ConcretizationTypeError):
            seen.append(int(red))

    model = ppl.Model(prior=watched, simulator=MODEL.simulator)
    few = {"chains": 1, "iterations": None, "budget": ppl.simulations(2)}
    with opened(model) as program, jax.disable_jit():
        seen.clear()
        mcmc = sampled(ppl.kernels.PriorMH(program), 1, 1)
        assert int(mcmc.get_samples()["goal_red"][0]) in seen
        assert len(program.records) == 2
        seen.clear()
        post = ppl.infer(EVENT, model, **{**OPTIONS, **few})
        assert seen
    assert post.tree["posterior"].sizes["draw"] == 1
