r"""SIMPLE's data-driven Metropolis-Hastings kernel.

Paper, "Inference via Metropolis-Hastings with Local Estimation": draw a local interval where
the current simulation errs most, propose a hypothesis bottom-up from the interval's data,
simulate it, accept or reject.

With r(k | e) the probability of interval k given the current errors e, and Q(h | S_k) the
proposal, the exact rule sums the interval out:

    A = P(h') L(h') sum_k r(k | e') Q(h | S_k)  /  P(h) L(h) sum_k r(k | e) Q(h' | S_k)

The rule as printed, kept as ``rule="paper"``, multiplies by Q(h' | S_k) / Q(h | S_k), the inverse
of what detailed balance needs, and leaves out the prior; it leaves another distribution invariant.
"""

from __future__ import annotations

from typing import Final, Literal

import jax
import jax.numpy as jnp
from jax import random
from jax.scipy.special import logsumexp

from phase_ppl.inference.kernels.base import HypothesisMH, MHState, Proposal
from phase_ppl.inference.program import Program, Sites
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.sites import SITES
from phase_ppl.world.errors import unknown_name

RULES: Final = ("exact", "paper")


@register_kernel(
    "local_mh",
    validity="exact",
    sims_per_step=1,
    chain_methods=("vectorized", "sequential", "parallel"),
)
class LocalMH(HypothesisMH):
    """SIMPLE's kernel.

    Args:
        program: the programs of one inference.
        rule: "exact" or "paper" (as printed; not exact).
        early_reject: stop hopeless simulations.

    Raises:
        UnknownNameError: there is no such rule.
    """

    def __init__(
        self,
        program: Program,
        *,
        rule: Literal["exact", "paper"] = "exact",
        early_reject: bool = True,
    ) -> None:
        if rule not in RULES:
            raise unknown_name("rule", rule, RULES)
        super().__init__(program, early_reject=early_reject)
        self.rule = rule

    @property
    def validity(self) -> str:
        return "exact" if self.rule == "exact" else "approximate"

    def initial(self, key: jax.Array) -> Sites:
        """Draw from the same mixture, over the whole video."""
        whole = jnp.asarray(self.program.proposals.n_windows)
        z, _ = self._draw(key, whole)
        return z

    def log_target(self, log_prior: jax.Array, log_likelihood: jax.Array) -> jax.Array:
        """Return log P(h) L(h); the printed rule leaves P(h) out."""
        return log_prior + log_likelihood if self.rule == "exact" else log_likelihood

    def propose(self, key: jax.Array, state: MHState) -> Proposal:
        """Draw an interval from the current errors, and a hypothesis from it."""
        proposals = self.program.proposals
        key_window, key_z = random.split(key)
        log_r = proposals.window_log_weights(state.step_error)
        k = random.categorical(key_window, log_r)
        z, local = self._draw(key_z, k, state.z)
        log_prior = self.program.log_prior(z)
        log_q_new = self._log_q(z, log_prior, local)
        log_q_old = self._log_q(state.z, state.log_prior, local)
        if self.rule == "exact":
            forward = logsumexp(log_r + log_q_new)
            bound = log_q_old.max()

            def reverse(errors: jax.Array) -> jax.Array:
                return logsumexp(proposals.window_log_weights(errors) + log_q_old)
        else:
            # as printed: Q of the proposal stands in the numerator
            forward = log_q_old[k]
            bound = log_q_new[k]

            def reverse(errors: jax.Array) -> jax.Array:
                return log_q_new[k]

        start = jnp.asarray(proposals.starts)[k]
        return Proposal(z, log_prior, start, forward, reverse, bound)

    def _draw(
        self, key: jax.Array, window: jax.Array, current: Sites | None = None
    ) -> tuple[Sites, jax.Array]:
        """Draw from 0.9 Q_local + 0.1 prior; also return whether it was the local part.

        A user's own sites come from the prior; a local move leaves those of ``current`` alone.
        """
        key_coin, key_prior, key_local = random.split(key, 3)
        local = random.uniform(key_coin) >= self.program.proposals.prior_share
        from_prior = self.program.sample_prior(key_prior)
        from_guide = dict(current or from_prior)
        from_guide.update(self.program.sample_local(key_local, window))
        z = {name: jnp.where(local, from_guide[name], v) for name, v in from_prior.items()}
        return z, local

    def _log_q(self, z: Sites, log_prior: jax.Array, local: jax.Array) -> jax.Array:
        """Return (W,) log density of proposing ``z`` from each interval.

        Without own sites this is one mixture. With own sites, which a local move does not touch,
        the coin chooses between two moves, each exact by itself.
        """
        proposals = self.program.proposals
        windows = jnp.arange(proposals.n_windows)
        log_local = self.program.log_local({name: z[name] for name in SITES}, windows)
        if self.program.own_sites:
            return jnp.where(local, log_local, log_prior)
        share = proposals.prior_share
        return jnp.logaddexp(jnp.log1p(-share) + log_local, jnp.log(share) + log_prior)
