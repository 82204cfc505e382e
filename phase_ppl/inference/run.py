"""Definition of a run: a kernel's particles on an event, and its length; ``sampler.py`` runs it.

Another iteration begins if the actual cost so far leaves room in the budget; costs that a kernel
declares do not count. With a budget of simulations or frames this depends on the run alone: it is
the same for any number of workers and after every resumption.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import jax
import numpy as np
from jax import lax, random
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.draws import Particles
from phase_ppl.inference.guide import bottom_up_guide
from phase_ppl.inference.kernels.amis import Adaptation, Proposal, first_proposal, guide_of
from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import EventKernel, Stage, through
from phase_ppl.inference.registry import KERNELS, Factory, KernelInfo, info_of
from phase_ppl.inference.settings import BUDGETS, Budget, SimpleSettings, check_event
from phase_ppl.inference.tables import (
    BottomUpTables,
    ReadingCost,
    bottom_up_tables,
    padded,
    reading_cost,
    window_count,
)
from phase_ppl.models import priors
from phase_ppl.models.bridge import Record, Request
from phase_ppl.models.compiled import Compiled
from phase_ppl.models.density import remembered, tracing
from phase_ppl.models.effective import WorldPrior, as_given
from phase_ppl.models.likelihood import InNats, RadialLikelihood, is_closed_loop
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram, Lookup
from phase_ppl.world.errors import InvalidSettingError, instance_of, whole_number
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest, source_hash, stable

_KEPT_PROGRAMS: Final = 16
_OURS: Final = "phase_ppl."
_BY_FRAME: Final = (RadialLikelihood, InNats)
"""Likelihoods that treat all frames alike."""

_SHORT, _USUAL = 16, 128
"""Lengths to which arrays of frames are padded; longer videos take the next power of 2."""

Kernel: TypeAlias = str | Factory
"""A kernel as users give it: a name, a class, or a factory."""


class Data(NamedTuple):
    """All that compiled code gets of an event."""

    proposal: BottomUpTables | Proposal  # tables of its windows, or a kernel's learned proposal
    bridge: jax.Array | int  # handle of the bridge that simulates
    observed: jax.Array | int | None  # number of frames, where arrays are longer
    table: Lookup | None = None  # what is looked up in place of a simulation


class Recipe(NamedTuple):
    """All that compiled programs depend on; events with equal recipes share programs."""

    info: KernelInfo
    options: tuple[tuple[str, Any], ...]  # of the kernel
    model: Model
    settings: SimpleSettings
    n_frames: int  # length of the arrays of frames


@dataclasses.dataclass(eq=False)
class Run:
    """All that determines the draws of a run, except their number.

    Raises:
        InvalidEventError: ``event`` is no event.
        InvalidSettingError, UnknownNameError: a setting that cannot be used.
    """

    event: Event  # what is explained
    model: Model  # prior, simulator, likelihood
    kernel: Kernel  # as the user gave it
    kernel_options: Mapping[str, Any]
    settings: SimpleSettings  # of SIMPLE
    chains: int  # particles M
    seed: int  # a whole number >= 0

    def __post_init__(self) -> None:
        check_event(self.event)
        world, model = self.event.scene.world, self.model
        self.info = info_of(self.kernel)
        if is_closed_loop(model.likelihood) and len(world.agents) > 2:
            raise InvalidSettingError(
                "a kernel on what the closed loop has read takes strengths by agent, and of three "
                f"agents and more, as in {world.name!r}, only some combinations are followed"
            )
        if is_closed_loop(model.likelihood) and self.info.adapts:
            raise InvalidSettingError(
                f"kernel {self.info.name!r} learns from simulations, and what the closed loop "
                "has read takes none: it is summed exactly; take 'importance'"
            )
        self.model = model.for_sampling().in_world(self.event.scene, self.event.observation)
        self.settings = self.settings.settled(world)
        self.chains = whole_number("chains", self.chains)
        self.seed = whole_number("seed", self.seed, minimum=0)
        self.n_frames = self.event.observation.n_frames
        # a user's own likelihood may treat frames differently
        self._is_padded = self.info.any_length and type(model.error_likelihood) in _BY_FRAME

    def identity(self) -> dict[str, Any]:
        """Return the identity of the run as plain data: runs with equal identities are the same."""
        factory = self.info.factory if isinstance(self.kernel, str) else self.kernel
        return {
            "event": event_digest(self.event),
            "model": stable(self.model.fingerprint()),
            "kernel": {
                "name": self.info.name,
                "source": source_hash(factory),
                "options": stable(dict(self.kernel_options)),
            },
            "settings": stable(vars(self.settings)),
            "chains": self.chains,
            "seed": self.seed,
        }

    def record(self, iterations: int) -> dict[str, Any]:
        """Return all that determines the result of ``iterations`` iterations, as plain data."""
        return {
            "kernel": {"name": self.info.name, **self.kernel_options},
            "chains": self.chains,
            "iterations": iterations,
            "seed": self.seed,
            "turning": self.event.scene.turning,
            "resets_velocity": self.event.scene.resets_velocity,
            "simple": dict(vars(self.settings)),
            "model": self.model.fingerprint(),
        }

    def again(self) -> dict[str, Any]:
        """Return the parts from which a file makes the run again; None: no plain data."""
        model = self.model
        prior, stored = priors.name_of(as_given(model.prior)), None
        if prior and model.simulator is None and type(model.likelihood) is RadialLikelihood:
            stored = {
                "prior": prior,
                "beta": model.likelihood.beta,
                "planner": model.planner_config().to_dict(),
            }
        return {
            "model": stored,
            "kernel": self.kernel if isinstance(self.kernel, str) else None,
            "options": _plain(self.kernel_options),
            "settings": _plain(vars(self.settings)),
        }

    @functools.cached_property
    def recipe(self) -> Recipe:
        """All that compiled programs depend on; the simulator is not part of it."""
        options, n_frames = tuple(self.kernel_options.items()), self.n_frames
        model = dataclasses.replace(self.model, simulator=None, planner=None)
        if self._is_padded:
            longer = max(_USUAL, 1 << (n_frames - 1).bit_length())
            n_frames = _SHORT if n_frames <= _SHORT else longer
        return Recipe(self.info, options, model, self.settings, n_frames)

    @property
    def reading_cost(self) -> ReadingCost:
        """Cost of reading the video before the first simulation, if proposals need that."""
        if self.settings.proposal != "closed_loop":
            return ReadingCost()
        return reading_cost(self.event.scene, self.event.observation)

    def data(
        self,
        bridge: int,
        progress: bool | None = None,
        threads: int | None = None,
        *,
        unread: bool = False,
    ) -> Data:
        """Return the data of the event for compiled code; ``bridge`` is the bridge's handle.

        If the closed loop proposes, it reads the video in ``threads`` threads. With ``unread`` it
        does not: placeholder tables are enough to check a kernel.
        """
        scene, observation, settings = self.event.scene, self.event.observation, self.settings
        if unread and settings.proposal == "closed_loop":
            settings = dataclasses.replace(settings, proposal=None)
        tables = bottom_up_tables(scene, observation, settings, progress, threads)
        proposal: BottomUpTables | Proposal
        if self.info.adapts:
            proposal = first_proposal(np.asarray(tables.goal_logits)[-1], self.model.prior)
        else:
            proposal = padded(tables, window_count(self.recipe.n_frames, settings.window))
        observed = self.n_frames if self._is_padded else None
        return Data(proposal, bridge, observed)

    def adaptation(self, data: Data) -> Adaptation | None:
        """Return the adaptation of a kernel that adapts; None for others."""
        if not self.info.adapts:
            return None
        observed, share = self.event.observation.positions, self.settings.prior_share
        assert isinstance(data.proposal, Proposal), "it is of a kernel that adapts"
        return Adaptation(self.model, observed, data.proposal, share)

    def check(self, iterations: int | None, budget: Budget | None) -> None:
        """Make the kernel and trace one step; nothing is simulated."""
        data = self.data(0, unread=True)
        kernel = make_kernel(self.recipe, data)
        Length.of(kernel, self.info, self.chains, iterations, budget, self.n_frames)
        steps = compiled(self.recipe)  # what is traced here is not traced again by the run
        keys = random.split(random.key(0), self.chains)
        steps.shapes("moves", data, steps.shapes("starts", data, keys, None))


def model_again(stored: Mapping[str, Any]) -> Model:
    """Return the model that :meth:`Run.again` recorded."""
    from phase_ppl.agents.config import PlannerConfig

    return Model(
        prior=stored["prior"],
        likelihood=RadialLikelihood(stored["beta"]),
        planner=PlannerConfig.from_dict(stored["planner"]),
    )


def _plain(options: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return options or settings if JSON restores them exactly; else None."""
    try:
        again: dict[str, Any] = json.loads(json.dumps(dict(options), allow_nan=False))
    except (TypeError, ValueError):
        return None
    # a list is no tuple, and 1 is not True
    return again if repr(again) == repr(dict(options)) else None


