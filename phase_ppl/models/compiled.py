"""Compiled functions kept on disk; apart from speed they equal ``jax.jit``.

Compiling the pieces of a kernel takes ten seconds, reading them from disk a tenth of a second. Code
that calls Python (``jax.pure_callback``) is compiled anew in every process.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import pickle
import time
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import jax
import jaxlib
import llvmlite.binding as llvm
from jax.experimental import serialize_executable

from phase_ppl.models.density import compiled_quickly, is_stepped, on_cpu, tracing
from phase_ppl.physics.jit import cache_folder
from phase_ppl.world.errors import OutputError
from phase_ppl.world.files import write_bytes
from phase_ppl.world.identity import code_changed_since, versions

SUFFIX: Final = ".xla"
MOST: Final = 400  # files; beyond, the least recently used one is deleted
_IMPORTED: Final = time.time()
_LEVEL: Final = 3  # of compression: as good as any for machine code, and fast
_DIGEST: Final = hashlib.sha256().digest_size
_CALLS_PYTHON: Final = "python_cpu_callback"  # in the text of a program that does


class Compiled:
    """A function compiled for the processor; with ``jax.disable_jit`` the function itself.

    ``identity`` distinguishes it from all other functions of this package. A function known by it
    need not be traced again. Without an identity its computation is the key.
    """

    def __init__(self, function: Callable[..., Any], identity: str | None = None) -> None:
        self._function, self._identity = function, identity
        self._jitted: Any = compiled_quickly(tracing()(function))
        self._made: dict[Any, Callable[..., Any]] = {}

    def shapes(self, *args: Any) -> Any:
        """Return shapes and types of a call's result."""
        return self._jitted.eval_shape(*args)

    def __call__(self, *args: Any) -> Any:
        with on_cpu():
            if is_stepped():
                return self._function(*args)
            leaves, treedef = jax.tree.flatten(args)
            kind = treedef, tuple(map(jax.typeof, leaves))
            if kind not in self._made:
                self._made[kind] = self._remembered(kind, args) or self._compiled(kind, args)
            return self._made[kind](*args)

    def _remembered(self, kind: Any, args: tuple[Any, ...]) -> Callable[..., Any] | None:
        """Return the program of this identity from an earlier process, if it is still kept."""
        name = self._identity and _name(f"{self._identity} {kind}")
        return read(name, args) if name else None

    def _compiled(self, kind: Any, args: tuple[Any, ...]) -> Callable[..., Any]:
        lowered = self._jitted.lower(*args)
        text = lowered.as_text()
        name = _name(f"{self._identity} {kind}" if self._identity else text)
        keeps = folder() is not None and _CALLS_PYTHON not in text
        if keeps and not self._identity and (known := read(name, args)):
            return known
        made = lowered.compile()
        if keeps and name is not None:
            with contextlib.suppress(NotImplementedError, ValueError, pickle.PicklingError):
                code = serialize_executable.serialize(made)[0]
                result = jax.tree.map(lambda _: 0, lowered.out_info)
                write(name, pickle.dumps((code, result)))
        found: Callable[..., Any] = made
        return found


def folder() -> Path | None:
    """Return the folder of programs; None: not kept, or JAX is set to keep them itself."""
    config: Any = jax.config
    return None if config.jax_compilation_cache_dir else cache_folder()


def _name(what: str) -> str | None:
    """Return the name of a file, specific to this code and machine.

    None if source files changed since they were imported: the running code differs from them.
    """
    if code_changed_since(_IMPORTED):
        return None
    settings = json.dumps([versions(), jax.config.values], default=str, sort_keys=True)
    return hashlib.sha256("\0".join((what, settings, *_target())).encode()).hexdigest()[:40]


@functools.cache
def _target() -> tuple[str, ...]:
    compiler = (jax.__version__, jaxlib.__version__, os.environ.get("XLA_FLAGS", ""))
    return (*compiler, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())


def read(name: str | None, args: tuple[Any, ...]) -> Callable[..., Any] | None:
    """Return a program for arguments of this kind from disk; None: missing or damaged."""
    if name is None or (place := folder()) is None:
        return None
    path = place / f"{name}{SUFFIX}"
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
            raise ValueError("its checksum is another")
        with contextlib.suppress(OSError):
            os.utime(path)
        code, result = pickle.loads(zlib.decompress(content[_DIGEST:]))
        found: Callable[..., Any] = serialize_executable.deserialize_and_load(
            code,
            jax.tree.structure((args, {})),
            jax.tree.structure(result),
            "cpu",
            execution_devices=jax.local_devices(backend="cpu")[:1],
        )
        return found
    except OSError:
        return None
    except Exception as error:  # a damaged file can make the reader raise anything
        warnings.warn(f"compiled anew, as {path} is damaged: {error!r}", RuntimeWarning, 2)
        return None


def write(name: str, content: bytes) -> None:
    """Write a file, and keep at most :data:`MOST` files in all."""
    if (place := folder()) is None:
        return
    packed = zlib.compress(content, _LEVEL)
    # if writing fails, the next process compiles again
    with contextlib.suppress(OutputError, OSError):
        place.mkdir(parents=True, exist_ok=True)
        path = place / f"{name}{SUFFIX}"
        write_bytes(path, (SUFFIX,), hashlib.sha256(packed).digest() + packed)
        kept = sorted(place.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime)
        for old in kept[:-MOST]:
            old.unlink(missing_ok=True)
