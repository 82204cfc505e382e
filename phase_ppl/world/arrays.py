"""Types of arrays, by what they hold, and which rows of a table are equal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


def equal_rows(columns: Sequence[NDArray[Any]]) -> tuple[IntArray, IntArray]:
    """Return the kind of each row of a table, (row,), and the first row of each kind, (kind,).

    Rows of one kind are equal in all columns, each (row,); NaN is equal to itself. Kinds are
    numbered in the order of their first rows.
    """
    import pandas as pd  # slow to import

    table = pd.DataFrame(dict(enumerate(columns)))
    kind = table.groupby(list(table), sort=False, dropna=False).ngroup().to_numpy()
    return kind, np.unique(kind, return_index=True)[1]