# --- compiled programs ----------------------------------------------------------------------------


@tracing()
def make_kernel(recipe: Recipe, data: Data) -> MCMCKernel:
    """Return the kernel for an event."""
    info, options, model, settings, n_frames = recipe
    proposal, bridge, observed, table = data
    program = EventProgram(model, bridge, n_frames, observed, table)
    supplies: dict[str, Any] = {"settings": settings} if "settings" in info.needs else {}
    if "guide" in info.needs:
        of, share = (model.prior, model.sites), settings.prior_share
        if isinstance(proposal, Proposal):
            supplies["guide"] = guide_of(*of, proposal, share)
        else:
            supplies["guide"] = bottom_up_guide(*of, proposal, prior_share=share)
    return info.make(program, **supplies, **dict(options))


Stages = Literal["starts", "moves"]


def _stages(recipe: Recipe, of: Stages, data: Data) -> list[Stage]:
    """Return the stages of a start, given keys and None, or of a move, given a state."""
    kernel = make_kernel(recipe, data)
    own = (type(kernel).init, type(kernel).sample) != (EventKernel.init, EventKernel.sample)
    if isinstance(kernel, EventKernel) and not own:
        return kernel.stages(of)

    def moved(state: Any) -> Any:
        if getattr(kernel, "_sample_fn", True) is None:
            # NumPyro's own kernels need a call of init
            jax.eval_shape(lambda keys: kernel.init(keys, 0, None, (), {}), state.rng_key)
        return kernel.sample(state, (), {})

    # another package's kernel: it simulates from within compiled code
    return [moved] if of == "moves" else [lambda keys, _: kernel.init(keys, 0, None, (), {})]


