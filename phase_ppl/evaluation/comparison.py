"""Several models and people on the same events: scores, differences, equivalence."""

from __future__ import annotations

import dataclasses
import functools
import numbers
import os
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.summary import plain
from phase_ppl.dataset.documents import check_schema, of_kind, read_json
from phase_ppl.dataset.load import load_events, save_events
from phase_ppl.evaluation import differences
from phase_ppl.evaluation.answer_sets import PEOPLE, AnswerSet, colours_of, label_of, people_answers
from phase_ppl.evaluation.bootstrap import LEVEL, Figure, figure, resampled, weighted_mean
from phase_ppl.evaluation.cells import NOTHING, aligned, figure_text, fitting, p_text, short
from phase_ppl.evaluation.differences import LEAST_EVENTS
from phase_ppl.evaluation.entries import (
    Entry,
    Source,
    check_names,
    entries,
    evaluations,
    shared_events,
)
from phase_ppl.evaluation.folder import COMPARISON, EVENTS
from phase_ppl.evaluation.metrics import Path as MetricPath
from phase_ppl.evaluation.metrics import at, events_with, human_accuracy, metrics_of_each
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.tables import world_of
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
from phase_ppl.world.hypothesis import SCENARIOS
from phase_ppl.world.picture import preformatted
from phase_ppl.world.scene import PHASE, World, check_phase

if TYPE_CHECKING:
    import pandas as pd

SCHEMA: Final = "phase-ppl-model-comparison-1"  # value of ``schema`` in comparison.json
MARGIN: Final = 0.1
RESAMPLES: Final = 10_000
"""Resamples for differences: with 1000 no p is below 0.002, which many pairs make useless."""

_COSTS: Final = ("cpu_seconds", "seconds")

_TABLE: Final = (
    *("goal_accuracy", "goal_top3_accuracy", "relation_accuracy"),
    *("goal_log_score_truth", "relation_log_score_truth", "human.goal_r", "human.goal_log_score"),
    *("human.goal_js", "human.relation_r", "human.relation_r_given_truth", "human.log_score"),
    *("human.js", "doubt.relation_r", "doubt.relation_r_given_truth", "doubt.log_score_gap"),
    *("doubt.brier", *_COSTS),
)


@dataclasses.dataclass(frozen=True, eq=False)
class ModelComparison:
    """Several models, and people, on the same events. ``print`` shows all tables.

    What a model or the events do not give is None, never a guess.

    Attributes:
        events: that all models were asked about.
        entries: the models, in the order in which they were given.
        settings: ``margin`` of equivalence, ``against``, ``seed`` and ``resamples``.
        notes: what is to be known about the events.
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

        They come with ``cpu_seconds`` and ``seconds``, the means per event. Each is about the
        events of which the model has a prediction.
        """
        seed = self.settings["seed"]
        found = metrics_of_each(
            self.events, {one.name: one.predictions for one in self.entries}, seed=seed
        )
        return {one.name: {**found[one.name], **_costs(one, seed)} for one in self.entries}

    @functools.cached_property
    def people(self) -> dict[str, Any]:
        """What people got right (:func:`~phase_ppl.evaluation.metrics.human_accuracy`).

        Empty in another world than PHASE, of which no judgments are read.
        """
        known = self.world == PHASE
        return human_accuracy(self.events, seed=self.settings["seed"]) if known else {}

    @functools.cached_property
    def differences(self) -> list[dict[str, Any]]:
        """Paired differences, see :func:`~phase_ppl.evaluation.differences.differences`.

        ``pandas.DataFrame(comparison.differences)`` is a table of them.
        """
        return differences.differences(
            self.events, self.entries, against=self.settings["against"], **self._drawn
        )

    @functools.cached_property
    def equivalence(self) -> list[dict[str, Any]]:
        """Models minus people, see :func:`~phase_ppl.evaluation.differences.equivalence`.

        Empty where no judged event has truth.
        """
        if not self.people:
            return []
        return differences.equivalence(
            self.events, self.entries, margin=self.settings["margin"], **self._drawn
        )

    @functools.cached_property
    def answers(self) -> list[AnswerSet]:
        """All answers, of people first, as figures and pages show them: those of PHASE."""
        check_phase(self.events[0].scene, "a figure or page of models")
        labels = [label_of(name) for name in self.models]
        found = [people_answers(self.events)]
        for one, label, colour in zip(self.entries, labels, colours_of(self.models), strict=True):
            unlike = label if labels.count(label) == 1 else one.name
            kind = "model" if one.kind == "model" else "reference"
            found.append(AnswerSet(one.name, kind, unlike, colour, one.predictions))
        return [answers for answers in found if answers.predictions]

    @functools.cached_property
    def measured(self) -> list[AnswerSet]:
        """The same with metrics."""
        metrics = {**self.metrics, PEOPLE: self.people}
        return [dataclasses.replace(one, metrics=metrics[one.name]) for one in self.answers]

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

    def _repr_html_(self) -> str:
        return preformatted(self)

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
            name, or one that of people; the events are of several worlds; or a number is out of
            range.
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


def _record(one: Entry) -> dict[str, Any]:
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


