"""Several models and people on the same events: scores, differences, equivalence."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np
import pandas as pd

from phase_ppl.data.documents import check_schema, converted, naming, read_document
from phase_ppl.data.load import load_events, save_events
from phase_ppl.evaluation.bootstrap import Resampled, resampled
from phase_ppl.evaluation.cells import (
    INTERVALS,
    difference_tables,
    equivalence_tables,
    metric_tables,
    wrapped,
)
from phase_ppl.evaluation.differences import differences_of, equivalence_of
from phase_ppl.evaluation.evaluation import COMPARISON, EVENTS, SETTINGS, Evaluation, evaluation_of
from phase_ppl.evaluation.metrics import at, human_accuracy, metrics_of
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.evaluation.ratings import REHEARSAL, rehearsed
from phase_ppl.evaluation.table import PEOPLE, peoples_answers, world_of
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    check_name,
    number_or_nan,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder, write_json
from phase_ppl.world.identity import event_digest
from phase_ppl.world.picture import Printed, plain

Given: TypeAlias = Evaluation | str | os.PathLike[str]
ALL: Final = "all"  # stands for all reference models of the events
SCHEMA: Final = "phase-ppl-model-comparison-1"  # value of ``schema`` in comparison.json
MARGIN: Final = 0.1
RESAMPLES: Final = 10_000
"""Resamples for differences: with 1000 no p is below 0.002, too coarse for many pairs."""
USUAL: Final = {"margin": MARGIN, "against": None, "seed": 0, "resamples": RESAMPLES}
"""Settings of a comparison, where none are given."""

_TABLE: Final = (
    *("goal_accuracy", "goal_top3_accuracy", "relation_accuracy"),
    *("goal_log_score_truth", "relation_log_score_truth", "human.goal_r", "human.goal_log_score"),
    *("human.goal_js", "human.relation_r", "human.relation_r_given_truth", "human.log_score"),
    *("human.js", "doubt.relation_r", "doubt.relation_r_given_truth", "doubt.log_score_gap"),
    *("doubt.brier", "cpu_seconds", "seconds"),
)


LABELS: Final[Mapping[str, str]] = {
    "simple": "SIMPLE",
    "simple_as_printed": "SIMPLE as printed",
    "simple_as_intended": "SIMPLE as intended",
    "simple_authors": "authors' SIMPLE",
    "socialgnn": "SocialGNN",
    "socialgnn_original": "SocialGNN, original",
    "socialgnn_2023": "SocialGNN 2023",
    "cue_lstm_2023": "cue LSTM 2023",
    "predicate": "predicate planning",
    "predicate_as_printed": "predicates as printed",
    "vlm": "VLM",
}
"""How known models are called in figures; others by their names, with spaces."""

PEOPLE_COLOUR: Final = "#3c3c3c"
PALETTE: Final = (
    *("#0072b2", "#d55e00", "#009e73", "#9a4c8f", "#8a6d00", "#56a0d3", "#b0507a", "#7f7f7f"),
    *("#a5ad00", "#e69f00", "#a50f15", "#6fc7b2", "#5b3fa0", "#a0643c", "#2b5d34", "#ff8fab"),
)
"""Colours of models, to be told apart without seeing red and green apart."""


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """Whose answers are compared: people, or a model."""

    name: str  # as the comparison calls it, different for all
    kind: str  # "people"; "model", of an evaluation; "reference", whose answers the events carry
    # event id -> answers, of the events compared; people's probabilities are shares of ratings
    predictions: Mapping[str, Prediction]
    # of the evaluation, as in its settings.json, without the events
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    # event id -> what went wrong, of the events compared
    failures: Mapping[str, str] = dataclasses.field(default_factory=dict)
    folder: str | None = None  # of the evaluation, if it has one
    # beside others: in figures, and its metrics
    label: str = ""
    colour: str = ""
    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def label_of(name: str) -> str:
    """Return how figures call a model."""
    return LABELS.get(name, name.replace("_", " "))


def reference_label(name: str, models: Collection[str]) -> str:
    """Return how a model whose answers the events carry is called beside other models."""
    return f"{name} (stored)" if name in models or name == PEOPLE else name


@dataclasses.dataclass(frozen=True, eq=False)
class ModelComparison(Printed):
    """Comparison of several models, and people, on the same events. ``print`` shows all tables.

    Missing values are None, never a guess.

    Attributes:
        events: events that all models were asked about.
        entries: the models, in the given order.
        settings: ``margin`` of equivalence, ``against``, ``seed`` and ``resamples``.
        notes: remarks about the events.
    """

    events: Sequence[Event]
    entries: Sequence[Source]
    settings: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    @property
    def models(self) -> list[str]:
        """Names of the models."""
        return [one.name for one in self.entries]

    @functools.cached_property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """Model -> its metrics (:mod:`phase_ppl.evaluation.metrics`).

        They include ``cpu_seconds`` and ``seconds``, means per event; None: unknown. Each model's
        metrics are over the events that it predicts.
        """
        seed = self.settings["seed"]
        found = metrics_of(self.events, self._predictions, seed=seed)
        for name, predictions in self._predictions.items():
            weights = resampled(len(predictions), seed)
            for unit in ("cpu_seconds", "seconds"):
                spent = [number_or_nan(given.cost.get(unit)) for given in predictions.values()]
                mean = Resampled.mean(weights, np.array(spent)[:, None])
                found[name][unit] = mean.measure()
        return found

    @functools.cached_property
    def people(self) -> dict[str, Any]:
        """People's accuracy (:func:`~phase_ppl.evaluation.metrics.human_accuracy`)."""
        return human_accuracy(self.events)

    @functools.cached_property
    def differences(self) -> list[dict[str, Any]]:
        """Paired differences, see :func:`~phase_ppl.evaluation.differences.differences_of`.

        ``pandas.DataFrame(comparison.differences)`` is a table of them.
        """
        return differences_of(
            self.events, self._predictions, against=self.settings["against"], **self._drawn
        )

    @functools.cached_property
    def equivalence(self) -> list[dict[str, Any]]:
        """Models minus people, see :func:`~phase_ppl.evaluation.differences.equivalence_of`.

        Empty where no judged event has truth.
        """
        return equivalence_of(
            self.events, self._predictions, margin=self.settings["margin"], **self._drawn
        )

    @functools.cached_property
    def sources(self) -> list[Source]:
        """Everybody who answered, people first, with metrics; as figures and pages show them."""
        people = f"scripted {PEOPLE}" if rehearsed(self.events) else PEOPLE
        judged = peoples_answers(self.events)
        found = [
            Source(PEOPLE, PEOPLE, judged, label=people, colour=PEOPLE_COLOUR, metrics=self.people)
        ]
        labels = [label_of(name) for name in self.models]
        for one, label, colour in zip(self.entries, labels, itertools.cycle(PALETTE), strict=False):
            label = label if labels.count(label) == 1 else one.name
            metrics = self.metrics[one.name]
            found.append(dataclasses.replace(one, label=label, colour=colour, metrics=metrics))
        return [one for one in found if one.predictions]

    @property
    def table(self) -> pd.DataFrame:
        """A row per model; columns (measure, part), parts "value", "ci_low" and "ci_high"."""
        columns: dict[tuple[str, str], list[Any]] = {}
        for measure in _TABLE:
            found = [at(self.metrics[name], measure) for name in self.models]
            for part in ("value", "ci_low", "ci_high"):
                columns[measure, part] = [f and f[part] for f in found]
        return pd.DataFrame(columns, index=pd.Index(self.models, name="model"), dtype=float)

    def evidence(self) -> pd.DataFrame:
        """Return log p(video) under each model, from the posteriors that evaluations have kept.

        Returns:
            A row per event and model: ``log_evidence`` of the posterior, nats, and its Monte-Carlo
            ``error`` (NaN: unknown); the ``difference`` from the model ``against``, or from the
            first, and ``difference_error``, as of independent runs; and a ``note``, why something
            is unknown. Events without a posterior of a model are left out.

        Raises:
            InvalidSettingError: no posteriors were kept, or some are of the closed loop and some of
                simulations, whose densities are of different things.
        """
        rows, kinds = [], set()
        for one in self.entries:
            if one.folder is None:
                continue
            kept = Evaluation.load(one.folder)
            for event_id in one.predictions:
                if (post := kept.posterior(event_id)) is not None:
                    kinds.add(type(post).__name__)
                    evidence = post.log_evidence
                    rows.append((event_id, one.name, float(evidence), evidence.error, evidence.why))
        if len(kinds) != 1:
            why = "no evaluation has kept posteriors: evaluate with out=FOLDER"
            both = (
                "the closed loop's density is of positions and angles, that of kernels of positions"
            )
            raise InvalidSettingError(f"log evidence cannot be compared: {both if kinds else why}")
        found = pd.DataFrame(rows, columns=["event", "model", "log_evidence", "error", "note"])
        base = found[found["model"] == (self.settings["against"] or self.models[0])]
        base = found[["event"]].merge(base, how="left", on="event")
        same = found["model"] == base["model"]
        found["difference"] = found["log_evidence"] - base["log_evidence"]
        error = np.hypot(found["error"], base["error"])
        found["difference_error"] = error.mask(same, 0.0)
        return found.assign(note=found.pop("note"))

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
            "models": [_record(one) for one in self.entries],
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
        """Read a comparison that :meth:`save` wrote; all numbers follow from its answers.

        Raises:
            InvalidEventError: there is no such folder, or a file in it is damaged.
        """
        path = Path(folder)
        if not (path / COMPARISON).is_file():
            raise InvalidEventError(f"{path} holds no comparison: it has no {COMPARISON}")
        events, read = load_events(path / EVENTS), []
        with naming(path / COMPARISON):
            record = read_document(path / COMPARISON)
            check_schema(record, SCHEMA)
            kept, world = converted(record, _Kept), world_of(events)
            for one in kept.models:
                made = [Prediction.from_dict(given, world) for given in one.predictions]
                by_id = {given.event_id: given for given in made}
                read.append(Source(**{**msgspec.structs.asdict(one), "predictions": by_id}))
            settings = _checked({**USUAL, **kept.settings}, read)
        return cls(events, read, settings, tuple(kept.notes))

    def __str__(self) -> str:
        models, events, judged = len(self.models), len(self.events), self.people["n_events"]
        head = f"{models} model{'s' * (models > 1)} on {events} event{'s' * (events > 1)}"
        if judged:
            head += f", {judged} of them with truth and people's judgments"
        lines = wrapped(f"{head}; {INTERVALS}")
        for note in self.notes:
            lines += wrapped(f"note: {note}")
        tables = [*metric_tables(self), *difference_tables(self)]
        for table in [*tables, *equivalence_tables(self)]:
            lines += table.lines()
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<ModelComparison of {', '.join(self.models)} on {len(self.events)} events>"

    @property
    def _predictions(self) -> dict[str, Mapping[str, Prediction]]:
        return {one.name: one.predictions for one in self.entries}

    @property
    def _drawn(self) -> dict[str, int]:
        return {"seed": self.settings["seed"], "resamples": self.settings["resamples"]}


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
        sources: evaluations, or folders of evaluations; a folder with several in it stands for
            all of them. Names may be given, ``{"fast": ..., "paper": ...}``. The default name is
            the model's, or the folder's if several are of the same model.
        stored: names of reference models, whose answers the events carry, to compare too; or "all".
        against: name of the model that the others are compared with; by default every pair is
            compared.
        common: compare on the events that all evaluations share; otherwise they must be about
            the same ones.
        margin: largest difference of shares of right answers that counts as equivalence of a model
            and people.
        seed, resamples: of the events, for differences and equivalence; metrics have the 1000
            resamples of the paper.

    Raises:
        InvalidEventError: a folder holds no evaluation, or a damaged one; or the evaluations
            are about different events, the message says which.
        InvalidSettingError: a source is no evaluation; there are none; two would have the same
            name, or one the name of people; the events are of several worlds; or a number is out
            of range.
        UnknownNameError: there is no model of that name to compare with, or stored.
    """
    found = evaluations(sources)
    if not found:
        raise InvalidSettingError("there are no evaluations to compare")
    events, notes = shared_events(found, common)
    compared = entries(found, events, stored)
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


def _checked(settings: Mapping[str, Any], compared: Sequence[Source]) -> dict[str, Any]:
    margin, against = settings["margin"], settings["against"]
    if not 0 < number_or_nan(margin) < 1:
        raise InvalidSettingError(f"margin={shown(margin)}, expected a number between 0 and 1")
    names = [one.name for one in compared]
    check_names(names)
    if against is not None:
        check_name("model to compare with", against, names)
    return {
        "margin": float(margin),
        "against": against,
        "seed": whole_number("seed", settings["seed"], 0),
        "resamples": whole_number("resamples", settings["resamples"]),
    }


class _Model(msgspec.Struct):
    """What comparison.json has of a model."""

    name: str
    kind: str
    predictions: list[dict[str, Any]]
    settings: dict[str, Any]
    failures: dict[str, str]
    folder: str | None


class _Kept(msgspec.Struct):
    """What is read of comparison.json; all numbers in it follow."""

    settings: dict[str, Any]
    models: list[_Model]
    notes: list[str]


def _record(one: Source) -> dict[str, Any]:
    fields = {name: getattr(one, name) for name in _Model.__struct_fields__}
    return {**fields, "predictions": [given.to_dict() for given in one.predictions.values()]}


# --- who is compared ------------------------------------------------------------------------------


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


def check_names(names: Sequence[object]) -> None:
    """Raise InvalidSettingError unless names are different texts, other than people's name."""
    for place, name in enumerate(names):
        if not (isinstance(name, str) and name.strip()):
            raise InvalidSettingError(f"a model is called {shown(name)}, expected a name")
        if name == PEOPLE:
            raise InvalidSettingError(f"a model is called {name!r}, as people are: name it, as in "
                                      "{'mine': ...} or mine=DIR")  # fmt: skip
        if name in names[:place]:
            raise InvalidSettingError(
                f"two models are called {name!r}: name them, as in {{'one': ...}} or one=DIR"
            )


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
