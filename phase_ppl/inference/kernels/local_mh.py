r"""SIMPLE: Metropolis-Hastings with local, bottom-up proposals (paper, Section 4).

A particle looks where its simulation fails. It picks a window k of the observation with
probability r(k | e) proportional to exp(eta * sum of its errors e in the window). From that window
it proposes a hypothesis, h' ~ Q(. | S_k), with a fresh simulator seed. The target is
P(h) p(w) L(e(h, w)) over hypothesis h and simulator seed w.

``rule="exact"``. The choice of window depends on the current errors. Summing it out in both
directions gives::

    log A = log P(h') - log P(h) + log L(e') - log L(e)
            + log sum_k r(k | e') Q(h | S_k) - log sum_k r(k | e) Q(h' | S_k)

``rule="window"``. The window is part of the move, and the reverse move uses the same window. Exact
too, but it accepts less::

    log A = log P(h') - log P(h) + log L(e') - log L(e)
            + log r(k | e') + log Q(h | S_k) - log r(k | e) - log Q(h' | S_k)

``rule="paper"``. The ratio as printed: log L(e') - log L(e) + log Q(h' | S_k) - log Q(h | S_k),
for the chosen window. It has the proposals upside down, no prior and no window term. Within a
fixed window it leaves L Q^2 invariant instead of the posterior. Only this rule allows a Q without a
share of the prior: from an h that no window suggests, every completed simulation is accepted.

Early rejection. All but L(e') and r(. | e') is known before simulating. The unknown terms are
bounded: sum_k r(k | e') Q(h | S_k) <= max_k Q(h | S_k), and r(k | e') <= 1.
"""

from __future__ import annotations

from typing import Final, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from jax.scipy.special import logsumexp
from numpyro import handlers

from phase_ppl.inference.guide import Guide
from phase_ppl.inference.kernels.metropolis import MetropolisKernel, MHState, Move, Proposed
from phase_ppl.inference.registry import Validity, register_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.tables import window_length
from phase_ppl.models.bridge import Request
from phase_ppl.models.density import Sites, draw, trace_log_density
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import unknown_name

Rule = Literal["exact", "window", "paper"]

RULES: Final = get_args(Rule)
EXACT_RULES: Final = ("exact", "window")


def log_window_choice(
    step_error: jax.Array, eta: float, length: int, count: jax.Array | int | None = None
) -> jax.Array:
    """Return (window,) log r(k | e), normalised, from errors (time,) [units].

    ``eta`` is in 1 / units; a window has one frame more than the ``length`` Delta T. Only the first
    ``count`` windows can be chosen; None: all.
    """
    n_windows = step_error.shape[0] - length
    frames = np.arange(n_windows)[:, None] + np.arange(length + 1)
    finite = jnp.where(jnp.isfinite(step_error), step_error, 0.0)
    logits = eta * finite[frames].sum(axis=1)
    if count is not None:
        logits = jnp.where(np.arange(n_windows) < count, logits, -jnp.inf)
    return jax.nn.log_softmax(logits)


def log_before(
    rule: Rule,
    window: jax.Array | int,
    log_prior: tuple[jax.Array, jax.Array],
    log_proposal: tuple[jax.Array, jax.Array],
    log_windows: jax.Array,
) -> jax.Array:
    """Return the part of the log acceptance ratio that is known before simulating.

    ``log_prior`` and ``log_proposal``, (window,) log Q(. | S_k), are pairs: of the current and of
    the proposed hypothesis. ``log_windows`` is log r(k | e) at the current errors; ``window`` is k.
    """
    if rule == "paper":
        return log_proposal[1][window] - log_proposal[0][window]
    prior = log_prior[1] - log_prior[0]
    if rule == "window":
        return prior + (log_proposal[0] - log_proposal[1] - log_windows)[window]
    return prior - logsumexp(log_windows + log_proposal[1])


def log_after(
    rule: Rule, window: jax.Array | int, log_proposal: jax.Array, log_windows: jax.Array
) -> jax.Array | float:
    """Return what the simulation adds to the log acceptance ratio, beside its likelihood.

    ``log_proposal`` is of the current hypothesis; ``log_windows`` is log r(k | e') at the errors of
    the proposed one.
    """
    if rule == "paper":
        return 0.0
    if rule == "window":
        return log_windows[window]
    return logsumexp(log_windows + log_proposal)


def log_after_bound(rule: Rule, log_proposal: jax.Array) -> jax.Array | float:
    """Return an upper bound of :func:`log_after` over all simulations."""
    return jnp.max(log_proposal) if rule == "exact" else 0.0


