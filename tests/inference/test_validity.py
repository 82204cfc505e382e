"""Every kernel that calls itself exact, against enumeration of a toy whose prior is a user's own.

Left out are kernels that are no ``MetropolisKernel``, which move in another space than the toy's,
and those that refuse its sites.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax, random
from numpy.typing import NDArray

from phase_ppl.inference.kernels.metropolis import MetropolisKernel
from phase_ppl.inference.registry import available_kernels, kernel_info
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError
from tests.inference import toy

CHAINS = 45
BLOCK = 60
BLOCKS = 4
"""Steps are compiled a block at a time."""

KERNELS = ("local_mh", "prior_mh", "single_site_mh")

ERRORS = toy.table_errors()
KEYS = random.split(random.key(3), CHAINS)

_CHAIN = np.arange(CHAINS)
START = {
    "goal_red": np.take(toy.RED_GOALS, _CHAIN % 3).astype(np.int32),
    "goal_green": np.take(toy.GREEN_GOALS, _CHAIN // 3 % 2).astype(np.int32),
    "outgoing": np.stack([_CHAIN % 2, _CHAIN // 2 % 2], axis=1).astype(np.int32),
    "sociability": np.full(CHAINS, 0.3, np.float32),
    "alpha": np.take(toy.ALPHA_CODES, _CHAIN // 6 % 3).astype(np.int32),
    "haste": np.linspace(-1, 2, CHAINS, dtype=np.float32),
    "strength_red": np.linspace(150, 600, CHAINS, dtype=np.float32),
    "strength_green": np.linspace(600, 150, CHAINS, dtype=np.float32),
}
"""Spread out, so that few steps lead from there to the posterior."""


@pytest.fixture(scope="module", params=KERNELS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@functools.cache
def model() -> Model:
    return Model(prior=toy.characters, simulator=toy.never_called)


@functools.cache
def supplies() -> dict[str, Any]:
    """What kernels ask for; not made on import, which every process pays for."""
    return {"guide": toy.table_guide(toy.characters), "settings": toy.SETTINGS}


class Run(NamedTuple):
    """States (step, chain, ...), and what was simulated."""

    states: Any
    runner: toy.TableRunner
    bridge: SimulatorBridge


def kernel(name: str, bridge: jax.Array | int, **options: Any) -> Any:
    info = kernel_info(name)
    needs = {need: supplies()[need] for need in info.needs}
    return info.make(EventProgram(model(), bridge, toy.N_FRAMES), **needs, **options)


@functools.cache
def initialised(name: str) -> Any:
    supplies()  # made here, so that no part of it is a tracer

    def init(keys: jax.Array, bridge: jax.Array) -> Any:
        return kernel(name, bridge).init(keys, 0, START, (), {})

    return compiled_quickly(init)


@functools.cache
def moved(name: str) -> Any:
    def block(state: Any, bridge: jax.Array) -> Any:
        def advance(state: Any, _: None) -> tuple[Any, Any]:
            state = kernel(name, bridge).sample(state, (), {})
            return state, state

        return lax.scan(advance, state, None, length=BLOCK)

    return compiled_quickly(block)


@functools.cache
def run(name: str, blocks: int = BLOCKS, stops_early: bool = True) -> Run:
    return follow(name, KEYS, blocks, toy.TableRunner(ERRORS, stops_early))


def follow(name: str, keys: jax.Array, blocks: int, runner: toy.TableRunner) -> Run:
    bridge = SimulatorBridge(runner, toy.N_FRAMES)
    handle = jnp.asarray(bridge.handle)
    # kernels differ in how they move, and start alike where they remember as much
    state = initialised("local_mh" if kernel_info(name).needs else "prior_mh")(keys, handle)
    states = []
    for _ in range(blocks):
        state, of_block = jax.block_until_ready(moved(name)(state, handle))
        states.append(jax.tree.map(np.asarray, of_block._replace(rng_key=np.zeros(BLOCK))))
    assert bridge.failure is None
    return Run(jax.tree.map(lambda *parts: np.concatenate(parts), *states), runner, bridge)


def assert_same(one: Any, other: Any, pick: Any) -> None:
    """Compare states in all that a run keeps; ``pick`` is what of the other's to compare with."""
    for field in ("sim_seed", "step_error", "window", "accepted", "log_joint"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field)[pick], field)
    for site, values in one.z.items():
        np.testing.assert_array_equal(values, other.z[site][pick], site)


def can_be_tested(name: str) -> bool:
    info = kernel_info(name)
    if info.validity != "exact" or not info.factory.__module__.startswith("phase_ppl."):
        return False
    try:
        return isinstance(kernel(name, 0), MetropolisKernel)
    except InvalidSettingError:
        return False


def test_no_exact_kernel_is_left_out() -> None:
    found = {name for name in available_kernels() if can_be_tested(name)}
    assert found == {*KERNELS}


def test_draws_have_the_posterior_law(name: str) -> None:
    z = {site: values[BLOCK:] for site, values in run(name).states.z.items()}
    share = np.stack([toy.visited_share({s: v[:, c] for s, v in z.items()}) for c in range(CHAINS)])
    exact = toy.exact_characters(ERRORS)
    # the total variation to be expected of so many independent chains
    error = share.std(axis=0, ddof=1) / np.sqrt(CHAINS)
    expected = 0.5 * np.sqrt(2 / np.pi) * error.sum()
    assert expected < 0.09
    assert toy.total_variation(share.mean(axis=0), exact.share) < 2 * expected
    for site, values in z.items():  # none stays where it began, be it as likely as any other
        still = (values == values[0]).reshape(len(values), CHAINS, -1).all(axis=(0, 2))
        assert still.mean() < 0.2, site
    for site, mean in exact.means.items():
        means = z[site].mean(axis=0, dtype=float).reshape(CHAINS, -1).mean(axis=1)
        error = means.std(ddof=1) / np.sqrt(CHAINS)
        assert abs(means.mean() - mean) < 4 * error, site
        assert error < 0.2 * z[site].std(), site