def _costs(one: Entry, seed: int) -> dict[str, Figure | None]:
    """Return the mean ``cpu_seconds`` and ``seconds`` per event; None where they are not known."""
    found: dict[str, Figure | None] = {}
    weights = resampled(len(one.predictions), seed)
    for name in _COSTS:
        given = [prediction.cost.get(name) for prediction in one.predictions.values()]
        numbers = [value if isinstance(value, int | float) else np.nan for value in given]
        values = np.array(numbers, np.float64).reshape(-1, 1)
        found[name] = figure(weighted_mean(weights, values), events_with(values))
    return found


# --- printed --------------------------------------------------------------------------------------

WIDTH: Final = 100
PAIRS: Final = 15
"""Pairs of models that are printed at most; of more, those with the first model."""

MAJORITY: Final = "people, majority"

_LABEL: Final = 24
_NAME: Final = 19
_EVENTS: Final = "n_events"
_KINDS: Final = {"goal": ("goals", "goal_"), "relation": ("relations", "")}
"""Kind of question -> its word, and what the names of its figures about people begin with."""

_DIFFERENCES: Final = {
    "right answers": "accuracy",
    "the log probability of the true answer, nats": "log_score_truth",
}

_Row = tuple[str, Mapping[str, Any]]
_Columns = Mapping[str, str | MetricPath]  # heading -> place in the metrics


def _text(c: ModelComparison) -> str:
    """Return all tables of a comparison."""
    n, judged = len(c.events), c.people.get("n_events", 0)
    head = f"{_number(len(c.models), 'model')} on {_number(n, 'event')}"
    if judged:
        head += f", {judged} of them with truth and people's judgments"
    lines = _wrapped(
        f"{head}; intervals of {LEVEL:.0%}: of right answers Clopper-Pearson, of the rest from "
        "resampled events"
    )
    for note in c.notes:
        lines += _wrapped(f"note: {note}")
    for title, columns, rows in _tables(c):
        lines += _table(title, columns, rows)
    return "\n".join([*lines, *_differences(c), *_equivalence(c)])


def _tables(c: ModelComparison) -> Iterator[tuple[str, _Columns, list[_Row]]]:
    """Yield title, columns and rows of the tables of metrics."""
    models: list[_Row] = [(name, c.metrics[name]) for name in c.models]
    right: list[_Row] = [*models]
    if c.people:
        right += [(PEOPLE, c.people), (MAJORITY, c.people["majority"])]
    yield (
        "right answers" + (" (people: share of people who are right)" if c.people else ""),
        {
            "goals": "goal_accuracy",
            "goal in top 3": "goal_top3_accuracy",
            "relations": "relation_accuracy",
            "events": _EVENTS,
            "CPU s/event": "cpu_seconds",
        },
        right,
    )
    for kind, (word, _) in _KINDS.items():
        title, places = _by_part(c, kind)
        columns = {name: (*place, f"{kind}_accuracy") for name, place in places.items()}
        yield f"{word} right, {title}", columns, right
    yield (
        "mean log probability of the true answer, nats",
        {word: f"{kind}_log_score_truth" for kind, (word, _) in _KINDS.items()},
        models,
    )
    if not c.people:
        return
    among: _Row = (PEOPLE, _among_people(models))
    for kind, (word, prefix) in _KINDS.items():
        yield (
            f"agreement with people on {word} (people: r of halves; bound of the log score)",
            {
                "r": f"human.{kind}_r",
                **({"r given truth": "human.relation_r_given_truth"} if not prefix else {}),
                "log score": f"human.{prefix}log_score",
                "JS divergence": f"human.{prefix}js",
            },
            [*models, among],
        )
    yield (
        "doubt about relations (intervals over events and raters; people: r of one with the rest)",
        {
            "r": "doubt.relation_r",
            "r given truth": "doubt.relation_r_given_truth",
            "log score gap": "doubt.log_score_gap",
            "Brier": "doubt.brier",
            "ECE": "doubt.ece",
        },
        [*models, (PEOPLE, _one_out(models))],
    )


def _by_part(c: ModelComparison, kind: str) -> tuple[str, dict[str, MetricPath]]:
    """Return by what answers are told apart, and heading -> its place in the metrics.

    In PHASE by scenario; elsewhere goals by agent, relations by pair.
    """
    metrics = [c.metrics[name] for name in c.models]
    if not c.people:
        parts = "by_agent" if kind == "goal" else "by_pair"
        return parts.replace("_", " "), {name: (parts, name) for name in metrics[0].get(parts, {})}
    counts = {name: max(m["by_scenario"][name]["n"] for m in metrics) for name in SCENARIOS}
    places: dict[str, MetricPath] = {
        f"{name} ({n})": ("by_scenario", name) for name, n in counts.items() if n
    }
    return "by true scenario (events)", places


def _one_out(models: Sequence[_Row]) -> dict[str, Any]:
    """Return how well raters predict one of them, in the places of models with people."""
    known = [m["doubt"]["ceiling"] for _, m in models if m["doubt"] and m["doubt"]["ceiling"]]
    names = ("r", "r_given_truth") if known else ()
    return {"doubt": {f"relation_{name}": known[0][f"one_out_{name}"] for name in names}}


