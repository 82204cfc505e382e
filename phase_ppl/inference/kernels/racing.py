r"""Racing: SIMPLE's chains, and as many simulations again that go where the posterior is decided.

Simulators of agents that search are noisy: two simulations of one hypothesis may differ by nats
in their log likelihood, so that a posterior over pairs of effective goals (g_i, g_j) stands and
falls with how well the mean likelihoods of the few pairs that lead, or could lead, are known.
Every other particle, the first one too, is a chain of SIMPLE's
(:mod:`~phase_ppl.inference.kernels.local_mh`), which refines what it has found where its
simulation fails. The others take their simulations, one an iteration, to

1. *new pairs*, a fifth of them: those never simulated that promise most, by
   Q(pair) / P(pair)^(1/2). Q is the bottom-up proposal of the whole observation; half of the
   prior is taken out of it again, so that what is rare but fits, such as rivals, is tried as well.
   Their first simulations are of new pairs only, all different.
2. *second chances*, two fifths: pairs that were tried before, in proportion to the root of what
   they promise, however they fared. One simulation says little: agents may get stuck in it.
3. *leaders*, two fifths: each particle draws, for every pair that was tried, what its
   P(pair) mean L might be, log-normal about the estimate with a standard deviation of
   sigma / sqrt(n) nats after n simulations, and takes the highest (Thompson 1933, Biometrika
   25:285; for finding the best of several, Russo 2020, Operations Research 68:1625).

Everything else about a hypothesis, such as strengths, is drawn from Q given its pair. What is so
unlikely that it can neither lead nor count, nor be accepted by its chain, is not simulated to its
end.

Whatever was chosen, the simulations of a pair are independent draws of its likelihood, and the
prior says what each pair weighs: the weights "stratified" make the posterior of them, which is
consistent as simulations grow. Draws carry the weights of their simulations.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from jax.scipy.special import logsumexp

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import MHState, Move, log_ratio, moved
from phase_ppl.inference.kernels.particle import EventKernel, chosen, log_uniform
from phase_ppl.inference.registry import register_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.density import NO_DENSITY, Program, Sites, log_density
from phase_ppl.models.effective import prior_of_pairs
from phase_ppl.models.program import EventProgram
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES
from phase_ppl.world.checks import positive_number
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import effective_pairs
from phase_ppl.world.scene import check_is_phase

POOL: Final = 4096
"""Draws from the proposal in every iteration, of which those that are simulated are taken."""

NEW: Final = 1 / 5
AGAIN: Final = 2 / 5
"""Shares of the racing particles that try a new pair, and that give one a second chance."""

PRIOR_POWER: Final = 0.5
"""Of the prior, taken out of the proposal for the order in which pairs are tried first."""

NEGLIGIBLE: Final = 12.0
"""Nats below the leading pair from which on a simulation makes no difference."""


class RacingState(NamedTuple):
    """State of a particle; those that race know of each other's simulations."""

    i: jax.Array
    # the hypothesis simulated last with any further sites; an earlier one where the last was not
    # simulated to its end
    z: dict[str, jax.Array]
    sim_seed: jax.Array
    accepted: jax.Array  # whether it was
    n_accepted: jax.Array
    n_of_pair: jax.Array  # (pair,) this particle's simulations of each pair of effective goals
    log_sum_of_pair: jax.Array  # (pair,) log of their summed likelihoods, less that of no error
    chain: MHState  # SIMPLE's, of every other particle; of the others it is not used
    rng_key: jax.Array


