"""What a model of social perception is, and how its answer becomes a prediction."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from phase_ppl.evaluation.prediction import Prediction, probabilities_of
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

Given: TypeAlias = Prediction | Mapping[str, Any]
"""An answer: a prediction, whose event id does not matter; or a mapping from questions
("goal_red", "goal_green", "relation") to a label, to label -> probability, or to probabilities in
label order. What the model does not answer is absent, or None."""


class Answer(NamedTuple):
    """An answer with files that belong to it.

    Attributes:
        given: the answer.
        artefacts: name of a file -> a function that writes it to the path it is given.
    """

    given: Given
    artefacts: Mapping[str, Callable[[Path], object]] = {}


Predict: TypeAlias = Callable[[Scene, Observation, int], Given | Answer]
"""A model, ready to be asked: ``predict(scene, observation, seed)``. That is all that it gets to
know of an event. The same three give the same answer.

It may have a method ``warm_up()``, called once before the first event, for what all processes can
share, such as compiled code on disk; and a method ``settings()``, which returns as plain data what
else determines its answers."""


def as_prediction(given: object, event_id: str = "") -> Prediction:
    """Return an answer as a prediction of the event.

    Raises:
        InvalidEventError, UnknownNameError: it is none; the message says what is wrong.
    """
    if isinstance(given, Prediction):
        found = dataclasses.replace(given, event_id=event_id)
    elif isinstance(given, Mapping):
        probabilities, labels = {}, {}
        for question, answer in given.items():
            if answer is None:
                continue
            if isinstance(answer, str):
                labels[question] = answer
            elif isinstance(answer, Mapping):
                probabilities[question] = probabilities_of(question, answer)
            else:
                probabilities[question] = np.asarray(answer)
        found = Prediction(event_id, probabilities, labels)
    else:
        raise InvalidEventError(
            f"the answer is {shown(given)}, expected a Prediction or a mapping with goal_red, "
            "goal_green or relation"
        )
    if not found.answers:
        raise InvalidEventError("the answer is empty: goal_red, goal_green or relation is needed")
    return found
