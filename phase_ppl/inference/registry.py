"""Registry of kernels by name: ours, in ``phase_ppl.inference.kernels``, and other packages'.

Another package registers its kernel under the entry point group ``phase_ppl.kernels``::

    [project.entry-points."phase_ppl.kernels"]
    my_kernel = "my_package.my_kernel:my_kernel"

where ``my_kernel`` is a function decorated with :func:`register_kernel`.

A kernel is an ``MCMCKernel`` of NumPyro. Its state has the fields ``z`` (site -> value),
``sim_seed`` (the simulator's seed of that hypothesis) and ``rng_key``. It may have ``accepted``,
``window``, ``log_weight`` (for weighted draws) and ``log_evidence``.

Some facts depend on the model. A kernel may define them as attributes: ``validity``,
``sims_per_step``, ``sims_at_start`` (simulations per initial particle, 1 by default) and
``n_iterations(chains)``, of a kernel that decides its own length.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, TypeVar, get_args

from numpyro.infer.hmc import HMC
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.models.program import EventProgram
from phase_ppl.world.errors import InvalidSettingError, shown, whole_number
from phase_ppl.world.registry import Registry

Validity = Literal["exact", "consistent", "approximate"]
Keeps = Literal["all", "last", "start"]

VALIDITIES: Final = get_args(Validity)
KEEPS: Final = get_args(Keeps)

NEEDS: Final = ("guide", "settings")
"""Arguments that a factory can ask for beside the program: the bottom-up proposal program
``guide(window)`` and the :class:`~phase_ppl.inference.settings.SimpleSettings`."""

Factory = Callable[..., MCMCKernel]
"""``factory(program, **needs, **options)`` returns a NumPyro kernel."""


@dataclasses.dataclass(frozen=True)
class KernelInfo:
    """Registered facts about a kernel, known without running it.

    Attributes:
        name: name of the kernel, for ``infer(..., kernel=name)``.
        factory: class or function that makes the kernel, see :func:`phase_ppl.register_kernel`.
        validity, sims_per_step, needs, keeps, weighted, any_length: the arguments of
            :func:`phase_ppl.register_kernel`; ``validity`` is "unknown" without registration.
        summary: first line of the factory's docstring.
        adapts: whether the kernel's proposal is fitted to its earlier draws.
    """

    name: str
    factory: Factory
    validity: str
    sims_per_step: int
    needs: tuple[str, ...]
    summary: str
    keeps: Keeps = "all"
    weighted: bool = False
    any_length: bool = False
    adapts: bool = False

    def make(self, program: EventProgram, **options: Any) -> MCMCKernel:
        """Return the kernel for an event's program; ``options`` are further arguments of it."""
        registered = self.validity in VALIDITIES  # then its needs are known
        for need in NEEDS:
            if registered and (need in options) != (need in self.needs):
                how = "missing" if need in self.needs else "got an unexpected"
                raise InvalidSettingError(f"kernel {self.name!r}: {how} argument {need!r}")
        try:
            inspect.signature(self.factory).bind(program, **options)
        except TypeError as error:
            raise InvalidSettingError(f"kernel {self.name!r}: {error}") from None
        made = self.factory(program, **options)
        refuse_numpyros(type(made), f"{self.name!r}, which makes a {type(made).__name__},")
        if not isinstance(made, MCMCKernel):
            hint = " (does the function return it?)" if made is None else ""
            raise InvalidSettingError(
                f"kernel {self.name!r} makes {shown(made)}: expected a NumPyro MCMCKernel{hint}"
            )
        if getattr(made, "adapts", False) and not self.adapts:
            raise InvalidSettingError(
                f"kernel {self.name!r} makes a {type(made).__name__}, whose proposal learns: give "
                "the class itself, or its name"
            )
        return made

    @property
    def options(self) -> tuple[str, ...] | None:
        """Names of the factory's arguments besides program and needs; None: it takes any name."""
        _, *given = inspect.signature(self.factory).parameters.values()
        if any(one.kind is one.VAR_KEYWORD for one in given):
            return None
        return tuple(one.name for one in given if one.name not in NEEDS)


def refuse_numpyros(kind: type, kernel: str) -> None:
    """Refuse a kernel class of NumPyro itself; the error says what to write instead."""
    if issubclass(kind, HMC):
        raise InvalidSettingError(
            f"kernel {kernel} needs a gradient, which a simulator does not have; "
            "available_kernels() lists kernels without one"
        )
    if issubclass(kind, MCMCKernel) and kind.__module__.startswith("numpyro."):
        raise InvalidSettingError(
            f"kernel {kernel} keeps no seed of the simulator: take 'sa', 'aies' or 'gibbs', which "
            "are NumPyro's, or make it a phase_ppl.kernels.NumpyroKernel"
        )


