r"""SIMPLE: Metropolis-Hastings with local, bottom-up proposals (paper, Section 4).

A particle looks where its simulation fails: it picks a window k of the observation with
probability r(k | e) proportional to exp(eta * sum of its errors e in the window), and proposes a
hypothesis from what the observation shows in that window, h' ~ Q(. | S_k), with a fresh
simulator seed.

``rule="exact"``. The target is P(h) p(w) L(e(h, w)) over hypothesis h and simulator seed w. The
window is a random choice within the move, and it depends on the current errors; summing it out
of the move in both directions gives

    log A = log P(h') - log P(h) + log L(e') - log L(e)
            + log sum_k r(k | e') Q(h | S_k) - log sum_k r(k | e) Q(h' | S_k)

``rule="paper"``. The ratio as printed: log L(e') - log L(e) + log Q(h' | S_k) - log Q(h | S_k),
for the chosen window. It has the proposals upside down, no prior and no window term. Within a
fixed window it leaves L Q^2 invariant instead of the posterior.

Early rejection. log u is drawn first. All but L(e') and r(k | e') is known before simulating,
and sum_k r(k | e') Q(h | S_k) <= max_k Q(h | S_k), so that there is a summed error beyond which
the proposal cannot be accepted; the runner stops there. Decisions are the same with and without.
"""

from __future__ import annotations

from typing import Any, Final, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from jax.scipy.special import logsumexp

from phase_ppl.inference.particle import ParticleKernel, chosen, log_uniform
from phase_ppl.inference.proposals import window_count, window_length
from phase_ppl.inference.registry import Validity, register_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.density import Program, Sites, log_density
from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import unknown_name

Rule = Literal["exact", "paper"]

RULES: Final = ("exact", "paper")


class LocalMHState(NamedTuple):
    """State of one particle.

    Attributes:
        i: iterations so far.
        z: site -> value, the current hypothesis with any further sites.
        sim_seed: seed of its simulation.
        log_prior: its log prior density.
        log_proposal: (window,) log Q(z | S_k) for every window k.
        step_error: (time,) errors of its simulation, units; never simulated again.
        log_joint: log prior + log likelihood, in single precision.
        window: the window of the last proposal, by its first frame; -1 before the first.
        accepted: whether the last proposal was accepted.
        n_accepted: how many were.
        rng_key: of the chain.
    """

    i: jax.Array
    z: dict[str, jax.Array]
    sim_seed: jax.Array
    log_prior: jax.Array
    log_proposal: jax.Array
    step_error: jax.Array
    log_joint: jax.Array
    window: jax.Array
    accepted: jax.Array
    n_accepted: jax.Array
    rng_key: jax.Array


