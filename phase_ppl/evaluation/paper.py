"""What the paper prints: numbers with their places, and those of our metrics.

The paper's other numbers are in figures only, and cannot be read off exactly.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from phase_ppl.evaluation.table import PEOPLE

SIMPLE: Final = "SIMPLE"
SOCIALGNN: Final = "SocialGNN"
PREDICATE: Final = "predicate inverse planning"
VLM: Final = "Gemini"
LABELLED: Final = "labels"
RATED: Final = "likeness"
STEERED: Final = "videos that people steer"
EVENTS: Final = "PHASE"
"""Of whom, or of what, a number is, beside people."""


class Printed(NamedTuple):
    """A number of the paper."""

    place: str  # where it is printed
    what: str  # it says
    whose: str  # people's, a model's, or of what else
    path: str  # of the same number in our metrics, parts joined by dots
    value: float
    low: float | None = None  # its interval, where one is printed
    high: float | None = None
    below: bool = False  # whether the value is printed as a bound only, "< 0.6"

    @property
    def digits(self) -> int:
        """Decimals to show: none of a count."""
        if self.value > 1 and self.value == int(self.value):
            return 0
        return 2 if round(self.value, 2) == self.value else 3


_HUMAN: Final = "Results, Human results"
_ACCURACY: Final = "Results, Comparing model and human accuracy"
_GRADED: Final = "Results, Explaining human graded judgments"
_SETS: Final = "A Paradigm for Physically Grounded Social Perception"
_A2: Final = "Appendix A.2, Comparing PHASE and human-generated videos"

_GOALS, _RELATIONS = (f"by_scenario.competing.{kind}_accuracy" for kind in ("goal", "relation"))
_APART: Final = "by_scenario.independent.goal_accuracy"
_ALIKE: Final = "scenario types without a significant difference from people"

PRINTED: Final = (
    Printed(_HUMAN, "goals right", PEOPLE, "goal_accuracy", 0.78),
    Printed(_HUMAN, "relations right", PEOPLE, "relation_accuracy", 0.89),
    Printed(_HUMAN, "r of halves, goals", PEOPLE, "human.goal_split_half_r", 0.92, 0.91, 0.94),
    Printed(_HUMAN, "r of halves, relations", PEOPLE, "human.split_half_r", 0.96, 0.95, 0.97),
    Printed(_ACCURACY, "goals right, competing", PEOPLE, _GOALS, 0.76, 0.74, 0.78),
    Printed(_ACCURACY, "goals right, competing", SIMPLE, _GOALS, 0.59, 0.41, 0.77),
    Printed(_ACCURACY, "relations right, competing", SIMPLE, _RELATIONS, 0.91, 0.72, 1.0),
    Printed(_ACCURACY, "relations right, competing", SOCIALGNN, _RELATIONS, 0.0),
    Printed(_ACCURACY, "goals right, independent", PREDICATE, _APART, 0.35, 0.22, 0.48),
    Printed(_ACCURACY, f"{_ALIKE}, goals", SIMPLE, "like_people.goal", 3),
    Printed(_ACCURACY, f"{_ALIKE}, relations", SIMPLE, "like_people.relation", 4),
    Printed(_GRADED, "r with people, goals", SIMPLE, "human.goal_r", 0.82, 0.78, 0.85),
    Printed(_GRADED, "r with people, relations", SIMPLE, "human.relation_r", 0.78, 0.71, 0.82),
    *(
        Printed(_GRADED, f"r with people, {kind}s", whose, f"human.{kind}_r", 0.6, below=True)
        for whose in (SOCIALGNN, PREDICATE, VLM)
        for kind in ("goal", "relation")
    ),
    Printed(_SETS, "share of friendly events", EVENTS, "friendly", 200 / 500),
    Printed(_SETS, "share of neutral events", EVENTS, "neutral", 108 / 500),
    Printed(_SETS, "share of adversarial events", EVENTS, "adversarial", 192 / 500),
    Printed(_SETS, "fewest events of a goal category", EVENTS, "of_category.fewest", 47),
    Printed(_SETS, "most events of a goal category", EVENTS, "of_category.most", 129),
    Printed(_SETS, "labels used, of 23", LABELLED, "used", 23),
    Printed(_SETS, "labels that are a category", LABELLED, "categories", 18),
    *(
        Printed(_A2, f"mode of responses right, {kind}s", whose, f"majority.{kind}_accuracy", value)
        for whose, goals, relations in ((STEERED, 0.965, 0.92), (PEOPLE, 0.97, 0.99))
        for kind, value in (("goal", goals), ("relation", relations))
    ),
    Printed(_A2, "mean likeness, videos that people steer", RATED, "played", 4.06),
    Printed(_A2, "sd of likeness, videos that people steer", RATED, "played_sd", 0.36),
    Printed(_A2, "mean likeness, PHASE", RATED, "generated", 3.98),
    Printed(_A2, "sd of likeness, PHASE", RATED, "generated_sd", 0.42),
)

NOT_DRAWN: Final = (
    "Fig. intro and Fig. of the model show photographs and sketches, Fig. interface the authors' "
    "pages"
)
"""What of the paper's figures is no result."""
