"""Pickles of plain data, read so that none of a file's code runs and no small file becomes large.

Python's unpickler calls whatever a file names. Here the opcodes are looked through before anything
is loaded: those of plain data pass, as many as :data:`MAX_OPCODES`. Then ``pickle.Unpickler`` loads
them with a ``find_class`` that knows the few names by which NumPy's arrays are described, and hands
out stand-ins for them: the functions that a file asks for are never called. The stand-ins put
arrays together from their parts, of numbers of fixed size only, since an array of objects would
hold a pickle of its own. Last, what came out is measured as if it were written out
(:data:`MAX_SIZE`, :data:`MAX_NESTING`).
"""

from __future__ import annotations

import io
import math
import os
import pickle
import pickletools
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.data.documents import reading_bytes, too_large
from phase_ppl.world.errors import InvalidEventError, shown

MAX_BYTES: Final = 256 * 2**20  # largest file that is read
MAX_OPCODES: Final = 2_000_000  # opcodes that are read, which takes some ten seconds at most
MAX_NESTING: Final = 64  # how deep lists, tuples and dicts may lie in each other

MAX_SIZE: Final = 20_000_000
"""Values, numbers in arrays and characters in all, where what is shared counts every time."""

MAX_CONVERTED: Final = 256 * 2**20
"""Characters that become bytes: a text that is shared may do so again and again."""

MAX_DIMENSIONS: Final = 8
MAX_LENGTH: Final = 2**31
"""Longest dimension of an array."""

_LONGEST_KEY: Final = 9  # longest tuple that is the key of a dict
_PROTOCOL: Final = 5
_DTYPE: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1)")
_NO_NUMBERS: Final = "holds an array of something else than plain numbers"
_DAMAGED: Final = "is damaged: its pickle makes no sense"
_NO_ARRAY: Final = "is damaged: it describes an array as NumPy never does"
_TOO_DEEP: Final = f"is nested more than {MAX_NESTING} deep, or in itself"
_NO_KEY: Final = "has a dict whose keys are no texts or whole numbers"


def read_pickle(path: str | os.PathLike[str]) -> Any:
    """Return what the pickle in the file ``path`` describes."""
    with reading_bytes("a pickle"), open(path, "rb") as file:
        content = file.read(MAX_BYTES + 1)
    return unpickled(content)


def unpickled(content: bytes) -> Any:
    """Return what a pickle describes; arrays are read-only. Errors as for :func:`read_pickle`."""
    if len(content) > MAX_BYTES:
        raise too_large(MAX_BYTES)
    if not content:
        raise InvalidEventError("is empty")
    _check_opcodes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for unknown escapes in texts of Python 2
            loaded = _Unpickler(content).load()
    except (InvalidEventError, MemoryError):
        raise
    except Exception:  # pickle raises nearly every kind of error that there is
        raise InvalidEventError(_DAMAGED) from None
    return _Finished().of(loaded, 0).value


# --- before it is loaded ---------------------------------------------------------------------


class _Effect(NamedTuple):
    """What an opcode does to the stack: values taken below and above a mark, and put there."""

    name: str
    marked: bool
    below: int
    puts: int


_MARKS: Final = (pickletools.markobject, pickletools.stackslice)
_EFFECTS: Final = {
    op.code.encode("latin-1"): _Effect(
        op.name,
        pickletools.markobject in op.stack_before,
        len([kind for kind in op.stack_before if kind not in _MARKS]),
        len(op.stack_after),
    )
    for op in pickletools.opcodes
}
_READERS: Final[Mapping[bytes, Callable[[io.BytesIO], Any] | None]] = {
    **{op.code.encode("latin-1"): op.arg.reader if op.arg else None for op in pickletools.opcodes},
    # their readers know ASCII only, and undo escapes
    b"S": lambda stream: _line(stream),
    b"c": lambda stream: (_line(stream), _line(stream)),
}

_REFUSED: Final = {
    **dict.fromkeys(("INST", "OBJ", "NEWOBJ", "NEWOBJ_EX"), "an object of a class"),
    **dict.fromkeys(("PERSID", "BINPERSID"), "a reference to something outside the file"),
    **dict.fromkeys(("EXT1", "EXT2", "EXT4"), "a number that stands for a class"),
    **dict.fromkeys(("EMPTY_SET", "ADDITEMS", "FROZENSET"), "a set"),
    **dict.fromkeys(("NEXT_BUFFER", "READONLY_BUFFER"), "a buffer outside the file"),
}
"""Opcodes that plain data do not need. EXT1 to EXT4 would get past ``find_class``."""

