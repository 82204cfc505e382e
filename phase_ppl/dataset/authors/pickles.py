"""Pickles of plain data, read so that none of a file's code runs and no small file becomes large.

Python's unpickler calls whatever a file names. Here its opcodes are followed one by one: those of
plain data, as many as :data:`MAX_OPCODES`; at any other the file is refused. The functions by which
a file describes NumPy's arrays are known by name, and never called: arrays are put together here,
of numbers of fixed size only, since an array of objects would hold a pickle of its own. Last, what
came out is measured as if it were written out (:data:`MAX_SIZE`, :data:`MAX_NESTING`).
"""

from __future__ import annotations

import codecs
import io
import math
import os
import pickletools
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.documents import reading_bytes, too_large
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
_NO_ARRAY: Final = "is damaged: it describes an array as NumPy never does"
_DAMAGED: Final = "is damaged: its pickle makes no sense"
_TOO_DEEP: Final = f"is nested more than {MAX_NESTING} deep, or in itself"


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
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for unknown escapes in texts of Python 2
            made = _Reader(content).read()
    except (InvalidEventError, MemoryError):
        raise
    except Exception:  # a value that is not there, or none that can be had
        raise InvalidEventError(_DAMAGED) from None
    return _Finished().of(made, 0)[0]


# --- following the opcodes -------------------------------------------------------------------


def _line(stream: io.BytesIO) -> bytes:
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise ValueError
    return line[:-1]


_OPCODES: Final[Mapping[bytes, tuple[str, Callable[[io.BytesIO], Any] | None]]] = {
    **{op.code.encode("latin-1"): (op.name, op.arg.reader if op.arg else None)
       for op in pickletools.opcodes},
    # their readers know ASCII only, and undo escapes
    b"S": ("STRING", _line),
    b"c": ("GLOBAL", lambda stream: (_line(stream), _line(stream))),
}  # fmt: skip
"""Opcode -> its name, and what reads its argument."""

_REFUSED: Final = {
    **dict.fromkeys(("INST", "OBJ", "NEWOBJ", "NEWOBJ_EX"), "an object of a class"),
    **dict.fromkeys(("PERSID", "BINPERSID"), "a reference to something outside the file"),
    **dict.fromkeys(("EXT1", "EXT2", "EXT4"), "a number that stands for a class"),
    **dict.fromkeys(("EMPTY_SET", "ADDITEMS", "FROZENSET"), "a set"),
    **dict.fromkeys(("NEXT_BUFFER", "READONLY_BUFFER"), "a buffer outside the file"),
}
"""Opcodes that plain data do not need."""

