"""Several models and people on the same events: scores, differences, equivalence."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from phase_ppl.data.documents import check_schema, of_kind, read_json
from phase_ppl.data.load import load_events, save_events
from phase_ppl.evaluation.bootstrap import resampled
from phase_ppl.evaluation.cells import (
    INTERVALS,
    KIND_WORDS,
    NOTHING,
    Table,
    measure_text,
    metric_tables,
    p_text,
    wrapped,
)
from phase_ppl.evaluation.differences import LEAST_EVENTS, differences_of, equivalence_of
from phase_ppl.evaluation.evaluation import COMPARISON, EVENTS, SETTINGS, Evaluation, evaluation_of
from phase_ppl.evaluation.metrics import Scores, at, human_accuracy, mean_measure
from phase_ppl.evaluation.prediction import Prediction, reference_predictions
from phase_ppl.evaluation.ratings import REHEARSAL, rehearsed
from phase_ppl.evaluation.table import (
    PEOPLE,
    AnswerSet,
    answer_sets,
    parts_of,
    reference_label,
    world_of,
)
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    PhasePPLError,
    check_name,
    number_or_nan,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder, write_json
from phase_ppl.world.identity import event_digest
from phase_ppl.world.picture import Printed, plain
from phase_ppl.world.scene import World

Source: TypeAlias = Evaluation | str | os.PathLike[str]
ALL: Final = "all"  # stands for all reference models of the events
SCHEMA: Final = "phase-ppl-model-comparison-1"  # value of ``schema`` in comparison.json
MARGIN: Final = 0.1
RESAMPLES: Final = 10_000
"""Resamples for differences: with 1000 no p is below 0.002, too coarse for many pairs."""

_TABLE: Final = (
    *("goal_accuracy", "goal_top3_accuracy", "relation_accuracy"),
    *("goal_log_score_truth", "relation_log_score_truth", "human.goal_r", "human.goal_log_score"),
    *("human.goal_js", "human.relation_r", "human.relation_r_given_truth", "human.log_score"),
    *("human.js", "doubt.relation_r", "doubt.relation_r_given_truth", "doubt.log_score_gap"),
    *("doubt.brier", "cpu_seconds", "seconds"),
)


@dataclasses.dataclass(frozen=True, eq=False)
class Entry:
    """One of the compared models."""

    name: str  # as the comparison calls it, different for all
    kind: str  # "model", of an evaluation; or "reference", whose answers the events carry
    predictions: Mapping[str, Prediction]  # event id -> answers, of the events compared
    # of the evaluation, as in its settings.json, without the events
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    # event id -> what went wrong, of the events compared
    failures: Mapping[str, str] = dataclasses.field(default_factory=dict)
    folder: str | None = None  # of the evaluation, if it has one


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
    entries: Sequence[Entry]
    settings: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    @functools.cached_property
    def world(self) -> World:
        """The world of all events."""
        return world_of(self.events)

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
        scores = Scores(self.events, seed=seed)
        found: dict[str, dict[str, Any]] = {}
        for one in self.entries:
            weights = resampled(len(one.predictions), seed)
            costs = [prediction.cost for prediction in one.predictions.values()]
            found[one.name] = scores.metrics(one.predictions)
            for name in ("cpu_seconds", "seconds"):
                spent = np.array([number_or_nan(cost.get(name)) for cost in costs])
                found[one.name][name] = mean_measure(weights, spent[:, None]).measure()
        return found

    @functools.cached_property
    def people(self) -> dict[str, Any]:
        """People's accuracy (:func:`~phase_ppl.evaluation.metrics.human_accuracy`)."""
        return human_accuracy(self.events, seed=self.settings["seed"])

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
    def answers(self) -> list[AnswerSet]:
        """All answers, of people first, as figures and pages show them."""
        references = [one.name for one in self.entries if one.kind != "model"]
        return answer_sets(self.events, self._predictions, references)

    @functools.cached_property
    def measured(self) -> list[AnswerSet]:
        """All answers, of people first, with metrics."""
        metrics = {**self.metrics, PEOPLE: self.people}
        return [dataclasses.replace(one, metrics=metrics[one.name]) for one in self.answers]

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
        record = read_json(path / COMPARISON)
        events = load_events(path / EVENTS)
        try:
            check_schema(record, SCHEMA)
            world = world_of(events)
            read = [_entry(one, world) for one in of_kind("models", record["models"], list)]
            ids = {event.id for event in events}
            for one in read:
                unknown = [name for name in one.predictions if name not in ids]
                if unknown:
                    raise InvalidEventError(
                        f"{one.name} predicts {shown(unknown[0])}, which is no event of {EVENTS}"
                    )
            settings = of_kind("settings", record["settings"], dict)
            notes = tuple(map(str, of_kind("notes", record["notes"], list)))
            return cls(events, read, _checked(settings, read), notes)
        except (PhasePPLError, KeyError) as error:
            reason = f"it has no {error}" if isinstance(error, KeyError) else str(error)
            raise InvalidEventError(f"{path / COMPARISON}: {reason}") from None

    def __str__(self) -> str:
        return _text(self)

    def __repr__(self) -> str:
        return f"<ModelComparison of {', '.join(self.models)} on {len(self.events)} events>"

    @property
    def _predictions(self) -> dict[str, Mapping[str, Prediction]]:
        return {one.name: one.predictions for one in self.entries}

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


