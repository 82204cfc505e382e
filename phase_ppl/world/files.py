"""Writing files so that nobody ever finds half of one."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from phase_ppl.world.errors import InvalidEventError, OutputError


@contextlib.contextmanager
def atomic_output(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Iterator[Path]:
    """Yield a fresh path beside ``path``; what was written there becomes ``path`` at the end.

    If the block raises, ``path`` stays as it was and what was written is deleted. Whether the
    folder can be written is found out before the block begins.

    Args:
        path: where the result is to be.
        suffixes: file name endings that are allowed, such as (".png",).

    Raises:
        OutputError: another ending, a folder in the way, or the folder cannot be written.
    """
    target = Path(path)
    with _part_of(target, suffixes) as part:
        yield part
        os.replace(part, target)


def write_json(path: str | os.PathLike[str], record: Mapping[str, Any]) -> None:
    """Write a JSON object, whole or not at all.

    Raises:
        OutputError: it cannot be written there, or its name does not end in .json.
    """
    with atomic_output(path, (".json",)) as part:
        text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")


def existing_file(path: str | os.PathLike[str]) -> Path:
    """Return ``path``.

    Raises:
        InvalidEventError: there is no such file.
    """
    source = Path(path)
    if not source.is_file():
        raise InvalidEventError(f"{source}: no such file")
    return source


def check_output(path: str | os.PathLike[str], suffixes: Sequence[str]) -> None:
    """Raise OutputError if :func:`atomic_output` could not write ``path``; nothing is written."""
    with _part_of(Path(path), suffixes):
        pass


@contextlib.contextmanager
def _part_of(target: Path, suffixes: Sequence[str]) -> Iterator[Path]:
    if target.suffix.lower() not in suffixes:
        raise OutputError(f"cannot write {target}: expected a name in {' or '.join(suffixes)}")
    if target.is_dir():
        raise OutputError(f"cannot write {target}: it is a folder")
    # a short name of its own: a long target name must not become too long
    part = target.with_name(f".part-{secrets.token_hex(4)}{target.suffix}")
    try:
        part.touch(exist_ok=False)
        yield part
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        reason = error.strerror or str(error).split("\n")[0]
        raise OutputError(f"cannot write {target}: {reason}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
