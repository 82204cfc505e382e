"""Several models and people on the same events: scores, differences, equivalence."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pandas as pd
from scipy.special import ndtr

from phase_ppl.data.documents import check_schema, converted, naming, read_document
from phase_ppl.data.load import load_events, save_events
from phase_ppl.evaluation.bootstrap import (
    LEAST_EVENTS,
    LEVEL,
    Resampled,
    difference,
    events_with,
    interval,
    resampled,
    weighted_mean,
    with_two,
)
from phase_ppl.evaluation.cells import (
    INTERVALS,
    Table,
    difference_tables,
    equivalence_tables,
    metric_tables,
    wrapped,
)
from phase_ppl.evaluation.folder import COMPARISON, EVENTS, ResultsFolder
from phase_ppl.evaluation.metrics import at, human_accuracy, measures_of, metrics_of
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.ratings import rehearsed
from phase_ppl.evaluation.table import (
    PEOPLE,
    Answers,
    Place,
    kinds_of,
    peoples_answers,
    predicted,
    true_scenario,
    world_of,
)
from phase_ppl.world.arrays import FloatArray
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
from phase_ppl.world.picture import Printed, plain

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
        entries: the models with their answers, in the given order.
        settings: the arguments ``margin``, ``against``, ``seed`` and ``resamples`` of
            :func:`phase_ppl.compare_models`.
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
        """Model -> its metrics over the events that it predicts.

        :mod:`phase_ppl.evaluation.metrics` lists them. ``cpu_seconds`` and ``seconds`` are added,
        means per event; None: unknown.
        """
        seed = self.settings["seed"]
        found = metrics_of(self.events, self._predictions, seed)
        for name, predictions in self._predictions.items():
            weights = resampled(len(predictions), seed)
            for unit in ("cpu_seconds", "seconds"):
                spent = [number_or_nan(given.cost.get(unit)) for given in predictions.values()]
                mean = Resampled.mean(weights, np.array(spent)[:, None])
                found[name][unit] = mean.measure()
        return found

    @functools.cached_property
    def people(self) -> dict[str, Any]:
        """People's accuracy (:func:`phase_ppl.human_accuracy`)."""
        return human_accuracy(self.events)

    @functools.cached_property
    def differences(self) -> list[dict[str, Any]]:
        """Differences between the scores of two models on the events that both predict.

        It is a list of rows, for ``pandas.DataFrame``;
        :func:`~phase_ppl.evaluation.comparison.differences_of` describes their keys.
        """
        return differences_of(
            self.events, self._predictions, against=self.settings["against"], **self._drawn
        )

    @functools.cached_property
    def equivalence(self) -> list[dict[str, Any]]:
        """Differences between models' accuracy and people's, with a test of equivalence.

        It is a list of rows; :func:`~phase_ppl.evaluation.comparison.equivalence_of` describes
        their keys. It is empty if no judged event has truth.
        """
        return equivalence_of(
            self.events, self._predictions, margin=self.settings["margin"], **self._drawn
        )

    @functools.cached_property
    def sources(self) -> list[Source]:
        """Everybody who answered, people first, with metrics and figures' labels and colours."""
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
    def tables(self) -> dict[str, list[Table]]:
        """Heading -> its tables of text, as ``print`` and a report's page show them."""
        margin, against = self.settings["margin"], self.settings["against"]
        first = None if against else self.models[0]
        return {
            "Summary": list(metric_tables(self.metrics, self.people)),
            "Differences": difference_tables(self.differences, first),
            "Equivalence with people": equivalence_tables(self.equivalence, margin),
        }

    @property
    def table(self) -> pd.DataFrame:
        """A row per model; columns (measure, part), parts "value", "ci_low", "ci_high" (95 %).

        A measure is a key of :attr:`metrics`, or a path of keys, such as "human.goal_r".
        """
        columns: dict[tuple[str, str], list[Any]] = {}
        for measure in _TABLE:
            found = [at(self.metrics[name], measure) for name in self.models]
            for part in ("value", "ci_low", "ci_high"):
                columns[measure, part] = [f and f[part] for f in found]
        return pd.DataFrame(columns, index=pd.Index(self.models, name="model"), dtype=float)

    def evidence(self) -> pd.DataFrame:
        """Return log p(video) under each model, from the posteriors that the evaluations kept.

        Returns:
            A row per event and model: ``log_evidence`` of the posterior, nats, and its Monte-Carlo
            ``error`` (NaN: unknown); the ``difference`` from the model ``against``, or from the
            first model, and ``difference_error``, as for independent runs; and a ``note``, why
            something is unknown. Rows without a posterior are left out.

        Raises:
            InvalidSettingError: no posteriors were kept; or some are of the closed loop and some of
                kernels, whose densities are of different things.
        """
        rows, kinds = [], set()
        for one in self.entries:
            if one.folder is None:
                continue
            kept = ResultsFolder.open(one.folder)
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
        """Write everything into a folder, as comparison.json and events.json; return the folder.

        Raises:
            OutputError: the folder or a file cannot be written.
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
        """Read a comparison that :meth:`save` wrote; numbers are computed anew from its answers.

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
            settings = checked({**USUAL, **kept.settings}, read)
        return cls(events, read, settings, tuple(kept.notes))

    def __str__(self) -> str:
        models, events, judged = len(self.models), len(self.events), self.people["n_events"]
        head = f"{models} model{'s' * (models > 1)} on {events} event{'s' * (events > 1)}"
        if judged:
            head += f", {judged} of them with truth and people's judgments"
        lines = wrapped(f"{head}; {INTERVALS}")
        for note in self.notes:
            lines += wrapped(f"note: {note}")
        for tables in self.tables.values():
            for table in tables:
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