def _checked(settings: Mapping[str, Any], compared: Sequence[Entry]) -> dict[str, Any]:
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


def _record(one: Entry) -> dict[str, Any]:
    fields = {field.name: getattr(one, field.name) for field in dataclasses.fields(one)}
    return {**fields, "predictions": [given.to_dict() for given in one.predictions.values()]}


def _entry(record: object, world: World) -> Entry:
    given = of_kind("a model", record, dict)
    fields = {field.name: given[field.name] for field in dataclasses.fields(Entry)}
    for name in ("settings", "failures"):
        of_kind(f"{name} of a model", fields[name], dict)
    predictions = [
        Prediction.from_dict(of_kind("a prediction", one, dict), world)
        for one in of_kind("predictions of a model", fields["predictions"], list)
    ]
    by_id = {prediction.event_id: prediction for prediction in predictions}
    return Entry(**{**fields, "predictions": by_id})


# --- who is compared ------------------------------------------------------------------------------


def evaluations(sources: Source | Sequence[Source] | Mapping[str, Source]) -> dict[str, Evaluation]:
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
    named: dict[str, Evaluation] = {}
    for given, evaluation in found:
        name = given or evaluation.name
        folder = evaluation.folder
        if not given and models.count(name) > 1 and folder is not None:
            name = folder.path.resolve().name
        if name in named:
            raise InvalidSettingError(
                f"two of the evaluations would be called {name!r}: name them, as in "
                f"{{'one': ..., 'other': ...}} or one=DIR other=DIR"
            )
        named[name] = evaluation
    return named


def check_names(names: Sequence[object]) -> None:
    """Raise InvalidSettingError unless names are different texts, other than people's name."""
    for place, name in enumerate(names):
        if not (isinstance(name, str) and name.strip()):
            raise InvalidSettingError(f"a model is called {shown(name)}, expected a name")
        if name == PEOPLE:
            raise InvalidSettingError(f"a model is called {name!r}, as people are: name it, as in "
                                      "{'mine': ...} or mine=DIR")  # fmt: skip
        if name in names[:place]:
            raise InvalidSettingError(f"two models are called {name!r}: expected different names")


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
        if not common and digests[name] != digests[first]:
            raise InvalidEventError(
                f"{first} and {name} were asked about different events: "
                f"{_differences(first, digests[first], name, digests[name])}; common=True "
                "(--common) compares them on the events that all share"
            )
        same = digests[first].items() & digests[name].items()
        chosen = {i: event for i, event in chosen.items() if (i, digests[first][i]) in same}
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


def _differences(first: str, mine: Mapping[str, str], name: str, theirs: Mapping[str, str]) -> str:
    groups = {
        f"only in {first}": [i for i in mine if i not in theirs],
        f"only in {name}": [i for i in theirs if i not in mine],
        "not the same in scene or observation": [
            i for i in mine if theirs.get(i, mine[i]) != mine[i]
        ],
    }
    return ", ".join(
        f"{len(ids)} {what} (such as {ids[0]!r})" for what, ids in groups.items() if ids
    )


