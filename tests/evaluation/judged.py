"""Small events with truth and judgments, and predictions of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from phase_ppl.evaluation.comparison import differences_of
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.prediction import Prediction, probabilities_of
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.hypothesis import RELATIONS
from tests.world.examples import make_scene, make_trajectory

BLUE_TO_RED = "Get blue item to red lm"
BLUE_TO_GREEN = "Get blue item to green lm"
PINK_TO_BLUE = "Get pink item to blue lm"
TO_GREEN = "get to green agent"
AWAY_FROM_RED = "get away from red agent"

COLLABORATIVE = (BLUE_TO_RED, BLUE_TO_RED)
INDEPENDENT = (BLUE_TO_RED, PINK_TO_BLUE)
COMPETING = (BLUE_TO_RED, BLUE_TO_GREEN)
OPPOSING = (TO_GREEN, AWAY_FROM_RED)


def make_event(
    id: str,
    goals: tuple[str, str] | None = COLLABORATIVE,
    votes: Sequence[int] | None = None,
    *,
    judgments: Mapping[str, Any] | None = None,
    predictions: Mapping[str, Any] | None = None,
) -> Event:
    """Return an event; ``votes`` are for friendly, neutral, adversarial."""
    if votes is not None:
        judgments = {"relation_counts": dict(zip(RELATIONS, votes, strict=True))}
    return Event(
        make_scene(),
        Observation(make_trajectory()),
        id=id,
        truth=None if goals is None else Truth(*goals),
        judgments=judgments,
        predictions=predictions,
    )


def answers(id: str, *goals: str, relation: str | None = None) -> Prediction:
    """Return a prediction of answers without probabilities: red's goal, green's, the relation."""
    given = dict(zip(("goal_red", "goal_green"), goals, strict=False))
    if relation is not None:
        given["relation"] = relation
    return Prediction(id, answers=given)


def shares(id: str, **probabilities: Mapping[str, float] | Sequence[float]) -> Prediction:
    """Return a prediction of probabilities, of relations in label order or by name."""
    return Prediction(
        id,
        {
            question: probabilities_of(question, given)
            if isinstance(given, Mapping)
            else list(given)  # type: ignore[misc]
            for question, given in probabilities.items()
        },
    )


def by_id(*predictions: Prediction) -> dict[str, Prediction]:
    return {prediction.event_id: prediction for prediction in predictions}


def values(metrics: Mapping[str, Any], *paths: str) -> list[float | None]:
    """Return the values of figures at places in the metrics, parts joined by dots."""
    figures = [at(metrics, path) for path in paths]
    return [figure and figure["value"] for figure in figures]


def differences(
    events: Sequence[Event],
    one: Mapping[str, Prediction],
    other: Mapping[str, Prediction],
    resamples: int = 1000,
) -> dict[str, dict[str, Any]]:
    """Return measure, in a scenario after its name -> difference of two models."""
    rows = differences_of(events, {"one": one, "other": other}, seed=0, resamples=resamples)
    return {".".join(filter(None, (row["scenario"], row["measure"]))): row for row in rows}