def checked(settings: Mapping[str, Any], compared: Sequence[Source]) -> dict[str, Any]:
    """Return the settings of a comparison; errors as of :func:`phase_ppl.compare_models`."""
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


# --- differences between models, and equivalence with people: on resampled events -----------------
# Both generalise to other events like these, not to other people or other runs of the models.

Row = dict[str, Any]
ALPHA: Final = 1 - LEVEL  # significance level of the corrected p of differences and equivalences

_ROUNDING: Final = 1e-12
"""Rounding error of shares' differences: a value this close to the margin counts as the margin."""


def differences_of(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    against: str | None = None,
    seed: int,
    resamples: int,
) -> list[Row]:
    """Return paired differences between models' scores, for every pair and measure.

    With ``against`` the other models are compared with this model alone. All pairs have the same
    resamples of the events.

    Returns:
        Rows of ``one``, ``other``, ``measure`` (place in the metrics, such as "human.js"),
        ``scenario`` (None: all), ``value`` (one minus other; higher is better, of ``js`` lower),
        ``ci_low``, ``ci_high`` (95 %), ``p`` (two-sided,
        :func:`~phase_ppl.evaluation.bootstrap.difference`), ``p_holm`` and ``n_events`` (that both
        predict). Holm's correction is over all pairs compared on the measure; by scenario it is
        over all pairs and scenarios of the measure.
    """
    if against is None:
        pairs = list(itertools.combinations(models, 2))
    else:
        pairs = [(name, against) for name in models if name != against]
    said = {name: Answers.of(predicted(events, of), of) for name, of in models.items()}
    made: dict[tuple[object, ...], dict[Place, Resampled]] = {}

    def measures(answers: Answers) -> dict[Place, Resampled]:
        """Return all measures; they are the same in all pairs of models that answer the same."""
        key: tuple[object, ...] = (*(e.id for e in answers.events), answers.content())
        if key not in made:
            made[key] = measures_of(answers, resampled(len(answers.events), seed, resamples))
        return made[key]

    rows: list[Row] = []
    for one, other in pairs:
        # only questions that both answer count, event by event
        first, second = said[one].about(models[other]), said[other].about(models[one])
        theirs = measures(second.where_known(first))
        for path, mine in measures(first.where_known(second)).items():
            if (value := mine.minus(theirs[path])) is None or path[-1].endswith("_people"):
                continue
            by_scenario = path[0] == "by_scenario"
            scenario = path[1] if by_scenario else None
            row = {"one": one, "other": other, "scenario": scenario, **value}
            row["measure"] = ".".join(path[2:] if by_scenario else path)
            row["n_events"] = sum(scenario in (None, true_scenario(e)) for e in first.events)
            rows.append(row)
    return _corrected(rows, "p")


