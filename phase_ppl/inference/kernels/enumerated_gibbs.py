r"""Gibbs sampling of goals by simulating all of them; Metropolis-Hastings for the rest.

An agent's goal is drawn from its conditional given everything else. The target P(h) p(w) L(e(h, w))
has one simulator seed w. Give each value v of the goal a seed w_v of its own:

    P(v, rest) L(e(v, rest, w_v)) prod_v p(w_v)

Summed over the seeds of all other values this is the target again. So a move that leaves it
invariant is exact. The kernel makes two such moves:

1. Given the current value, the seeds of the others are independent of everything: draw them anew.
2. Given all seeds, draw the value with probability proportional to P(v, rest) L(e(v, rest, w_v)).
   The current value keeps the state's seed and errors. The seeds not chosen are then dropped.

All values are simulated in one batch, to the end, because each one's likelihood counts. Only agents
that act on their own goal are chosen: the goal of a helper or hinderer changes no simulation. The
site of who helps or hinders whom stays the same, so the choice needs no correction.
"""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import random

from phase_ppl.inference.kernels.metropolis import MetropolisKernel, MHState, for_each
from phase_ppl.inference.registry import register_kernel
from phase_ppl.models.bridge import Request
from phase_ppl.models.density import NO_DENSITY
from phase_ppl.world.scene import PHASE
from phase_ppl.world.space import HypothesisSpace, space_of


def most_simulations(space: HypothesisSpace) -> int:
    """Return the most simulations that a step takes: one per other goal of an agent, and one more.

    Goals without prior mass are not simulated.
    """
    return int((~space.impossible).sum(axis=1).max())


SIMS_PER_STEP: Final = most_simulations(space_of(PHASE))


@register_kernel("enumerated_gibbs", validity="exact", sims_per_step=SIMS_PER_STEP, any_length=True)
class EnumeratedGibbs(MetropolisKernel):
    """Gibbs sampling of goals by simulating all, with Metropolis-Hastings for the rest.

    Draws one agent's goal from its conditional, then moves a random site as single_site_mh does.
    ``early_reject`` is about the second.
    """

    moves = ("goals_asked", "goal_drawn", "accept")

    @property
    def sims_per_step(self) -> int:
        """The most simulations that a step takes."""
        return SIMS_PER_STEP if self._program is None else most_simulations(self.program.space)

    def goals_asked(self, state: MHState) -> tuple[Any, Request]:
        """Ask for the simulations (goal,) of all values of one agent's goal."""
        program, space = self.program, self.program.space
        key, key_goal, *keys_after = random.split(state.rng_key, 5)
        key_agent, key_value, *keys = random.split(key_goal, 2 + space.n_goals)
        acts_on_own = space.owner == np.arange(space.n_agents)
        log_choice = jnp.asarray(np.where(acts_on_own, 0.0, -np.inf))
        agent = random.categorical(key_agent, log_choice[state.z[space.company_site]])
        current = jnp.stack([state.z[name] for name in space.goal_sites])[agent]

        def asked(value: jax.Array, key: jax.Array) -> tuple[jax.Array, Request]:
            sites = self._with_goal(state, agent, value)
            kept = value == current
            log_prior = program.log_prior(sites)
            seed = jnp.where(kept, state.sim_seed, program.simulator_seed(key, sites))
            # goals without prior mass are not simulated
            return log_prior, Request(sites, jnp.where(kept, -jnp.inf, log_prior), seed)

        log_prior, request = for_each(asked, jnp.arange(space.n_goals), jnp.stack(keys))
        known = state, agent, current, log_prior, request.seed, key_value, (key, *keys_after)
        return known, request

    def goal_drawn(self, known: Any, step_error: jax.Array) -> tuple[Any, Request]:
        """Draw that goal, given the errors (goal, time), and propose another value of a site."""
        state, agent, current, log_prior, seed, key_value, keys = known
        program, values = self.program, jnp.arange(self.program.space.n_goals)
        step_error = jnp.where((values == current)[:, None], state.step_error, step_error)
        by_frame = program.log_likelihood(step_error)
        # relative to errors of 0, so that the large constant of the likelihood cancels
        likeness = (by_frame - program.log_likelihood(jnp.zeros_like(step_error))).sum(axis=1)
        weight = jnp.where(log_prior > NO_DENSITY, log_prior + likeness, -jnp.inf)
        value = random.categorical(key_value, weight)
        value = jnp.where(jnp.isfinite(weight).any(), value, current)  # all failed
        drawn = state._replace(
            z=self._with_goal(state, agent, value),
            sim_seed=seed[value],
            log_prior=log_prior[value],
            step_error=step_error[value],
            log_joint=log_prior[value] + by_frame[value].sum(),
        )
        key, key_site, key_seed, key_accept = keys
        sites, log_hastings = self.one_site_moved(key_site, drawn.z)
        move = self.move_to(sites, log_hastings, drawn)
        proposed, request = self.asked(move, drawn, key, key_seed, key_accept)
        return (proposed, drawn.sim_seed != state.sim_seed), request

    def accept(self, known: Any, step_error: jax.Array) -> MHState:
        proposed, changed = known
        new = super().accept(proposed, step_error)
        accepted = new.accepted | changed
        return new._replace(accepted=accepted, n_accepted=proposed.state.n_accepted + accepted)

    def _with_goal(self, state: MHState, agent: jax.Array, value: jax.Array) -> Any:
        """Return the hypothesis of a state with another goal of an agent."""
        goals = {
            name: jnp.where(agent == holder, value, state.z[name]).astype(state.z[name].dtype)
            for holder, name in enumerate(self.program.space.goal_sites)
        }
        return {**state.z, **goals}