def entries(
    found: Mapping[str, Evaluation], events: Sequence[Event], stored: str | Sequence[str] = ()
) -> list[Entry]:
    """Return the compared models with their answers about the events."""
    ids = [event.id for event in events]
    made = [
        Entry(
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
        made.append(Entry(reference_label(name, found), "reference", references[name]))
    return made


def chosen_references(stored: str | Sequence[str], references: Iterable[str]) -> list[str]:
    """Return the names of the chosen reference models."""
    known = list(references)
    if isinstance(stored, str):
        stored = known if stored == ALL else [stored]
    if not isinstance(stored, Iterable):
        raise InvalidSettingError(f"stored={shown(stored)}, expected names of models, or {ALL!r}")
    for name in stored:
        check_name("stored model", name, known)
    return list(dict.fromkeys(stored))


# --- printed --------------------------------------------------------------------------------------

PAIRS: Final = 15  # most pairs of models that are printed; beyond, only those with the first model

_DIFFERENCES: Final = {
    "right answers": "accuracy",
    "the log probability of the true answer, nats": "log_score_truth",
}


def _text(c: ModelComparison) -> str:
    """Return all tables of a comparison."""
    models, judged = len(c.models), c.people["n_events"]
    head = f"{models} model{'s' * (models > 1)} on {len(c.events)} event{'s' * (len(c.events) > 1)}"
    if judged:
        head += f", {judged} of them with truth and people's judgments"
    lines = wrapped(f"{head}; {INTERVALS}")
    for note in c.notes:
        lines += wrapped(f"note: {note}")
    tables = [*metric_tables(list(c.metrics.items()), c.people), *difference_tables(c)]
    for table in [*tables, *equivalence_tables(c)]:
        lines += table.lines()
    return "\n".join(lines)


def difference_tables(c: ModelComparison) -> list[Table]:
    """Return the tables of paired differences: in right answers, in log probabilities.

    With more than :data:`PAIRS` pairs only those with the first model are shown.
    """
    found = {(r["one"], r["other"], r["measure"]): r for r in c.differences if not r["scenario"]}
    tables, note = [], "p: bootstrap, corrected by Holm over the pairs"
    for title, measure in _DIFFERENCES.items():
        measures = [f"{kind}_{measure}" for kind in KIND_WORDS]
        pairs = list(dict.fromkeys((one, other) for one, other, m in found if m in measures))
        if len(pairs) > PAIRS and c.settings["against"] is None:
            pairs = [pair for pair in pairs if c.models[0] in pair]
            note = "p: bootstrap, corrected by Holm over all pairs; more pairs are in .differences"
        if pairs:
            columns = {}
            for name, word in zip(measures, KIND_WORDS.values(), strict=True):
                rows = [found.get((*pair, name)) for pair in pairs]
                columns[word, ""] = [measure_text(r, signed=True) for r in rows]
                columns[word, "p"] = [p_text(r["p_holm"] if r else None) for r in rows]
            index = pd.MultiIndex.from_tuples(pairs, names=("one", "other"))
            cells = pd.DataFrame(columns, index)
            cells.columns = [part or word for word, part in columns]
            tables.append(Table(f"paired differences in {title}", cells))
    return [*tables[:-1], *(table._replace(note=note) for table in tables[-1:])]


def equivalence_tables(c: ModelComparison) -> list[Table]:
    """Return the table of equivalence with people, if there is one."""
    rows = [row for row in c.equivalence if row["scenario"] is None]
    if not rows:
        return []
    margin = c.settings["margin"]
    cells = pd.DataFrame(
        {
            "": [KIND_WORDS[row["measure"].removesuffix("_accuracy")] for row in rows],
            "value": [f"{row['value']:+.2f}" for row in rows],
            "90 %": [
                NOTHING if row["low"] is None else f"[{row['low']:+.2f}, {row['high']:+.2f}]"
                for row in rows
            ],
            "p equiv.": [p_text(row["p_equivalent_holm"]) for row in rows],
            "p differ": [p_text(row["p_holm"]) for row in rows],
            "verdict": [row["verdict"] for row in rows],
        },
        pd.Index([row["model"] for row in rows], name="model minus people"),
    )
    groups = {group for kind in KIND_WORDS for group, _ in parts_of(c.world, kind)}
    parts = " and ".join(sorted(group.removeprefix("by_") for group in groups))
    note = (
        f"Tested is a model's being right minus the share of people who are right, event by event. "
        f"Equivalent: both one-sided tests reject a difference of {margin:g} or more (p equiv.); "
        "higher, lower: there is one (p differ). Both corrected by Holm over the models; neither "
        f"shown: undecided. Fewer than {LEAST_EVENTS} events are not tested for equivalence. "
        f"comparison.json has differences and equivalence by {parts} too."
    )
    return [Table(f"equivalence with people, margin {margin:g}", cells, note)]
