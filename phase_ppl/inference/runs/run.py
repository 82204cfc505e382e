"""What a run is: the particles of a kernel on an event; ``sampler.py`` runs it."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from typing import Any, Final, NamedTuple, TypeAlias

import jax
from jax import random
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.proposals.guide import bottom_up_guide
from phase_ppl.inference.proposals.tables import (
    BottomUpTables,
    bottom_up_tables,
    padded,
    window_count,
)
from phase_ppl.inference.registry import KERNELS, Factory, KernelInfo, described
from phase_ppl.inference.runs.length import Length
from phase_ppl.inference.settings import Budget, SimpleSettings
from phase_ppl.models import priors
from phase_ppl.models.density import remembered
from phase_ppl.models.hosted import Hosted
from phase_ppl.models.likelihood import InNats, RadialLikelihood, is_stepwise
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram, event_salt
from phase_ppl.models.roles import WorldPrior, as_given
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest, source_hash, stable
from phase_ppl.world.scene import check_is_phase

_KEPT_PROGRAMS: Final = 16
_OURS: Final = "phase_ppl."
_BY_FRAME: Final = (RadialLikelihood, InNats)
"""Likelihoods for which it does not matter where in the video a frame is."""


Kernel: TypeAlias = str | Factory | MCMCKernel
"""A kernel as users give it: by name, as what makes one for an event, or as an instance."""


class Data(NamedTuple):
    """All that compiled code is told of an event."""

    tables: BottomUpTables  # what its windows say
    salt: jax.Array | int  # a number that stands for it
    bridge: jax.Array | int  # handle of the bridge that simulates
    observed: jax.Array | int | None  # number of frames, where arrays are longer


class Recipe(NamedTuple):
    """What compiled programs depend on. Events with the same share them."""

    info: KernelInfo
    options: tuple[tuple[str, Any], ...]  # of the kernel
    model: Model
    settings: SimpleSettings
    n_frames: int  # length of the arrays of frames


_LENGTHS: Final = (16, 128)
"""Lengths to which arrays of frames are padded; longer videos take the next doubling of the last.
Nearly all events have the second in common."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """All that determines the draws of a run, but for how many there are.

    Raises:
        InvalidEventError: ``event`` is no event.
        InvalidSettingError, UnknownNameError: a setting that cannot be used.
    """

    event: Event  # what is explained
    model: Model  # prior, simulator, likelihood
    kernel: Kernel  # as the user gave it
    options: Mapping[str, Any]  # of the kernel
    settings: SimpleSettings  # of SIMPLE
    chains: int  # particles M
    seed: int  # a whole number >= 0
    info: KernelInfo = dataclasses.field(init=False)
    """What is known of the kernel."""

    def __post_init__(self) -> None:
        check_event(self.event)
        world = self.event.scene.world
        object.__setattr__(self, "info", described(self.kernel))
        if is_stepwise(self.model.likelihood):
            check_is_phase(world, f"kernel {self.info.name!r} on the closed loop's table")
        object.__setattr__(self, "model", self.model.in_world(world))
        guided = "guide" in self.info.needs and self.model.is_joint
        object.__setattr__(self, "settings", self.settings.settled(world, guided=guided))
        object.__setattr__(self, "chains", whole_number("chains", self.chains))
        object.__setattr__(self, "seed", whole_number("seed", self.seed, minimum=0))
        if self.info.even_chains and self.chains % 2:
            raise InvalidSettingError(
                f"chains={self.chains}: kernel {self.info.name!r} needs an even number, such as "
                f"{self.chains + 1}"
            )

    def identity(self) -> dict[str, Any]:
        """Return as plain data what a run must have in common with another to be the same."""
        own_values = vars(self.kernel) if isinstance(self.kernel, MCMCKernel) else {}
        plain = bool | int | float | str
        return {
            "event": event_digest(self.event),
            "model": stable(self.model.fingerprint()),
            "kernel": {
                "name": self.info.name,
                "source": source_hash(
                    self.info.factory if isinstance(self.kernel, str) else self.kernel
                ),
                "values": {k: v for k, v in sorted(own_values.items()) if isinstance(v, plain)},
                "options": stable(dict(self.options)),
            },
            "settings": stable(vars(self.settings)),
            "chains": self.chains,
            "seed": self.seed,
        }

    def again(self) -> dict[str, Any]:
        """Return what makes the run again from a file; None for what is no plain data."""
        model = self.model
        prior, stored = priors.name_of(as_given(model.prior)), None
        if prior and model.simulator is None and type(model.likelihood) is RadialLikelihood:
            stored = {
                "prior": prior,
                "beta": model.likelihood.beta,
                "planner": model.planner_config().to_dict(),
                "noise": model.noise,
            }
        return {
            "model": stored,
            "kernel": self.kernel if isinstance(self.kernel, str) else None,
            "options": _plain(self.options),
            "settings": _plain(vars(self.settings)),
        }

    @functools.cached_property
    def recipe(self) -> Recipe:
        """What the compiled programs depend on: not on the simulator, which runs beside them."""
        options = tuple(self.options.items())
        model = dataclasses.replace(self.model, simulator=None, planner=None)
        return Recipe(self.info, options, model, self.settings, self._length)

    @property
    def _is_padded(self) -> bool:
        # a likelihood of one's own may depend on where a frame is
        return self.info.any_length and type(self.model.error_likelihood) in _BY_FRAME

    @property
    def _length(self) -> int:
        n_frames = self.event.observation.n_frames
        if not self._is_padded:
            return n_frames
        length = next((length for length in _LENGTHS if length >= n_frames), _LENGTHS[-1])
        while length < n_frames:
            length *= 2
        return length

    def data(
        self,
        bridge: int,
        progress: bool | None = None,
        threads: int | None = None,
        *,
        unread: bool = False,
    ) -> Data:
        """Return what compiled code is told of the event and the bridge with that handle.

        The closed loop reads the video in so many ``threads``; or as if it had not to, to see
        whether a kernel works.
        """
        scene, observation, settings = self.event.scene, self.event.observation, self.settings
        if unread and settings.proposal == "closed_loop":
            settings = dataclasses.replace(settings, proposal=None)
        tables = bottom_up_tables(scene, observation, settings, progress, threads)
        salt = event_salt(scene, observation)
        tables = padded(tables, window_count(self._length, self.settings.window))
        observed = observation.n_frames if self._is_padded else None
        return Data(tables, salt, bridge, observed)

    def check(self, iterations: int | None, budget: Budget | None) -> None:
        """Make the kernel and trace a step of it, with nothing simulated."""
        kernel = make_kernel(self.recipe, self.data(0, unread=True))
        n_frames = self.event.observation.n_frames
        Length.of(kernel, self.info, self.chains, iterations, budget, n_frames)
        # one program: NumPyro's own kernels are made ready by init
        jax.eval_shape(
            lambda keys: kernel.sample(kernel.init(keys, 0, None, (), {}), (), {}),
            random.split(random.key(0), self.chains),
        )


def check_event(given: object) -> None:
    """Raise InvalidEventError if something is no event."""
    if not isinstance(given, Event):
        raise InvalidEventError(f"{shown(given)} is no event; phase_ppl.load_event reads one")


def model_again(stored: Mapping[str, Any]) -> Model:
    """Return the model that :meth:`Run.again` wrote down."""
    from phase_ppl.agents.config import PlannerConfig

    return Model(
        prior=stored["prior"],
        likelihood=RadialLikelihood(stored["beta"]),
        planner=PlannerConfig.from_dict(stored["planner"]),
        noise=stored["noise"],
    )


def _plain(options: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return options or settings if JSON gives them back as they are; else None."""
    try:
        again: dict[str, Any] = json.loads(json.dumps(dict(options), allow_nan=False))
    except (TypeError, ValueError):
        return None
    # a list is no tuple, and 1 is not True
    return again if repr(again) == repr(dict(options)) else None


