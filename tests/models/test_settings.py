"""Settings that make no sense are refused where they are made, by name, with what is expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from phase_people.observers import Perception
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.predicate import PredicateSettings
from phase_ppl.models.socialgnn.store import TrainingSettings
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError

NAN, INF = math.nan, math.inf
POSITIVE, NOT_NEGATIVE = "expected a positive number", "expected a number >= 0"
WHOLE = "expected a whole number >= 1"
WRONG: list[tuple[Callable[..., Any], str, tuple[Any, ...], str]] = [
    (RadialLikelihood, "beta", (0, INF, 10**400, "0.05", True), POSITIVE),
    (Tracking, "strengths", ((100.0,),), "expected newtons in [150, 600]"),
    (Tracking, "strengths", ((300, 300),), "a strength is named twice"),
    (Tracking, "states", (0,), WHOLE),
    (PlannerConfig, "simulations", (0,), WHOLE),
    (PlannerConfig, "discount", (1.5,), "expected a number in (0, 1]"),
    (PlannerConfig, "c_base", (0,), POSITIVE),
    (SimpleSettings, "eta", (-0.1, NAN), NOT_NEGATIVE),
    (SimpleSettings, "window", (0,), WHOLE),
    (SimpleSettings, "prior_share", (1,), "expected a number in [0, 1)"),
    (SimpleSettings, "sign", ("both",), "'printed'"),
    (PredicateSettings, "on_agent", (0,), POSITIVE),
    (PredicateSettings, "rationality", (-1, "high", False, 10**400), NOT_NEGATIVE),
    (PredicateSettings, "lapse", (1,), "expected a number in (0, 1)"),
    (Perception, "missed", (1.0,), "expected a number in [0, 1)"),
    (TrainingSettings, "learning_rate", (NAN,), "expected a number from 1e-07 to 1"),
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