class Steps:
    """The compiled starts and moves of a recipe's particles; made by :func:`compiled`."""

    def __init__(self, recipe: Recipe) -> None:
        self._recipe = recipe
        self._compiled: dict[Stages, list[Compiled]] = {}

    def _each(self, of: Stages, data: Data) -> list[Compiled]:
        if of not in self._compiled:
            self._compiled[of] = [
                Compiled(
                    lambda data, *given, n=number: _stages(self._recipe, of, data)[n](*given),
                    _identity(self._recipe, f"{of} {number}"),
                )
                for number in range(len(_stages(self._recipe, of, data)))
            ]
        return self._compiled[of]

    def run(self, of: Stages, answer: Callable[[Request], Any], data: Data, *given: Any) -> Any:
        """Return the state after a start or a move, with its simulations answered in between."""
        stages = [functools.partial(one, data) for one in self._each(of, data)]
        return through(stages, answer, *given)

    def shapes(self, of: Stages, data: Data, *given: Any) -> Any:
        """Return shapes and types of what :meth:`run` returns; nothing is computed."""
        n_frames = self._recipe.n_frames

        def answer(request: Request) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct((*request.seed.shape, n_frames), np.float32)

        stages = [functools.partial(one.shapes, data) for one in self._each(of, data)]
        return through(stages, answer, *given)


compiled = remembered(_KEPT_PROGRAMS)(Steps)