# --- compiled programs ----------------------------------------------------------------------------


def make_kernel(recipe: Recipe, data: Data) -> MCMCKernel:
    """Return the kernel for an event."""
    info, options, model, settings, n_frames = recipe
    tables, salt, bridge, observed = data
    supplies: dict[str, Any] = {}
    if "settings" in info.needs:
        supplies["settings"] = settings
    if "guide" in info.needs:
        supplies["guide"] = bottom_up_guide(
            model.prior, model.sites, tables, prior_share=settings.prior_share
        )
    return info.make(
        EventProgram(model, bridge, n_frames, salt, observed), **supplies, **dict(options)
    )


@remembered(_KEPT_PROGRAMS)
def compiled(recipe: Recipe) -> tuple[Hosted, Hosted]:
    """Return the two compiled functions of a recipe: (keys, data) and (state, data) -> state."""

    def init(keys: jax.Array, data: Data) -> Any:
        return make_kernel(recipe, data).init(keys, 0, None, (), {})

    def step(state: Any, data: Data) -> Any:
        kernel = make_kernel(recipe, data)
        if getattr(kernel, "_sample_fn", True) is None:
            # NumPyro's own kernels are made ready by init
            jax.eval_shape(lambda keys: kernel.init(keys, 0, None, (), {}), state.rng_key)
        return kernel.sample(state, (), {})

    return Hosted(init, _identity(recipe, "init")), Hosted(step, _identity(recipe, "step"))


@remembered(_KEPT_PROGRAMS)
def compiled_given(recipe: Recipe) -> Hosted:
    """Return the compiled function (keys, given sites, log floors, data) -> errors (chain, time).

    Each particle simulates a hypothesis of which some sites are given, the others proposed by
    SIMPLE, whatever the kernel.
    """

    def simulate(
        keys: jax.Array, given: dict[str, jax.Array], log_floor: jax.Array, data: Data
    ) -> Any:
        kernel = make_kernel(recipe._replace(info=KERNELS["local_mh"], options=()), data)
        assert isinstance(kernel, LocalMH), "it is registered by that name"
        return jax.vmap(kernel.simulate_given)(keys, given, log_floor)

    return Hosted(simulate, _identity(recipe, "given sites"))


def _identity(recipe: Recipe, what: str) -> str | None:
    """Return what tells ``what`` is compiled of a recipe from others.

    None unless all of its code is this package's.
    """
    info, options, model, settings, length = recipe
    plain = _plain(dict(options))
    known = KERNELS.entries.get(info.name) is info and info.factory.__module__.startswith(_OURS)
    if plain is None or not known:
        return None
    prior, likelihood = priors.name_of(as_given(model.prior)), model.error_likelihood
    if prior is None or type(likelihood) not in _BY_FRAME:
        return None
    numbers = settings.eta, settings.window, settings.prior_share
    parts = info.name, plain, prior, model.noise, numbers, length
    kind = likelihood if isinstance(likelihood, RadialLikelihood) else "nats"
    world = f" {model.prior.world.to_dict()!r}" if isinstance(model.prior, WorldPrior) else ""
    return f"{what} of {parts!r} {kind!r}{world}"
