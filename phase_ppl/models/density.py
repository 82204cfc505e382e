"""Draws from a NumPyro program, and its density, inside compiled code."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax._src import xla_bridge
from numpyro import handlers

from phase_ppl.world.errors import InvalidSettingError

Program = Callable[..., Any]  # A NumPyro program
Sites = Mapping[str, jax.Array]  # latent site -> value
NO_DENSITY: Final = -1e20  # log densities below this count as zero mass


Result = TypeVar("Result")


def remembered(most: int) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Return a decorator like ``functools.lru_cache`` that allows unhashable arguments.

    For a program or model that cannot be hashed the result is computed anew.
    """

    def decorate(function: Callable[..., Result]) -> Callable[..., Result]:
        kept = functools.lru_cache(most)(function)

        @functools.wraps(function)
        def call(*args: Any) -> Result:
            try:
                hash(args)
            except TypeError:
                return function(*args)
            return kept(*args)

        call.cache_info = kept.cache_info  # type: ignore[attr-defined]
        return call

    return decorate


# --- in other people's processes and threads ------------------------------------------------------

_stack: Final = threading.RLock()
_forked = False


def _note_fork() -> None:
    global _forked
    _forked = _forked or xla_bridge.backends_are_initialized()


os.register_at_fork(after_in_child=_note_fork)


def _check_not_forked() -> None:
    """Raise InvalidSettingError in a forked process: JAX would hang, since it lost its threads."""
    if _forked:
        raise InvalidSettingError(
            "this process was forked from one in which JAX was at work, and would hang: start "
            'processes by multiprocessing.get_context("spawn"), in ProcessPoolExecutor by '
            "mp_context, or before anything is inferred"
        )


@contextlib.contextmanager
def tracing() -> Iterator[None]:
    """Keep other threads from tracing NumPyro programs in the meantime.

    All threads share NumPyro's stack of handlers. So use this context, or decorator, around code
    that uses NumPyro's handlers or kernels while other threads may infer. Other threads wait, so do
    not simulate within.

    Raises:
        InvalidSettingError: the process was forked from one in which JAX was at work.
    """
    _check_not_forked()
    with _stack:
        yield


# --- programs -------------------------------------------------------------------------------------


@tracing()
def traced(program: Program, key: jax.Array, given: Sites | None = None, *args: Any) -> Any:
    """Return the trace of ``program(*args)`` with a key, and with the given values of sites."""
    with_values = handlers.substitute(program, data=dict(given or {}))
    return handlers.trace(handlers.seed(with_values, key)).get_trace(*args)