@remembered(_KEPT_PROGRAMS)
def compiled_chains(recipe: Recipe, length: int) -> tuple[Compiled, Compiled]:
    """Return compiled (data, keys) -> state, and (data, state) -> last state and all new ones.

    For simulations that are looked up in a table, so whole chains can be compiled.
    """

    def start(data: Data, keys: jax.Array) -> Any:
        return make_kernel(recipe, data).init(keys, 0, None, (), {})

    def block(data: Data, state: Any) -> tuple[Any, Particles]:
        kernel = make_kernel(recipe, data)

        def one(state: Any, _: None) -> tuple[Any, Particles]:
            state = kernel.sample(state, (), {})
            return state, Particles.of(state)

        return lax.scan(one, state, length=length)

    return (
        Compiled(start, _identity(recipe, "start")),
        Compiled(block, _identity(recipe, f"block of {length}")),
    )


@remembered(_KEPT_PROGRAMS)
def compiled_given(recipe: Recipe) -> Compiled:
    """Return compiled (data, keys, given sites, log drawn, log floors) -> requests (chain,).

    Each particle simulates a hypothesis with some sites given. SIMPLE proposes the others, for any
    kernel: see ``LocalMH.request_given``.
    """
    simple = recipe._replace(info=KERNELS["local_mh"], options=())

    def asked(data: Data, *given: Any) -> Any:
        kernel = make_kernel(simple, data)
        assert isinstance(kernel, LocalMH), "it is registered by that name"
        return jax.vmap(kernel.request_given)(*given)

    return Compiled(asked, _identity(simple, "given sites"))


def _identity(recipe: Recipe, what: str) -> str | None:
    """Return a text that identifies program ``what`` of a recipe.

    None unless all of its code is this package's.
    """
    info, options, model, settings, length = recipe
    plain, prior = _plain(dict(options)), priors.name_of(as_given(model.prior))
    known = KERNELS.entries.get(info.name) is info and info.factory.__module__.startswith(_OURS)
    likelihood = model.error_likelihood
    if plain is None or prior is None or not known or type(likelihood) not in _BY_FRAME:
        return None
    numbers = settings.eta, settings.window, settings.prior_share
    parts = info.name, plain, prior, numbers, length
    kind = likelihood if isinstance(likelihood, RadialLikelihood) else "nats"
    world = f" {model.prior.world.to_dict()!r}" if isinstance(model.prior, WorldPrior) else ""
    return f"{what} of {parts!r} {kind!r}{world}"


# --- how long a run is ----------------------------------------------------------------------------

ITERATIONS: Final = 6  # L, the paper's number of iterations
RECENT: Final = 3  # iterations whose mean is what the next one is expected to take

IDLE: Final = 100
"""Iterations in a row without a simulation, after which a run ends: its budget will never be spent.
This happens if no proposal has prior mass."""

clock: Callable[[], float] = time.perf_counter  # seconds of wall time


class Length(NamedTuple):
    """When a run ends."""

    chains: int  # number of particles M
    iterations: int | None = None  # L, after the initial particles; None: until the budget is spent
    budget: Budget | None = None  # none where there is a number of iterations
    sims_at_start: int = 1  # the most simulations of each initial particle
    sims_per_step: int = 1  # the most simulations that an iteration takes per particle

    @classmethod
    @tracing()
    def of(
        cls,
        kernel: Any,
        info: KernelInfo,
        chains: int,
        iterations: int | None,
        budget: Budget | None,
        n_frames: int,
    ) -> Length:
        """Return the length that the user asked for; the kernel is made for the event."""
        if budget is not None and iterations is not None:
            raise InvalidSettingError("give either iterations or a budget, not both")
        if budget is not None:
            instance_of("budget", budget, Budget, BUDGETS)
        per_step = getattr(kernel, "sims_per_step", info.sims_per_step)
        length = cls(chains, iterations, budget, getattr(kernel, "sims_at_start", 1), per_step)
        if own := getattr(kernel, "n_iterations", None):
            length._check_own(info.name, own(chains), n_frames)
            return length._replace(iterations=own(chains), budget=None)
        if budget is None:
            wanted = ITERATIONS if iterations is None else whole_number("iterations", iterations)
            return length._replace(iterations=wanted)
        small = f"a budget of {budget} is too small: {chains} initial particles"
        # the cost of an iteration is unknown beforehand: assume one simulation for each particle
        at_start = length.at_most(0)
        if length.limit("simulations") < at_start + chains:
            raise InvalidSettingError(f"{small} and one iteration need {at_start + chains}")
        if length.limit("frames") <= at_start * n_frames:
            raise InvalidSettingError(f"{small} need {at_start * n_frames}, and iterations on top")
        return length

    def _check_own(self, name: str, needed: int, n_frames: int) -> None:
        """Raise InvalidSettingError if the length contradicts a kernel that decides its own."""
        takes = f"with {self.chains} chains it takes {needed}"
        if self.limit("seconds") < math.inf:
            raise InvalidSettingError(
                f"a budget of seconds is of no use to kernel {name!r}: {takes} iterations"
            )
        if self.iterations not in (None, needed):
            raise InvalidSettingError(
                f"iterations={self.iterations}, but kernel {name!r} decides itself: {takes}; "
                "leave iterations out"
            )
        least = self.at_most(needed)
        for unit, amount in (("simulations", least), ("frames", least * n_frames)):
            if self.limit(unit) < amount:
                raise InvalidSettingError(
                    f"a budget of {self.budget} is too small: kernel {name!r} takes {amount}"
                )

    def at_most(self, iterations: int) -> int:
        """Return the most simulations that ``iterations`` iterations take."""
        return self.chains * (self.sims_at_start + iterations * self.sims_per_step)

    def limit(self, unit: str) -> float:
        """Return the budget if it is in ``unit``; else inf."""
        return self.budget.amount if self.budget and self.budget.unit == unit else math.inf

    @property
    def is_counted(self) -> bool:
        """Whether the budget is in simulations or frames."""
        return self.budget is not None and self.budget.unit != "seconds"


