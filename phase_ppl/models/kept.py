"""What XLA has compiled, kept on disk beside numba's code, for the next process."""

from __future__ import annotations

import contextlib
import hashlib
import os
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

SUFFIX: Final = ".xla"

MOST: Final = 400
"""Programs on disk, some 100 kB each; beyond that the one goes that was not used for longest."""

_LEVEL: Final = 3
"""Of compression: as good as any for machine code, and fast."""

_DIGEST: Final = hashlib.sha256().digest_size


def compiled_or_kept(lowered: jax.stages.Lowered) -> Callable[..., Any]:
    """Return the compiled program, from the disk where it has been compiled before.

    Where JAX keeps what it compiles (``jax_compilation_cache_dir``) that is left to JAX.

    Args:
        lowered: for the processor, and without calls of the host.
    """
    folder = None if jax.config.jax_compilation_cache_dir else cache_folder()
    if folder is None:
        return lowered.compile()
    path = folder / f"{_name(lowered)}{SUFFIX}"
    try:
        return _read(path, lowered)
    except FileNotFoundError:
        pass
    except Exception as error:  # whatever a damaged file makes the reader stumble over
        warnings.warn(f"compiled anew, as {path} is damaged: {error!r}", RuntimeWarning, 2)
    compiled = lowered.compile()
    # what cannot be serialised, or written, is compiled again in the next process
    with contextlib.suppress(NotImplementedError, ValueError, OutputError, OSError):
        content = zlib.compress(serialize_executable.serialize(compiled)[0], _LEVEL)
        write_bytes(path, (SUFFIX,), hashlib.sha256(content).digest() + content)
        _forget_oldest(folder)
    return compiled


def _name(lowered: jax.stages.Lowered) -> str:
    """Return what identifies a program: what it computes, what compiles it, and for what."""
    compiler = (jax.__version__, jaxlib.__version__, os.environ.get("XLA_FLAGS", ""))
    machine = (llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
    parts = (lowered.as_text(), *compiler, *machine)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:40]


def _read(path: Path, lowered: jax.stages.Lowered) -> Callable[..., Any]:
    content = path.read_bytes()
    if hashlib.sha256(content[_DIGEST:]).digest() != content[:_DIGEST]:
        raise ValueError("its checksum is another")
    with contextlib.suppress(OSError):
        os.utime(path)
    return serialize_executable.deserialize_and_load(
        zlib.decompress(content[_DIGEST:]), lowered.in_tree, lowered.out_tree, backend="cpu"
    )


def _forget_oldest(folder: Path) -> None:
    kept = sorted(folder.glob(f"*{SUFFIX}"), key=lambda path: path.stat().st_mtime)
    for path in kept[:-MOST]:
        path.unlink(missing_ok=True)
