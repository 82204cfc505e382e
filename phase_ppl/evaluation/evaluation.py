"""What a model made of many events: predictions, metrics, differences from other models."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from phase_ppl.analysis.summary import plain
from phase_ppl.evaluation.folder import SETTINGS, ResultsFolder
from phase_ppl.evaluation.metrics import evaluate_predictions, paired_difference, reference_models
from phase_ppl.evaluation.people import human_accuracy
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.printed import table
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """What a model made of many events. ``print`` shows the table.

    Attributes:
        events: all of them, in the order of the file.
        predictions: event id -> prediction, of the events that have one.
        failures: event id -> what went wrong, of the others.
        settings: all that determines the predictions: ``model``, ``options``, ``seed``, the
            ``events`` by id with a checksum of what is seen of them, ``versions``.
        cost: ``seconds`` (summed over events), ``simulations`` (None where the model counts
            none), ``workers`` and ``wall_seconds`` of the last call, and ``events``, the same
            for each.
        folder: where it is kept; None: nowhere.
        notes: what had to be done beside predicting.
    """

    events: Sequence[Event]
    predictions: Mapping[str, Prediction]
    failures: Mapping[str, str]
    settings: Mapping[str, Any]
    cost: Mapping[str, Any]
    folder: ResultsFolder | None = None
    notes: tuple[str, ...] = ()

    @functools.cached_property
    def metrics(self) -> dict[str, Any]:
        """The metrics, in JSON's types.

        Those of :mod:`phase_ppl.evaluation.metrics`; ``people``, what people got right
        (:func:`~phase_ppl.evaluation.people.human_accuracy`); ``reference_models``, the metrics
        of the models whose predictions the events carry; ``failures``, ``settings``, ``cost``.
        """
        found = {
            **evaluate_predictions(self.events, self.predictions),
            "people": human_accuracy(self.events),
            "reference_models": reference_models(self.events),
            "failures": self.failures,
            "settings": self.settings,
            "cost": self.cost,
        }
        return {name: plain(value) for name, value in found.items()}

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Evaluation:
        """Read an evaluation, finished or not, from its folder.

        Raises:
            InvalidEventError: it is no such folder, or a file in it is damaged.
        """
        folder = ResultsFolder.open(path)
        for name in ("model", "seed"):
            if name not in folder.settings:
                raise InvalidEventError(f"{folder.path / SETTINGS} has no {name}")
        predictions = folder.predictions()
        stored = (folder.metrics() or {}).get("cost") or {}
        cost = cost_of(predictions, stored.get("workers"), stored.get("wall_seconds"))
        return cls(folder.events, predictions, folder.failures(), folder.settings, cost, folder)

    def against(self, other: Evaluation | str | os.PathLike[str]) -> dict[str, Any]:
        """Return how much better this model is than another, on the events that both predict.

        Args:
            other: an evaluation, the folder of one, or the name of a model whose predictions
                the events carry.

        Returns:
            ``one`` and ``other``, names of the models, and what
            :func:`~phase_ppl.evaluation.metrics.paired_difference` gives, in JSON's types.

        Raises:
            InvalidEventError: there is no such folder; or an event is not the same in both.
            InvalidSettingError: ``other`` is none of these; or there is no event that both
                predict.
        """
        name, predictions = opponent(self.events, other)
        if not set(predictions) & set(self.predictions):
            raise InvalidSettingError(f"there is no event that {self.name} and {name} both predict")
        found = paired_difference(self.events, self.predictions, predictions)
        return {name: plain(value) for name, value in
                {"one": self.name, "other": name, **found}.items()}  # fmt: skip

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self.settings["model"])

    def __str__(self) -> str:
        return table(self)

    def __repr__(self) -> str:
        return (
            f"<Evaluation of {self.name}: {len(self.predictions)} of {len(self.events)} events, "
            f"{len(self.failures)} failed>"
        )


def opponent(
    events: Sequence[Event], other: Evaluation | str | os.PathLike[str]
) -> tuple[str, Mapping[str, Prediction]]:
    """Return name and predictions of what a model is compared with.

    Args:
        events: that the model is asked about.
        other: as of :meth:`Evaluation.against`.

    Raises:
        As :meth:`Evaluation.against`.
    """
    name: str
    predictions: Mapping[str, Prediction]
    references = reference_predictions(events)
    if isinstance(other, str) and other in references:
        name, predictions = other, references[other]
    else:
        if not isinstance(other, Evaluation):
            if not isinstance(other, str | os.PathLike):
                raise InvalidSettingError(
                    f"{shown(other)} is neither an evaluation, the folder of one, nor the name of "
                    "a model"
                )
            if not Path(other).exists():
                known = f", and no reference model ({', '.join(references)})" if references else ""
                raise InvalidEventError(f"{other}: no such folder{known}")
            other = Evaluation.load(other)
        mine = {event.id: event for event in events}
        for event in other.events:
            if event.id in mine and event_digest(event) != event_digest(mine[event.id]):
                raise InvalidEventError(
                    f"event {event.id!r} is not the same in both evaluations: its scene or "
                    "observation differ"
                )
        name, predictions = other.name, other.predictions
    if not any(event.id in predictions for event in events):
        raise InvalidSettingError(f"{name} predicts none of the {len(events)} events")
    return name, predictions


def cost_of(
    predictions: Mapping[str, Prediction], workers: int | None, wall_seconds: float | None
) -> dict[str, Any]:
    """Return what predictions cost, together and each."""
    each = {name: dict(prediction.cost) for name, prediction in predictions.items()}
    counts, seconds = (
        [cost[name] for cost in each.values() if isinstance(cost.get(name), int | float)]
        for name in ("simulations", "seconds")
    )
    return {
        "seconds": sum(seconds),
        "simulations": sum(counts) if counts else None,
        "workers": workers,
        "wall_seconds": wall_seconds,
        "events": each,
    }
