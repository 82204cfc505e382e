"""Base classes of the kernels: batches of particles, and steps of Metropolis-Hastings.

The target is P(h) p(w) L(e(h, w)) over hypothesis h and simulator seed w, where e are the errors
of the simulation. A kernel proposes h' with a fresh seed w' and accepts if

    log u < log P(h') - log P(h) + log L(e') - log L(e) + log q(h | h') - log q(h' | h)

The seed and the errors belong to the state (pseudo-marginal). The current hypothesis is never
simulated again. The stationary law of h is the posterior under the mean likelihood over seeds.

Early rejection. log u is drawn first, so there is a summed error beyond which the proposal cannot
be accepted. The runner stops there. Decisions are the same with and without.
"""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Final, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, random
from numpyro import handlers
from numpyro.infer.mcmc import MCMCKernel
from numpyro.util import is_prng_key

from phase_ppl.inference.guide import Guide
from phase_ppl.inference.registry import Validity, register_kernel
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.tables import window_count
from phase_ppl.models.bridge import Request
from phase_ppl.models.density import (
    NO_DENSITY,
    Sites,
    compiled_quickly,
    is_stepped,
)
from phase_ppl.models.program import HOW_TO_CONDITION, EventProgram
from phase_ppl.world.errors import InvalidSettingError, shown

_SLACK: Final = 0.01
_RELATIVE_SLACK: Final = 1e-5


Stage = Callable[..., Any]
"""A pure function of its known values and the errors of the simulations requested last.

The last stage returns a state. The others return known values for the next one and a ``Request``.
"""


