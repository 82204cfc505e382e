"""Several models and people on the same events: scores, differences, equivalence."""

from __future__ import annotations

import dataclasses
import functools
import numbers
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from phase_ppl.analysis.summary import plain
from phase_ppl.dataset.documents import read_json
from phase_ppl.dataset.load import load_events, save_events
from phase_ppl.evaluation.comparison import statistics
from phase_ppl.evaluation.comparison.contenders import (
    Contender,
    Source,
    check_names,
    contenders,
    evaluations,
    shared_events,
)
from phase_ppl.evaluation.comparison.printed import comparison_text
from phase_ppl.evaluation.curves import at
from phase_ppl.evaluation.folder import COMPARISON, EVENTS
from phase_ppl.evaluation.metrics import metrics_of_each
from phase_ppl.evaluation.people import human_accuracy
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    PhasePPLError,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder, write_json

if TYPE_CHECKING:
    import pandas as pd

SCHEMA: Final = "phase-ppl-model-comparison-1"
"""Value of ``schema`` in comparison.json."""

MARGIN: Final = 0.1
RESAMPLES: Final = 10_000
"""Resamples for differences: with 1000 no p is below 0.002, which many pairs make useless."""

_Kind = TypeVar("_Kind")

_TABLE: Final = (
    *("goal_accuracy", "goal_top3_accuracy", "relation_accuracy"),
    *("goal_log_score_truth", "relation_log_score_truth", "human.goal_r", "human.goal_log_score"),
    *("human.goal_js", "human.relation_r", "human.relation_r_given_truth", "human.log_score"),
    *("human.js", *statistics.COSTS),
)


@dataclasses.dataclass(frozen=True, eq=False)
class ModelComparison:
    """Several models, and people, on the same events. ``print`` shows all tables.

    What a model or the events do not give is None, never a guess.

    Attributes:
        events: that all models were asked about.
        contenders: the models, in the order in which they were given.
        settings: ``margin`` of equivalence, ``against``, ``seed`` and ``resamples``.
        notes: what is to be known about the events.
    """

    events: Sequence[Event]
    contenders: Sequence[Contender]
    settings: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    @property
    def models(self) -> list[str]:
        """Names of the models."""
        return [one.name for one in self.contenders]

    @functools.cached_property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """Model -> its metrics (:mod:`phase_ppl.evaluation.metrics`).

        They come with ``cpu_seconds`` and ``seconds``, the means per event. Each is about the
        events of which the model has a prediction.
        """
        seed = self.settings["seed"]
        found = metrics_of_each(
            self.events, {one.name: one.predictions for one in self.contenders}, seed=seed
        )
        return {
            one.name: {**found[one.name], **statistics.costs(one, seed)} for one in self.contenders
        }

    @functools.cached_property
    def people(self) -> dict[str, Any]:
        """What people got right (:func:`~phase_ppl.evaluation.people.human_accuracy`)."""
        return human_accuracy(self.events, seed=self.settings["seed"])

    @functools.cached_property
    def differences(self) -> list[dict[str, Any]]:
        """Paired differences, see :func:`~phase_ppl.evaluation.comparison.statistics.differences`.

        ``pandas.DataFrame(comparison.differences)`` is a table of them.
        """
        return statistics.differences(
            self.events, self.contenders, against=self.settings["against"], **self._drawn
        )

    @functools.cached_property
    def equivalence(self) -> list[dict[str, Any]]:
        """Models minus people, see :func:`~phase_ppl.evaluation.comparison.statistics.equivalence`.

        Empty where no judged event has truth.
        """
        return statistics.equivalence(
            self.events, self.contenders, margin=self.settings["margin"], **self._drawn
        )

    @property
    def table(self) -> pd.DataFrame:
        """A row per model; columns (measure, part), parts "value", "ci_low" and "ci_high"."""
        import pandas as pd

        columns: dict[tuple[str, str], list[Any]] = {}
        for measure in _TABLE:
            path = tuple(measure.split("."))
            figures = [at(self.metrics[name], path) for name in self.models]
            for part in ("value", "ci_low", "ci_high"):
                columns[measure, part] = [None if f is None else f[part] for f in figures]
        return pd.DataFrame(columns, index=pd.Index(self.models, name="model"), dtype=float)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write everything into a folder: comparison.json and events.json.

        Raises:
            OutputError: it cannot be written.
        """
        path = writable_folder(folder)
        record = {
            "schema": SCHEMA,
            "settings": dict(self.settings),
            "notes": list(self.notes),
            "models": [_record(one) for one in self.contenders],
            "metrics": self.metrics,
            "people": self.people,
            "differences": self.differences,
            "equivalence": self.equivalence,
        }
        save_events(self.events, path / EVENTS)
        write_json(path / COMPARISON, plain(record))
        return path

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> ModelComparison:
        """Read what :meth:`save` wrote. All figures follow from the answers in it.

        Raises:
            InvalidEventError: there is no such folder, or a file in it is damaged.
        """
        path = Path(folder)
        if not (path / COMPARISON).is_file():
            raise InvalidEventError(f"{path} holds no comparison: it has no {COMPARISON}")
        record = read_json(path / COMPARISON)
        events = load_events(path / EVENTS)
        try:
            if record.get("schema") != SCHEMA:
                raise InvalidEventError(
                    f"its schema is {shown(record.get('schema'))}, not {SCHEMA!r}"
                )
            read = [_contender(one) for one in _of_kind(list, "models", record["models"])]
            ids = {event.id for event in events}
            for one in read:
                unknown = [name for name in one.predictions if name not in ids]
                if unknown:
                    raise InvalidEventError(
                        f"{one.name} predicts {shown(unknown[0])}, which is no event of {EVENTS}"
                    )
            settings = _of_kind(dict, "settings", record["settings"])
            notes = tuple(map(str, _of_kind(list, "notes", record["notes"])))
            return cls(events, read, _checked(settings, read), notes)
        except (PhasePPLError, KeyError) as error:
            reason = f"it has no {error}" if isinstance(error, KeyError) else str(error)
            raise InvalidEventError(f"{path / COMPARISON}: {reason}") from None

    def __str__(self) -> str:
        return comparison_text(self)

    def __repr__(self) -> str:
        return f"<ModelComparison of {', '.join(self.models)} on {len(self.events)} events>"

    @property
    def _drawn(self) -> dict[str, int]:
        return {"seed": self.settings["seed"], "resamples": self.settings["resamples"]}


def compare_models(
    sources: Source | Sequence[Source] | Mapping[str, Source],
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
        sources: evaluations, or folders of evaluations; a folder with several in it stands for
            all of them. With names, ``{"fast": ..., "paper": ...}``, they are called so;
            otherwise by the model, or by the folder where several are of the same model.
        stored: names of models whose answers the events carry, to be compared too, or "all".
        against: name of the model from which the others' differences are wanted; by default
            those of every pair.
        common: compare on the events that all evaluations share; otherwise they must be about
            the same ones.
        margin: a difference of shares of right answers up to which a model and people are
            equivalent.
        seed, resamples: of the events, for differences and equivalence; metrics have the 1000
            resamples of the paper.

    Raises:
        InvalidEventError: a folder holds no evaluation, or a damaged one; or the evaluations
            are about different events, the message says which.
        InvalidSettingError: a source is no evaluation; there are none; two would have the same
            name, or one that of people; or a number is out of range.
        UnknownNameError: there is no model of that name to compare with, or stored.
    """
    found = evaluations(sources)
    if not found:
        raise InvalidSettingError("there are no evaluations to compare")
    events, notes = shared_events(found, common)
    compared = contenders(found, events, stored)
    given = {"margin": margin, "against": against, "seed": seed, "resamples": resamples}
    settings = _checked(given, compared)
    for one in compared:
        missing = len(events) - len(one.predictions)
        if missing:
            why = f" ({len(one.failures)} failed)" if one.failures else ""
            notes.append(
                f"{one.name} predicts {len(one.predictions)} of {len(events)} events{why}; its "
                "scores are about those"
            )
    return ModelComparison(events, compared, settings, tuple(notes))


