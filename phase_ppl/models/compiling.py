"""Compilation of programs that run for milliseconds, where compiling well does not pay."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final

import jax

_WANTED: Final[dict[str, Any]] = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}


def compiled_quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``jax.jit(function)``, compiled as fast as possible."""
    compiled: Callable[..., Any] = jax.jit(function, compiler_options=_known_options())
    return compiled


@functools.cache
def _known_options() -> dict[str, Any]:
    """Return those options that the installed XLA knows; they come and go with its versions."""
    return {name: value for name, value in _WANTED.items() if _is_known(name, value)}


def _is_known(name: str, value: Any) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options={name: value}).lower(0.0).compile()
    except Exception:  # of a kind of XLA's own
        return False
    return True
