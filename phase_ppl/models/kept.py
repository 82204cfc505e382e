"""What XLA has compiled, kept on disk beside numba's code, for the next process."""

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

from phase_ppl.physics.jit import cache_folder
from phase_ppl.world.errors import OutputError
from phase_ppl.world.files import write_bytes
from phase_ppl.world.identity import code_changed_since, versions

SUFFIX: Final = ".xla"
_IMPORTED: Final = time.time()
MOST: Final = 400  # files; beyond that the one goes that was not used for longest
_LEVEL: Final = 3  # of compression: as good as any for machine code, and fast
_DIGEST: Final = hashlib.sha256().digest_size


def folder() -> Path | None:
    """Return where programs are kept; None: nowhere, or where JAX is told to keep them itself."""
    config: Any = jax.config
    return None if config.jax_compilation_cache_dir else cache_folder()


def code_name(lowered: jax.stages.Lowered) -> str:
    """Return what identifies a compiled program: what it computes, and for what machine."""
    return _hash(lowered.as_text())


def outline_name(identity: str) -> str | None:
    """Return what identifies the making of a program: what is said of it, and all code.

    None where code was changed since it was imported: what runs is not what the files say.
    """
    if code_changed_since(_IMPORTED):
        return None
    return _hash(identity, json.dumps([versions(), jax.config.values], default=str, sort_keys=True))


def _hash(*parts: str) -> str:
    return hashlib.sha256("\0".join((*parts, *_target())).encode()).hexdigest()[:40]


@functools.cache
def _target() -> tuple[str, ...]:
    compiler = (jax.__version__, jaxlib.__version__, os.environ.get("XLA_FLAGS", ""))
    return (*compiler, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())


def read_code(name: str, n_inputs: int, n_outputs: int) -> Callable[..., Any] | None:
    """Return a compiled program from the disk, of flat arguments and results; None: not there."""
    given = jax.tree.structure(((0,) * n_inputs, {}))
    results = jax.tree.structure([0] * n_outputs)
    return _read(
        name,
        lambda content: serialize_executable.deserialize_and_load(
            content,
            *(given, results, "cpu"),
            execution_devices=jax.local_devices(backend="cpu")[:1],
        ),
    )


def write_code(name: str, compiled: jax.stages.Compiled) -> None:
    """Keep a compiled program, where it can be serialised and written."""
    with contextlib.suppress(NotImplementedError, ValueError):
        _write(name, serialize_executable.serialize(compiled)[0])


def read_outline(name: str) -> Any:
    """Return what :func:`write_outline` was given; None: not there."""
    return _read(name, pickle.loads)


def write_outline(name: str, outline: Any) -> None:
    """Keep what says how pieces of compiled code go together."""
    with contextlib.suppress(TypeError, AttributeError, pickle.PicklingError):
        _write(name, pickle.dumps(outline))


def _read(name: str, understood: Callable[[bytes], Any]) -> Any:
    if (place := folder()) is None:
        return None
    path = place / f"{name}{SUFFIX}"
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
            raise ValueError("its checksum is another")
        with contextlib.suppress(OSError):
            os.utime(path)
        return understood(zlib.decompress(content[_DIGEST:]))
    except OSError:
        return None
    except Exception as error:  # whatever a damaged file makes the reader stumble over
        warnings.warn(f"compiled anew, as {path} is damaged: {error!r}", RuntimeWarning, 2)
        return None


def _write(name: str, content: bytes) -> None:
    if (place := folder()) is None:
        return
    packed = zlib.compress(content, _LEVEL)
    # what cannot be written is compiled again by the next process
    with contextlib.suppress(OutputError, OSError):
        place.mkdir(parents=True, exist_ok=True)
        path = place / f"{name}{SUFFIX}"
        write_bytes(path, (SUFFIX,), hashlib.sha256(packed).digest() + packed)
        kept = sorted(place.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime)
        for old in kept[:-MOST]:
            old.unlink(missing_ok=True)
