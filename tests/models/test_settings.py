"""Settings that make no sense are refused where they are made, by name, with what is expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from phase_people.observers import Perception
from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.predicate import PredicateSettings
from phase_ppl.models.socialgnn.store import TrainingSettings
from phase_ppl.simulator.joint import DynamicsNoise
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError

NAN, INF = math.nan, math.inf
POSITIVE, NOT_NEGATIVE = "expected a positive number", "expected a number >= 0"
WHOLE = "expected a whole number >= 1"
WRONG: list[tuple[Callable[..., Any], str, tuple[Any, ...], str]] = [
    (RadialLikelihood, "beta", (0, -1.0, NAN, INF, 10**400, "0.05", True), POSITIVE),
    (DynamicsNoise, "speed", (-0.1, "1"), NOT_NEGATIVE),
    (Tracking, "strengths", ((100.0,),), "expected newtons in [150, 600]"),
    (Tracking, "strengths", ((300, 300),), "a strength is named twice"),
    (Tracking, "states", (0,), WHOLE),
    (Tracking, "noise", (-1.0,), NOT_NEGATIVE),
    (PredicateSettings, "on_agent", (0,), POSITIVE),
    (PredicateSettings, "lasting", (0, 1.5), WHOLE),
    (PredicateSettings, "rationality", (-1, "high", False, 10**400), NOT_NEGATIVE),
    (PredicateSettings, "operator_frames", (1,), "expected a number > 1"),
    (PredicateSettings, "lapse", (1,), "expected a number in (0, 1)"),
    (Perception, "missed", (1.0,), "expected a number in [0, 1)"),
    (TrainingSettings, "epochs", (0,), WHOLE),
    (TrainingSettings, "learning_rate", (NAN,), "expected a number from 1e-07 to 1"),
    (TrainingSettings, "dropout", (1.0,), "expected a number from 0 to 0.9"),
    (TrainingSettings, "looks", (1,), "expected True or False"),
    (TrainingSettings, "variant", ("origina",), "'original'"),
]


@pytest.mark.parametrize(
    ("kind", "name", "values", "expected"), WRONG, ids=[f"{k.__name__}-{n}" for k, n, *_ in WRONG]
)
def test_what_makes_no_sense_is_refused(
    kind: Callable[..., Any], name: str, values: tuple[Any, ...], expected: str
) -> None:
    for value in values:
        with pytest.raises((InvalidSettingError, UnknownNameError)) as raised:
            kind(**{name: value})
        assert name in str(raised.value)
        assert expected in str(raised.value)