_INTEGERS: Final = ("INT", "BININT", "LONG", "LONG1", "LONG4")
_TUPLES: Final = ("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3")
_CONTAINERS: Final = (
    *("EMPTY_LIST", "LIST", "APPEND", "APPENDS"),
    *("EMPTY_DICT", "DICT", "SETITEM", "SETITEMS"),
)
_KEYS_AT: Final = {"DICT": slice(0, None, 2), "SETITEMS": slice(1, None, 2), "SETITEM": slice(1, 2)}
"""Opcode -> where the keys are among the values that it takes."""


def _opcodes(content: bytes) -> Iterator[tuple[_Effect, Any]]:
    """Yield each opcode with its argument, up to the end of the pickle and of the file."""
    stream = io.BytesIO(content)
    for _ in range(MAX_OPCODES):
        place, code = stream.tell(), stream.read(1)
        if code not in _EFFECTS:
            what = f"unknown opcode {code!r}" if code else "the pickle ends too early"
            raise InvalidEventError(f"is damaged: {what}")
        effect, reader = _EFFECTS[code], _READERS[code]
        if effect.name in _REFUSED:
            raise InvalidEventError(f"holds {_REFUSED[effect.name]}, refused")
        try:
            argument = None if reader is None else reader(stream)
        except (ValueError, OverflowError):  # not enough bytes, or no number or text
            raise InvalidEventError(
                f"is damaged: the pickle ends too early, or what its {effect.name} at byte {place} "
                "says cannot be"
            ) from None
        yield effect, argument
        if code == b".":
            break
    else:
        raise InvalidEventError(f"has more than {MAX_OPCODES} opcodes")
    if stream.tell() != len(content):
        raise InvalidEventError("goes on after the end of its pickle")


def _line(stream: io.BytesIO) -> bytes:
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise ValueError
    return line


def _check_opcodes(content: bytes) -> None:
    """Follow what the opcodes do to the stack, without the values.

    Of each value it is known how deep tuples lie in it: 0 for what has no parts, 1 for a short
    tuple of such, more for other tuples, for lists and for dicts. Keys of dicts are hashed while a
    pickle is loaded, which takes for ever for tuples of tuples of the same tuple, and overflows the
    stack of C for deep ones: keys must be of 0 or 1.
    """
    stack: list[int] = []
    marks: list[int] = []  # how long the stack was
    memo: dict[int, int] = {}
    for (name, marked, below, puts), argument in _opcodes(content):
        if name == "PROTO" and argument > _PROTOCOL:
            raise InvalidEventError(
                f"is a pickle of protocol {argument}, expected at most {_PROTOCOL}"
            )
        if name in _INTEGERS and not -(2**63) <= argument < 2**64:
            raise InvalidEventError("holds a whole number of more than 64 bits")
        start = len(stack)
        if marked:
            if not marks:
                raise InvalidEventError(_DAMAGED)
            start = marks.pop()
        start -= below
        if start < (marks[-1] if marks else 0):
            raise InvalidEventError(_DAMAGED)
        taken = stack[start:]
        if below or marked:
            del stack[start:]
        if name in _KEYS_AT and any(depth > 1 for depth in taken[_KEYS_AT[name]]):
            raise InvalidEventError(_NO_KEY)
        made = 0
        if name in _TUPLES:
            made = max(taken, default=0) + 1 + (len(taken) > _LONGEST_KEY)
        elif name in _CONTAINERS:
            made = 2
        elif name in ("DUP", "BUILD", "MEMOIZE"):  # BUILD with None leaves any value as it was
            made = taken[0]
        elif name.endswith("GET"):
            if argument not in memo:
                raise InvalidEventError(_DAMAGED)
            made = memo[argument]
        elif name == "MARK":
            marks.append(len(stack))
            continue
        elif name.endswith("PUT"):
            # room is made for all places up to the last one
            if len(stack) == (marks[-1] if marks else 0) or not 0 <= argument <= MAX_OPCODES:
                raise InvalidEventError(_DAMAGED)
            memo[argument] = stack[-1]
        if name == "MEMOIZE":
            memo[len(memo)] = made
        if made > MAX_NESTING:
            raise InvalidEventError(_TOO_DEEP)
        stack += [made] * puts
    if stack or marks:
        raise InvalidEventError(_DAMAGED)