@register_kernel("local_mh", validity="exact", needs=("guide", "settings"), any_length=True)
class LocalMH(MetropolisKernel):
    """SIMPLE: Metropolis-Hastings with local, bottom-up proposals.

    A proposal comes from a window, a short interval of the video in which the current simulation
    has large errors. Formulas are in :mod:`phase_ppl.inference.kernels.local_mh`.

    Args:
        program: the event's program, of :func:`phase_ppl.program`.
        guide: bottom-up proposal program over the prior's sites; None: the program's. Its proposal
            for the whole video draws the initial hypotheses.
        settings: ``SimpleSettings`` with eta and the length of windows; None: the program's, or
            else the paper's.
        rule: acceptance ratio. "exact": Hastings' ratio with the window summed out; "window":
            Hastings' ratio with the window as part of the move; "paper": the ratio as printed,
            which is biased.
        early_reject: whether to stop a simulation once it cannot be accepted any more. The chain is
            the same with and without.

    Raises:
        UnknownNameError: there is no such rule.
    """

    def __init__(
        self,
        program: EventProgram,
        guide: Guide | None = None,
        settings: SimpleSettings | None = None,
        *,
        rule: Rule = "exact",
        early_reject: bool = True,
    ) -> None:
        super().__init__(program, guide, settings, early_reject=early_reject)
        if rule not in RULES:
            raise unknown_name("rule", rule, RULES)
        self._rule: Rule = rule

    @property
    def validity(self) -> Validity:
        """How far to trust the kernel: "exact", or "approximate" with the printed rule."""
        return "exact" if self._rule in EXACT_RULES else "approximate"

    def memo(self, sites: Sites) -> dict[str, jax.Array]:
        """Return the log density (window,) of proposing ``sites`` from each window.

        It is -inf for windows that do not exist.
        """
        windows = jnp.arange(self.most_windows)
        density = jax.vmap(lambda window: self.guide.log_prob(sites, window))(windows)
        if self.program.is_padded:
            density = jnp.where(windows < self.n_windows, density, -jnp.inf)
        return {"log_proposal": density}

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return a hypothesis proposed from the whole observation."""
        return self.guide.draw(key, self.n_windows)

    def log_initial_proposal(self, sites: Sites, log_prior: jax.Array) -> jax.Array:
        """Return the log density of proposing ``sites`` from the whole observation."""
        return self.guide.log_prob(sites, self.n_windows)

    def propose(self, state: MHState) -> tuple[Proposed, Request]:
        """Propose from a window in which the simulation has large errors."""
        key, key_window, key_sites, key_seed, key_accept = random.split(state.rng_key, 5)
        window, sites = self.propose_locally(key_window, key_sites, state)
        move = self.local_move(window, sites, state)
        return self.asked(move, state, key, key_seed, key_accept)

    def propose_locally(
        self, key_window: jax.Array, key_sites: jax.Array, state: MHState
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Return a window with large errors of the simulation, and a hypothesis from it."""
        window = random.categorical(key_window, self.log_windows(state.step_error))
        return window, self.guide.draw(key_sites, window)

    def local_move(self, window: jax.Array, sites: dict[str, jax.Array], state: MHState) -> Move:
        """Return the move to a hypothesis that was proposed from a window."""
        rule, log_prior, memo = self._rule, self.program.log_prior(sites), self.memo(sites)
        before, log_windows = state.memo["log_proposal"], self.log_windows(state.step_error)
        known = log_before(
            rule, window, (state.log_prior, log_prior), (before, memo["log_proposal"]), log_windows
        )
        return Move(
            sites,
            log_prior,
            memo,
            known,
            log_after_bound(rule, before),
            window,
            logsumexp(log_windows + memo["log_proposal"]),
        )

    def log_after(self, move: Move, state: MHState, step_error: jax.Array) -> jax.Array | float:
        """Return the part of the log reverse probability that depends on the errors (time,)."""
        before = state.memo["log_proposal"]
        return log_after(self._rule, move.window, before, self.log_windows(step_error))

    def request_given(
        self,
        key: jax.Array,
        given: dict[str, jax.Array],
        log_drawn: jax.Array,
        log_floor: jax.Array,
    ) -> Request:
        """Return the request for a simulation of a hypothesis with some sites given.

        The given sites were drawn with log probability ``log_drawn``. The others are drawn from the
        proposal for the whole observation, given them. The request keeps the density of both
        together. The simulation stops when its log likelihood cannot reach ``log_floor``.
        """
        # Q may lack a share of the prior: nothing is divided by it here
        assert self._guide is not None, "a run gives one"
        program, window = self.program, jnp.asarray(self.n_windows)
        bottom_up = self._guide.programs[0]
        key_sites, key_seed = random.split(key)
        sites = draw(handlers.substitute(bottom_up, data=given), key_sites, window)
        trace = handlers.trace(handlers.substitute(bottom_up, data=sites)).get_trace(window)
        others = {name: site for name, site in trace.items() if name not in given}
        log_prior, log_proposal = program.log_prior(sites), log_drawn + trace_log_density(others)
        seed = program.simulator_seed(key_seed)
        return Request(sites, log_prior, seed, self.error_ceiling(log_floor), log_proposal)

    def log_windows(self, step_error: jax.Array) -> jax.Array:
        """Return (window,) the log probability of choosing each window, given errors (time,)."""
        length = window_length(self.program.n_frames, self.settings.window)
        count = self.n_windows if self.program.is_padded else None
        return log_window_choice(step_error, self.settings.eta, length, count)
