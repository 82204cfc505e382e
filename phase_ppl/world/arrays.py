"""Array types by content, checks of numbers that users pass, and equal rows of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidEventError, number_or_nan, shown

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

GOLDEN: Final = (math.sqrt(5) - 1) / 2  # its multiples lie evenly between 0 and 1, modulo 1


def equal_rows(columns: Sequence[NDArray[Any]]) -> tuple[IntArray, IntArray]:
    """Return the kind of each row of a table, (row,), and the first row of each kind, (kind,).

    Rows of one kind are equal in all columns, each (row,); NaN is equal to itself. Kinds are
    numbered in the order of their first rows.
    """
    import pandas as pd  # slow to import

    table = pd.DataFrame(dict(enumerate(columns)))
    kind = table.groupby(list(table), sort=False, dropna=False).ngroup().to_numpy()
    return kind, np.unique(kind, return_index=True)[1]


def finite_array(
    name: str,
    value: object,
    shape: tuple[int | None, ...],
    error: type[Exception] = InvalidEventError,
    *,
    unseen: bool = False,
) -> FloatArray:
    """Return ``value`` as a read-only float array of ``shape`` (None: any length).

    With ``unseen`` the last axis is x, y, angle, of which NaN says that it was not seen: all three,
    or the angle alone.
    """
    if np.ma.is_masked(value):
        raise error(f"{name} is masked in places, expected numbers everywhere")
    try:
        given = np.asarray(value)
    except ValueError:
        raise error(f"{name} is ragged: its rows differ in length") from None
    if given.dtype.kind not in "iuf":
        values = np.array(value, dtype=object).ravel().tolist()
        odd = next((v for v in values if not math.isfinite(number_or_nan(v))), value)
        raise error(f"{name} holds {shown(odd)}, expected numbers")
    array = np.array(given, dtype=np.float64)
    if array.size == 0 and None in shape:
        array = array.reshape([0 if n is None else n for n in shape])
    fits = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = tuple("n" if n is None else n for n in shape)
        raise error(f"{name} has shape {array.shape}, expected {wanted}")
    odd = ~np.isfinite(array)
    if unseen and odd.any():
        nan = np.isnan(array)
        x, y, angle = np.moveaxis(nan, -1, 0)
        in_part = (x != y) | (x & ~angle)
        if in_part.any():
            where = tuple(int(i) for i in np.argwhere(in_part)[0])
            raise error(
                f"{name}{list(where)} is {array[where].tolist()}, expected NaN for all three of a "
                "body that was not seen, or for its angle alone"
            )
        odd &= ~nan
    if odd.any():
        where = tuple(int(i) for i in np.argwhere(odd)[0])
        raise error(f"{name}{list(where)} is {array[where]}, expected a finite number")
    array.setflags(write=False)
    return array