def latent_sites(trace: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sites of a trace that a program samples without observing them."""
    return {
        name: site
        for name, site in trace.items()
        if site["type"] == "sample" and not site["is_observed"]
    }


def site_shapes(program: Program) -> dict[str, tuple[int, ...]]:
    """Return the latent sites of ``program()`` and their shapes; nothing is drawn or compiled."""
    found: dict[str, tuple[int, ...]] = {}

    def run() -> None:
        latent = latent_sites(traced(program, jax.random.key(0)))
        found.update({name: jnp.shape(site["value"]) for name, site in latent.items()})

    jax.eval_shape(run)
    return found


class Site(NamedTuple):
    """The possible values of a site that is a single number."""

    discrete: bool
    values: tuple[float, ...] | None  # all of them; None: not a small fixed set


@remembered(16)
@tracing()
def single_sites(program: Program) -> dict[str, Site]:
    """Return the latent sites of ``program()`` that are single numbers."""
    found: dict[str, Site] = {}
    unknown: list[str] = []  # discrete sites whose values were not to be had

    def run(key: jax.Array) -> jax.Array:
        unknown.clear()
        for name, site in latent_sites(traced(program, key)).items():
            if jnp.shape(site["value"]) == ():
                discrete, values = bool(site["fn"].support.is_discrete), None
                if discrete and site["fn"].has_enumerate_support:
                    try:
                        with jax.ensure_compile_time_eval():
                            values = np.ravel(site["fn"].enumerate_support(expand=False)).tolist()
                    except (jax.errors.JAXTypeError, NotImplementedError):
                        unknown.append(name)
                found[name] = Site(discrete, None if values is None else tuple(values))
        return key

    jax.eval_shape(run, jax.random.key(0))
    if unknown:
        # under vmap constants are numbers, while values that depend on other sites are
        # placeholders; but each operation is compiled
        jax.vmap(run)(jax.random.split(jax.random.key(0), 1))
    return found


def draw(program: Program, key: jax.Array, *args: Any) -> dict[str, jax.Array]:
    """Return values of all latent sites of ``program(*args)``."""
    latent = latent_sites(traced(program, key, None, *args))
    return {name: site["value"] for name, site in latent.items()}


@tracing()
def log_density(program: Program, sites: Sites, *args: Any) -> jax.Array:
    """Return the log density of ``program(*args)`` at ``sites``, -inf outside its support.

    NumPyro's own ``log_density`` does not check the support: its uniform distribution has the same
    density everywhere.
    """
    trace = handlers.trace(handlers.substitute(program, data=dict(sites))).get_trace(*args)
    return trace_log_density(trace)


def trace_log_density(trace: Mapping[str, Any]) -> jax.Array:
    """Return the log density of a trace, latent and observed sites, -inf outside the support."""
    total = jnp.zeros(())
    for site in trace.values():
        if site["type"] != "sample":
            continue
        value = site["value"]
        part = jnp.sum(site["fn"].log_prob(value))
        if not site["is_observed"]:
            part = jnp.where(jnp.all(site["fn"].support(value)), part, -jnp.inf)
        total = total + part
    return total


# --- fast compilation, for programs that run for milliseconds -------------------------------------

_WANTED: Final[dict[str, Any]] = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}


def compiled_quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``jax.jit(function)``, compiled as fast as possible."""
    return jax.jit(function, compiler_options=_known_options())


@functools.cache
def _known_options() -> dict[str, Any]:
    """Return the options that the installed version of XLA knows."""
    known = {}
    for name, value in _WANTED.items():
        with contextlib.suppress(Exception):  # of a kind of XLA's own
            jax.jit(lambda x: x, compiler_options={name: value}).lower(0.0).compile()
            known[name] = value
    return known


def is_stepped() -> bool:
    """Whether compilation is off (``jax.disable_jit``), as for stepping through in a debugger."""
    config: Any = jax.config
    return bool(config.jax_disable_jit)


@contextlib.contextmanager
def on_cpu() -> Iterator[None]:
    """Run JAX on the CPU with JAX's and NumPy's default settings, not the calling program's.

    A context, and a decorator. Random numbers, and so results, are the same in all programs.
    Simulations in threads of their own keep their program's settings.
    """
    _check_not_forked()
    with contextlib.ExitStack() as settings:
        # the programs are tiny, and the same everywhere; an accelerator would not help
        settings.enter_context(jax.default_device(_processor()))
        settings.enter_context(_single_precision())
        settings.enter_context(np.errstate(all="warn", under="ignore"))
        for name, value in _OWN_SETTINGS.items():
            settings.enter_context(getattr(jax, name)(value))
        yield


_OWN_SETTINGS: Final = {
    "default_prng_impl": "threefry2x32",
    "numpy_dtype_promotion": "standard",
    "numpy_rank_promotion": "allow",
    "threefry_partitionable": True,
    "transfer_guard": "allow",
}


def _processor() -> jax.Device:
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError as error:
        platforms, reason = os.environ.get("JAX_PLATFORMS"), " ".join(str(error).split())
        raise InvalidSettingError(
            f"JAX has no processor to work on, with JAX_PLATFORMS={platforms!r}: {reason}"
        ) from error


def _single_precision() -> contextlib.AbstractContextManager[Any]:
    place: Any = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    return cast("contextlib.AbstractContextManager[Any]", place.enable_x64(False))