class EventKernel(MCMCKernel):
    """Base of our kernels: bound to the model of an event, and made of stages.

    A start and a move are stages (:data:`Stage`) with simulations in between. Stages are compiled,
    and simulating is plain Python. A start is ``initial(key, sites or None)``, simulate,
    ``started(known, errors)``. A move is ``propose(state)``, simulate, ``accept(known, errors)``.
    The simulations of all particles reach the runner in one call (``chain_method="vectorized"``).

    States hold constrained values, so nothing is replayed after the run. Beside the fields that the
    registry asks for, they have ``n_accepted``: how many of ``i`` iterations accepted, or could
    simulate, a hypothesis. The proposal program ``guide(window)`` counts windows by their first
    frame; the index after the last one stands for the whole observation.
    """

    sample_field: ClassVar[str] = "z"
    default_fields: ClassVar[tuple[str, ...]] = ("z", "sim_seed", "accepted")
    starts: ClassVar[tuple[str, ...]] = ("initial", "started")
    moves: ClassVar[tuple[str, ...]] = ("propose", "accept")
    """Names of the methods that are the stages of a start and of a move."""
    is_population: ClassVar[bool] = False
    """Whether stages get all particles together, because these depend on each other."""
    initial_tries: ClassVar[int] = 16
    """Initial hypotheses drawn per particle; the first one with prior mass is taken. It is 1 if
    draws are weighed, since the best of several has another density."""

    def __init__(
        self,
        program: EventProgram,
        guide: Guide | None = None,
        settings: SimpleSettings | None = None,
    ) -> None:
        if not isinstance(program, EventProgram):
            raise InvalidSettingError(
                f"{type(self).__name__}({shown(program)}): expected the phase_ppl.program itself, "
                f"whose prior a handler does not change; {HOW_TO_CONDITION}"
            )
        if guide is not None and not hasattr(guide, "draw"):
            raise InvalidSettingError(f"guide={shown(guide)}, expected one with draw and log_prob")
        self.program = program
        self._guide = guide
        # one of ``phase_ppl.program`` has settings, and a guide by them
        settings = getattr(program, "settings", None) if settings is None else settings
        self.settings = SimpleSettings() if settings is None else settings

    @property
    def guide(self) -> Guide:
        guide = getattr(self.program, "guide", None) if self._guide is None else self._guide
        if guide is None:
            raise InvalidSettingError(f"{type(self).__name__} needs a guide")
        if self.settings.prior_share == 0 and getattr(self, "validity", "exact") != "approximate":
            raise InvalidSettingError(
                f"prior_share=0 for {type(self).__name__}: only a share of the prior keeps Q, "
                "which it divides by, above 0; expected a number in (0, 1), or kernel='local_mh' "
                "with rule='paper', the ratio as printed"
            )
        found: Guide = guide
        return found

    def init(
        self,
        rng_key: jax.Array,
        num_warmup: int,
        init_params: dict[str, jax.Array] | None = None,
        model_args: tuple[Any, ...] = (),
        model_kwargs: dict[str, Any] | None = None,
    ) -> Any:
        """Return the initial state of the particle, or of a batch if ``rng_key`` is one.

        ``init_params`` is the hypothesis to start from, by default the kernel's own proposal. The
        other arguments are ignored: nothing is tuned, and the program knows its event.
        """
        # JAX takes compiler options for whole programs only, not for a part of one
        part = any(isinstance(one, jax.core.Tracer) for one in (rng_key, jnp.zeros(())))

        def started(given: tuple[Any, Any]) -> Any:
            return through(self.stages("starts"), self.program.answer, *given)

        start = (jax.jit if part else compiled_quickly)(started)
        if is_prng_key(rng_key):
            return as_batch_of_one(start, (rng_key, init_params))
        return start((rng_key, init_params))

    def sample(self, state: Any, model_args: Any = (), model_kwargs: Any = None) -> Any:
        return self._sample_fn(state)

    def _sample_fn(self, state: Any) -> Any:
        """Move one particle or a batch; NumPyro checks for this name to see if init is due."""

        def moved(state: Any) -> Any:
            return through(self.stages("moves"), self.program.answer, state)

        return as_batch_of_one(moved, state) if is_prng_key(state.rng_key) else moved(state)

    def stages(self, of: Literal["starts", "moves"]) -> list[Stage]:
        """Return the stages of a start or of a move, for all particles together."""
        *first, last = (getattr(self, name) for name in getattr(self, of))
        stages = [*first, last if of == "moves" else lambda *given: _strongly_typed(last(*given))]
        return stages if self.is_population else [functools.partial(for_each, s) for s in stages]

    def initial(self, key: jax.Array, sites: dict[str, jax.Array] | None) -> tuple[Any, Request]:
        """Start a particle at ``sites``, by default at :meth:`initial_sites`; see :data:`Stage`."""
        key, key_sites, key_start = random.split(key, 3)
        return self.start(key, key_start, self.initial_sites(key_sites) if sites is None else sites)

    def start(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> tuple[Any, Request]:
        """Return known values for ``started``, and the request for an initial simulation."""
        raise NotImplementedError

    def get_diagnostics_str(self, state: Any) -> str:
        """Return the share of accepted proposals, for NumPyro's progress bar."""
        return f"acc. rate={float(jnp.mean(state.n_accepted / jnp.maximum(state.i, 1))):.2f}"

    def lenient(self, log_floor: jax.Array) -> jax.Array:
        """Return a slightly lower log likelihood, since both it and simulations are rounded."""
        return log_floor - _SLACK - _RELATIVE_SLACK * jnp.abs(log_floor)

    def error_ceiling(self, log_floor: jax.Array) -> jax.Array:
        """Return the summed error [units] beyond which the log likelihood cannot reach a floor.

        It is lenient: no simulation is stopped that would have been accepted.
        """
        floor = self.lenient(log_floor)
        # without a floor, as before a first completed simulation, there is no ceiling either
        floor = jnp.where(jnp.isfinite(floor), floor, -jnp.inf)
        n_frames: Any = self.program.observed  # perhaps known only inside compiled code
        return self.program.likelihood.max_total_error(floor, n_frames)

    @property
    def n_windows(self) -> Any:
        """Number of windows of the observation; an array if the observation is padded."""
        if not self.program.is_padded:
            return self.most_windows
        # ``window_count`` for a length that is known only at run time
        return jnp.maximum(self.program.observed - self.settings.window, 1)

    @property
    def most_windows(self) -> int:
        """Number of windows that the arrays have room for."""
        return window_count(self.program.n_frames, self.settings.window)

    def initial_sites(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return the first of several initial hypotheses that has prior mass.

        A window may suggest what a user's prior excludes; the last try is from the prior.
        """
        if self.initial_tries == 1:
            return self.propose_initial(key)
        keys = random.split(key, self.initial_tries)
        tries = for_each(self.propose_initial, keys[1:])
        last = self.program.draw_prior(keys[0])
        tries = {
            name: jnp.append(values, last[name][None].astype(values.dtype), axis=0)
            for name, values in tries.items()
        }
        possible = for_each(self.program.log_prior, tries) > NO_DENSITY
        return {name: values[jnp.argmax(possible)] for name, values in tries.items()}

    def propose_initial(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return a hypothesis to start from; by default from the prior."""
        return self.program.draw_prior(key)


def log_uniform(key: jax.Array) -> jax.Array:
    """Return the log of a uniform random number, never -inf."""
    return -random.exponential(key)


def chosen(accepted: jax.Array, new: Any, old: Any) -> Any:
    """Return ``new`` where accepted, else ``old``, for whole trees of arrays."""
    return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), new, old)


