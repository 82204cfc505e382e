"""Files that are written whole or not at all, and locks that keep a folder to one process."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import secrets
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    shown,
    shown_path,
)

__all__ = [
    "as_path",
    "atomic_output",
    "check_output",
    "existing_file",
    "locked",
    "writable_folder",
    "write_bytes",
    "write_json",
]

_NAME_BYTES: Final = 255
_PATH_BYTES: Final = 4095
"""Longest file name that common file systems allow, and longest path."""


@contextlib.contextmanager
def atomic_output(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Iterator[Path]:
    """Yield the path of a new, empty file, which replaces ``path`` when the block ends.

    The block writes into the new file. If the block raises, ``path`` stays as it was and the new
    file is deleted. The new file is on the disk before it replaces the old one.

    Args:
        path: the file to write.
        suffixes: allowed endings of its name, in lower case, such as (".json",).

    Raises:
        OutputError: before the block: the folder cannot be written, or the name has another ending.
            After it: the file cannot be written, or the block wrote nothing.
        InvalidSettingError: ``path`` is no path, or a name that no file can have.
    """
    with _part_of(target := as_path(path), suffixes) as part:
        yield part
        if not part.stat().st_size:
            raise OutputError(f"cannot write {shown_path(target)}: nothing was written")
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, target)


def write_bytes(path: str | os.PathLike[str], suffixes: Sequence[str], content: bytes) -> None:
    """Write ``content`` to ``path``, whole or not at all. See :func:`atomic_output` for errors."""
    with atomic_output(path, suffixes) as part:
        part.write_bytes(content)


def write_json(path: str | os.PathLike[str], record: Mapping[str, Any]) -> None:
    """Write ``record`` to the .json file ``path``. See :func:`atomic_output` for errors.

    The file is written whole or not at all (ValueError: a number is not finite).
    """
    text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (".json",), f"{text}\n".encode())


def as_path(path: object) -> Path:
    """Return ``path`` as a Path (InvalidSettingError: no file can have that name)."""
    if not isinstance(path, str | os.PathLike) or isinstance(os.fspath(path), bytes):
        raise InvalidSettingError(f"{shown(path)} is no path of a file or folder")
    found = Path(path)
    longest = max((len(os.fsencode(part)) for part in found.parts), default=0)
    if "\0" in str(found) or longest > _NAME_BYTES or len(os.fsencode(found)) > _PATH_BYTES:
        raise InvalidSettingError(f"{shown_path(found)} is a name that no file can have")
    return found


def existing_file(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` as a Path (InvalidEventError: there is no such file)."""
    source = as_path(path)
    if not source.is_file():
        raise InvalidEventError(f"{shown_path(source)}: no such file")
    return source


def check_output(path: str | os.PathLike[str], suffixes: Sequence[str]) -> None:
    """Raise OutputError if :func:`atomic_output` could not write ``path``; nothing is written."""
    with _part_of(as_path(path), suffixes):
        pass


def writable_folder(path: str | os.PathLike[str]) -> Path:
    """Create the folder ``path`` unless it exists; return it (OutputError: it is not writable)."""
    folder = as_path(path)
    with refusing(f"into folder {shown_path(folder)}"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    return folder


@contextlib.contextmanager
def locked(path: str | os.PathLike[str] | None) -> Iterator[None]:
    """Lock a folder, or a file that may not exist yet, to this process during the block.

    The lock ends with the process, even if the process crashes. Nothing is locked on file systems
    without locks, or if ``path`` is None.

    Raises:
        OutputError: another process holds the lock, or the lock's own file cannot be written.
    """
    if path is None:
        yield
        return
    target = as_path(path)
    digest = hashlib.sha256(target.name.encode(errors="replace")).hexdigest()[:8]
    lock = target / ".lock" if target.is_dir() else target.with_name(f".lock-{digest}")
    with contextlib.ExitStack() as held:
        with refusing(shown_path(target)):
            while True:
                handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
                held.callback(os.close, handle)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise OutputError(
                        f"another process is at work in {shown_path(target)}: wait for it, or give "
                        "another path"
                    ) from None
                except OSError:
                    break
                # the process that had it before may have deleted the file in between
                with contextlib.suppress(FileNotFoundError):
                    if os.path.samestat(os.fstat(handle), os.stat(lock)):
                        break
        held.callback(lock.unlink, missing_ok=True)
        yield


@contextlib.contextmanager
def refusing(what: str) -> Iterator[None]:
    """Turn any refusal by the file system into one line."""
    try:
        yield
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        reason = error.strerror or str(error).split("\n")[0]
        raise OutputError(f"cannot write {what}: {reason}") from error


@contextlib.contextmanager
def _part_of(target: Path, suffixes: Sequence[str]) -> Iterator[Path]:
    name = shown_path(target)
    if target.suffix.lower() not in suffixes:
        raise OutputError(f"cannot write {name}: expected a name in {' or '.join(suffixes)}")
    # a short name: appending to a long one could make it too long
    part = target.with_name(f".part-{secrets.token_hex(4)}{target.suffix}")
    with refusing(name):
        if target.is_dir():
            raise OutputError(f"cannot write {name}: it is a folder")
        try:
            part.touch(exist_ok=False)
            yield part
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)


def __dir__() -> list[str]:
    return __all__