@register_kernel(
    "racing",
    validity="consistent",
    needs=("guide", "settings"),
    keeps="start",
    weights="stratified",
    any_length=True,
)
class Racing(EventKernel[RacingState]):
    """SIMPLE's chains beside simulations of the pairs of goals that lead, or could lead.

    Args:
        sigma: standard deviation of the log likelihood over simulator seeds that is reckoned
            with, nats: the larger, the longer are pairs tried again that seem to have lost.

    Raises:
        InvalidSettingError: ``sigma`` is no positive number, or the event is of another world than
            PHASE: the kernel keeps account of all pairs of goals of two agents.
    """

    def __init__(
        self,
        program: EventProgram | None = None,
        guide: Program | None = None,
        settings: SimpleSettings | None = None,
        *,
        sigma: float = 8.0,
    ) -> None:
        super().__init__(program, guide, settings)
        if program is not None:
            check_is_phase(program.space.world, "kernel 'racing'")
        self._sigma = positive_number("sigma", sigma)

    def _start(self, keys: jax.Array, given: dict[str, jax.Array] | None) -> RacingState:
        n = keys.shape[0]
        zeros = jnp.zeros(n, jnp.int32)
        nothing = jnp.full((n, N_GOALS**2), -jnp.inf, jnp.float32)
        n_of_pair = jnp.zeros(nothing.shape, jnp.int32)
        keys, to_begin = jnp.swapaxes(jax.vmap(random.split)(keys), 0, 1)
        first = jax.vmap(lambda key: self.draw_guide(key, self.n_windows))(to_begin)
        if given is not None:
            first = {name: given[name].astype(value.dtype) for name, value in first.items()}
        # the first simulations take the place of what is not known of a chain
        nothing_known = jnp.zeros(n, jnp.float32)
        chain = MHState(
            zeros,
            first,
            zeros,
            nothing_known,
            {"log_proposal": jnp.zeros((n, self.most_windows), jnp.float32)},
            jnp.zeros((n, self.program.n_frames), jnp.float32),
            nothing_known,
            zeros - 1,
            zeros > 0,
            zeros,
            keys,
        )
        state = RacingState(
            zeros - 1, first, zeros, zeros > 0, zeros, n_of_pair, nothing, chain, keys
        )
        return self._step(state, given)

    @property
    def _local(self) -> LocalMH:
        return LocalMH(self._program, self._guide, self.settings)

    def _step(self, state: RacingState, given: dict[str, jax.Array] | None = None) -> RacingState:
        """Propose for the chains, choose a pair of goals for the others, and simulate."""
        program, begins = self.program, state.i < 0
        keys = jax.vmap(lambda key: random.split(key, 6))(state.rng_key)
        log_prior_of_pair = self._log_prior_of_pairs()
        place = jnp.arange(len(keys))
        # of those that race only: what chains dwell on would hide what is worth a second chance
        racers = slice(1, None, 2) if len(keys) > 1 else slice(None)
        tried = state.n_of_pair[racers].sum(axis=0)
        log_sum = logsumexp(state.log_sum_of_pair[racers], axis=0)
        log_mean = log_sum - jnp.log(jnp.maximum(tried, 1))
        log_mass = jnp.where(tried > 0, log_prior_of_pair + log_mean, -jnp.inf)
        window, sites = jax.vmap(self._local.propose_locally)(keys[:, 3], keys[:, 4], state.chain)
        sites = jax.vmap(chosen)(begins, state.chain.z, sites)
        from_whole = begins
        if given is None and len(keys) > 1:
            raced = self._chosen(keys[1::2, 0], state.i[0], tried, log_mass, log_prior_of_pair)
            sites = {name: values.at[1::2].set(raced[name]) for name, values in sites.items()}
            from_whole |= place % 2 == 1
        pair = _pair_of(sites)
        move = jax.vmap(self._move)(window, sites, state.chain)
        log_proposal = jnp.where(
            from_whole,
            jax.vmap(lambda one: log_density(self.guide, one, self.n_windows))(sites),
            move.log_proposal,
        )
        seed = jax.vmap(program.simulator_seed)(keys[:, 1], sites)
        without_error = program.log_likelihood(jnp.zeros(program.n_frames)).sum()
        log_floor = log_mass.max() - NEGLIGIBLE - log_prior_of_pair[pair] + without_error
        log_u = jax.vmap(log_uniform)(keys[:, 5])
        # what a chain's proposal needs at least to be accepted
        current = jax.vmap(lambda error: program.log_likelihood(error).sum())(
            state.chain.step_error
        )
        accepts_from = log_u - move.log_known - move.log_bound + current
        accepts_from = jnp.where(begins, -jnp.inf, accepts_from)
        log_floor = jnp.where(place % 2 == 0, jnp.minimum(log_floor, accepts_from), log_floor)
        errors = jax.vmap(program.simulate)(
            sites, move.log_prior, seed, self.error_ceiling(log_floor), log_proposal
        )
        completed = jnp.isfinite(errors).all(axis=-1)
        found = jax.vmap(program.relative_log_likelihood)(errors)
        # what was stopped has reached the floor at best
        at_best = jnp.where(jnp.isfinite(log_floor), log_floor - without_error, -jnp.inf)
        found = jnp.where(completed, found, at_best)
        chain = jax.vmap(self._moved)(state.chain, move, seed, errors, log_u, begins)
        sums = state.log_sum_of_pair
        z, sim_seed = jax.vmap(chosen)(completed, (sites, seed), (state.z, state.sim_seed))
        return RacingState(
            state.i + 1,
            z,
            sim_seed,
            completed,
            state.n_accepted + completed,
            state.n_of_pair.at[place, pair].add(1),
            sums.at[place, pair].set(jnp.logaddexp(sums[place, pair], found)),
            chain,
            keys[:, 2],
        )

    def _move(self, window: jax.Array, sites: dict[str, jax.Array], chain: MHState) -> Move:
        move = self._local.local_move(window, sites, chain)
        return move._replace(log_after=None)  # type: ignore[arg-type]  # no array can hold it

    def _moved(
        self,
        chain: MHState,
        move: Move,
        seed: jax.Array,
        errors: jax.Array,
        log_u: jax.Array,
        begins: jax.Array,
    ) -> MHState:
        """Return a chain after a simulation of what it proposed; before the first it has none."""
        current, proposed = map(self.program.log_likelihood, (chain.step_error, errors))
        back = logsumexp(self._local.log_windows(errors) + chain.memo["log_proposal"])
        ratio = log_ratio(move.log_known, current, proposed, back)
        # not a number, where both failed: rejected
        accepted = begins | (log_u < ratio)
        return chosen(accepted, moved(chain, move, seed, errors, proposed), chain)

    def _chosen(
        self,
        keys: jax.Array,
        i: jax.Array,
        tried: jax.Array,
        log_mass: jax.Array,
        log_prior_of_pair: jax.Array,
    ) -> dict[str, jax.Array]:
        """Return what to simulate.

        Args:
            keys: of the particles that race.
            i: iterations so far; -1 for the first simulations, of new pairs only.
            tried: (pair,) simulations so far.
            log_mass: (pair,) log P(pair) mean L, -inf for what was not tried.
            log_prior_of_pair: (pair,).
        """
        n = len(keys)
        key_pool, key_member = random.split(keys[0])
        pool = jax.vmap(lambda key: self.draw_guide(key, self.n_windows))(
            random.split(key_pool, POOL)
        )
        possible = jax.vmap(self.program.log_prior)(pool) > NO_DENSITY
        of_draw = _pair_of(pool)
        drawn = jnp.zeros(N_GOALS**2).at[of_draw].add(possible)
        promise = jnp.log(drawn) - PRIOR_POWER * log_prior_of_pair
        possible_pair = (drawn > 0) & jnp.isfinite(log_prior_of_pair)
        untried = jnp.where((tried == 0) & possible_pair, promise, -jnp.inf)
        best_new = jnp.argsort(-untried)[jnp.minimum(jnp.arange(n), N_GOALS**2 - 1)]

        chance = jax.vmap(lambda key: random.normal(key, log_mass.shape))(keys)
        # the best of particles' chances is the draw of a pair in proportion to its weight
        gumbel = jax.vmap(lambda key: random.gumbel(key, log_mass.shape))(keys)
        again = jnp.where((tried > 0) & (drawn > 0), promise / 2, -jnp.inf)
        second = jnp.argmax(again + gumbel, axis=1)
        could = log_mass + chance * self._sigma / jnp.sqrt(jnp.maximum(tried, 1))
        leader = jnp.argmax(jnp.where(drawn > 0, could, -jnp.inf), axis=1)

        place = jnp.arange(n)
        n_new = jnp.where(i < 0, n, _by(NEW, i + 1, n) - _by(NEW, i, n))
        n_again = _by(AGAIN, i + 1, n) - _by(AGAIN, i, n)
        is_new = (place < jnp.minimum(n_new, N_GOALS**2)) & jnp.isfinite(untried[best_new])
        pair = jnp.where(place < n_new + n_again, second, leader)
        pair = jnp.where(is_new, best_new, pair)
        # any of the pool's draws of the pair; should it have none, any draw
        order = random.gumbel(key_member, (n, POOL)) + jnp.where(of_draw == pair[:, None], 0, -1e6)
        member = jnp.argmax(jnp.where(possible, order, -jnp.inf), axis=1)
        return {name: values[member] for name, values in pool.items()}

    def _log_prior_of_pairs(self) -> jax.Array:
        """Return (pair,) log P(pair), -inf for what is impossible."""
        with jax.ensure_compile_time_eval():
            mass = prior_of_pairs(self.program.model.prior)
        with np.errstate(divide="ignore"):
            return jnp.asarray(np.log(mass.ravel()), jnp.float32)


def _by(share: float, i: jax.Array, n: int) -> jax.Array:
    """Return how many of n particles' simulations were for a purpose after i iterations."""
    return jnp.floor(i * n * share + 1e-3).astype(jnp.int32)


def _pair_of(sites: Sites) -> jax.Array:
    """Return (...) the pair of effective goals, 36 x that of red + that of green."""
    pairs = jnp.asarray(effective_pairs(), jnp.int32)
    return pairs[tuple(sites[name] for name in (*GOAL_SITES, ALPHA_SITE))]