def through(stages: Sequence[Stage], answer: Callable[[Request], Any], *given: Any) -> Any:
    """Return the result of an iteration's stages; ``answer`` fulfils their requests."""
    for stage in stages[:-1]:
        known, request = stage(*given)
        given = known, answer(request)
    return stages[-1](*given)


def for_each(function: Callable[..., Any], *trees: Any) -> Any:
    """Return ``jax.vmap(function)(*trees)``.

    Under ``jax.disable_jit`` it runs one after the other, so that a debugger shows numbers.
    """
    if not is_stepped():
        return jax.vmap(function)(*trees)
    n = len(jax.tree.leaves(trees)[0])
    rows = [function(*jax.tree.map(lambda leaf, i=i: leaf[i], trees)) for i in range(n)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)


def as_batch_of_one(function: Callable[[Any], Any], tree: Any) -> Any:
    """Apply a function of a batch to a single element, and return a single result."""
    return jax.tree.map(lambda leaf: leaf[0], function(jax.tree.map(lambda leaf: leaf[None], tree)))


def _strongly_typed(state: Any) -> Any:
    """Strip weak types; with them the step would be compiled twice."""

    def strip(leaf: jax.Array) -> jax.Array:
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            return leaf
        return lax.convert_element_type(leaf, np.dtype(leaf.dtype))

    return jax.tree.map(strip, jax.tree.map(jnp.asarray, state))


# --- steps of Metropolis-Hastings -----------------------------------------------------------------


class MHState(NamedTuple):
    """State of one particle."""

    i: jax.Array
    z: dict[str, jax.Array]  # site -> value, the current hypothesis with any further sites
    sim_seed: jax.Array
    log_prior: jax.Array  # its log prior density
    memo: dict[str, jax.Array]  # what else is known of it, see ``MetropolisKernel.memo``
    step_error: jax.Array  # (time,) errors of its simulation, units; never simulated again
    log_joint: jax.Array  # log prior + log likelihood, in single precision
    window: jax.Array  # the window of the last proposal, by its first frame; -1 where it had none
    accepted: jax.Array  # whether the last proposal was accepted
    n_accepted: jax.Array
    rng_key: jax.Array


class Move(NamedTuple):
    """A proposed hypothesis, and the part of its acceptance ratio known before simulating."""

    sites: dict[str, jax.Array]  # the hypothesis
    log_prior: jax.Array  # its log prior density
    memo: dict[str, jax.Array]  # of the hypothesis, see ``MetropolisKernel.memo``
    # the log ratio as far as it is known: all but the likelihoods and ``log_after``
    log_known: jax.Array
    log_bound: jax.Array | float = 0.0  # the most that ``log_after`` can be
    window: jax.Array | int = -1  # see ``MHState``
    # log density of the draw that made the hypothesis, given the state; NaN where it has none, as
    # of a move of a single site
    log_proposal: jax.Array | float = np.nan