# --- what stands in for what it asks for -----------------------------------------------------

_NDARRAY: Final = object()  # stands for the class of arrays


class _Unpickler(pickle.Unpickler):
    """Knows the names in :data:`_STAND_INS` and no others."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content), fix_imports=False, encoding="latin-1")
        self._converted = 0

    def find_class(self, module: str, name: str) -> Any:
        found = _STAND_INS.get((module, name))
        if found is None:
            raise InvalidEventError(
                f"asks for {shown(f'{module[:60]}.{name[:60]}')}, which is refused: only dicts, "
                "lists, tuples, texts, numbers and arrays of numbers are read"
            )
        return _Function(found, self) if callable(found) else found

    def raw(self, content: object) -> bytes | bytearray:
        """Return bytes; those that Python 2, or an old protocol, wrote as a text are counted."""
        if isinstance(content, (bytes, bytearray)):
            return content
        if not isinstance(content, str):
            raise InvalidEventError(_NO_NUMBERS)
        self._converted += len(content)
        if self._converted > MAX_CONVERTED:
            raise InvalidEventError("becomes too large: it shares long texts")
        try:
            return content.encode("latin-1")
        except UnicodeEncodeError:
            raise InvalidEventError(_NO_ARRAY) from None


class _Function:
    """Stands for a function; called with the arguments that the file gives it."""

    __slots__ = ("_call", "_reader")

    def __init__(self, call: Callable[..., Any], reader: _Unpickler):
        self._call, self._reader = call, reader

    def __call__(self, *arguments: Any) -> Any:
        try:
            return self._call(self._reader, *arguments)
        except TypeError:  # too few of them, or too many
            raise InvalidEventError(_NO_ARRAY) from None

    def __setstate__(self, state: object) -> None:
        raise InvalidEventError("sets the state of what is no array")


class _Dtype:
    """A data type of numbers of fixed size, whose byte order may still be set."""

    __slots__ = ("dtype",)

    def __init__(self, spelling: str) -> None:
        self.dtype = np.dtype(spelling)

    def __setstate__(self, state: object) -> None:
        """Take (version, byte order, ...); the rest is about fields and nested arrays."""
        if not (
            isinstance(state, tuple)
            and len(state) in (8, 9)
            and state[1] in ("<", ">", "|", "=")
            and state[2:5] == (None, None, None)
        ):
            raise InvalidEventError(_NO_NUMBERS)
        if state[1] in "<>":
            self.dtype = self.dtype.newbyteorder(state[1])


class _Array:
    """An array, read-only, whose content may still be set: None before it is known."""

    __slots__ = ("_reader", "array")

    def __init__(self, reader: _Unpickler, array: NDArray[Any] | None = None) -> None:
        self._reader, self.array = reader, array

    def __setstate__(self, state: object) -> None:
        """Take (version, shape, data type, whether in Fortran order, bytes); version optional."""
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise InvalidEventError(_NO_ARRAY)
        shape, dtype, fortran, content = state[-4:]
        order = "F" if fortran in (1, True) else "C"
        self.array = _array(self._reader, content, dtype, shape, order)


def _array(
    reader: _Unpickler, content: object, dtype: object, shape: object, order: str
) -> NDArray[Any]:
    """Return ``content`` as an array, without copying it unless it is a text of Python 2."""
    if not isinstance(dtype, _Dtype):
        raise InvalidEventError(_NO_NUMBERS)
    if type(shape) is int:
        shape = (shape,)
    if not (
        isinstance(shape, tuple)
        and len(shape) <= MAX_DIMENSIONS
        and all(type(n) is int and 0 <= n <= MAX_LENGTH for n in shape)
    ):
        raise InvalidEventError("holds an array of an impossible shape")
    raw = reader.raw(content)
    wanted = math.prod(shape) * dtype.dtype.itemsize
    if len(raw) != wanted:
        raise InvalidEventError(
            f"holds an array of shape {shape} in {len(raw)} bytes, expected {wanted}"
        )
    flat = np.frombuffer(raw, dtype.dtype) if raw else np.empty(0, dtype.dtype)
    array = flat.reshape(shape, order="F" if order == "F" else "C")
    array.setflags(write=False)
    return array


def _reconstruct(reader: _Unpickler, kind: object, shape: object, letter: object) -> _Array:
    if kind is not _NDARRAY:
        raise InvalidEventError(_NO_ARRAY)
    return _Array(reader)


def _from_buffer(
    reader: _Unpickler, content: object, dtype: object, shape: object, order: Any, axes: Any = None
) -> _Array:
    """Return an array in the order "C", "F" or "K", for which that of the axes is given."""
    if order not in ("C", "F", "K") or (order == "K") != (axes is not None):
        raise InvalidEventError(_NO_ARRAY)
    array = _array(reader, content, dtype, shape, order)
    if axes is None:
        return _Array(reader, array)
    if (
        not isinstance(axes, (tuple, list))
        or any(type(axis) is not int for axis in axes)
        or sorted(axes) != list(range(array.ndim))
    ):
        raise InvalidEventError(_NO_ARRAY)
    return _Array(reader, array.transpose(axes))


def _scalar(reader: _Unpickler, dtype: object, content: object) -> Any:
    return _array(reader, content, dtype, (), "C").item()


def _dtype(reader: _Unpickler, spelling: object = None, *_: object) -> _Dtype:
    match = _DTYPE.fullmatch(spelling) if isinstance(spelling, str) else None
    if match is None:
        raise InvalidEventError(_NO_NUMBERS)
    return _Dtype(match.group(0))


def _encode(reader: _Unpickler, text: object, codec: object) -> bytes | bytearray:
    """Return a text as bytes: the way of old protocols to write bytes."""
    if not isinstance(text, str) or codec not in ("latin1", "latin-1"):
        raise InvalidEventError(_NO_ARRAY)
    return reader.raw(text)


_STAND_INS: Final[Mapping[tuple[str, str], Callable[..., Any] | object]] = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    **dict.fromkeys((("__builtin__", "bytes"), ("builtins", "bytes")), lambda reader: b""),
    **{
        (f"numpy.{core}.{module}", name): function
        for core in ("core", "_core")  # before and since NumPy 2
        for module, name, function in (
            ("multiarray", "_reconstruct", _reconstruct),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
}
"""(module, name) that a pickle may ask for -> what it gets instead."""


# --- after it was loaded ---------------------------------------------------------------------


class _Part(NamedTuple):
    """A finished value, how large it is written out, and how deeply nested."""

    value: Any
    size: int
    height: int


class _Finished:
    """Replaces what stood for arrays by arrays, and measures what was made."""

    def __init__(self) -> None:
        self._known: dict[int, _Part] = {}
        self._open: set[int] = set()

    def of(self, value: Any, depth: int) -> _Part:
        """Return ``value``, which lies ``depth`` deep, without stand-ins."""
        if value is None or isinstance(value, (bool, int, float)):
            return _Part(value, 1, 0)
        if isinstance(value, (str, bytes, bytearray)):
            plain = value if isinstance(value, str) else bytes(value)
            return _Part(plain, 1 + len(value), 0)
        if isinstance(value, _Array):
            if value.array is None:
                raise InvalidEventError("is damaged: it holds an array without content")
            return _Part(value.array, 1 + value.array.size, 0)
        if type(value) not in (list, tuple, dict):
            raise InvalidEventError("holds a function or a class in place of data")
        part = self._known.get(id(value))
        if part is None:
            part = self._known[id(value)] = self._container(value, depth)
        if depth + part.height > MAX_NESTING:
            raise InvalidEventError(_TOO_DEEP)
        return part

    def _container(self, value: Any, depth: int) -> _Part:
        if depth > MAX_NESTING or id(value) in self._open:
            raise InvalidEventError(_TOO_DEEP)
        self._open.add(id(value))
        parts, size = [], 1
        if type(value) is dict:
            for key in value:
                parts_of_key = key if type(key) is tuple and len(key) <= _LONGEST_KEY else (key,)
                if any(type(part) not in (str, int) for part in parts_of_key):
                    raise InvalidEventError(_NO_KEY)
                size += sum(1 + len(p) if isinstance(p, str) else 1 for p in parts_of_key)
        for item in value.values() if type(value) is dict else value:
            part = self.of(item, depth + 1)
            parts.append(part)
            size += part.size
            if size > MAX_SIZE:
                raise InvalidEventError(
                    f"is larger than the {MAX_SIZE} values that are read, written out"
                )
        self._open.remove(id(value))
        values = (part.value for part in parts)
        height = 1 + max((part.height for part in parts), default=0)
        made = dict(zip(value, values, strict=True)) if type(value) is dict else type(value)(values)
        return _Part(made, size, height)