KERNELS: Final = Registry[KernelInfo](
    "kernel", package="phase_ppl.inference.kernels", entry_points="phase_ppl.kernels"
)

AnyFactory = TypeVar("AnyFactory", bound=Factory)


def register_kernel(
    name: str,
    *,
    validity: Validity,
    sims_per_step: int = 1,
    needs: Sequence[str] = (),
    keeps: Keeps = "all",
    weighted: bool = False,
    any_length: bool = False,
) -> Callable[[AnyFactory], AnyFactory]:
    """Return a decorator that registers a factory, a class or function that makes a kernel.

    ``factory(program, **needs, **options)`` takes a :class:`phase_ppl.EventProgram` and returns an
    ``MCMCKernel`` of NumPyro. What the kernel's state must have is said in
    :mod:`phase_ppl.inference.registry`.

    Args:
        name: name of the kernel, for ``infer(..., kernel=name)``.
        validity: "exact": the kernel's stationary distribution is the posterior. "consistent": the
            draws approach the posterior as the number of particles grows. "approximate": neither.
        sims_per_step: largest number of simulations per particle and iteration. Progress bars and
            budgets of seconds begin with it; other budgets count simulations that were run.
        needs: keyword arguments that the factory needs: some of "guide", the bottom-up proposal
            program ``guide(window)``, and "settings", the ``SimpleSettings``.
        keeps: particles that are draws of the posterior: "all": those after every iteration;
            "last": those after the last iteration; "start": those after every iteration, and the
            initial ones.
        weighted: whether draws have a weight, ``log_weight`` of the kernel's state.
        any_length: whether arrays of frames may be longer than the observation: the kernel takes
            the number of frames from ``program.observed``, known only at run time, not from
            ``program.n_frames``. One compiled program then serves events of all lengths.

    Raises:
        InvalidSettingError: the name is taken by another factory, or a value is not allowed.
    """
    if validity not in VALIDITIES:
        raise InvalidSettingError(f"validity={validity!r} is none of {VALIDITIES}")
    whole_number("sims_per_step", sims_per_step)
    for given, allowed in ((needs, NEEDS), ((keeps,), KEEPS)):
        for entry in given:
            if entry not in allowed:
                raise InvalidSettingError(f"kernel {name!r}: {entry!r} is none of {allowed}")
    more = keeps, weighted, any_length
    return KERNELS.register(
        name,
        lambda factory, summary: KernelInfo(
            *(name, factory, validity, sims_per_step, tuple(needs), summary, *more),
            adapts=getattr(factory, "adapts", False),
        ),
    )


def available_kernels() -> list[str]:
    """Return the names of all registered kernels, sorted."""
    return KERNELS.names()


def kernel_info(name: str) -> KernelInfo:
    """Return the ``KernelInfo`` of a kernel: its validity, needs, options and more.

    Raises:
        UnknownNameError: there is no such kernel; the message names close matches.
    """
    return KERNELS[name]


def info_of(kernel: str | Factory) -> KernelInfo:
    """Return the facts about a kernel given by name, factory or class."""
    if isinstance(kernel, str):
        return kernel_info(kernel)
    refuse_numpyros(kernel if isinstance(kernel, type) else type(kernel), shown(kernel))
    if not callable(kernel) or isinstance(kernel, MCMCKernel):
        raise InvalidSettingError(
            f"kernel={shown(kernel)}: expected a name of phase_ppl.available_kernels(), such as "
            "'local_mh', a kernel class, or a function that makes a kernel from the program"
        )
    for _, info in KERNELS.items():
        if info.factory is kernel:
            return info
    parameters = inspect.signature(kernel).parameters
    return KernelInfo(
        getattr(kernel, "__name__", type(kernel).__name__),
        kernel,
        validity="unknown",
        sims_per_step=getattr(kernel, "sims_per_step", 1),
        needs=tuple(need for need in NEEDS if need in parameters),
        summary=(inspect.getdoc(kernel) or "").split("\n")[0],
        keeps=getattr(kernel, "keeps", "all"),
        weighted=getattr(kernel, "weighted", False),
        adapts=getattr(kernel, "adapts", False),
    )