def _checked(settings: Mapping[str, Any], compared: Sequence[Contender]) -> dict[str, Any]:
    margin, against = settings["margin"], settings["against"]
    number = isinstance(margin, numbers.Real) and not isinstance(margin, bool)
    if not (number and 0 < margin < 1):
        raise InvalidSettingError(f"margin={shown(margin)}, expected a number between 0 and 1")
    names = [one.name for one in compared]
    check_names(names)
    if against is not None and against not in names:
        raise unknown_name("model to compare with", against, names)
    return {
        "margin": float(margin),
        "against": against,
        "seed": whole_number("seed", settings["seed"], 0),
        "resamples": whole_number("resamples", settings["resamples"]),
    }


def _record(one: Contender) -> dict[str, Any]:
    predictions = []
    for prediction in one.predictions.values():
        record = prediction.to_dict()
        record["probabilities"] = {
            question: {answer: p for answer, p in shares.items() if p > 0}
            for question, shares in record["probabilities"].items()
        }
        predictions.append(record)
    fields = {field.name: getattr(one, field.name) for field in dataclasses.fields(one)}
    return {**fields, "predictions": predictions}


def _contender(record: object) -> Contender:
    given = _of_kind(dict, "a model", record)
    fields = {field.name: given[field.name] for field in dataclasses.fields(Contender)}
    for name in ("settings", "failures"):
        _of_kind(dict, f"{name} of a model", fields[name])
    predictions = [
        Prediction.from_dict(_of_kind(dict, "a prediction", one))
        for one in _of_kind(list, "predictions of a model", fields["predictions"])
    ]
    by_id = {prediction.event_id: prediction for prediction in predictions}
    return Contender(**{**fields, "predictions": by_id})


def _of_kind(kind: type[_Kind], name: str, value: object) -> _Kind:
    """Return a value of a file, which is a list or an object.

    Raises:
        InvalidEventError: it is not.
    """
    if not isinstance(value, kind):
        what = "a list" if kind is list else "an object"
        raise InvalidEventError(f"{name} is {shown(value)}, expected {what}")
    return value
