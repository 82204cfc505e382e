"""A safe reader of pickles of plain data: no code of a file runs, no small file becomes large.

Python's unpickler calls any function that a file names. This one has the opcodes of plain data
only, and reads at most :data:`MAX_OPCODES`. It knows the few names by which NumPy's arrays are
described, and replaces them by functions that build arrays of plain numbers. Arrays of objects are
refused, since they would hold a pickle of their own. At last, the result is measured as if written
out.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import re
import struct
import warnings
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.data.documents import reading_bytes, too_large
from phase_ppl.world.errors import InvalidEventError, shown

MAX_BYTES: Final = 256 * 2**20  # largest file that is read
MAX_OPCODES: Final = 2_000_000  # most opcodes that are read, which takes some ten seconds
MAX_NESTING: Final = 64  # deepest nesting of lists, tuples and dicts

MAX_SIZE: Final = 20_000_000
"""Most values, numbers in arrays and characters together; shared parts count every time."""

MAX_COPIED: Final = 256 * 2**20
"""Most bytes that are copied into arrays; a shared part may be copied again and again."""

_LONGEST_KEY: Final = 9  # longest tuple allowed as the key of a dict
_NUMBERS: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1)")
_NO_NUMBERS: Final = "holds an array of something else than plain numbers"
_NDARRAY: Final = object()  # represents the class of arrays


def read_pickle(path: str | os.PathLike[str]) -> Any:
    """Return what the pickle in the file ``path`` describes."""
    with reading_bytes("a pickle"), open(path, "rb") as file:
        content = file.read(MAX_BYTES + 1)
    return unpickled(content)


def unpickled(content: bytes) -> Any:
    """Return what a pickle describes. Errors as for :func:`read_pickle`."""
    if len(content) > MAX_BYTES:
        raise too_large(MAX_BYTES)
    if not content:
        raise InvalidEventError("is empty")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for unknown escapes in texts of Python 2
            loaded = _Reader(content).load()
    except (InvalidEventError, MemoryError):
        raise
    except EOFError:
        raise InvalidEventError("is damaged: the pickle ends too early") from None
    except Exception:  # pickle can raise nearly any kind of error
        raise InvalidEventError("is damaged: its pickle makes no sense") from None
    if _size(loaded, {}) > MAX_SIZE:
        raise InvalidEventError(f"is larger than the {MAX_SIZE} values that are read, written out")
    return loaded


def _size(value: Any, known: dict[int, int], depth: int = 0) -> int:
    """Return the number of values, written out."""
    if isinstance(value, str | bytes | bytearray):
        return 1 + len(value)
    if isinstance(value, np.ndarray):
        return 1 + value.size
    if value is None or isinstance(value, bool | int | float):
        return 1
    if not isinstance(value, list | tuple | dict):
        raise InvalidEventError("holds a function or a class in place of data")
    if depth > MAX_NESTING:
        raise InvalidEventError(f"is nested more than {MAX_NESTING} deep, or in itself")
    if id(value) not in known:
        parts = [*value, *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_size(part, known, depth + 1) for part in parts)
    return known[id(value)]


_Base: Any = pickle._Unpickler  # type: ignore[attr-defined]  # the one whose opcodes can be chosen


class _Reader(_Base):  # type: ignore[misc]
    """Python's unpickler, limited to opcodes of plain data, with its own functions for arrays."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content), fix_imports=False, encoding="latin-1")
        self.dispatch = _Opcodes()
        self._copied = 0
        self._known: dict[tuple[str, str], Any] = {
            ("numpy", "ndarray"): _NDARRAY,
            ("numpy", "dtype"): self._dtype,
            ("_codecs", "encode"): self._encode,
            **dict.fromkeys((("__builtin__", "bytes"), ("builtins", "bytes")), lambda: b""),
        }
        for core in ("numpy.core", "numpy._core"):  # before and since NumPy 2
            self._known[f"{core}.multiarray", "_reconstruct"] = self._reconstruct
            self._known[f"{core}.multiarray", "scalar"] = self._scalar
            self._known[f"{core}.numeric", "_frombuffer"] = self._from_buffer

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._known:
            raise InvalidEventError(
                f"asks for {shown(f'{module[:60]}.{name[:60]}')}, which is refused: only dicts, "
                "lists, tuples, texts, numbers and arrays of numbers are read"
            )
        return self._known[module, name]

    # --- opcodes that differ from Python's

    def load_build(self) -> None:
        """Set the content of an array, or the byte order of a data type."""
        state, made = self.stack.pop(), self.stack[-1]
        if isinstance(made, np.dtype):
            # the rest is about fields and nested arrays
            plain = isinstance(state, tuple) and len(state) in (8, 9)
            if not plain or state[1] not in tuple("<>|=") or state[2:5] != (None, None, None):
                raise InvalidEventError(_NO_NUMBERS)
            made.__setstate__((3, state[1], None, None, None, -1, -1, 0))  # type: ignore[attr-defined]
        elif isinstance(made, np.ndarray):
            shape, dtype, fortran, content = state[-4:]
            raw = self._raw(content)
            self._count(len(raw))
            _check_array(raw, dtype, shape)
            made.__setstate__((1, shape, dtype, fortran in (1, True), raw))  # type: ignore[arg-type]
        else:
            raise InvalidEventError("sets the state of what is no array")

    def load_bytearray8(self) -> None:
        (n,) = struct.unpack("<Q", self.read(8))
        self.append(bytearray(self.read(n)))  # takes no more memory than the file has bytes

    def load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._set([key], [value])

    def load_setitems(self) -> None:
        items = self.pop_mark()
        self._set(items[::2], items[1::2])

    def load_dict(self) -> None:
        items = self.pop_mark()
        self.append({})
        self._set(items[::2], items[1::2])

    def _set(self, keys: list[Any], values: list[Any]) -> None:
        """Put items into the dict on top of the stack; keys that take long to hash are refused."""
        for key, value in zip(keys, values, strict=True):
            parts = key if type(key) is tuple and len(key) <= _LONGEST_KEY else (key,)
            if any(
                type(part) is not str and (type(part) is not int or abs(part) >= 2**64)
                for part in parts
            ):
                raise InvalidEventError("has a dict whose keys are no texts or whole numbers")
            self.stack[-1][key] = value

    # --- functions that build arrays, called with anything that a file says

    def _raw(self, content: Any) -> bytes:
        """Return bytes; Python 2 and old protocols wrote them as a text."""
        if isinstance(content, bytes):
            return content
        if not isinstance(content, str | bytearray):
            raise InvalidEventError(_NO_NUMBERS)
        self._count(len(content))
        return content.encode("latin-1") if isinstance(content, str) else bytes(content)

    def _count(self, n: int) -> None:
        self._copied += n
        if self._copied > MAX_COPIED:
            raise InvalidEventError("becomes too large: it shares long texts or arrays")

    def _encode(self, text: str, codec: str) -> bytes:
        if codec not in ("latin1", "latin-1"):
            raise ValueError(codec)
        return self._raw(text)

    def _dtype(self, spelling: str, *_: Any) -> np.dtype[Any]:
        if not isinstance(spelling, str) or not _NUMBERS.fullmatch(spelling):
            raise InvalidEventError(_NO_NUMBERS)
        return np.dtype(spelling, copy=True)  # whose byte order may still be set

    def _reconstruct(self, kind: Any, shape: Any, letter: Any) -> NDArray[Any]:
        if kind is not _NDARRAY:
            raise ValueError(kind)
        return np.empty(0)

    def _scalar(self, dtype: Any, content: Any) -> Any:
        return self._from_buffer(content, dtype, (), "C").item()

    def _from_buffer(
        self, content: Any, dtype: Any, shape: Any, order: str, axes: Any = None
    ) -> NDArray[Any]:
        """Return an array in the order "C", "F" or "K"; "K" follows a given order of the axes."""
        raw = self._raw(content)
        _check_array(raw, dtype, shape)
        flat = np.frombuffer(raw, dtype) if raw else np.empty(0, dtype)
        array = flat.reshape(shape, order="F" if order == "F" else "C")
        return array if axes is None else array.transpose(axes)


