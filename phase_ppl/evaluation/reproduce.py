"""The paper's tables and figures in one go, on real videos or, as a try, on generated ones.

The folder that it writes::

    DIR/
      asked.json           what was asked for
      models/LABEL/        an evaluation per model, event by event
      generated/           a set of events, where there are no real videos
      comparison/          all answers together
      reproduction.json    every cell: the paper's value, ours, the verdict
      reproduction.html    the same as one page, with all figures

What is finished is not done again: the same call with ``resume`` goes on with what is there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from phase_ppl.data.documents import read_json
from phase_ppl.data.generated import MANIFEST
from phase_ppl.evaluation.answer_sets import PEOPLE, label_of
from phase_ppl.evaluation.bootstrap import Measure, proportion
from phase_ppl.evaluation.comparison import ModelComparison, compare_models
from phase_ppl.evaluation.evaluate import evaluate
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.experiments import Likeness, Tags, load_likeness, load_tags
from phase_ppl.evaluation.figures import likeness as likeness_figure
from phase_ppl.evaluation.figures import tags as tags_figure
from phase_ppl.evaluation.judgments import all_events, judged
from phase_ppl.evaluation.metrics import at, human_accuracy
from phase_ppl.evaluation.paper import (
    EVENTS,
    LABELLED,
    PREDICATE,
    PRINTED,
    RATED,
    SIMPLE,
    SOCIALGNN,
    STEERED,
    VLM,
    Cell,
    Printed,
    Reproduction,
    verdict,
)
from phase_ppl.evaluation.registry import model_info, not_installed
from phase_ppl.inference.settings import simulations
from phase_ppl.world.errors import (
    AnswerError,
    InvalidSettingError,
    OutputError,
    check_name,
    number_of_workers,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked, writable_folder, write_json
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS
from phase_ppl.world.identity import differences
from phase_ppl.world.scene import check_is_phase

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawn

PROFILES: Final = ("quick", "paper", "full")
ASKED, RESULT, PAGE = "asked.json", "reproduction.json", "reproduction.html"
MODELS, GENERATED, COMPARED = "models", "generated", "comparison"

ADDED: Final = ("judgments", "vlm_store", "tags", "likeness", "steered")
"""What may be added when it is resumed: none of it changes an answer that is there."""

_QUICK_SET, _WHOLE_SET = 20, 100
"""Generated events where there are no real videos."""

_USUAL_FRAMES: Final = 61
_VIDEOS: Final = 100


class Asked(NamedTuple):
    """A model that is asked."""

    model: str  # its name
    seconds: float  # of one core, for a video of usual length; 0: next to none
    options: Mapping[str, Any] = {}  # of the model
    whose: str = ""  # as which of the paper's models its numbers count


def models_of(profile: str, vlm_store: str | os.PathLike[str] | None) -> dict[str, Asked]:
    """Return label -> model of a profile.

    "quick": SIMPLE with few simulations and searches as small as the fast planner's; "paper": as
    the paper has it, as printed and as intended, and as it is here; "full": and all lesions, and
    what is beyond the paper.
    """
    check_name("profile", profile, PROFILES)
    printed = {"preset": "as_printed"}
    if profile == "quick":
        few = {"budget": simulations(30)}  # 15 particles, one iteration
        small = {**printed, "planner": "as_printed_fast", **few}
        found = {
            "simple_as_printed": Asked("simple", 20, small, SIMPLE),
            "simple": Asked("simple", 20, few, SIMPLE),
        }
    else:
        found = {
            "simple_as_printed": Asked("simple", 346, printed, SIMPLE),
            "simple_as_intended": Asked("simple", 346, {"preset": "as_intended"}, SIMPLE),
            "simple": Asked("simple", 40, whose=SIMPLE),
        }
    found |= {
        "predicate_as_printed": Asked("predicate", 0.1, printed, PREDICATE),
        "predicate": Asked("predicate", 0.1, whose=PREDICATE),
        "socialgnn": Asked("socialgnn", 0.05, whose=SOCIALGNN),
        "socialgnn_original": Asked("socialgnn", 0.05, {"variant": "original"}, SOCIALGNN),
    }
    if vlm_store is not None:
        kept = {"client": "google", "store": os.fspath(vlm_store), "replay": True}
        found["vlm"] = Asked("vlm", 0, kept, VLM)
    if profile == "full":
        lesions = "no_physics noisy_physics full_observation true_state no_cost_weight"
        found |= {name: Asked(name, 34) for name in (*lesions.split(), "no_social_goals")}
        found |= {
            "stepwise": Asked("stepwise", 10),
            "message_passing": Asked("socialgnn", 0.05, {"variant": "message_passing"}),
            "last_frame": Asked("last_frame", 0),
            "majority": Asked("majority", 0),
        }
    return found


def expected_seconds(asked: Mapping[str, Asked], events: Sequence[Event], workers: int) -> float:
    """Return about how long the models take on idle cores, by figures of ours."""
    videos = sum(event.observation.n_frames for event in events) / _USUAL_FRAMES
    return videos * sum(
        one.seconds / (workers if model_info(one.model).parallel else 1) for one in asked.values()
    )


def reproduce(
    out: str | os.PathLike[str],
    videos: str | os.PathLike[str] | None = None,
    *,
    profile: str = "quick",
    judgments: str | os.PathLike[str] | None = None,
    vlm_store: str | os.PathLike[str] | None = None,
    tags: str | os.PathLike[str] | None = None,
    likeness: str | os.PathLike[str] | None = None,
    steered: str | os.PathLike[str] | None = None,
    seed: int = 0,
    workers: int | None = None,
    resume: bool = False,
    progress: bool | None = None,
    say: Callable[[str], object] = print,
) -> Reproduction:
    """Do what the paper did, and hold it against what the paper prints.

    Args:
        out: folder to keep everything in, see the module.
        videos: file of real videos, as phase-test JSON or the authors' release; without, or with
            the folder of a generated set, it is a try on a test split, which says so everywhere.
        profile: "quick", "paper" or "full" (:func:`models_of`).
        judgments: people's judgments, in place of those in the events.
        vlm_store: folder with the stored answers of a vision-language model.
        tags, likeness: CSV files of what people said in the paper's other two experiments.
        steered: file or folder of events that people steered, with people's judgments in them.
        seed: of the models.
        workers: processes, at most; by default one per usable core.
        resume: go on with what is in ``out``, by the same arguments; judgments, answers, tags and
            likeness may be added where there were none.
        progress: whether to show bars; by default where stderr is a terminal.
        say: takes lines about what is done, an estimate of the time before it begins among them.

    Raises:
        InvalidEventError, InvalidSettingError, UnknownNameError: data or settings that cannot be
            used; or ``out`` was begun with others.
        OutputError: ``out`` cannot be written, or holds a reproduction that is not to be resumed.
        EvaluationInterrupted: Ctrl-C; what was finished is kept.
    """
    slots = number_of_workers(workers)
    asked = models_of(profile, vlm_store)
    whole_number("seed", seed, 0)
    labels = None if tags is None else load_tags(tags)
    rated = None if likeness is None else load_likeness(likeness)
    played = [] if steered is None else list(judged(all_events(steered), None))
    for event in played:
        check_is_phase(event.scene.world, "reproduce")
    folder = writable_folder(out)
    with locked(folder):
        files = {"videos": videos, "judgments": judgments, "vlm_store": vlm_store,
                 "tags": tags, "likeness": likeness, "steered": steered}  # fmt: skip
        given = {
            **{name: file and str(Path(file).resolve()) for name, file in files.items()},
            **{"profile": profile, "seed": seed},
        }
        _same_as_before(folder / ASKED, given, resume)
        events, real, note = _events(folder, videos, profile, slots, progress, say)
        events = judged(list(events), judgments)
        for event in events:
            check_is_phase(event.scene.world, "reproduce")
        write_json(folder / ASKED, given)
        missing = {}
        for label, one in asked.items():
            info = model_info(one.model)
            if (absent := not_installed(info.needs, info.extra)) is not None:
                missing[label] = absent
        chosen = {label: one for label, one in asked.items() if label not in missing}
        minutes = expected_seconds(chosen, events, slots) / 60
        say(f"{len(chosen)} models on {len(events)} events: about {minutes:.0f} minutes with "
            f"{slots} idle core{'s' * (slots > 1)}, what is finished included")  # fmt: skip
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
        comparison = compare_models(found, stored="all")
        comparison.save(folder / COMPARED)
        cells = list(_cells(comparison, asked, missing, labels, rated, played))
        notes = [note]
        for label, why in missing.items():
            notes.append(f"{label_of(label)} is left out, for it needs {why}")
        if real and len(events) != _VIDEOS:
            notes.append(
                f"the paper has {_VIDEOS} test videos, these are {len(events)}: with fewer, "
                "intervals are wider and fewer differences significant, so that it takes less to "
                "be inside"
            )
        if profile == "quick":
            notes.append("quick: SIMPLE, as printed too, has 30 simulations a video and 100 a "
                         "decision; the paper has 105 and 1000")  # fmt: skip
        notes += comparison.notes
        drawn = list(_drawings(events, labels, rated, real))
        result = Reproduction(cells, comparison, real, notes, drawn, folder)
        record = {**given, "real": real, "notes": notes, "cells": [one.to_dict() for one in cells]}
        write_json(folder / RESULT, record)
        from phase_ppl.evaluation.report import reproduction_page, write_page

        write_page(reproduction_page(result, progress=progress), folder / PAGE)
        return result


def _same_as_before(file: Path, given: Mapping[str, Any], resume: bool) -> None:
    if not file.exists():
        return
    if not resume:
        raise OutputError(f"{file.parent} holds a reproduction already; resume it, or name another")
    before = read_json(file)
    before |= {name: given[name] for name in ADDED if before.get(name) is None}
    apart = differences(before, given)
    if apart:
        raise InvalidSettingError(f"{file.parent} was begun with others: {'; '.join(apart)}")


def _events(
    folder: Path,
    videos: str | os.PathLike[str] | None,
    profile: str,
    workers: int,
    progress: bool | None,
    say: Callable[[str], object],
) -> tuple[Sequence[Event], bool, str]:
    """Return the events, whether they are real, and a note about them."""
    if videos is not None and not (Path(videos) / MANIFEST).is_file():
        return all_events(videos), True, f"real videos of {Path(videos).name}"
    source = folder / GENERATED if videos is None else Path(videos)
    if videos is None and not (source / MANIFEST).is_file():
        from phase_ppl.data.generation.generate import generate

        n = _QUICK_SET if profile == "quick" else _WHOLE_SET
        planner = "fast" if profile == "quick" else "paper"
        say(f"no real videos: {n} events are generated")
        generate(
            source, n=n, splits={"test": 1.0}, planner=planner, workers=workers, resume=True,
            progress=progress,
        )  # fmt: skip
    return all_events(source, "test"), False, "test split of a generated set"


# --- cells ----------------------------------------------------------------------------------------

_STORED: Final = {SIMPLE: "simple_authors", SOCIALGNN: "socialgnn_2023"}
"""Paper's model -> the authors' own answers, where the events carry them."""

_NEEDS: Final = {
    VLM: "answers of a vision-language model (--vlm-store)",
    LABELLED: "labels by people (--tags)",
    RATED: "ratings by people (--likeness)",
    STEERED: "videos that people steer, with judgments (--steered)",
    "of_category": "what a goal category is, which the paper does not say",
}


def _cells(
    comparison: ModelComparison,
    asked: Mapping[str, Asked],
    missing: Mapping[str, str],
    tags: Tags | None,
    likeness: Likeness | None,
    steered: Sequence[Event],
) -> Iterator[Cell]:
    """Yield each number of the paper beside those of ours that stand for it."""
    metrics = {name: dict(found) for name, found in comparison.metrics.items()}
    for name, found in metrics.items():
        found["like_people"] = _like_people(comparison, name)
    others = {
        PEOPLE: _of_people(comparison),
        EVENTS: _of_events(comparison.events),
        LABELLED: {} if tags is None else _of_tags(tags),
        RATED: {} if likeness is None else _of_likeness(likeness),
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
            judged = any(at(of_other, path) is not None for of_other in metrics.values())
            unsure = "its probabilities" if judged and path[0] == "human" else None
            needed = _NEEDS.get(printed.whose) or _NEEDS.get(path[0])
            why = missing.get(label) or needed or unsure or _data(printed)
            yield Cell(printed, label, None, "not computable", why)


def _data(printed: Printed) -> str:
    """Return which data a number takes."""
    goals = "goal" in printed.path
    if printed.path.startswith(("human", "like_people")) or printed.whose == PEOPLE:
        what = f"people's judgments of {'goals' if goals else 'relations'} (--judgments)"
        if printed.path.startswith("human") and printed.whose != PEOPLE:
            what = f"probabilities, and {what}"
    else:
        what = f"answers about {'goals' if goals else 'relations'}"
    if printed.path.startswith("by_scenario"):
        what += f", in {printed.path.split('.')[1]} events"
    return what


def _like_people(comparison: ModelComparison, name: str) -> dict[str, Measure]:
    """Return kind -> in how many types of scenario a model is no different from people."""
    found: dict[str, Measure] = {}
    for kind in ("goal", "relation"):
        p = [
            row["p"]
            for row in comparison.equivalence
            if (row["model"], row["measure"]) == (name, f"{kind}_accuracy") and row["scenario"]
        ]
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


def _of_tags(tags: Tags) -> dict[str, Measure]:
    table = tags.summary()
    return {"used": _count((table["used"] > 0).sum()),
            "categories": _count((table["percent"] > 0).sum())}  # fmt: skip


_TAILS: Final = (0.025, 0.975)


def _of_likeness(likeness: Likeness) -> dict[str, Measure]:
    from scipy.special import chdtri, stdtrit  # slow to import

    # of the videos' means; the paper does not say of what its standard deviations are
    found: dict[str, Measure] = {}
    pairs = zip(("played", "generated"), likeness.means("videos").values(), strict=True)
    for name, means in pairs:
        value, n = float(means.mean()), len(means)
        found[name] = _count(value)
        if n > 1:
            sd = float(means.std(ddof=1))
            half = float(stdtrit(n - 1, 0.975)) * sd / n**0.5
            found[name] |= {"ci_low": value - half, "ci_high": value + half}
            low, high = (sd * ((n - 1) / float(chdtri(n - 1, tail))) ** 0.5 for tail in _TAILS)
            found[f"{name}_sd"] = {"value": sd, "ci_low": low, "ci_high": high}
    return found


# --- figures that are of no comparison of models --------------------------------------------------


def _drawings(
    events: Sequence[Event], tags: Tags | None, likeness: Likeness | None, real: bool
) -> Iterator[tuple[str, str, Callable[[], Drawn]]]:
    """Yield title, words and what draws it."""
    from phase_ppl.analysis import figures as plots
    from phase_ppl.data.statistics import statistics

    yield (
        "What an agent believes, before and after it sees something (Fig. belief update)",
        "Arenas: true state and field of view, all particles, one of them, at two moments.",
        lambda: plots.beliefs(_with_discovery(events)),
    )
    yield (
        "The cost of a search (Fig. value example)",
        "Arenas: the way of the green agent to an item that it does not see, for two values of "
        "lambda.",
        plots.search,
    )
    yield (
        "Statistics of the events",
        "Bars: relations, goals, strengths, sizes and shares of time beside those of PHASE.",
        lambda: plots.data_card(statistics(events)),
    )
    if tags is not None:
        words = "Bars: percentage of videos with each label."
        yield "What people see (Fig. video annotation)", words, lambda: tags_figure(tags)
    if likeness is not None:
        words = "Ratings of likeness of two groups of videos, and their difference."
        yield "Likeness to people (A.2)", words, lambda: likeness_figure(likeness)


def _with_discovery(events: Sequence[Event]) -> Event:
    """Return the first event in which the red agent sees what it did not know where to look for."""
    from phase_ppl.analysis.figures.beliefs import PAPERS_PARTICLES, beliefs_of, discovery

    seen = (discovery(list(beliefs_of(event, 0, PAPERS_PARTICLES))) for event in events)
    return next((e for e, frame in zip(events, seen, strict=True) if frame), events[0])
