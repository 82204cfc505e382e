"""Every kernel that calls itself exact, against enumeration of a toy whose prior is a user's own.

Left out are kernels that are no ``ParticleKernel``, which move in another space than the toy's,
and those that refuse its sites.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax, random

from phase_ppl.inference.kernels.metropolis import ParticleKernel
from phase_ppl.inference.registry import available_kernels, kernel_info
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError
from tests.inference.toy import (
    N_FRAMES,
    SEEDS,
    SETTINGS,
    TableRunner,
    characters,
    exact_characters,
    never_called,
    table_errors,
    table_guide,
    total_variation,
    visited_share,
)

CHAINS = 15
BLOCK = 100
BLOCKS = 7
"""Steps are compiled a block at a time."""

EXACT = ("enumerated_gibbs", "local_mh", "mixture", "prior_mh", "random_walk_mh", "single_site_mh")

ERRORS = table_errors()
KEYS = random.split(random.key(0), CHAINS)

_WHOLE, _NUMBER = np.zeros(CHAINS, np.int32), np.ones(CHAINS, np.float32)
START = {
    "goal_red": _WHOLE,
    "goal_green": _WHOLE + 3,
    "outgoing": np.zeros((CHAINS, 2), np.int32),
    "sociability": _NUMBER * 0.2,
    "alpha": _WHOLE,
    "haste": _NUMBER * 0,
    "strength_red": _NUMBER * 300,
    "strength_green": _NUMBER * 300,
}


@functools.cache
def model() -> Model:
    return Model(prior=characters, simulator=never_called)


@functools.cache
def supplies() -> dict[str, Any]:
    """What kernels ask for; not made on import, which every process pays for."""
    return {"guide": table_guide(characters), "settings": SETTINGS}


class Run(NamedTuple):
    """States (step, chain, ...), the initial ones, and what was simulated."""

    states: Any
    start: Any
    runner: TableRunner
    bridge: SimulatorBridge


def kernel(name: str, bridge: jax.Array | int, **options: Any) -> Any:
    info = kernel_info(name)
    needs = {need: supplies()[need] for need in info.needs}
    return info.make(EventProgram(model(), bridge, N_FRAMES), **needs, **options)


@functools.cache
def programs(name: str) -> tuple[Any, Any]:
    supplies()  # made here, so that no part of it is a tracer

    def init(keys: jax.Array, sites: dict[str, jax.Array], bridge: jax.Array) -> Any:
        return kernel(name, bridge).init(keys, 0, sites, (), {})

    def block(state: Any, bridge: jax.Array) -> Any:
        def advance(state: Any, _: None) -> tuple[Any, Any]:
            state = kernel(name, bridge).sample(state, (), {})
            return state, state

        return lax.scan(advance, state, None, length=BLOCK)

    return compiled_quickly(init), compiled_quickly(block)


@functools.cache
def run(name: str, blocks: int = BLOCKS, stops_early: bool = True) -> Run:
    return follow(name, KEYS, START, blocks, TableRunner(ERRORS, stops_early))


def follow(name: str, keys: jax.Array, sites: Any, blocks: int, runner: TableRunner) -> Run:
    bridge = SimulatorBridge(runner, N_FRAMES)
    handle = jnp.asarray(bridge.handle)
    init, block = programs(name)
    start = state = init(keys, sites, handle)
    states = []
    for _ in range(blocks):
        state, moved = jax.block_until_ready(block(state, handle))
        states.append(jax.tree.map(np.asarray, moved._replace(rng_key=np.zeros(BLOCK))))
    assert bridge.failure is None
    return Run(jax.tree.map(lambda *parts: np.concatenate(parts), *states), start, runner, bridge)


def by_chain(values: Any) -> Any:
    """Return (chain, ...) means over the steps after a first block."""
    return np.asarray(values, float)[BLOCK:].mean(axis=0)


def assert_same(one: Any, other: Any, pick: Any, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Compare states in all that a run keeps; ``pick`` is what of the other's to compare with."""
    for field in ("sim_seed", "step_error", "window", "accepted", "log_joint"):
        mine, theirs = getattr(one, field), getattr(other, field)[pick]
        np.testing.assert_allclose(mine, theirs, rtol, err_msg=field)
    for site, values in one.z.items():
        np.testing.assert_allclose(values, other.z[site][pick], 10 * rtol, atol, err_msg=site)


def can_be_tested(name: str) -> bool:
    info = kernel_info(name)
    if info.validity != "exact" or not info.factory.__module__.startswith("phase_ppl."):
        return False
    try:
        return isinstance(kernel(name, 0), ParticleKernel)
    except InvalidSettingError:
        return False


def test_no_exact_kernel_is_left_out() -> None:
    assert {name for name in available_kernels() if can_be_tested(name)} == set(EXACT)


@pytest.mark.parametrize("name", EXACT)
def test_draws_visit_hypotheses_as_often_as_the_posterior_says(name: str) -> None:
    z = {site: values[BLOCK:] for site, values in run(name).states.z.items()}
    share = np.stack([visited_share({s: v[:, c] for s, v in z.items()}) for c in range(CHAINS)])
    # the total variation to be expected of so many independent chains
    error = share.std(axis=0, ddof=1) / np.sqrt(CHAINS)
    expected = 0.5 * np.sqrt(2 / np.pi) * error.sum()
    assert expected < 0.09
    assert total_variation(share.mean(axis=0), exact_characters(ERRORS).share) < 2 * expected


