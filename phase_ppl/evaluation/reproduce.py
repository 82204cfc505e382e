"""The paper's tables and figures in one go, on real videos.

The folder that it writes::

    DIR/
      models/LABEL/        an evaluation per model, event by event
      comparison/          all answers together; report.html in it shows them, with all figures
      reproduction.json    every cell: the paper's value, ours, the verdict
      reproduction.csv     the same as a table

Finished parts are not repeated: the same call with ``resume`` continues.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from phase_ppl.data.generated import MANIFEST
from phase_ppl.evaluation.bootstrap import Measure, proportion
from phase_ppl.evaluation.cells import lines_of, measure_text
from phase_ppl.evaluation.comparison import ModelComparison, label_of
from phase_ppl.evaluation.evaluate import evaluate
from phase_ppl.evaluation.evaluation import Evaluation, compare_models
from phase_ppl.evaluation.folder import all_events
from phase_ppl.evaluation.judgments import judged
from phase_ppl.evaluation.metrics import at, human_accuracy
from phase_ppl.evaluation.registry import model_info, not_installed
from phase_ppl.evaluation.table import PEOPLE
from phase_ppl.inference.settings import simulations
from phase_ppl.world.errors import (
    AnswerError,
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    check_name,
    number_of_workers,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, locked, writable_folder, write_bytes, write_json
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS
from phase_ppl.world.identity import event_digest
from phase_ppl.world.scene import check_is_phase

# --- what the paper prints: numbers with their places, and those of our metrics ------------------
# The paper's other numbers are in figures only, and cannot be read off exactly.

SIMPLE: Final = "SIMPLE"
SOCIALGNN: Final = "SocialGNN"
PREDICATE: Final = "predicate inverse planning"
VLM: Final = "Gemini"
STEERED: Final = "videos that people steer"
EVENTS: Final = "PHASE"
"""Of whom, or of what, a number is, beside people."""


class Printed(NamedTuple):
    """A number of the paper."""

    place: str  # where it is printed
    what: str  # it says
    whose: str  # people's, a model's, or of what else
    path: str  # of the same number in our metrics, parts joined by dots
    value: float
    low: float | None = None  # its interval, where one is printed
    high: float | None = None
    below: bool = False  # whether the value is printed as a bound only, "< 0.6"

    @property
    def digits(self) -> int:
        """Decimals to show: none of a count."""
        if self.value > 1 and self.value == int(self.value):
            return 0
        return 2 if round(self.value, 2) == self.value else 3


_HUMAN: Final = "Results, Human results"
_ACCURACY: Final = "Results, Comparing model and human accuracy"
_GRADED: Final = "Results, Explaining human graded judgments"
_SETS: Final = "A Paradigm for Physically Grounded Social Perception"
_A2: Final = "Appendix A.2, Comparing PHASE and human-generated videos"

_GOALS, _RELATIONS = (f"by_scenario.competing.{kind}_accuracy" for kind in ("goal", "relation"))
_APART: Final = "by_scenario.independent.goal_accuracy"
_ALIKE: Final = "scenario types without a significant difference from people"

PRINTED: Final = (
    Printed(_HUMAN, "goals right", PEOPLE, "goal_accuracy", 0.78),
    Printed(_HUMAN, "relations right", PEOPLE, "relation_accuracy", 0.89),
    Printed(_HUMAN, "r of halves, goals", PEOPLE, "human.goal_split_half_r", 0.92, 0.91, 0.94),
    Printed(_HUMAN, "r of halves, relations", PEOPLE, "human.split_half_r", 0.96, 0.95, 0.97),
    Printed(_ACCURACY, "goals right, competing", PEOPLE, _GOALS, 0.76, 0.74, 0.78),
    Printed(_ACCURACY, "goals right, competing", SIMPLE, _GOALS, 0.59, 0.41, 0.77),
    Printed(_ACCURACY, "relations right, competing", SIMPLE, _RELATIONS, 0.91, 0.72, 1.0),
    Printed(_ACCURACY, "relations right, competing", SOCIALGNN, _RELATIONS, 0.0),
    Printed(_ACCURACY, "goals right, independent", PREDICATE, _APART, 0.35, 0.22, 0.48),
    Printed(_ACCURACY, f"{_ALIKE}, goals", SIMPLE, "like_people.goal", 3),
    Printed(_ACCURACY, f"{_ALIKE}, relations", SIMPLE, "like_people.relation", 4),
    Printed(_GRADED, "r with people, goals", SIMPLE, "human.goal_r", 0.82, 0.78, 0.85),
    Printed(_GRADED, "r with people, relations", SIMPLE, "human.relation_r", 0.78, 0.71, 0.82),
    *(
        Printed(_GRADED, f"r with people, {kind}s", whose, f"human.{kind}_r", 0.6, below=True)
        for whose in (SOCIALGNN, PREDICATE, VLM)
        for kind in ("goal", "relation")
    ),
    Printed(_SETS, "share of friendly events", EVENTS, "friendly", 200 / 500),
    Printed(_SETS, "share of neutral events", EVENTS, "neutral", 108 / 500),
    Printed(_SETS, "share of adversarial events", EVENTS, "adversarial", 192 / 500),
    Printed(_SETS, "fewest events of a goal category", EVENTS, "of_category.fewest", 47),
    Printed(_SETS, "most events of a goal category", EVENTS, "of_category.most", 129),
    *(
        Printed(_A2, f"mode of responses right, {kind}s", whose, f"majority.{kind}_accuracy", value)
        for whose, goals, relations in ((STEERED, 0.965, 0.92), (PEOPLE, 0.97, 0.99))
        for kind, value in (("goal", goals), ("relation", relations))
    ),
)


# --- held against ours ----------------------------------------------------------------------------

_INSIDE: Final = (
    "inside: the paper's value lies in the 95 % interval of ours, or ours in the paper's, or both "
    "are the same to the digits printed; of a bound, our interval does not lie above it; a wide "
    "interval says little"
)


class Cell(NamedTuple):
    """A number of the paper beside one of ours."""

    printed: Printed  # the paper's
    label: str  # of the model of ours, or what it is of
    ours: Measure | None  # with its interval; None: not computable
    verdict: str  # "inside", "outside" or "not computable"
    missing: str = ""  # what data it would take
    videos: int | None = None  # of one type of scenario, on which ours rests


class Reproduction(NamedTuple):
    """The paper's numbers beside ours, as :func:`phase_ppl.reproduce` returns them.

    Attributes:
        cells: a cell per number of the paper: ``printed``, the number; ``ours``, our value with its
            interval; and ``verdict``: "inside", "outside" or "not computable".
        comparison: comparison of all models.
        notes: remarks on how the numbers came about.
        folder: folder that holds everything.
    """

    cells: Sequence[Cell]
    comparison: ModelComparison
    notes: Sequence[str]
    folder: Path

    def table(self, cells: Sequence[Cell]) -> pd.DataFrame:
        """Return what ``print`` shows of some of the cells, a row each."""
        found = {}
        for cell in cells:
            p = cell.printed
            printed = {"value": p.value, "ci_low": p.low, "ci_high": p.high}
            ours = measure_text(cell.ours, digits=p.digits)
            found[f"{cell.label}: {p.what}"] = {
                "place": p.place,
                "paper": ("< " if p.below else "") + measure_text(printed, digits=p.digits),
                "ours": ours + (f" of {cell.videos}" if cell.videos else ""),
                "verdict": cell.verdict,
                "needs": cell.missing,
            }
        return pd.DataFrame.from_dict(found, orient="index")

    def __str__(self) -> str:
        notes = (f"note: {note}" for note in self.notes)
        table = self.table(self.cells).drop(columns=["place", "needs"])
        return "\n".join([*notes, "", *lines_of(table, width=None)])


def verdict(printed: Printed, ours: Measure) -> str:
    """Return "inside" if the paper's value and ours are compatible, else "outside".

    They are if either value lies within the other's interval, or both agree to the printed digits.
    A bound holds unless our interval lies above it.
    """
    value, low, high = ours["value"], ours["ci_low"], ours["ci_high"]
    assert value is not None, "a measure has a value"
    if printed.below:
        return "inside" if (value if low is None else low) < printed.value else "outside"
    inside = abs(value - printed.value) < 0.005
    if low is not None and high is not None:
        inside |= low <= printed.value <= high
    if printed.low is not None and printed.high is not None:
        inside |= printed.low <= value <= printed.high
    return "inside" if inside else "outside"


# --- models that are asked ------------------------------------------------------------------------

PROFILES: Final = ("quick", "paper")
RESULT, TABLE = "reproduction.json", "reproduction.csv"
MODELS, COMPARED = "models", "comparison"

_VIDEOS: Final = 100  # that the paper has


class Asked(NamedTuple):
    """A model that is asked."""

    model: str  # its name
    options: Mapping[str, Any] = {}  # of the model
    whose: str = ""  # as which of the paper's models its numbers count


def models_of(profile: str) -> dict[str, Asked]:
    """Return label -> model of a profile.

    "quick": SIMPLE with few simulations and searches as small as the fast planner's; "paper": as
    the paper has it, as printed and as intended, and as it is here.
    """
    check_name("profile", profile, PROFILES)
    printed = {"preset": "as_printed"}
    if profile == "quick":
        few = {"budget": simulations(30)}  # 15 particles, one iteration
        small = {**printed, "planner": "as_printed_fast", **few}
        found = {
            "simple_as_printed": Asked("simple", small, SIMPLE),
            "simple": Asked("simple", few, SIMPLE),
        }
    else:
        found = {
            "simple_as_printed": Asked("simple", printed, SIMPLE),
            "simple_as_intended": Asked("simple", {"preset": "as_intended"}, SIMPLE),
            "simple": Asked("simple", whose=SIMPLE),
        }
    found |= {
        "predicate_as_printed": Asked("predicate", printed, PREDICATE),
        "predicate": Asked("predicate", whose=PREDICATE),
        "socialgnn": Asked("socialgnn", whose=SOCIALGNN),
        "socialgnn_original": Asked("socialgnn", {"variant": "original"}, SOCIALGNN),
    }
    return found


def reproduce(
    out: str | os.PathLike[str],
    videos: str | os.PathLike[str],
    *,
    profile: str = "quick",
    judgments: str | os.PathLike[str] | None = None,
    vlm: str | os.PathLike[str] | None = None,
    steered: str | os.PathLike[str] | None = None,
    seed: int = 0,
    workers: int | None = None,
    resume: bool = False,
    progress: bool | None = None,
    say: Callable[[str], object] = print,
) -> Reproduction:
    """Repeat the paper's experiments, and compare the results with the paper's numbers.

    Args:
        out: folder to keep everything in; ``comparison/report.html`` in it shows all results.
        videos: file of real videos: the authors' release, or JSON in the format "phase-test"
            (:mod:`phase_ppl.data.events_json`).
        profile: "quick": SIMPLE with few simulations and small searches; "paper": SIMPLE as
            printed, as intended, and as in this package.
        judgments: people's judgments of the videos, in place of those in the events.
        vlm: folder of a finished evaluation of a vision-language model on the same videos.
        steered: file or folder of events that people steered, with people's judgments in them.
        seed: seed of the models.
        workers: largest number of processes; by default one per usable core.
        resume: whether to continue with what is in ``out``; the models' settings and the videos
            must be the same.
        progress: whether to show bars; by default if stderr is a terminal.
        say: function that is called with each line about what is done.

    Raises:
        InvalidEventError, InvalidSettingError, UnknownNameError: data or settings cannot be used,
            or ``out`` was begun with others.
        OutputError: ``out`` cannot be written, or holds a reproduction and ``resume`` is not set.
        EvaluationInterrupted: Ctrl-C was pressed; what was finished is kept.
    """
    if (as_path(videos) / MANIFEST).is_file():
        raise InvalidSettingError(
            f"{videos} holds generated events: reproduce takes real videos; evaluate takes any"
        )
    slots = number_of_workers(workers)
    asked = models_of(profile)
    whole_number("seed", seed, 0)
    answered = {} if vlm is None else {"vlm": Evaluation.load(vlm)}
    played = [] if steered is None else list(judged(all_events(steered), None))
    for event in played:
        check_is_phase(event.scene.world, "reproduce")
    folder = writable_folder(out)
    with locked(folder):
        if not resume and (folder / MODELS).is_dir():
            raise OutputError(f"{folder} holds a reproduction already; resume it, or name another")
        events = judged(all_events(videos), judgments)
        for event in events:
            check_is_phase(event.scene.world, "reproduce")
        digests = {event.id: event_digest(event) for event in events}
        if any(one.settings["events"] != digests for one in answered.values()):
            raise InvalidEventError(f"{vlm} holds answers about other events than {videos}")
        missing = {}
        for label, one in asked.items():
            info = model_info(one.model)
            if (absent := not_installed(info.needs, info.extra)) is not None:
                missing[label] = absent
        chosen = {label: one for label, one in asked.items() if label not in missing}
        found: dict[str, Evaluation] = {}
        for place, (label, one) in enumerate(chosen.items(), 1):
            say(f"{place} of {len(chosen)}: {label}")
            try:
                found[label] = evaluate(
                    events, one.model, out=folder / MODELS / label, workers=slots, resume=True,
                    seed=seed, progress=progress, **one.options,
                )  # fmt: skip
            except AnswerError as error:  # other models may do better
                say(str(error))
                found[label] = error.evaluation  # type: ignore[attr-defined]
        asked |= {label: Asked(label, whose=VLM) for label in answered}
        comparison = compare_models({**found, **answered}, stored="all")
        cells = list(_cells(comparison, asked, missing, played))
        notes = [f"real videos of {Path(videos).name}"]
        for label, why in missing.items():
            notes.append(f"{label_of(label)} is left out, for it needs {why}")
        if len(events) != _VIDEOS:
            notes.append(
                f"the paper has {_VIDEOS} test videos, these are {len(events)}: with fewer, "
                "intervals are wider and fewer differences significant, so that it takes less to "
                "be inside"
            )
        if profile == "quick":
            notes.append("quick: SIMPLE, as printed too, has 30 simulations a video and 100 a "
                         "decision; the paper has 105 and 1000")  # fmt: skip
        notes += comparison.notes
        comparison = dataclasses.replace(comparison, notes=tuple(notes))
        notes.append(_INSIDE)
        result = Reproduction(cells, comparison, notes, folder)
        plain = [{**one._asdict(), "printed": one.printed._asdict()} for one in cells]
        record = {"profile": profile, "notes": notes, "cells": plain}
        write_json(folder / RESULT, record)
        table = result.table(cells).to_csv(index_label="number")
        write_bytes(folder / TABLE, (".csv",), table.encode())
        from phase_ppl.evaluation.report import report

        report(comparison.save(folder / COMPARED), progress=progress)
        return result


# --- cells ----------------------------------------------------------------------------------------

_STORED: Final = {SIMPLE: "simple_authors", SOCIALGNN: "socialgnn_2023"}
"""Paper's model -> the authors' own answers, where the events carry them."""

_JUDGED: Final = "people's judgments (--judgments)"
_NEEDS: Final = {
    PEOPLE: _JUDGED,
    VLM: "answers of a vision-language model (--vlm)",
    STEERED: "videos that people steer, with judgments (--steered)",
    "of_category": "what a goal category is, which the paper does not say",
    "human": f"the model's probabilities, and {_JUDGED}",
    "like_people": _JUDGED,
}
"""Of whom, or the first part of the path -> which data a number takes."""


def _cells(
    comparison: ModelComparison,
    asked: Mapping[str, Asked],
    missing: Mapping[str, str],
    steered: Sequence[Event],
) -> Iterator[Cell]:
    """Yield each number of the paper beside those of ours that stand for it."""
    metrics = {name: dict(found) for name, found in comparison.metrics.items()}
    for name, found in metrics.items():
        found["like_people"] = _like_people(comparison, name)
    others = {
        PEOPLE: _of_people(comparison),
        EVENTS: _of_events(comparison.events),
        STEERED: human_accuracy(steered) if any(event.judgments for event in steered) else {},
    }
    for printed in PRINTED:
        path = tuple(printed.path.split("."))
        labels = [label for label, one in asked.items() if one.whose == printed.whose]
        labels += [n for n in metrics if n.startswith(_STORED.get(printed.whose, "?"))][:1]
        for label in labels or [printed.whose]:
            of_model = {**metrics, **others}.get(label, {})
            ours = at(of_model, path)
            if ours is not None:
                in_scenario = path[0] == "by_scenario"
                counted = in_scenario and label in metrics  # of people there are participants
                videos = at(of_model, (*path[:2], "n")) if counted else None
                alone = in_scenario and ours["ci_low"] is None
                why = f"more than one {path[1]} event" if alone else ""
                said = "not computable" if alone else verdict(printed, ours)
                yield Cell(printed, label, ours, said, why, videos)
                continue
            needed = _NEEDS.get(printed.whose) or _NEEDS.get(path[0]) or "answers about such events"
            yield Cell(printed, label, None, "not computable", missing.get(label) or needed)


def _like_people(comparison: ModelComparison, name: str) -> dict[str, Measure]:
    """Return kind -> in how many types of scenario a model is no different from people."""
    found: dict[str, Measure] = {}
    for kind in ("goal", "relation"):
        asked = (name, f"{kind}_accuracy")
        rows = [r for r in comparison.equivalence if (r["model"], r["measure"]) == asked]
        p = [row["p"] for row in rows if row["scenario"]]
        if len(p) == len(SCENARIOS) and None not in p:
            found[kind] = _count(sum(one >= 0.05 for one in p))
    return found


def _count(n: float) -> Measure:
    """Return a measure that is known exactly, or not how exactly."""
    return {"value": float(n), "ci_low": None, "ci_high": None}


def _of_people(comparison: ModelComparison) -> dict[str, Any]:
    """Return people's accuracies, by participant where that is known, and r of halves."""
    by_participant = comparison.people["by_participant"] or {}
    human: dict[str, Any] = {}
    for of_model in comparison.metrics.values():
        for name in ("goal_split_half_r", "split_half_r"):
            human[name] = human.get(name) or at(of_model, ("human", name))
    return {**comparison.people, **by_participant, "human": human}


def _of_events(events: Sequence[Event]) -> dict[str, Measure | None]:
    relations = np.array([event.truth.relation for event in events if event.truth is not None], str)
    return {name: proportion((relations == name).astype(float)) for name in RELATIONS}
