"""SIMPLE's kernel and its rules; what holds for every exact kernel is in test_validity."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.inference.kernels.local_mh import (
    EXACT_RULES,
    RULES,
    Rule,
    log_after,
    log_after_bound,
    log_before,
    log_window_choice,
)
from phase_ppl.inference.kernels.metropolis import PriorMH, log_ratio
from phase_ppl.inference.run import Run
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from tests.inference.toy import SETTINGS, total_variation, walkers, walking_event


def made(n_frames: int, **changes: Any) -> Run:
    given = {"model": Model(simulator=walkers), "kernel": "local_mh", **changes}
    event = walking_event(n_frames)
    return Run(event, kernel_options={}, settings=SETTINGS, chains=4, seed=0, **given)


def test_events_of_all_lengths_share_a_program() -> None:
    recipes = {n: made(n).recipe for n in (5, 14, 20, 90, 128, 129, 200)}
    assert recipes[20] == recipes[90] == recipes[128]
    assert recipes[5] == recipes[14] != recipes[20]
    assert recipes[129][-1] == recipes[200][-1] == 256


class Fading(RadialLikelihood):
    """Of which a frame counts the less, the later it is."""

    def log_prob(self, errors: Any) -> Any:
        return super().log_prob(errors) * jnp.linspace(1.0, 0.5, 20)


def test_likelihoods_and_kernels_of_ones_own_get_arrays_as_long_as_the_observation() -> None:
    own = made(20, kernel="prior_mh", model=Model(simulator=walkers, likelihood=Fading()))
    own.check(1, None)
    unknown = made(20, kernel=lambda program: PriorMH(program))
    assert own.recipe[-1] == unknown.recipe[-1] == 20
    assert made(20, kernel=PriorMH).recipe[-1] == made(20, kernel="prior_mh").recipe[-1] > 20


HYPOTHESES, SEEDS, TIME, LENGTH, ETA, BETA = 8, 3, 10, 3, 0.5, 0.4


class Tiny:
    """Random hypotheses whose proposals look at the errors of a window, and a uniform seed."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        level = rng.gamma(1.2, 1.0, (HYPOTHESES, 1, TIME))
        self.errors = np.abs(level + rng.normal(0, 0.6, (HYPOTHESES, SEEDS, TIME)))
        self.prior = rng.dirichlet(np.full(HYPOTHESES, 3.0))
        frames = np.arange(TIME - LENGTH)[:, None] + np.arange(LENGTH + 1)
        likes = np.exp(-1.5 * level[:, 0, frames].sum(axis=-1).T)
        likes /= likes.sum(axis=1, keepdims=True)
        self.proposal = 0.9 * likes + 0.1 / HYPOTHESES  # (window, hypothesis)

    def posterior(self) -> NDArray[np.float64]:
        mass = self.prior * np.exp(-BETA * self.errors.sum(axis=-1)).mean(axis=1)
        return mass / mass.sum()

    def stationary(self, rule: Rule) -> NDArray[np.float64]:
        """Return (hypothesis,) the law that the library's acceptance leaves invariant."""
        matrix = self.transitions(rule)
        assert (matrix >= 0).all()
        n = len(matrix)
        equations = np.vstack([matrix.T - np.eye(n), np.ones(n)])
        law = np.linalg.lstsq(equations, np.append(np.zeros(n), 1.0), rcond=None)[0]
        return law.reshape(HYPOTHESES, SEEDS).sum(axis=1)

    def transitions(self, rule: Rule) -> NDArray[np.float64]:
        with jax.enable_x64(True):
            return np.asarray(_transitions(rule, self.errors, self.prior, self.proposal))


@functools.partial(jax.jit, static_argnums=0)
def _transitions(rule: Rule, errors: jax.Array, prior: jax.Array, proposal: jax.Array) -> jax.Array:
    hypothesis = np.repeat(np.arange(HYPOTHESES), SEEDS)
    errors = errors.reshape(-1, TIME)
    log_prior, log_q = jnp.log(prior)[hypothesis], jnp.log(proposal.T)[hypothesis]
    log_windows = jax.vmap(lambda e: log_window_choice(e, ETA, LENGTH))(errors)
    by_frame = RadialLikelihood(BETA).log_prob(errors)

    def flow(old: jax.Array, new: jax.Array, window: jax.Array) -> jax.Array:
        known = log_before(
            rule,
            window,
            (log_prior[old], log_prior[new]),
            (log_q[old], log_q[new]),
            log_windows[old],
        )
        after = log_after(rule, window, log_q[old], log_windows[new])
        ratio = log_ratio(known, by_frame[old], by_frame[new], after)
        proposed = log_windows[old, window] + log_q[new, window] - jnp.log(SEEDS)
        return jnp.exp(proposed + jnp.minimum(ratio, 0.0))

    states, windows = jnp.arange(len(errors)), jnp.arange(log_windows.shape[1])
    by_window = jax.vmap(flow, (None, None, 0))
    moves = jax.vmap(jax.vmap(by_window, (None, 0, None)), (0, None, None))
    matrix = moves(states, states, windows).sum(axis=-1)
    return matrix + jnp.diag(1 - matrix.sum(axis=1))


@pytest.mark.parametrize("seed", [0, 1])
def test_exact_rules_leave_the_posterior_invariant_the_printed_one_does_not(seed: int) -> None:
    tiny = Tiny(seed)
    for rule in EXACT_RULES:
        assert total_variation(tiny.stationary(rule), tiny.posterior()) < 1e-6, rule
    assert total_variation(tiny.stationary("paper"), tiny.posterior()) > 0.1
    # a window that is summed out accepts more
    kept = {rule: np.trace(tiny.transitions(rule)) for rule in EXACT_RULES}
    assert kept["exact"] < kept["window"]


def test_no_simulation_adds_more_to_the_ratio_than_early_rejection_allows() -> None:
    rng = np.random.default_rng(0)
    for rule, _ in itertools.product(RULES, range(10)):
        log_q = jnp.asarray(rng.normal(0.0, 3.0, TIME - LENGTH))
        log_windows = log_window_choice(jnp.asarray(rng.gamma(1.0, 5.0, TIME)), ETA, LENGTH)
        for window in (0, TIME - LENGTH - 1):
            after = log_after(rule, window, log_q, log_windows)
            assert after <= log_after_bound(rule, log_q) + 1e-5
