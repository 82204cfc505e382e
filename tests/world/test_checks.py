"""Checks of numbers that settings share."""

from __future__ import annotations

import math

import numpy as np
import pytest

from phase_ppl.world.checks import nonnegative_number, positive_number
from phase_ppl.world.errors import InvalidSettingError


def test_numbers_of_all_kinds_become_floats() -> None:
    for value in (2, 2.0, np.float32(2), np.int64(2)):
        for check in (positive_number, nonnegative_number):
            found = check("x", value)
            assert type(found) is float
            assert found == 2.0
    assert nonnegative_number("x", 0) == 0.0


@pytest.mark.parametrize("value", [-1, math.nan, math.inf, 10**400, "2", True, None])
def test_what_is_no_such_number_is_refused_by_name(value: object) -> None:
    with pytest.raises(InvalidSettingError, match=r"^x=.* expected a number >= 0"):
        nonnegative_number("x", value)
    for bad in (value, 0):
        with pytest.raises(InvalidSettingError, match=r"^x=.* expected a positive number"):
            positive_number("x", bad)
