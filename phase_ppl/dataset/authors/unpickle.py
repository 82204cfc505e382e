"""Reading a pickle without loading it.

Python's own unpickler calls whatever a file names. Here nothing that a file names is called: the
opcodes of protocols 0 to 5 are interpreted one by one, and make dicts, lists, tuples, texts, bytes,
numbers and NumPy arrays of numbers (:mod:`phase_ppl.dataset.authors.arrays`), or are refused.
Limits on bytes, opcodes, nesting and size when written out keep small files from becoming large.
"""

from __future__ import annotations

import os
from typing import Any, Final, NamedTuple

from phase_ppl.dataset.authors.arrays import PickledArray
from phase_ppl.dataset.authors.machine import Machine
from phase_ppl.world.errors import InvalidEventError

MAX_BYTES: Final = 256 * 2**20
"""Largest file that is read."""

MAX_NESTING: Final = 64
"""How deep lists, tuples and dicts may lie in each other."""

MAX_SIZE: Final = 20_000_000
"""Values, numbers in arrays and characters in all, where what is shared counts every time."""


def read_pickle(path: str | os.PathLike[str]) -> Any:
    """Return what the pickle in the file ``path`` describes.

    Raises:
        InvalidEventError: no such file, too large, damaged, or it holds or asks for anything else
            than dicts, lists, tuples, texts, numbers and arrays of numbers.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_BYTES + 1)
    except IsADirectoryError:
        raise InvalidEventError("is a folder, expected a pickle") from None
    except FileNotFoundError:
        raise InvalidEventError("no such file") from None
    except OSError as error:
        raise InvalidEventError(f"cannot be read: {error.strerror or error}") from None
    return unpickled(content)


def unpickled(content: bytes) -> Any:
    """Return what a pickle describes; arrays are read-only. Errors as for :func:`read_pickle`."""
    if len(content) > MAX_BYTES:
        raise InvalidEventError(f"is larger than the {MAX_BYTES // 2**20} MB that are read")
    if not content:
        raise InvalidEventError("is empty")
    return _Finished().of(Machine(content).run(), 0).value


class _Part(NamedTuple):
    """A finished value, how large it is written out, and how deeply nested."""

    value: Any
    size: int
    height: int


class _Finished:
    """Replaces what stood for arrays by arrays, and measures what was made."""

    def __init__(self) -> None:
        self.known: dict[int, _Part] = {}
        self.open: set[int] = set()

    def of(self, value: Any, depth: int) -> _Part:
        """Return ``value``, which lies ``depth`` deep, without stand-ins.

        Raises:
            InvalidEventError: nested too deeply or in itself, too large, or not data.
        """
        if value is None or isinstance(value, (bool, int, float)):
            return _Part(value, 1, 0)
        if isinstance(value, (str, bytes)):
            return _Part(value, 1 + len(value), 0)
        if isinstance(value, PickledArray):
            if value.array is None:
                raise InvalidEventError("is damaged: it holds an array without content")
            return _Part(value.array, 1 + value.array.size, 0)
        if type(value) not in (list, tuple, dict):
            raise InvalidEventError("holds a function or a class in place of data")
        part = self.known.get(id(value))
        if part is None:
            part = self.known[id(value)] = self._container(value, depth)
        if depth + part.height > MAX_NESTING:
            raise _too_deep()
        return part

    def _container(self, value: Any, depth: int) -> _Part:
        if depth > MAX_NESTING or id(value) in self.open:
            raise _too_deep()
        self.open.add(id(value))
        parts, size = [], 1
        if type(value) is dict:
            size += sum(self.of(key, depth + 1).size for key in value)
        for item in value.values() if type(value) is dict else value:
            part = self.of(item, depth + 1)
            parts.append(part)
            size += part.size
            if size > MAX_SIZE:
                raise _too_large()
        self.open.remove(id(value))
        values = (part.value for part in parts)
        height = 1 + max((part.height for part in parts), default=0)
        made = dict(zip(value, values, strict=True)) if type(value) is dict else type(value)(values)
        return _Part(made, size, height)


def _too_large() -> InvalidEventError:
    return InvalidEventError(f"is larger than the {MAX_SIZE} values that are read, written out")


def _too_deep() -> InvalidEventError:
    return InvalidEventError(f"is nested more than {MAX_NESTING} deep, or in itself")