def test_a_particle_stays_with_its_simulation_until_it_accepts_another(name: str) -> None:
    states = run(name).states
    assert np.isfinite(states.step_error).all()
    neither = states.z["alpha"] == 0
    red, green = states.z["goal_red"], states.z["goal_green"]
    expected = ERRORS[red, green, states.sim_seed % toy.SEEDS][neither]
    np.testing.assert_allclose(states.step_error[neither], expected, rtol=1e-5)
    stayed = ~states.accepted[1:]
    assert 0.05 < stayed.mean() < 0.95
    # of several kinds of moves none is idle
    for kind in (states.window >= 0, states.window < 0):
        assert not kind.any() or states.accepted[kind].mean() > 0.05
    for field in ("sim_seed", "step_error"):
        values = getattr(states, field)
        np.testing.assert_array_equal(values[1:][stayed], values[:-1][stayed], field)
    # a sum, which may be computed anew, and compiled so that it rounds otherwise
    joint = states.log_joint
    np.testing.assert_allclose(joint[1:][stayed], joint[:-1][stayed], 1e-6)
    of_frames = RadialLikelihood().log_prob(states.step_error).sum(axis=-1)
    np.testing.assert_allclose(states.log_prior, joint - of_frames, atol=1e-3)
    assert (states.sim_seed[1:] != states.sim_seed[:-1])[~stayed].all()
    np.testing.assert_array_equal(states.n_accepted[-1], states.accepted.sum(axis=0))


def test_no_particle_pays_for_more_than_promised_and_records_say_where_it_stops(name: str) -> None:
    _, runner, bridge = run(name)
    promised, steps = kernel_info(name).sims_per_step, BLOCKS * BLOCK
    assert max(map(len, runner.batches)) <= promised * CHAINS
    paid = np.bincount([record.chain for record in bridge.records], minlength=CHAINS)
    assert (paid <= 1 + steps * promised).all()
    if promised == 1:
        assert len(runner.batches) == 1 + steps
    # the bound that is kept and the ceiling tell the random number that decided
    ceilings = np.concatenate(runner.batches)
    bounds = np.array([record.log_bound for record in bridge.records])
    stoppable = np.isfinite(ceilings)
    np.testing.assert_array_equal(stoppable, np.isfinite(bounds))
    floor = toy.N_FRAMES * RadialLikelihood().log_prob(ceilings[stoppable] / toy.N_FRAMES)
    u = np.exp(bounds[stoppable] + floor)
    # even in (0, 1) up to rounding, as what it is compared with
    assert 0.99 < u.max() < 1.001
    assert u.mean() == pytest.approx(0.5, abs=4 * 0.289 / np.sqrt(len(u)))


def test_proposals_are_kept_with_the_density_that_they_are_drawn_from(name: str) -> None:
    states, _, bridge = run(name)
    log_prior, log_proposal = np.array(
        [(one.log_prior, one.log_proposal) for one in bridge.records[CHAINS:]]
    ).T
    known, n_drawn = ~np.isnan(log_proposal), int((states.window >= 0).sum())
    if name == "prior_mh":
        np.testing.assert_array_equal(log_proposal, log_prior)
    elif not n_drawn:  # a move of one site says nothing of how its hypothesis comes about
        assert not known.any()
    else:
        assert_mean_is_one(np.exp(log_prior - log_proposal)[known], n_drawn)


def test_a_start_is_kept_with_the_density_that_it_is_drawn_from() -> None:
    bridge = SimulatorBridge(toy.TableRunner(ERRORS), toy.N_FRAMES)
    keys = random.split(KEYS[0], 2000)
    supplies()
    start = compiled_quickly(lambda keys, handle: kernel("local_mh", handle).init(keys, 0))
    jax.block_until_ready(start(keys, jnp.asarray(bridge.handle)))
    ratio = [math.exp(one.log_prior - one.log_proposal) for one in bridge.records]
    assert_mean_is_one(np.array(ratio), len(keys))


def assert_mean_is_one(ratio: NDArray[np.float64], n_drawn: int) -> None:
    """Check P / Q of those of ``n_drawn`` draws from Q that P has mass on."""
    error = np.sqrt((ratio**2).sum()) / n_drawn
    assert error < 0.05
    assert ratio.sum() / n_drawn == pytest.approx(1.0, abs=4 * error)


def test_early_rejection_changes_no_decision(name: str) -> None:
    stopped, _, bridge = run(name)
    whole, _, whole_bridge = run(name, blocks=1, stops_early=False)
    assert_same(whole, stopped, slice(BLOCK))
    number = len(whole_bridge.records)
    frames = [
        sum(record.result.frames_simulated for record in records[:number])
        for records in (bridge.records, whole_bridge.records)
    ]
    assert frames[0] < 0.98 * frames[1]


def test_particles_do_not_notice_each_other(name: str) -> None:
    others = random.split(random.key(1), CHAINS)
    among = follow(name, others.at[4].set(KEYS[4]), 1, toy.TableRunner(ERRORS)).states
    fourth = jax.tree.map(lambda leaf: leaf[:, 4], among._replace(rng_key=None))
    assert_same(fourth, run(name).states, (slice(BLOCK), 4))
