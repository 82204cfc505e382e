"""Kernels against exact enumeration on a toy whose simulations are looked up in a table."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from jax import random
from numpyro.infer import MCMC

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.prior_mh import PriorMH
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.inference.toy import (
    N_FRAMES,
    SETTINGS,
    TableRunner,
    exact_posterior,
    run,
    table_errors,
    table_guide,
    table_program,
    total_variation,
    visited_share,
)

STEPS = 1500
MONTE_CARLO = 0.06
"""Twice the total variation that the autocorrelated draws of so many steps give."""

ERRORS = table_errors()
KEYS = random.split(random.key(0), 15)


def local_mh(runner: TableRunner, **options: Any) -> tuple[LocalMH, SimulatorBridge]:
    program, bridge = table_program(runner)
    return LocalMH(program, table_guide(), SETTINGS, **options), bridge


@functools.cache
def local_run(rule: str = "exact", early_reject: bool = True) -> tuple[Any, SimulatorBridge]:
    kernel, bridge = local_mh(TableRunner(ERRORS), rule=rule, early_reject=early_reject)
    return run(kernel, STEPS, KEYS), bridge


def test_exact_rule_reaches_the_enumerated_posterior() -> None:
    states, _ = local_run()
    assert total_variation(visited_share(states.z), exact_posterior(ERRORS)) < MONTE_CARLO


def test_exact_rule_leaves_strengths_that_change_nothing_at_their_prior() -> None:
    states, _ = local_run()
    strength = np.asarray(states.z["strength_red"])
    assert strength.mean() == pytest.approx(375, abs=6)
    assert strength.std() == pytest.approx(450 / np.sqrt(12), abs=6)


def test_printed_rule_settles_elsewhere() -> None:
    states, _ = local_run("paper")
    assert total_variation(visited_share(states.z), exact_posterior(ERRORS)) > 0.1


def test_prior_proposals_reach_the_enumerated_posterior() -> None:
    program, _bridge = table_program(TableRunner(ERRORS))
    states = run(PriorMH(program), STEPS, KEYS)
    assert total_variation(visited_share(states.z), exact_posterior(ERRORS)) < MONTE_CARLO


def test_early_rejection_leaves_the_chain_bit_for_bit_the_same() -> None:
    with_it, bridge_with = local_run()
    without, bridge_without = local_run(early_reject=False)
    for field in ("sim_seed", "step_error", "window", "accepted", "log_joint"):
        np.testing.assert_array_equal(getattr(with_it, field), getattr(without, field), field)
    for site, values in with_it.z.items():
        np.testing.assert_array_equal(values, without.z[site], site)
    frames = [
        sum(record.result.frames_simulated for record in bridge.records)
        for bridge in (bridge_with, bridge_without)
    ]
    assert frames[0] < 0.95 * frames[1]


def test_current_hypothesis_is_never_simulated_again() -> None:
    states, bridge = local_run()
    assert bridge.calls == STEPS + 1
    stayed = ~np.asarray(states.accepted)[1:]
    same = (np.asarray(states.step_error)[1:] == np.asarray(states.step_error)[:-1]).all(axis=-1)
    assert same[stayed].all()
    seed = np.asarray(states.sim_seed)
    assert (seed[1:] == seed[:-1])[stayed].all()


def test_a_state_agrees_with_its_own_simulation() -> None:
    states, _ = local_run()
    z = {name: np.asarray(values)[-1] for name, values in states.z.items()}
    seed = np.asarray(states.sim_seed)[-1]
    for chain in np.flatnonzero(z["alpha"] == 0):
        expected = ERRORS[z["goal_red"][chain], z["goal_green"][chain], seed[chain] % 3]
        np.testing.assert_allclose(states.step_error[-1, chain], expected, rtol=1e-5)


def test_a_particle_moves_among_others_as_it_would_alone() -> None:
    runner = TableRunner(ERRORS)
    kernel, _bridge = local_mh(runner)
    together = run(kernel, 30, KEYS[:3])
    assert runner.batches == [3] * 31
    runner.batches.clear()
    alone = run(kernel, 30, KEYS[1])
    assert runner.batches == [1] * 31
    for name in ("accepted", "window", "sim_seed", "log_joint", "step_error"):
        one, among = getattr(alone, name), getattr(together, name)[:, 1]
        np.testing.assert_allclose(one, among, 1e-5, err_msg=name)
    for name, values in alone.z.items():
        np.testing.assert_allclose(values, together.z[name][:, 1], 1e-5, err_msg=name)


@functools.cache
def prior_kernel() -> tuple[PriorMH, SimulatorBridge, Any]:
    program, bridge = table_program(TableRunner(ERRORS))
    kernel = PriorMH(program)
    return kernel, bridge, run(kernel, 5, KEYS[:2]).z


@pytest.mark.parametrize("method", ["vectorized", "sequential"])
def test_kernel_runs_under_numpyros_chain_methods(method: str) -> None:
    kernel, _bridge, expected = prior_kernel()
    mcmc = MCMC(
        kernel,
        num_warmup=0,
        num_samples=5,
        num_chains=2,
        chain_method=method,
        progress_bar=False,
    )
    mcmc.run(KEYS[:2])
    for name, values in mcmc.get_samples(group_by_chain=True).items():
        np.testing.assert_allclose(values, np.swapaxes(expected[name], 0, 1), 1e-5)


def test_unknown_rule_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="papr"):
        LocalMH(rule="papr")  # type: ignore[arg-type]


def test_kernel_without_an_event_says_so() -> None:
    with pytest.raises(InvalidSettingError, match="LocalMH has no program"):
        _ = LocalMH().model


def test_bound_copy_keeps_the_options() -> None:
    program, _bridge = table_program(TableRunner(ERRORS))
    bound = LocalMH(rule="paper").bound_to(program, table_guide(), SETTINGS)
    assert bound.settings == SETTINGS
    assert bound.validity == "approximate"
    assert bound.model is program
    assert program.n_frames == N_FRAMES