class Proposed(NamedTuple):
    """A move whose simulation was requested."""

    state: MHState  # from where
    move: Move
    seed: jax.Array  # of the simulation
    log_u: jax.Array  # log of the random number that decides
    key: jax.Array  # of the state to come


def log_ratio(
    log_known: jax.Array,
    current: jax.Array,
    proposed: jax.Array,
    log_after: jax.Array | float = 0.0,
) -> jax.Array:
    """Return the log of the acceptance ratio; see :class:`Move`.

    ``current`` and ``proposed`` are (time,) log likelihoods of the frames under the two hypotheses.
    """
    # frame by frame: the large constant of the likelihood cancels without rounding
    return log_known + (proposed - current).sum() + log_after


class MetropolisKernel(EventKernel):
    """Base of the family: a subclass proposes a :class:`Move`, which :meth:`accept` decides on.

    With ``early_reject`` a simulation is stopped once it cannot be accepted any more; the chain is
    the same with and without.
    """

    def __init__(
        self,
        program: EventProgram,
        guide: Guide | None = None,
        settings: SimpleSettings | None = None,
        *,
        early_reject: bool = True,
    ) -> None:
        super().__init__(program, guide, settings)
        self._early_reject = early_reject

    @property
    def validity(self) -> Validity:
        return "exact"

    def memo(self, sites: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Return values of a hypothesis that the kernel needs again later; by default none."""
        return {}

    def log_initial_proposal(self, sites: Sites, log_prior: jax.Array) -> jax.Array | float:
        """Return the log density of :meth:`propose_initial`; NaN where it is not known."""
        return log_prior

    def start(
        self, key: jax.Array, key_start: jax.Array, sites: dict[str, jax.Array]
    ) -> tuple[Any, Request]:
        log_prior = self.program.log_prior(sites)
        log_proposal = self.log_initial_proposal(sites, log_prior)
        seed = self.program.simulator_seed(key_start)
        known = key, sites, seed, log_prior
        return known, Request(sites, log_prior, seed, log_proposal=log_proposal)

    def started(self, known: Any, step_error: jax.Array) -> MHState:
        key, sites, seed, log_prior = known
        none = jnp.zeros((), jnp.int32)
        return MHState(
            i=none,
            z=sites,
            sim_seed=seed,
            log_prior=log_prior,
            memo=self.memo(sites),
            step_error=step_error,
            log_joint=log_prior + self.program.log_likelihood(step_error).sum(),
            window=none - 1,
            accepted=jnp.array(False),
            n_accepted=none,
            rng_key=key,
        )

    def log_after(self, move: Move, state: MHState, step_error: jax.Array) -> jax.Array | float:
        """Return what the simulation (time,) adds to the log ratio, beside its likelihood.

        It is not 0 if the probability of the reverse move depends on the simulation.
        """
        return 0.0

    def asked(
        self, move: Move, state: MHState, key: jax.Array, key_seed: jax.Array, key_accept: jax.Array
    ) -> tuple[Proposed, Request]:
        """Return a move, and the request for the simulation that decides on it."""
        seed = self.program.simulator_seed(key_seed)
        log_u = log_uniform(key_accept)
        request = Request(move.sites, move.log_prior, seed, log_proposal=move.log_proposal)
        if self._early_reject:
            current = self.program.log_likelihood(state.step_error).sum()
            floor = log_u - move.log_known - move.log_bound + current
            ceiling, log_bound = self.error_ceiling(floor), log_u - self.lenient(floor)
            request = request._replace(error_ceiling=ceiling, log_bound=log_bound)
        return Proposed(state, move, seed, log_u, key), request

    def accept(self, known: Proposed, step_error: jax.Array) -> MHState:
        """Return the state after the acceptance or rejection of a move."""
        state, move, seed, log_u, key = known
        current = self.program.log_likelihood(state.step_error)
        proposed = self.program.log_likelihood(step_error)
        after = self.log_after(move, state, step_error)
        accepted = log_u < log_ratio(move.log_known, current, proposed, after)  # NaN: rejected
        moved = state._replace(
            z=move.sites,
            sim_seed=seed,
            log_prior=move.log_prior,
            memo=move.memo,
            step_error=step_error,
            log_joint=move.log_prior + proposed.sum(),
        )
        return chosen(accepted, moved, state)._replace(
            i=state.i + 1,
            window=jnp.asarray(move.window, jnp.int32),
            accepted=accepted,
            n_accepted=state.n_accepted + accepted,
            rng_key=key,
        )


class ProposalKernel(MetropolisKernel):
    """Base of the kernels of the family whose proposal does not look at simulations."""

    @abstractmethod
    def proposed(
        self, key: jax.Array, state: MHState
    ) -> tuple[dict[str, jax.Array], jax.Array, jax.Array | float]:
        """Return a hypothesis z', log q(z | z') - log q(z' | z), and the log density of its draw.

        q is the proposal, z the hypothesis of ``state``. The log density is NaN if it is unknown.
        """

    def propose(self, state: MHState) -> tuple[Proposed, Request]:
        key, key_propose, key_seed, key_accept = random.split(state.rng_key, 4)
        sites, log_hastings, log_proposal = self.proposed(key_propose, state)
        log_prior = self.program.log_prior(sites)
        # from a start without mass, every completed simulation is accepted
        known = log_prior - state.log_prior + log_hastings
        known = jnp.where(state.log_prior > NO_DENSITY, known, 0.0)
        move = Move(sites, log_prior, self.memo(sites), known, log_proposal=log_proposal)
        return self.asked(move, state, key, key_seed, key_accept)


@register_kernel("prior_mh", validity="exact", any_length=True)
class PriorMH(ProposalKernel):
    """Metropolis-Hastings with proposals from the prior.

    It is an independence sampler: prior and proposal cancel, so the acceptance ratio is the ratio
    of likelihoods. ``program`` comes from :func:`phase_ppl.program`. ``early_reject`` says whether
    to stop a simulation once it cannot be accepted any more. The other arguments have no effect.
    """

    def proposed(
        self, key: jax.Array, state: MHState
    ) -> tuple[dict[str, jax.Array], jax.Array, jax.Array | float]:
        sites = self.program.draw_prior(key)
        log_prior = self.program.log_prior(sites)
        return sites, state.log_prior - log_prior, log_prior


@register_kernel("single_site_mh", validity="exact", any_length=True)
class SingleSiteMH(ProposalKernel):
    """Metropolis-Hastings that proposes one site at a time from the prior.

    A random site is drawn from its prior given the sites above it; all other sites stay. Further
    sites of your own prior move too. Arguments are those of :class:`PriorMH`.
    """

    def proposed(
        self, key: jax.Array, state: MHState
    ) -> tuple[dict[str, jax.Array], jax.Array, jax.Array | float]:
        # the move changes the prior of the sites below too, which the prior's ratio accounts for
        model = self.program.model
        trace = handlers.trace(handlers.substitute(model.prior, data=dict(state.z))).get_trace()
        key_which, *keys = random.split(key, 1 + len(model.sites))
        which = random.randint(key_which, (), 0, len(model.sites))
        proposed, corrections = dict(state.z), []
        for index, (name, key_site) in enumerate(zip(model.sites, keys, strict=True)):
            site, old = trace[name], jnp.asarray(state.z[name])
            prior = site["fn"]
            new = prior.sample(key_site, site["kwargs"].get("sample_shape", ()))
            back, forth = (jnp.sum(prior.log_prob(value)) for value in (site["value"], new))
            proposed[name] = jnp.where(which == index, jnp.asarray(new, old.dtype), old)
            corrections.append(jnp.asarray(back - forth, jnp.float32))
        return proposed, jnp.stack(corrections)[which], np.nan
