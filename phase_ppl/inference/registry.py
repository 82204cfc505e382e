"""The registry of kernels.

A kernel is a factory: called with a :class:`~phase_ppl.inference.program.Program` it returns a
NumPyro ``MCMCKernel``. Other packages register theirs in the entry-point group
``phase_ppl.kernels``; the entry point is loaded, and its import registers the kernel.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import importlib.metadata
from collections.abc import Callable
from typing import Any, Final, Literal, TypeVar

from phase_ppl.world.errors import InvalidSettingError, unknown_name

Validity = Literal["exact", "consistent", "approximate"]
VALIDITIES: Final = ("exact", "consistent", "approximate")
CHAIN_METHODS: Final = ("vectorized", "sequential", "parallel")
ENTRY_POINTS: Final = "phase_ppl.kernels"

Factory = Callable[..., Any]
AnyFactory = TypeVar("AnyFactory", bound=Factory)


@dataclasses.dataclass(frozen=True)
class KernelInfo:
    """What the runner must know about a kernel before a simulation is paid for.

    Attributes:
        name: as users call it.
        factory: makes the kernel from a program and options.
        validity: "exact": the posterior is stationary; "consistent": approached as particles
            grow; "approximate": neither.
        sims_per_step: simulations per chain and iteration.
        chain_methods: of NumPyro's that it supports.
        needs: properties that the program must have.
    """

    name: str
    factory: Factory
    validity: Validity
    sims_per_step: float
    chain_methods: tuple[str, ...]
    needs: tuple[str, ...]


_KERNELS: dict[str, KernelInfo] = {}


def register_kernel(
    name: str,
    *,
    validity: Validity,
    sims_per_step: float = 1,
    chain_methods: tuple[str, ...] = ("vectorized",),
    needs: tuple[str, ...] = (),
) -> Callable[[AnyFactory], AnyFactory]:
    """Return a decorator that registers a kernel class or factory under ``name``.

    Raises:
        UnknownNameError: ``validity`` or a chain method is none of the allowed ones.
        InvalidSettingError: another kernel has this name.
    """
    if validity not in VALIDITIES:
        raise unknown_name("validity", validity, VALIDITIES)
    for method in chain_methods:
        if method not in CHAIN_METHODS:
            raise unknown_name("chain method", method, CHAIN_METHODS)

    def register(factory: AnyFactory) -> AnyFactory:
        known = _KERNELS.get(name)
        same = known is not None and _path(known.factory) == _path(factory)
        if known is not None and not same:
            raise InvalidSettingError(f"there is already a kernel named {name!r}")
        _KERNELS[name] = KernelInfo(
            name, factory, validity, sims_per_step, tuple(chain_methods), tuple(needs)
        )
        return factory

    return register


def _path(factory: Factory) -> tuple[str, str]:
    return factory.__module__, getattr(factory, "__qualname__", "")


@functools.cache
def _load_all() -> None:
    importlib.import_module("phase_ppl.inference.kernels")
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS):
        entry.load()


def available_kernels() -> tuple[str, ...]:
    """Return the names of all registered kernels."""
    _load_all()
    return tuple(sorted(_KERNELS))


def kernel_info(name: str) -> KernelInfo:
    """Return what is registered under ``name``.

    Raises:
        UnknownNameError: no kernel has this name.
    """
    _load_all()
    if name not in _KERNELS:
        raise unknown_name("kernel", name, available_kernels())
    return _KERNELS[name]


def make_kernel(name: str, program: Any, **options: Any) -> Any:
    """Return the kernel ``name`` for a program.

    Raises:
        UnknownNameError: no kernel has this name.
        InvalidSettingError: it has no such option.
    """
    info = kernel_info(name)
    try:
        return info.factory(program, **options)
    except TypeError as error:
        raise InvalidSettingError(f"kernel {name!r}: {error}") from error