@pytest.mark.parametrize("name", EXACT)
def test_a_users_own_sites_have_their_posterior(name: str) -> None:
    z = run(name).states.z
    for site, exact in exact_characters(ERRORS).means.items():
        means = by_chain(z[site]).reshape(CHAINS, -1).mean(axis=1)
        error = means.std(ddof=1) / np.sqrt(CHAINS)
        assert abs(means.mean() - exact) < 4 * error, site
        assert error < 0.2 * z[site].std(), site


@pytest.mark.parametrize("name", EXACT)
def test_no_particle_pays_for_more_simulations_than_promised(name: str) -> None:
    _, _, runner, bridge = run(name)
    promised, steps = kernel_info(name).sims_per_step, BLOCKS * BLOCK
    assert np.max(runner.batches) <= promised * CHAINS
    paid = np.bincount([record.chain for record in bridge.records], minlength=CHAINS)
    assert (paid <= 1 + steps * promised).all()
    if promised == 1:
        assert len(runner.batches) == 1 + steps


@pytest.mark.parametrize("name", EXACT)
def test_early_rejection_changes_no_decision(name: str) -> None:
    stopped, _, _, bridge = run(name)
    whole, _, _, whole_bridge = run(name, blocks=1, stops_early=False)
    assert_same(whole, stopped, slice(BLOCK))
    number = len(whole_bridge.records)
    frames = [
        sum(record.result.frames_simulated for record in records[:number])
        for records in (bridge.records, whole_bridge.records)
    ]
    assert frames[0] < 0.98 * frames[1]


class Watched(EventProgram):
    """Keeps how far simulations are to run."""

    ceilings: list[Any]

    def simulate(
        self, sites: Any, log_prior: Any, seed: Any, error_ceiling: Any = np.inf, *kept: Any
    ) -> Any:
        self.ceilings.append(error_ceiling)
        return super().simulate(sites, log_prior, seed, error_ceiling, *kept)


@pytest.mark.parametrize("name", EXACT)
def test_a_single_particle_is_stopped_early_only_where_that_is_wanted(name: str) -> None:
    watched = Watched(model(), 0, N_FRAMES)
    sites = {site: values[0] for site, values in START.items()}
    state: Any = None
    for early_reject in (True, False):
        single = kernel(name, 0, early_reject=early_reject)
        single = single.bound_to(watched, supplies()["guide"], SETTINGS)
        watched.ceilings = []
        if state is None:
            state = jax.eval_shape(functools.partial(single.init, KEYS[0], 0, sites))
        assert jax.eval_shape(single.sample, state) == state
        stops = [isinstance(ceiling, jax.core.Tracer) for ceiling in watched.ceilings]
        assert any(stops) == early_reject


@pytest.mark.parametrize("name", EXACT)
def test_particles_do_not_notice_each_other(name: str) -> None:
    others = random.split(random.key(1), CHAINS)
    among = follow(name, others.at[7].set(KEYS[4]), START, 1, TableRunner(ERRORS)).states
    seventh = jax.tree.map(lambda leaf: leaf[:, 7], among._replace(rng_key=None))
    assert_same(seventh, run(name).states, (slice(BLOCK), 4))


def test_a_particle_moves_among_others_as_it_would_alone() -> None:
    name = "enumerated_gibbs"  # whose simulations are a batch of their own
    sites = {site: values[4] for site, values in START.items()}
    alone, _, runner, bridge = follow(name, KEYS[4], sites, 1, TableRunner(ERRORS))
    assert {record.chain for record in bridge.records} == {0}
    assert np.max(runner.batches) <= kernel_info(name).sims_per_step
    assert_same(alone, run(name).states, (slice(BLOCK), 4), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("name", EXACT)
def test_a_particle_stays_with_its_simulation_until_it_accepts_another(name: str) -> None:
    states = run(name).states
    assert np.isfinite(states.step_error).all()
    neither = states.z["alpha"] == 0
    red, green = states.z["goal_red"], states.z["goal_green"]
    expected = ERRORS[red, green, states.sim_seed % SEEDS][neither]
    np.testing.assert_allclose(states.step_error[neither], expected, rtol=1e-5)
    stayed = ~states.accepted[1:]
    assert 0.05 < stayed.mean() < 0.95
    for field in ("sim_seed", "step_error"):
        values = getattr(states, field)
        np.testing.assert_array_equal(values[1:][stayed], values[:-1][stayed], field)
    # a sum, which may be computed anew, and compiled so that it rounds otherwise
    joint = states.log_joint
    np.testing.assert_allclose(joint[1:][stayed], joint[:-1][stayed], 1e-6)
    assert (states.sim_seed[1:] != states.sim_seed[:-1])[~stayed].all()
    np.testing.assert_array_equal(states.n_accepted[-1], states.accepted.sum(axis=0))
