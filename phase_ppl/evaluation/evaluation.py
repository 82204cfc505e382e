"""What a model made of many events: predictions, metrics, differences from other models."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from phase_ppl.evaluation.answer_sets import PEOPLE, AnswerSet, answer_sets, stored_label
from phase_ppl.evaluation.cells import INTERVALS, metric_tables, wrapped
from phase_ppl.evaluation.folder import SETTINGS, ResultsFolder
from phase_ppl.evaluation.metrics import (
    evaluate_predictions,
    human_accuracy,
    paired_difference,
    reference_models,
)
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.evaluation.tables import world_of
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest
from phase_ppl.world.picture import plain, preformatted
from phase_ppl.world.scene import PHASE


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
        (:func:`~phase_ppl.evaluation.metrics.human_accuracy`); ``reference_models``, the metrics
        of the models whose predictions the events carry; ``failures``, ``settings``, ``cost``.
        """
        judged = any(event.judgments for event in self.events)
        of_phase = world_of(self.events) == PHASE
        found = {
            **evaluate_predictions(self.events, self.predictions),
            "people": human_accuracy(self.events) if judged or of_phase else None,
            "reference_models": reference_models(self.events),
            "failures": self.failures,
            "settings": self.settings,
            "cost": self.cost,
        }
        return dict(plain(found))

    @property
    def finished(self) -> bool:
        """Whether every event has a prediction, or failed."""
        return len(self.predictions) + len(self.failures) >= len(self.events)

    @functools.cached_property
    def answers(self) -> list[AnswerSet]:
        """All answers, of people first, as figures and pages show them."""
        return self._answers_about(self.events, {})

    @functools.cached_property
    def measured(self) -> list[AnswerSet]:
        """The same with metrics; of an evaluation that is not finished all about what is."""
        events, metrics = self.events, self.metrics
        people, references = metrics["people"] or {}, metrics["reference_models"]
        if not self.finished:
            events = [event for event in events if event.id in self.predictions]
            people, references = human_accuracy(events), reference_models(events)
        others = {PEOPLE: people, **self._of_references(references)}
        return self._answers_about(events, {**others, self.name: metrics})

    def _answers_about(
        self, events: Sequence[Event], metrics: Mapping[str, Mapping[str, Any]]
    ) -> list[AnswerSet]:
        references = self._of_references(reference_predictions(events))
        models = {self.name: self.predictions, **references}
        return answer_sets(events, models, references, metrics)

    def _of_references(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is given of models whose answers the events carry by their names here."""
        return {stored_label(name, [self.name]): of_model for name, of_model in given.items()}

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
        cost = cost_of(predictions, *folder.last_call())
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
        return {"one": self.name, "other": name, **plain(found)}

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self.settings["model"])

    def __str__(self) -> str:
        metrics = self.metrics
        models = {self.name: metrics, **self._of_references(metrics["reference_models"])}
        head = f"{self.name}: {len(self.predictions)} of {len(self.events)} events"
        told = [
            f"cost: {_cost(self.cost)}",
            *(f"failed: {event}: {failure}" for event, failure in self.failures.items()),
            *(f"note: {note}" for note in self.notes),
        ]
        lines = wrapped(f"{head}, seed {self.settings['seed']}; {INTERVALS}")
        lines += [*metric_tables(list(models.items()), metrics["people"]), ""]
        return "\n".join([*lines, *(line for text in told for line in wrapped(text))])

    def _repr_html_(self) -> str:
        return preformatted(self)

    def __repr__(self) -> str:
        return (
            f"<Evaluation of {self.name}: {len(self.predictions)} of {len(self.events)} events, "
            f"{len(self.failures)} failed>"
        )


def evaluation_of(source: object, references: Collection[str] = ()) -> Evaluation:
    """Return an evaluation, or that in a folder; ``references`` are names it could have been."""
    if isinstance(source, Evaluation):
        return source
    if not isinstance(source, str | os.PathLike):
        raise InvalidSettingError(f"{shown(source)} is neither an evaluation nor the folder of one")
    if not Path(source).exists():
        known = f", and no reference model ({', '.join(references)})" if references else ""
        raise InvalidEventError(f"{source}: no such folder{known}")
    return Evaluation.load(source)


def opponent(
    events: Sequence[Event], other: Evaluation | str | os.PathLike[str]
) -> tuple[str, Mapping[str, Prediction]]:
    """Return name and predictions of what a model is compared with."""
    references = reference_predictions(events)
    if isinstance(other, str) and other in references:
        return other, references[other]
    found = evaluation_of(other, references)
    mine = {event.id: event for event in events}
    for event in found.events:
        if event.id in mine and event_digest(event) != event_digest(mine[event.id]):
            raise InvalidEventError(
                f"event {event.id!r} is not the same in both evaluations: its scene or "
                "observation differ"
            )
    if not any(event.id in found.predictions for event in events):
        raise InvalidSettingError(f"{found.name} predicts none of the {len(events)} events")
    return found.name, found.predictions


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


def reference_evaluation(events: Sequence[Event], name: str) -> Evaluation:
    """Return the answers of a reference model as if it had been evaluated on the events.

    It has no seed, nothing was timed, and there is no folder. Events without an answer of the
    model are in ``failures``.

    Args:
        events: with their predictions (:mod:`phase_ppl.evaluation.prediction`).
        name: of the model, as the events call it.

    Raises:
        UnknownNameError: no event has a prediction of that model.
        InvalidEventError: a prediction cannot be read.
    """
    references = reference_predictions(events)
    if name not in references:
        raise unknown_name("reference model", name, references)
    predictions = references[name]
    settings = {
        "model": name,
        "reference": True,
        "seed": None,
        "events": {event.id: event_digest(event) for event in events},
    }
    failures = {
        event.id: f"the event carries no prediction of {name}"
        for event in events
        if event.id not in predictions
    }
    cost = cost_of(predictions, None, None)
    return Evaluation(list(events), predictions, failures, settings, cost)


# --- printed --------------------------------------------------------------------------------------


def difference_table(found: Mapping[str, Any]) -> str:
    """Return the differences that ``Evaluation.against`` found."""
    head = wrapped(
        f"{found['one']} minus {found['other']}: on the {found['n_events']} events that both "
        "predict; intervals and p from resampled events"
    )
    return "\n".join([*head, *metric_tables([("difference", found)])])


def _cost(cost: Mapping[str, Any]) -> str:
    words = f"{_time(cost['seconds'])} in all"
    if cost["simulations"] is not None:
        words = f"{cost['simulations']} simulations, {words}"
    if cost["wall_seconds"] is not None:
        n = cost["workers"]
        on = "" if n is None else f" with {n} worker{'' if n == 1 else 's'}"
        words += f"; this call took {_time(cost['wall_seconds'])}{on}"
    return words


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.1f} min"
