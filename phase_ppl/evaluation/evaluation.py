"""A model's predictions of many events, and several models compared."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.evaluation.cells import INTERVALS, LINES, WIDTH, metric_tables, on_screen, wrapped
from phase_ppl.evaluation.comparison import (
    MARGIN,
    RESAMPLES,
    USUAL,
    ModelComparison,
    Source,
    check_names,
    checked,
    reference_label,
)
from phase_ppl.evaluation.folder import SETTINGS, ResultsFolder
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.evaluation.ratings import REHEARSAL, rehearsed
from phase_ppl.evaluation.table import Answers
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, check_name, shown
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest
from phase_ppl.world.picture import Printed, plain

if TYPE_CHECKING:
    import pandas as pd

_UNKNOWN: Final = (
    "the errors of all answers are unknown (they need two sets of searches or more; "
    "planner_seeds=1 gives one): so no answer is sure, and no event is decided"
)
_FEW: Final = 3  # failures and notes that are printed

_COLUMNS: Final = {
    **dict.fromkeys(("event", "question", "label", "model"), None),
    **dict.fromkeys(("probability", "error"), "float64"),
    "answer": "bool",
    **dict.fromkeys(("truth", "sure", "decided"), "boolean"),
    **{"people": "float64", "n": "int64", "at": "float64"},
}
"""Column of the tidy table -> its type of numbers; None: text."""


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation(Printed):
    """A model's predictions of many events. ``print`` shows the table of metrics.

    Attributes:
        events: all events, in the order given.
        predictions: event id -> prediction, for the events that have one.
        failures: event id -> what went wrong, for the events at which the model failed.
        settings: all that determines the predictions: ``model``, ``options``, ``seed``,
            ``versions``, and ``events``: id -> checksum of scene and observation.
        folder: folder that keeps the evaluation; None: it is not kept.
        notes: remarks, such as about damaged predictions.
    """

    events: Sequence[Event]
    predictions: Mapping[str, Prediction]
    failures: Mapping[str, str]
    settings: Mapping[str, Any]
    folder: ResultsFolder | None = None
    notes: tuple[str, ...] = ()

    @functools.cached_property
    def cost(self) -> dict[str, Any]:
        """What the predictions cost.

        Keys: ``seconds`` and ``simulations``, summed over events (``simulations`` is None if the
        model counts none); ``events``: event id -> its cost.
        """
        each = {name: dict(prediction.cost) for name, prediction in self.predictions.items()}
        counts, seconds = (
            [cost[name] for cost in each.values() if isinstance(cost.get(name), int | float)]
            for name in ("simulations", "seconds")
        )
        total = sum(counts) if counts else None
        return {"seconds": sum(seconds), "simulations": total, "events": each}

    @functools.cached_property
    def compared(self) -> ModelComparison:
        """This model compared with people and with the models whose answers the events carry."""
        return ModelComparison(self.events, entries({self.name: self}, self.events, ALL), USUAL)

    @functools.cached_property
    def metrics(self) -> dict[str, Any]:
        """The metrics, in JSON's types; :mod:`phase_ppl.evaluation.metrics` lists them.

        Further keys: ``cpu_seconds`` and ``seconds``, means per event; ``people``, people's
        accuracy (:func:`phase_ppl.human_accuracy`); ``reference_models``: model -> metrics, for the
        models whose predictions the events carry; ``failures``, ``settings``, ``cost``.
        """
        others = dict(self.compared.metrics)
        found = {
            **others.pop(self.name),
            "people": self.compared.people,
            "reference_models": others,
            "failures": self.failures,
            "settings": self.settings,
            "cost": self.cost,
        }
        return dict(plain(found))

    def to_dataframe(self) -> pd.DataFrame:
        """Return a tidy table: a row per event, question and possible answer (label).

        Questions that the model did not answer have no rows.

        Returns:
            Columns:

            * ``event``, ``question``, ``label``, ``model``: text.
            * ``probability``, and its Monte-Carlo ``error`` (NaN: unknown).
            * ``answer``: whether the label is the model's answer.
            * ``truth``: whether the label is true (NA: unknown).
            * ``sure``: whether the posterior is sure of the answer (NA: no posterior).
            * ``decided``: whether the posterior is sure of the event as a whole, by its
              ``diagnostics()`` (NA: no posterior).
            * ``people``: share of people who gave the label (NaN: nobody was asked).
            * ``n``: number of people who answered the question.
            * ``at``: seconds of the film that had been shown (NaN: the whole film).
        """
        events = [event for event in self.events if event.id in self.predictions]
        rows = Answers.of(events, self.predictions).rows
        keys = ["event", "at", "question"]
        n = rows.groupby(keys, sort=False, dropna=False)["votes"].transform("sum").round()
        table = rows.assign(n=n, model=self.name)[rows["answer"].notna()]
        kinds = {name: kind for name, kind in _COLUMNS.items() if kind}
        return table[list(_COLUMNS)].reset_index(drop=True).astype(kinds)

    def posterior(self, event_id: str) -> Posterior | ClosedLoopPosterior | None:
        """Return the posterior of an event, read from the folder; None: no posterior was kept.

        Raises:
            UnknownNameError: there is no such event.
        """
        check_name("event", event_id, [event.id for event in self.events])
        return None if self.folder is None else self.folder.posterior(event_id)

    @property
    def finished(self) -> bool:
        """Whether every event has a prediction, or failed."""
        return len(self.predictions) + len(self.failures) >= len(self.events)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Evaluation:
        """Read an evaluation, finished or not, from its folder.

        Raises:
            InvalidEventError: there is no such folder, it holds no evaluation, or a file is
                damaged.
        """
        folder = ResultsFolder.open(path)
        for name in ("model", "seed"):
            if name not in folder.settings:
                raise InvalidEventError(f"{folder.path / SETTINGS} has no {name}")
        predictions, failures = folder.predictions(), folder.failures()
        return cls(folder.events, predictions, failures, folder.settings, folder)

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self.settings["model"])

    def __str__(self) -> str:
        head = f"{self.name}: {len(self.predictions)} of {len(self.events)} events"
        failed = [f"failed: {event}: {failure}" for event, failure in self.failures.items()]
        told = [
            f"cost: {_cost(self.cost)}",
            *_first(failed, "failures"),
            *_first([f"note: {note}" for note in self.notes], "notes"),
            *([f"note: {_UNKNOWN}"] if self._has_no_errors else []),
        ]
        lines = wrapped(f"{head}, seed {self.settings['seed']}; {INTERVALS}")
        lines += wrapped(f"note: {REHEARSAL}") if rehearsed(self.events) else []
        ending = ["", *(line for text in told for line in wrapped(text))]
        tables = metric_tables(self.compared.metrics, self.compared.people)
        lines += on_screen(tables, LINES - len(lines) - len(ending))
        return "\n".join([*lines, *ending])

    @property
    def _has_no_errors(self) -> bool:
        """Whether posteriors gave the answers, all with unknown errors."""
        of_posteriors = [one for one in self.predictions.values() if one.decided is not None]
        errors = [p for one in of_posteriors for values in one.errors.values() for p in values]
        return bool(errors) and all(map(math.isnan, errors))

    def __repr__(self) -> str:
        return (
            f"<Evaluation of {self.name}: {len(self.predictions)} of {len(self.events)} events, "
            f"{len(self.failures)} failed>"
        )


# --- printed --------------------------------------------------------------------------------------


def _first(texts: Sequence[str], what: str) -> list[str]:
    """Return the first few texts, shortened; the last says where there are more."""
    shown = [textwrap.shorten(text, 2 * WIDTH, placeholder=" ...") for text in texts[:_FEW]]
    return [*shown, *([f"{len(texts)} in all, see .{what}"] if len(texts) > _FEW else ())]


def _cost(cost: Mapping[str, Any]) -> str:
    words = f"{_time(cost['seconds'])} by the clock, summed over events"
    cpu = [one["cpu_seconds"] for one in cost["events"].values() if one.get("cpu_seconds")]
    words += f", {_time(sum(cpu))} of CPU" if cpu else ""
    if cost["simulations"] is not None:
        words = f"{cost['simulations']} simulations, {words}"
    return words


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


# --- several models, and people, on the same events -----------------------------------------------

Given: TypeAlias = Evaluation | str | os.PathLike[str]
ALL: Final = "all"  # stands for all reference models of the events


def compare_models(
    sources: Given | Sequence[Given] | Mapping[str, Given],
    *,
    stored: str | Sequence[str] = (),
    against: str | None = None,
    common: bool = False,
    margin: float = MARGIN,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> ModelComparison:
    """Compare models, and people, on the same events.

    Args:
        sources: evaluations, or folders of evaluations. A folder that holds several stands for all
            of them. A mapping gives names, as in ``{"fast": ..., "paper": ...}``. Otherwise an
            evaluation is called by its model, or by its folder if several have the same model.
        stored: names of further models to compare, whose answers the events carry; or "all".
            Default: none.
        against: name of the model that the other models are compared with; by default every pair is
            compared.
        common: whether to compare on the events that all evaluations share. By default all must be
            about the same events.
        margin: a model and people count as equivalent if two one-sided tests reject that their
            shares of right answers differ by this much or more. Between 0 and 1.
        seed: seed of the resamples of the events, a whole number >= 0.
        resamples: number of resamples of the events, for differences and equivalence; by default
            10 000. The intervals of metrics always come from 1000, as in the paper.

    Raises:
        InvalidEventError: a folder holds no evaluation, or a damaged one; or the evaluations are
            about different events, and the message says which.
        InvalidSettingError: a source is no evaluation; there are none; two have the same name;
            one is named "people", which is reserved for people's answers; the events are of several
            worlds; or a number is out of range.
        UnknownNameError: there is no model with the name in ``against`` or ``stored``.
    """
    found = evaluations(sources)
    if not found:
        raise InvalidSettingError("there are no evaluations to compare")
    events, notes = shared_events(found, common)
    compared = entries(found, events, stored)
    given = {"margin": margin, "against": against, "seed": seed, "resamples": resamples}
    settings = checked(given, compared)
    for one in compared:
        missing = len(events) - len(one.predictions)
        if missing:
            why = f" ({len(one.failures)} failed)" if one.failures else ""
            notes.append(
                f"{one.name} predicts {len(one.predictions)} of {len(events)} events{why}; its "
                "scores are about those"
            )
    return ModelComparison(events, compared, settings, tuple(notes))


def evaluation_of(source: object) -> Evaluation:
    """Return an evaluation, or read it from a folder."""
    if isinstance(source, Evaluation):
        return source
    if not isinstance(source, str | os.PathLike):
        raise InvalidSettingError(f"{shown(source)} is neither an evaluation nor the folder of one")
    if not Path(source).exists():
        raise InvalidEventError(f"{source}: no such folder")
    return Evaluation.load(source)


def evaluations(sources: Given | Sequence[Given] | Mapping[str, Given]) -> dict[str, Evaluation]:
    """Return name -> evaluation.

    A folder that holds no evaluation itself stands for those in it, under the names of their
    folders. Others are named by the model, or by the folder if several are of the same model.
    """
    if isinstance(sources, Mapping):
        check_names(list(sources))
        return {name: evaluation_of(source) for name, source in sources.items()}
    if isinstance(sources, str | os.PathLike | Evaluation):
        sources = [sources]
    found: list[tuple[str, Evaluation]] = []
    for source in sources:
        inside = [(folder.name, Evaluation.load(folder)) for folder in _inside(source)]
        found += inside or [("", evaluation_of(source))]
    models = [evaluation.name for _, evaluation in found]
    named = []
    for name, one in found:
        if not name and models.count(one.name) > 1 and one.folder is not None:
            name = one.folder.path.resolve().name
        named.append((name or one.name, one))
    check_names([name for name, _ in named])
    return dict(named)


def _inside(source: object) -> list[Path]:
    """Return the folders of evaluations in a folder that holds none itself."""
    if not isinstance(source, str | os.PathLike) or (Path(source) / SETTINGS).is_file():
        return []
    return sorted(file.parent for file in Path(source).glob(f"*/{SETTINGS}"))


def shared_events(
    found: Mapping[str, Evaluation], common: bool = False
) -> tuple[list[Event], list[str]]:
    """Return the events that all evaluations are about, and notes about them.

    Events are the same if id, scene and observation are. Truth and judgments are those of the first
    evaluation.
    """
    given = {name: {event.id: event for event in one.events} for name, one in found.items()}
    digests = {name: {i: event_digest(e) for i, e in of.items()} for name, of in given.items()}
    (first, chosen), *others = given.items()
    notes = []
    for name, theirs in others:
        pairs = {
            i: (digests[first].get(i), digests[name].get(i)) for i in {**given[first], **theirs}
        }
        apart = [i for i, (mine, other) in pairs.items() if mine != other]
        if apart and not common:
            raise InvalidEventError(
                f"{first} and {name} were asked about different events: {len(apart)}, such as "
                f"{apart[0]!r}, are in one only, or differ in scene or observation; common=True "
                "(--common) compares them on the events that all share"
            )
        chosen = {i: event for i, event in chosen.items() if i not in apart}
        changed = [
            i
            for i, e in chosen.items()
            if (e.truth, e.judgments) != (theirs[i].truth, theirs[i].judgments)
        ]
        if changed:
            notes.append(
                f"truth or judgments of {len(changed)} events, such as {changed[0]!r}, are not the "
                f"same in {first} and {name}; those in {first} count"
            )
    if not chosen:
        raise InvalidEventError(f"there is no event that {', '.join(found)} share")
    if rehearsed(chosen.values()):
        notes.append(REHEARSAL)
    largest = max(map(len, given.values()))
    if len(chosen) < largest:
        notes.insert(0, f"on the {len(chosen)} events that all share, of up to {largest}")
    return list(chosen.values()), notes


def entries(
    found: Mapping[str, Evaluation], events: Sequence[Event], stored: str | Sequence[str] = ()
) -> list[Source]:
    """Return the compared models with their answers about the events."""
    ids = [event.id for event in events]
    made = [
        Source(
            name,
            "model",
            {i: one.predictions[i] for i in ids if i in one.predictions},
            {key: value for key, value in one.settings.items() if key != "events"},
            {i: str(one.failures[i]) for i in ids if i in one.failures},
            None if one.folder is None else str(one.folder.path),
        )
        for name, one in found.items()
    ]
    references = reference_predictions(events)
    for name in chosen_references(stored, references):
        made.append(Source(reference_label(name, found), "reference", references[name]))
    return made


def chosen_references(stored: str | Sequence[str], references: Iterable[str]) -> list[str]:
    """Return the names of the chosen reference models."""
    known = list(references)
    if isinstance(stored, str):
        stored = known if stored == ALL else [stored]
    for name in stored:
        check_name("stored model", name, known)
    return list(dict.fromkeys(stored))