class Pace:
    """The cost of a run so far, and whether another iteration begins.

    ``began`` is the :func:`clock` at the start of the call. Earlier calls took ``seconds``, and
    their last iterations ``recent``.

    Attributes:
        done: finished iterations; -1: not even the initial particles are there.
        simulations: made by the initial particles and the finished iterations.
        frames: simulated in them.
        recent: seconds that the last iterations took.
    """

    def __init__(
        self, length: Length, began: float, *, seconds: float = 0.0, recent: Iterable[float] = ()
    ) -> None:
        self.done, self.simulations, self.frames = -1, 0, 0
        self.recent = deque(recent, maxlen=RECENT)
        self._length, self._begin = length, began - seconds
        self._first_guess, self._mark = False, 0.0
        self._last = 0  # the last iteration that took a simulation

    def count(self, records: Sequence[Record], done: int) -> None:
        """Count the cost of the first ``done`` iterations, at least as many as before."""
        new = [record for record in records[self.simulations :] if record.iteration <= done]
        self.done = done
        self.simulations += len(new)
        self.frames += sum(record.result.frames_simulated for record in new)
        self._last = new[-1].iteration if new else self._last

    @property
    def is_spent(self) -> bool:
        """Whether a budget of simulations or frames is used up."""
        limit = self._length.limit
        return self.simulations >= limit("simulations") or self.frames >= limit("frames")

    @property
    def seconds(self) -> float:
        """Seconds that the run has taken so far, in all calls."""
        return clock() - self._begin

    def begin(self) -> None:
        """Note that the initial particles or an iteration begin."""
        self._mark = clock()

    def end(self, *, initial: bool = False) -> None:
        """Note that they ended.

        Before the first iteration, its time is estimated by the initial particles' time: these
        compile and simulate too, and are never stopped early.
        """
        taken = clock() - self._mark
        if initial:
            taken *= self._length.sims_per_step / self._length.sims_at_start
        elif self._first_guess:
            self.recent.clear()
        self._first_guess = initial
        self.recent.append(taken)

    @property
    def goes_on(self) -> bool:
        """Whether another iteration begins."""
        if self._length.is_counted:
            return not self.is_spent and self.done - self._last < IDLE
        return self.done < self.expected

    @property
    def expected(self) -> int:
        """Expected number of iterations in all, by the clock so far."""
        if self._length.iterations is not None:
            return self._length.iterations
        done, left = max(self.done, 0), self._length.limit("seconds") - self.seconds
        if left == math.inf or not self.recent:
            return done
        each = max(math.fsum(self.recent) / len(self.recent), 1e-6)
        return done + max(int(left / each), 0)