def equivalence_of(
    events: Sequence[Event],
    models: Mapping[str, Mapping[str, Prediction]],
    *,
    margin: float,
    seed: int,
    resamples: int,
) -> list[Row]:
    """Return models' accuracy minus people's, with a test of equivalence.

    The difference is a mean over the events that both answered: the model's score (1 or 0; for
    goals the mean of both agents) minus the share of people who are right. Two one-sided tests by
    resampling show that it is not below ``-margin`` and not above ``margin``.

    Events that agree show no spread. So p is at least that of normal tests, corrected for
    continuity (1 / 2n). Their spread is the larger of two: the events' own, and a model's that errs
    where people do not, in about a share ``margin`` of the events.

    Returns:
        Rows of ``model``, ``measure`` ("goal_accuracy", "relation_accuracy"), ``scenario`` (None:
        all), ``value``, ``ci_low``, ``ci_high`` (95 %), ``low``, ``high`` (90 %), ``p`` (two-sided,
        of no difference), ``p_equivalent`` (of the two one-sided tests), both with ``_holm``,
        as in :func:`differences_of`; ``n_events``, and ``verdict``: "equivalent" if the corrected
        ``p_equivalent`` is at most 0.05; "higher" or "lower" if the corrected ``p`` is; both
        joined if both are; else "undecided". Fewer than :data:`LEAST_EVENTS` events are not tested
        for equivalence.
    """
    rows: list[Row] = []
    for model, predictions in models.items():
        answers = Answers.of(predicted(events, predictions), predictions)
        weights = resampled(len(answers.events), seed, resamples)
        for kind in kinds_of(answers.world):
            true, given, people = (answers.array(kind, c) for c in ("truth", "answer", "people"))
            more = (true * given).sum(axis=-1) - (people * true).sum(axis=-1)
            for path, chosen in answers.parts(kind).items():
                part = np.where(chosen, more, np.nan)
                found = _tested(weighted_mean(weights, part), events_with(part), margin)
                if found is not None:
                    part_name = path[-1] if path else None
                    row = {"model": model, "measure": f"{kind}_accuracy", "scenario": part_name}
                    rows.append({**row, **found})
    for name in ("p", "p_equivalent"):
        rows = _corrected(rows, name)
    return [{**row, "verdict": _verdict(row)} for row in rows]


def _tested(values: FloatArray, n: int, margin: float) -> Row | None:
    found: Row | None = difference(values, np.zeros_like(values), n, of_shares=True)
    if found is None:
        return None
    drawn = values[1:][np.isfinite(values[1:])]
    low = high = p = None
    if n > 1 and drawn.size:
        low, high = interval(with_two(values, n), 1 - 2 * ALPHA)
    if n >= LEAST_EVENTS and drawn.size:
        inside = margin - _ROUNDING
        beyond = max((drawn <= -inside).sum(), (drawn >= inside).sum())
        spread = max(float(drawn.var()), margin * (1 - margin) / n)
        within = (margin - abs(found["value"]) - 0.5 / n) / math.sqrt(spread)
        p = max(float((beyond + 1) / (drawn.size + 1)), float(ndtr(-within)))
    return {**found, "low": low, "high": high, "p_equivalent": p, "n_events": n}


def _verdict(row: Row) -> str:
    words = []
    if row["p_equivalent_holm"] is not None and row["p_equivalent_holm"] <= ALPHA:
        words.append("equivalent")
    if row["p_holm"] is not None and row["p_holm"] <= ALPHA:
        words.append("higher" if row["value"] > 0 else "lower")
    return ", ".join(words) or "undecided"


def _corrected(rows: Sequence[Row], name: str) -> list[Row]:
    """Return the rows with corrected p-values; families are by measure, and overall or scenario."""
    table = pd.DataFrame(rows, columns=["measure", "scenario", name]).astype({name: float})
    families = table.groupby(["measure", table["scenario"].isna()])
    corrected = families[name].transform(holm) if rows else table[name]
    return [
        {**row, f"{name}_holm": None if math.isnan(value) else value}
        for row, value in zip(rows, corrected.tolist(), strict=True)
    ]


def holm(p: pd.Series[float]) -> pd.Series[float]:
    """Return p-values of a family of tests, corrected by Holm's step-down procedure (Holm 1979).

    Rejecting corrected values up to alpha keeps the probability of any false rejection in the
    family at most alpha. NaN is no test.
    """
    steps = p.sort_values(kind="stable") * (p.count() - np.arange(len(p)))
    return steps.cummax().clip(upper=1).reindex(p.index)