def _check_array(raw: bytes, dtype: Any, shape: Any) -> None:
    if not isinstance(dtype, np.dtype):
        raise InvalidEventError(_NO_NUMBERS)
    if not isinstance(shape, tuple) or not all(type(n) is int and 0 <= n < 2**31 for n in shape):
        raise InvalidEventError("holds an array of an impossible shape")
    if math.prod(shape) * dtype.itemsize != len(raw):
        raise InvalidEventError(f"holds an array of shape {shape} in {len(raw)} bytes")


_PLAIN: Final = (
    *("PROTO", "FRAME", "MARK", "STOP", "POP", "POP_MARK", "DUP", "MEMOIZE"),
    *("GET", "BINGET", "LONG_BINGET", "PUT", "BINPUT", "LONG_BINPUT"),
    *("NONE", "NEWTRUE", "NEWFALSE", "FLOAT", "BINFLOAT"),
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"),
    *("STRING", "BINSTRING", "SHORT_BINSTRING"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
    *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    *("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
    *("EMPTY_LIST", "LIST", "APPEND", "APPENDS"),
    *("EMPTY_DICT", "DICT", "SETITEM", "SETITEMS"),
    *("GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"),
)


class _Opcodes(dict[int, Callable[[_Reader], None]]):
    """The functions of the allowed opcodes, by code; counts how often they are asked for."""

    def __init__(self) -> None:
        super().__init__()
        for name in _PLAIN:
            code = getattr(pickle, name)[0]
            self[code] = getattr(_Reader, f"load_{name.lower()}", _Base.dispatch[code])
        self._left = MAX_OPCODES

    def __getitem__(self, code: int) -> Callable[[_Reader], None]:
        self._left -= 1
        if self._left < 0:
            raise InvalidEventError(f"has more than {MAX_OPCODES} opcodes")
        if code not in self:
            raise InvalidEventError(
                f"is damaged, or holds an object of a class, refused: opcode {bytes([code])!r}"
            )
        return super().__getitem__(code)
