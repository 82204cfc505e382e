"""What a model made of many events: predictions, metrics, differences from other models."""

from __future__ import annotations

import dataclasses
import functools
import os
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from phase_ppl.analysis.summary import WIDTH, plain
from phase_ppl.evaluation.answer_sets import PEOPLE, AnswerSet, answer_sets
from phase_ppl.evaluation.cells import fitting
from phase_ppl.evaluation.folder import SETTINGS, ResultsFolder
from phase_ppl.evaluation.metrics import (
    at,
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
from phase_ppl.world.picture import preformatted
from phase_ppl.world.scene import PHASE, check_phase

_DRAWN: Final = "a figure or page of an evaluation"


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
        of_phase = world_of(self.events) == PHASE
        found = {
            **evaluate_predictions(self.events, self.predictions),
            "people": human_accuracy(self.events) if of_phase else None,
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
        check_phase(self.events[0].scene, _DRAWN)
        return answer_sets(self.events, self.name, self.predictions)

    @functools.cached_property
    def measured(self) -> list[AnswerSet]:
        """The same with metrics; of an evaluation that is not finished all about what is."""
        metrics, events = self.metrics, self.events
        check_phase(events[0].scene, _DRAWN)
        others = {PEOPLE: metrics["people"], **metrics["reference_models"]}
        if not self.finished:
            events = [event for event in events if event.id in self.predictions]
            others = {PEOPLE: human_accuracy(events), **reference_models(events)}
        return [
            dataclasses.replace(one, metrics=metrics if one.kind == "model" else others[one.name])
            for one in answer_sets(events, self.name, self.predictions)
        ]

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
        return table(self)

    def _repr_html_(self) -> str:
        return preformatted(self)

    def __repr__(self) -> str:
        return (
            f"<Evaluation of {self.name}: {len(self.predictions)} of {len(self.events)} events, "
            f"{len(self.failures)} failed>"
        )


def opponent(
    events: Sequence[Event], other: Evaluation | str | os.PathLike[str]
) -> tuple[str, Mapping[str, Prediction]]:
    """Return name and predictions of what a model is compared with."""
    references = reference_predictions(events)
    if isinstance(other, str) and other in references:
        return other, references[other]
    if not isinstance(other, Evaluation):
        if not isinstance(other, str | os.PathLike):
            raise InvalidSettingError(
                f"{shown(other)} is neither an evaluation, the folder of one, nor the name of a "
                "model"
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
    if not any(event.id in other.predictions for event in events):
        raise InvalidSettingError(f"{other.name} predicts none of the {len(events)} events")
    return other.name, other.predictions


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

_LABEL: Final = 24
_OWN: Final = 19
_NAME: Final = 16
_GAP: Final = 2
"""Widths of columns: of the labels, of the model, of others' names at most, and between them."""

_INTERVALS: Final = "95 %; of right answers Clopper-Pearson, of scores and r over resampled events"

MetricPath = tuple[str, ...]


class _Row(NamedTuple):
    """A row: its label, where models have the figure, and where people have theirs.

    People's figures with a path that begins with "human" are among the model's metrics, as they
    are about the same events.
    """

    label: str
    path: MetricPath
    people: MetricPath = ()


class _Column(NamedTuple):
    """A column: whose figures it has, their metrics, and whether with intervals."""

    name: str
    metrics: Mapping[str, Any]
    width: int
    whole: bool = False


def table(evaluation: Evaluation) -> str:
    """Return the metrics of an evaluation by scenario, beside those of people and references."""
    metrics = evaluation.metrics
    head = f"{len(evaluation.predictions)} of {len(evaluation.events)} events"
    others = [(PEOPLE, metrics["people"]), *metrics["reference_models"].items()]
    columns = [
        _Column(evaluation.name, metrics, _OWN, whole=True),
        *(_Column(name, of, min(len(name), _NAME) + _GAP) for name, of in others),
    ]
    lines = [
        *_wrapped(evaluation.name, f"{head}, seed {evaluation.settings['seed']}"),
        *_figures(columns, metrics),
        "",
        *_wrapped("intervals", _INTERVALS),
        *_wrapped("cost", _cost(evaluation.cost)),
    ]
    for event, failure in evaluation.failures.items():
        lines += _wrapped("failed", f"{event}: {failure}")
    for note in evaluation.notes:
        lines += _wrapped("note", note)
    return "\n".join(lines)


def difference_table(found: Mapping[str, Any]) -> str:
    """Return the differences that ``Evaluation.against`` found."""
    lines = _wrapped(
        f"{found['one']} minus {found['other']}",
        f"on the {found['n_events']} events that both predict; intervals and p from resampled "
        "events",
    )
    column = _Column("difference", found, _OWN + 9, whole=True)
    return "\n".join([*lines, *_figures([column], found)])


def _rows(metrics: Mapping[str, Any]) -> Iterator[_Row]:
    for kind, title in (("goal", "goals right"), ("relation", "relation right")):
        name = f"{kind}_accuracy"
        yield _Row(title, (name,), (name,))
        for scenario, of_scenario in metrics.get("by_scenario", {}).items():
            n = of_scenario.get("n")
            path = ("by_scenario", scenario, name)
            yield _Row(f"  {scenario} ({n})" if n else f"  {scenario}", path, path)
        parts = "by_agent" if kind == "goal" else "by_pair"
        for part in metrics.get(parts, {}):
            yield _Row(f"  {part}"[: _LABEL - 1], (parts, part, name))
        if kind == "goal":
            yield _Row("  among the top 3", ("goal_top3_accuracy",))
        yield _Row("  log score of truth", (f"{kind}_log_score_truth",))
        for least, of_those in metrics.get("calibration", {}).get(kind, {}).items():
            if least != "0":
                label = f"  of p >= {least} ({of_those['n']})"
                yield _Row(label, ("calibration", kind, least, "accuracy"))
    for kind, prefix in (("goal", "goal_"), ("relation", "")):
        score, js = f"{prefix}log_score", f"{prefix}js"
        yield _Row(
            f"r with people, {kind}", ("human", f"{kind}_r"), ("human", f"{prefix}split_half_r")
        )
        if kind == "relation":
            yield _Row("  given the truth", ("human", "relation_r_given_truth"))
        yield _Row("  log score", ("human", score), ("human", f"{score}_people"))
        yield _Row("  JS divergence", ("human", js))


def _figures(columns: Sequence[_Column], metrics: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table; rows and columns without a figure are left out."""
    found = [(row, [_figure(row, column, metrics) for column in columns]) for row in _rows(metrics)]
    used = [i for i in range(len(columns)) if any(figures[i] for _, figures in found)]
    lines = []
    for block in fitting({i: columns[i].width for i in used}, WIDTH - _LABEL):
        names = "".join(f"{columns[i].name[:_NAME]:>{columns[i].width}}" for i in block)
        lines += ["", f"{'':<{_LABEL}}{names}"]
        for row, figures in found:
            if any(figures[i] for i in block):
                cells = "".join(_cell(figures[i], columns[i]) for i in block)
                lines.append(f"{row.label:<{_LABEL}}{cells}")
    return lines


def _figure(row: _Row, column: _Column, metrics: Mapping[str, Any]) -> dict[str, Any] | None:
    path, found = row.path, column.metrics
    if column.name == PEOPLE:
        path, found = row.people, metrics if row.people[:1] == ("human",) else found
    return at(found, path) if path else None


def _cell(figure: Mapping[str, Any] | None, column: _Column) -> str:
    if figure is None:
        return f"{'-':>{column.width}}"
    text = f"{figure['value']:.2f}"
    if column.whole and figure["ci_low"] is not None:
        text += f" [{figure['ci_low']:.2f}, {figure['ci_high']:.2f}]"
    if figure.get("p") is not None:
        text += f" p {figure['p']:.3f}"
    return f"{text:>{column.width}}"


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


def _wrapped(label: str, text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=f"{label}: ", subsequent_indent=" " * 4)