def _among_people(models: Sequence[_Row]) -> dict[str, Any]:
    """Return people's agreement with each other, in the places of models' with people.

    It is about the same events as a model's; of those that have it, the one with most events.
    """
    by_events = sorted((m for _, m in models), key=lambda metrics: -metrics["n_events"])
    found = {}
    for kind, (_, prefix) in _KINDS.items():
        places = (f"{kind}_r", "split_half_r"), (f"{prefix}log_score", "log_score_people")
        for place, name in places:
            of_people = (m["human"][f"{prefix}{name}"] for m in by_events)
            found[place] = next(filter(None, of_people), None)
    return {"human": found}


def _table(title: str, columns: _Columns, rows: Sequence[_Row]) -> list[str]:
    """Return a table without rows and columns that have nothing to say."""
    kept = [
        (short(name, _LABEL - 2), [_cell(metrics, place) for place in columns.values()])
        for name, metrics in rows
        if any(_cell(metrics, place) != NOTHING for place in columns.values() if place != _EVENTS)
    ]
    if not kept:
        return []
    headings = list(columns)
    used = [j for j in range(len(columns)) if any(row[j] != NOTHING for _, row in kept)]
    widths = {j: max(len(headings[j]), *(len(row[j]) for _, row in kept)) + 2 for j in used}
    lines = ["", title]
    for block in fitting(widths, WIDTH - max(len(name) for name, _ in kept)):
        table = [["", *(headings[j] for j in block)]]
        table += [
            [name, *(row[j] for j in block)]
            for name, row in kept
            if any(row[j] != NOTHING for j in block)
        ]
        lines += aligned(table)
    return lines


def _cell(metrics: Mapping[str, Any], place: str | MetricPath) -> str:
    """Return what a table shows of a place in the metrics."""
    found = at(metrics, tuple(place.split(".")) if isinstance(place, str) else place)
    if place == "cpu_seconds" and found is not None:
        value = found["value"]
        return f"{value:.3f}" if value < 1 else f"{value:.1f}" if value < 100 else f"{value:.0f}"
    if isinstance(found, float):
        return f"{found:.2f}"
    return str(found) if isinstance(found, int) else figure_text(found)


def _differences(c: ModelComparison) -> list[str]:
    """Return the tables of paired differences: in right answers, in log probabilities."""
    rows = [r for r in c.differences if r["scenario"] is None]
    found = {(r["one"], r["other"], r["measure"]): r for r in rows}
    lines, left_out = [], 0
    for title, measure in _DIFFERENCES.items():
        measures = [f"{kind}_{measure}" for kind in _KINDS]
        pairs = list(dict.fromkeys((one, other) for one, other, m in found if m in measures))
        if not pairs:
            continue
        if len(pairs) > PAIRS and c.settings["against"] is None:
            shown = [pair for pair in pairs if c.models[0] in pair]
            pairs, left_out = shown, max(left_out, len(pairs) - len(shown))
        table = [
            ["one minus other", *(cell for word, _ in _KINDS.values() for cell in (word, "p"))]
        ]
        for one, other in pairs:
            cells = [f"{short(one, _NAME)} - {short(other, _NAME)}"]
            for name in measures:
                row = found.get((one, other, name))
                cells += [
                    figure_text(row, signed=True),
                    p_text(None if row is None else row["p_holm"]),
                ]
            table.append(cells)
        lines += ["", f"paired differences in {title}", *aligned(table)]
    if lines:
        lines += _wrapped("p: bootstrap, corrected by Holm over the pairs")
    if left_out:
        lines += _wrapped(
            f"{left_out} more pairs, all corrected together, are in comparison.json; --against "
            "NAME compares with one model alone"
        )
    return lines


def _equivalence(c: ModelComparison) -> list[str]:
    rows = [row for row in c.equivalence if row["scenario"] is None]
    if not rows:
        return []
    margin = c.settings["margin"]
    table = [["model minus people", "", "value", "90 %", "p equiv.", "p differ", "verdict"]]
    for row in rows:
        word, _ = _KINDS[row["measure"].removesuffix("_accuracy")]
        between = NOTHING if row["low"] is None else f"[{row['low']:+.2f}, {row['high']:+.2f}]"
        tests = [p_text(row[p]) for p in ("p_equivalent_holm", "p_holm")]
        model = short(row["model"], _LABEL)
        table.append([model, word, f"{row['value']:+.2f}", between, *tests, row["verdict"]])
    words = (
        f"Tested is a model's being right minus the share of people who are right, event by event. "
        f"Equivalent: both one-sided tests reject a difference of {margin:g} or more (p equiv.); "
        "higher, lower: there is one (p differ). Both corrected by Holm over the models; neither "
        f"shown: undecided. Fewer than {LEAST_EVENTS} events are not tested for equivalence. "
        "comparison.json has differences and equivalence by scenario too."
    )
    title = f"equivalence with people, margin {margin:g}"
    return ["", title, *aligned(table), *_wrapped(words)]


def _number(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ")
