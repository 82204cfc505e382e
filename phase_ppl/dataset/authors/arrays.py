"""NumPy arrays as pickles describe them, put together here from their parts.

A pickle of an array asks for functions of NumPy, with arguments, and for a state to be set. The
functions that are asked for are never called: those below stand in for them. They take a tuple of
arguments, as found in the file, and accept numbers of fixed size only: an array of objects would
hold a pickle of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidEventError

MAX_DIMENSIONS: Final = 8
MAX_LENGTH: Final = 2**31
"""Longest dimension of an array."""

_DTYPE: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1)")

_NO_NUMBERS: Final = "holds an array of something else than plain numbers"

NDARRAY: Final = object()
"""Stands for the class of arrays."""


class PickledDtype:
    """A data type whose byte order may still be set.

    Attributes:
        dtype: of numbers of fixed size.
    """

    def __init__(self, spelling: str) -> None:
        self.dtype = np.dtype(spelling)

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Take (version, byte order, ...); the rest is about fields and nested arrays."""
        if not (
            len(state) in (8, 9)
            and state[1] in ("<", ">", "|", "=")
            and state[2:5] == (None, None, None)
        ):
            raise InvalidEventError(_NO_NUMBERS)
        if state[1] in "<>":
            self.dtype = self.dtype.newbyteorder(state[1])


class PickledArray:
    """An array whose content may still be set.

    Attributes:
        array: read-only; None before its content is known.
    """

    def __init__(self, array: NDArray[Any] | None = None) -> None:
        self.array = array

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Take (version, shape, data type, whether in Fortran order, bytes); version optional."""
        if len(state) not in (4, 5):
            raise _damaged()
        shape, dtype, fortran, content = state[-4:]
        self.array = _array(content, dtype, shape, "F" if fortran in (1, True) else "C")


def _array(content: object, dtype: object, shape: object, order: str) -> NDArray[Any]:
    """Return ``content`` as an array, without copying it unless it is a text of Python 2."""
    if not isinstance(dtype, PickledDtype):
        raise InvalidEventError(_NO_NUMBERS)
    if isinstance(shape, int):
        shape = (shape,)
    if not (
        isinstance(shape, tuple)
        and len(shape) <= MAX_DIMENSIONS
        and all(type(n) is int and 0 <= n <= MAX_LENGTH for n in shape)
    ):
        raise InvalidEventError("holds an array of an impossible shape")
    raw = _raw(content)
    wanted = math.prod(shape) * dtype.dtype.itemsize
    if len(raw) != wanted:
        raise InvalidEventError(
            f"holds an array of shape {shape} in {len(raw)} bytes, expected {wanted}"
        )
    flat = np.frombuffer(raw, dtype.dtype) if raw else np.empty(0, dtype.dtype)
    array = flat.reshape(shape, order="F" if order == "F" else "C")
    array.setflags(write=False)
    return array


def _raw(content: object) -> bytes:
    if isinstance(content, str):
        try:
            return content.encode("latin-1")
        except UnicodeEncodeError:
            raise _damaged() from None
    if not isinstance(content, bytes):
        raise InvalidEventError(_NO_NUMBERS)
    return content


def _reconstruct(arguments: tuple[Any, ...]) -> PickledArray:
    if len(arguments) != 3 or arguments[0] is not NDARRAY:
        raise _damaged()
    return PickledArray()


def _from_buffer(arguments: tuple[Any, ...]) -> PickledArray:
    """Arguments: bytes, data type, shape, order "C", "F" or "K", and for "K" that of the axes."""
    if len(arguments) not in (4, 5):
        raise _damaged()
    content, dtype, shape, order, *rest = arguments
    axes = rest[0] if rest else None
    if order not in ("C", "F", "K") or (order == "K") != (axes is not None):
        raise _damaged()
    array = _array(content, dtype, shape, order)
    if axes is None:
        return PickledArray(array)
    if not isinstance(axes, (tuple, list)) or len(axes) != array.ndim:
        raise _damaged()
    if any(type(axis) is not int for axis in axes) or sorted(axes) != list(range(array.ndim)):
        raise _damaged()
    return PickledArray(array.transpose(axes))


def _scalar(arguments: tuple[Any, ...]) -> Any:
    if len(arguments) != 2:
        raise _damaged()
    return _array(arguments[1], arguments[0], (), "C").item()


def _dtype(arguments: tuple[Any, ...]) -> PickledDtype:
    spelling = arguments[0] if arguments else None
    match = _DTYPE.fullmatch(spelling) if isinstance(spelling, str) else None
    if match is None:
        raise InvalidEventError(_NO_NUMBERS)
    return PickledDtype(match.group(0))


def _encode(arguments: tuple[Any, ...]) -> bytes:
    """Return a text as bytes: the way of old protocols to write bytes."""
    if len(arguments) != 2 or arguments[1] not in ("latin1", "latin-1"):
        raise _damaged()
    if not isinstance(arguments[0], str):
        raise _damaged()
    return _raw(arguments[0])


def _no_bytes(arguments: tuple[Any, ...]) -> bytes:
    if arguments:
        raise _damaged()
    return b""


def _damaged() -> InvalidEventError:
    return InvalidEventError("is damaged: it describes an array as NumPy never does")


STAND_INS: Final[Mapping[tuple[str, str], Callable[[tuple[Any, ...]], Any] | object]] = {
    ("numpy", "ndarray"): NDARRAY,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("__builtin__", "bytes"): _no_bytes,
    ("builtins", "bytes"): _no_bytes,
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