_INTEGERS: Final = ("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4")
_VALUES: Final = (
    *("FLOAT", "BINFLOAT", "BINSTRING", "SHORT_BINSTRING"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
)
"""Opcodes whose argument is a value."""


class _Reader:
    """Follows the opcodes of a pickle."""

    def __init__(self, content: bytes) -> None:
        self._stream, self._n_bytes = io.BytesIO(content), len(content)
        self._stack: list[Any] = []  # the values above the last mark
        self._below: list[list[Any]] = []  # those below it, and below each mark before
        self._memo: dict[int, Any] = {}
        self._converted = 0

    def read(self) -> Any:
        """Return what the pickle describes, in which stand-ins may take the place of arrays."""
        stream = self._stream
        for _ in range(MAX_OPCODES):
            place, code = stream.tell(), stream.read(1)
            if code not in _OPCODES:
                what = f"unknown opcode {code!r}" if code else "the pickle ends too early"
                raise InvalidEventError(f"is damaged: {what}")
            name, reader = _OPCODES[code]
            if name in _REFUSED:
                raise InvalidEventError(f"holds {_REFUSED[name]}, refused")
            try:
                argument = None if reader is None else reader(stream)
            except (ValueError, OverflowError):  # not enough bytes, or no number or text
                raise InvalidEventError(
                    f"is damaged: the pickle ends too early, or what its {name} at byte {place} "
                    "says cannot be"
                ) from None
            if name == "STOP":
                break
            self._do(name, argument)
        else:
            raise InvalidEventError(f"has more than {MAX_OPCODES} opcodes")
        if stream.tell() != self._n_bytes:
            raise InvalidEventError("goes on after the end of its pickle")
        (made,) = self._stack
        if self._below:
            raise InvalidEventError(_DAMAGED)
        return made

    def _do(self, name: str, argument: Any) -> None:
        """Do what an opcode says; any error means that the pickle makes no sense."""
        stack = self._stack
        match name:
            case "PROTO" if argument > _PROTOCOL:
                raise InvalidEventError(
                    f"is a pickle of protocol {argument}, expected at most {_PROTOCOL}"
                )
            case "PROTO":
                pass
            case "FRAME":
                if argument > self._n_bytes - self._stream.tell():
                    raise InvalidEventError(_DAMAGED)
            case "NONE":
                stack.append(None)
            case "NEWTRUE" | "NEWFALSE":
                stack.append(name == "NEWTRUE")
            case _ if name in _INTEGERS:
                if not -(2**63) <= argument < 2**64:
                    raise InvalidEventError("holds a whole number of more than 64 bits")
                stack.append(argument)
            case _ if name in _VALUES:
                stack.append(argument)
            case "STRING":
                if len(argument) < 2 or argument[:1] not in b"'\"" or argument[:1] != argument[-1:]:
                    raise InvalidEventError(_DAMAGED)
                stack.append(codecs.escape_decode(argument[1:-1])[0].decode("latin-1"))  # type: ignore[attr-defined]
            case "MARK":
                self._below.append(stack)
                self._stack = []
            case "POP":
                stack.pop()
            case "POP_MARK":
                self._marked()
            case "DUP":
                stack.append(stack[-1])
            case "MEMOIZE" | "PUT" | "BINPUT" | "LONG_BINPUT":
                self._memo[len(self._memo) if name == "MEMOIZE" else argument] = stack[-1]
            case "GET" | "BINGET" | "LONG_BINGET":
                stack.append(self._memo[argument])
            case "EMPTY_TUPLE":
                stack.append(())
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                n = int(name[-1])
                parts = [stack.pop() for _ in range(n)]
                stack.append(tuple(reversed(parts)))
            case "TUPLE" | "LIST":
                values = self._marked()
                self._stack.append(tuple(values) if name == "TUPLE" else values)
            case "EMPTY_LIST":
                stack.append([])
            case "APPEND" | "APPENDS":
                values = self._marked() if name == "APPENDS" else [stack.pop()]
                _exactly(list, self._stack[-1]).extend(values)
            case "EMPTY_DICT":
                stack.append({})
            case "DICT" | "SETITEMS" | "SETITEM":
                values = [stack.pop(), stack.pop()][::-1] if name == "SETITEM" else self._marked()
                if name == "DICT":
                    self._stack.append({})
                target = _exactly(dict, self._stack[-1])
                for key, value in zip(values[::2], values[1::2], strict=True):
                    _size_of_key(key)  # before it is hashed
                    target[key] = value
            case "GLOBAL" | "STACK_GLOBAL":
                if name == "GLOBAL":
                    module, named = (line.decode() for line in argument)
                else:
                    named, module = (_exactly(str, stack.pop()) for _ in range(2))
                if (module, named) not in _NAMES:
                    raise InvalidEventError(
                        f"asks for {shown(f'{module[:60]}.{named[:60]}')}, which is refused: only "
                        "dicts, lists, tuples, texts, numbers and arrays of numbers are read"
                    )
                stack.append(_NAMES[module, named])
            case "REDUCE":
                arguments, function = _exactly(tuple, stack.pop()), _exactly(_Named, stack.pop())
                stack.append(_called(self, function.name, arguments))
            case "BUILD":
                state = stack.pop()
                if not isinstance(stack[-1], _Array | _Dtype):
                    raise InvalidEventError("sets the state of what is no array")
                stack[-1].build(self, state)
            case _:
                raise InvalidEventError(f"holds {name}, which plain data do not need")

    def _marked(self) -> list[Any]:
        """Take the values above the last mark, and the mark."""
        values, self._stack = self._stack, self._below.pop()
        return values

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


def _exactly(kind: type, value: Any) -> Any:
    """Return a value, which must be of a type and of no other."""
    if type(value) is not kind:
        raise InvalidEventError(_DAMAGED)
    return value


def _size_of_key(key: object) -> int:
    """Return how large the key of a dict is: longer or deeper ones could take for ever to hash."""
    parts = key if type(key) is tuple and len(key) <= _LONGEST_KEY else (key,)
    if any(type(part) not in (str, int) for part in parts):
        raise InvalidEventError("has a dict whose keys are no texts or whole numbers")
    return sum(1 + len(part) if isinstance(part, str) else 1 for part in parts)


# --- arrays, from what describes them ---------------------------------------------------------


class _Named(NamedTuple):
    """What a pickle asks for by its name."""

    name: str


_NAMES: Final[Mapping[tuple[str, str], _Named]] = {
    ("numpy", "ndarray"): _Named("ndarray"),
    ("numpy", "dtype"): _Named("dtype"),
    ("_codecs", "encode"): _Named("encode"),
    ("__builtin__", "bytes"): _Named("bytes"),
    ("builtins", "bytes"): _Named("bytes"),
    **{
        (f"numpy.{core}.{module}", name): _Named(name)
        for core in ("core", "_core")  # before and since NumPy 2
        for module, name in (
            ("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"),
        )
    },
}  # fmt: skip
"""(module, name) that a pickle may ask for."""


class _Dtype:
    """A data type of numbers of fixed size, whose byte order may still be set."""

    def __init__(self, spelling: str) -> None:
        self.dtype = np.dtype(spelling)

    def build(self, _reader: _Reader, state: object) -> None:
        """Take (version, byte order, ...); the rest is about fields and nested arrays."""
        match state:
            case (_, "<" | ">" | "|" | "=" as order, None, None, None, _, _, _, *rest) if (
                isinstance(state, tuple) and len(rest) < 2
            ):
                if order in "<>":
                    self.dtype = self.dtype.newbyteorder(order)  # type: ignore[arg-type]
            case _:
                raise InvalidEventError(_NO_NUMBERS)


class _Array:
    """An array, read-only, whose content may still be set: None before it is known."""

    def __init__(self, array: NDArray[Any] | None = None) -> None:
        self.array = array

    def build(self, reader: _Reader, state: object) -> None:
        """Take (version, shape, data type, whether in Fortran order, bytes); version optional."""
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise InvalidEventError(_NO_ARRAY)
        shape, dtype, fortran, content = state[-4:]
        self.array = _array(reader, content, dtype, shape, "F" if fortran in (1, True) else "C")


def _array(
    reader: _Reader, content: object, dtype: object, shape: object, order: Literal["C", "F"] = "C"
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
    array = flat.reshape(shape, order=order)
    array.setflags(write=False)
    return array


def _called(reader: _Reader, name: str, arguments: tuple[Any, ...]) -> Any:
    """Return what a function that a pickle names makes of arguments; it is not called for that."""
    match (name, *arguments):
        case ("_reconstruct", _Named("ndarray"), _, _):
            return _Array()
        case ("_frombuffer", content, dtype, shape, "C" | "F" as order, *rest) if rest in (
            [],
            [None],
        ):
            return _Array(_array(reader, content, dtype, shape, order))  # type: ignore[arg-type]
        case ("_frombuffer", content, dtype, shape, "K", [*axes]) if all(
            type(axis) is int for axis in axes
        ):
            array = _array(reader, content, dtype, shape)
            if sorted(axes) == list(range(array.ndim)):
                return _Array(array.transpose(axes))
        case ("scalar", dtype, content):
            return _array(reader, content, dtype, ()).item()
        case ("dtype", str() as spelling, *_) if _DTYPE.fullmatch(spelling):
            return _Dtype(spelling)
        case ("dtype", *_):
            raise InvalidEventError(_NO_NUMBERS)
        case ("encode", str() as text, "latin1" | "latin-1"):  # how old protocols write bytes
            return reader.raw(text)
        case ("bytes",):
            return b""
    raise InvalidEventError(_NO_ARRAY)


# --- after it was read -----------------------------------------------------------------------


class _Finished:
    """Replaces what stood for arrays by arrays, and measures what was made."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, int, int]] = {}
        self._open: set[int] = set()

    def of(self, value: Any, depth: int) -> tuple[Any, int, int]:
        """Return ``value``, which lies ``depth`` deep, its size written out, and its nesting."""
        if value is None or isinstance(value, (bool, int, float)):
            return value, 1, 0
        if isinstance(value, (str, bytes, bytearray)):
            return value if isinstance(value, str) else bytes(value), 1 + len(value), 0
        if isinstance(value, _Array):
            if value.array is None:
                raise InvalidEventError("is damaged: it holds an array without content")
            return value.array, 1 + value.array.size, 0
        if type(value) not in (list, tuple, dict):
            raise InvalidEventError("holds a function or a class in place of data")
        if id(value) not in self._known:
            if depth > MAX_NESTING or id(value) in self._open:
                raise InvalidEventError(_TOO_DEEP)
            self._open.add(id(value))
            self._known[id(value)] = self._container(value, depth)
            self._open.remove(id(value))
        if depth + self._known[id(value)][2] > MAX_NESTING:
            raise InvalidEventError(_TOO_DEEP)
        return self._known[id(value)]

    def _container(self, value: Any, depth: int) -> tuple[Any, int, int]:
        is_dict = type(value) is dict
        size, height, parts = 1 + (sum(map(_size_of_key, value)) if is_dict else 0), 0, []
        for item in value.values() if is_dict else value:
            part, its_size, its_height = self.of(item, depth + 1)
            parts.append(part)
            size, height = size + its_size, max(height, its_height)
            if size > MAX_SIZE:
                raise InvalidEventError(
                    f"is larger than the {MAX_SIZE} values that are read, written out"
                )
        made = dict(zip(value, parts, strict=True)) if is_dict else type(value)(parts)
        return made, size, height + 1