class LocalMH(ParticleKernel[LocalMHState]):
    """SIMPLE's kernel; see the module for its rules.

    Args:
        program: the model of an event.
        guide: proposal program ``guide(window)`` over the prior's sites, with windows counted
            by their first frame; the index after the last one stands for the whole observation
            and makes the initial hypotheses.
        settings: eta and the length of the windows; by default the paper's.
        rule: "exact": Hastings' ratio; "paper": the ratio as printed, which is biased.
        early_reject: stop a simulation once it cannot be accepted any more; the chain is the
            same with and without.

    Raises:
        UnknownNameError: there is no such rule.
    """

    def __init__(
        self,
        program: EventProgram | None = None,
        guide: Program | None = None,
        settings: SimpleSettings | None = None,
        *,
        rule: Rule = "exact",
        early_reject: bool = True,
    ) -> None:
        super().__init__(program, guide, settings)
        if rule not in RULES:
            raise unknown_name("rule", rule, RULES)
        self._rule, self._early_reject = rule, early_reject

    @property
    def validity(self) -> Validity:
        """Whether the stationary law is the posterior: with the exact rule."""
        return "exact" if self._rule == "exact" else "approximate"

    @property
    def _n_windows(self) -> int:
        return window_count(self.model.n_frames, self.settings.window)

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return a hypothesis from what the whole observation shows."""
        return self.draw_guide(key, self._n_windows)

    def start_one(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> LocalMHState:
        """Simulate the initial hypothesis."""
        program = self.model
        seed = program.simulator_seed(key_start, sites)
        log_prior = program.log_prior(sites)
        step_error = program.simulate(sites, log_prior, seed)
        none = jnp.zeros((), jnp.int32)
        return LocalMHState(
            i=none,
            z=sites,
            sim_seed=seed,
            log_prior=log_prior,
            log_proposal=self._log_proposal(sites),
            step_error=step_error,
            log_joint=log_prior + program.log_likelihood(step_error).sum(),
            window=none - 1,
            accepted=jnp.array(False),
            n_accepted=none,
            rng_key=key,
        )

    def step_one(self, state: LocalMHState) -> LocalMHState:
        """Propose from a window that is simulated badly; accept by the rule."""
        program = self.model
        key, key_window, key_sites, key_seed, key_accept = random.split(state.rng_key, 5)
        log_windows = self._log_windows(state.step_error)
        window = random.categorical(key_window, log_windows)
        proposed = self.draw_guide(key_sites, window)
        log_prior = program.log_prior(proposed)
        log_proposal = self._log_proposal(proposed)
        seed = program.simulator_seed(key_seed, proposed)
        log_u = log_uniform(key_accept)
        current = program.log_likelihood(state.step_error)

        # what is known before simulating, and a bound of what is not, beside the likelihood
        if self._rule == "exact":
            forward = logsumexp(log_windows + log_proposal)
            known = log_prior - state.log_prior - forward
            bound = jnp.max(state.log_proposal)
        else:
            known = log_proposal[window] - state.log_proposal[window]
            bound = jnp.zeros(())
        floor = log_u - known - bound + current.sum()
        ceiling = self.error_ceiling(floor) if self._early_reject else np.inf

        step_error = program.simulate(proposed, log_prior, seed, ceiling)
        by_frame = program.log_likelihood(step_error)
        # frame by frame, so that the large constant of the likelihood cancels without rounding
        log_ratio = known + (by_frame - current).sum()
        if self._rule == "exact":
            log_ratio += logsumexp(self._log_windows(step_error) + state.log_proposal)
        accepted = log_u < log_ratio  # not a number, where both failed: rejected

        new = (proposed, seed, log_prior, log_proposal, step_error, log_prior + by_frame.sum())
        z, seed, log_prior, log_proposal, step_error, log_joint = chosen(
            accepted, new, _kept(state)
        )
        return LocalMHState(
            i=state.i + 1,
            z=z,
            sim_seed=seed,
            log_prior=log_prior,
            log_proposal=log_proposal,
            step_error=step_error,
            log_joint=log_joint,
            window=window.astype(jnp.int32),
            accepted=accepted,
            n_accepted=state.n_accepted + accepted,
            rng_key=key,
        )

    def _log_windows(self, step_error: jax.Array) -> jax.Array:
        """Return (window,) log r(k | e), normalised."""
        length = window_length(self.model.n_frames, self.settings.window)
        frames = np.arange(self._n_windows)[:, None] + np.arange(length + 1)
        finite = jnp.where(jnp.isfinite(step_error), step_error, 0.0)
        return jax.nn.log_softmax(self.settings.eta * finite[frames].sum(axis=1))

    def _log_proposal(self, sites: Sites) -> jax.Array:
        """Return (window,) log Q(sites | S_k)."""
        windows = jnp.arange(self._n_windows)
        return jax.vmap(lambda window: log_density(self.guide, sites, window))(windows)


def _kept(state: LocalMHState) -> tuple[Any, ...]:
    return (
        *(state.z, state.sim_seed, state.log_prior),
        *(state.log_proposal, state.step_error, state.log_joint),
    )


@register_kernel("local_mh", validity="exact", needs=("guide", "settings"))
def local_mh(
    program: EventProgram,
    *,
    guide: Program,
    settings: SimpleSettings,
    rule: Rule = "exact",
    early_reject: bool = True,
) -> LocalMH:
    """SIMPLE: Metropolis-Hastings with local, bottom-up proposals."""
    return LocalMH(program, guide, settings, rule=rule, early_reject=early_reject)
