"""The report of an evaluation: who is right, who agrees with people, and every event."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.evaluation.curves import at
from phase_ppl.evaluation.figures import DRAWN, TITLES
from phase_ppl.evaluation.figures.results import FolderResults, NothingToDrawError
from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.evaluation.observers import Observer, label_of
from phase_ppl.evaluation.report import parts
from phase_ppl.evaluation.report.html import (
    Child,
    Html,
    facts,
    figure_of,
    more,
    number,
    page,
    rolled,
    section,
    table,
    tag,
)
from phase_ppl.evaluation.report.videos import videos_section
from phase_ppl.world.relations import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS: Final = {
    ("goal_accuracy",): "goals right",
    ("goal_top3_accuracy",): "goal among the first 3",
    ("relation_accuracy",): "relations right",
    ("human", "goal_r"): "r with people, goals",
    ("human", "relation_r"): "r with people, relations",
    ("human", "relation_r_given_truth"): "r given the truth",
    ("human", "log_score"): "log score of people's answers",
    ("human", "js"): "Jensen-Shannon divergence",
}
"""Place of a figure in the metrics -> heading of its column."""

ALTS: Final = {
    "accuracy": "Bars: share of right goals and relations of everybody, over all events and by "
    "true scenario, with 95 % intervals; the numbers are in the tables above.",
    "confusion": "Matrices of counts: true scenario against the scenario of the goals answered.",
    "correlation": "Bars: correlation of each model with people; the numbers are in the table.",
    "scatter_goals": "Points: probability of a goal for a model against that for people.",
    "scatter_relations": "Points: probability of a relation for a model against that for people.",
    "film_strips": "Film strips: an event of every scenario, from first to last frame.",
    "costs": "Points: share of right answers against CPU seconds per event, with intervals.",
    "differences": "Matrices: difference in right answers between every two models.",
    "equivalence": "Points with intervals: right answers of models minus those of people, beside "
    "the margin of equivalence; the numbers are in the table.",
}
"""Name of a figure -> what stands in its place for those who do not see it."""

_INTERVALS: Final = (
    "In small: 95 % intervals, of right answers Clopper-Pearson for as many independent answers "
    "as they are worth, of the rest over resampled events. "
)


def results_report(
    folder: ResultsFolder, *, videos: bool = False, progress: bool | None = None
) -> str:
    """Return the page of an evaluation.

    Args:
        folder: of the evaluation, finished or not.
        videos: film every event.
        progress: show a bar over the events; None: where stderr is a terminal.

    Raises:
        InvalidEventError, UnknownNameError: a file in the folder is damaged.
    """
    results = FolderResults(folder)
    name = label_of(str(folder.settings.get("model", "model")))
    finished = sum(folder.is_finished(event.id) for event in folder.events)
    title = f"Evaluation of {name}"
    stored = folder.metrics() or {}
    cost = stored.get("cost")
    return page(
        title,
        tag("h1", title),
        tag("p", _state(folder, finished), class_="soft"),
        section("Summary", summary_table(results.measured), scenario_table(results.measured)),
        section("Figures", *drawn_figures(results, DRAWN)),
        _failures(folder),
        videos_section(results, films=videos, progress=progress),
        section(
            "Settings and cost",
            facts(parts.flat(cost), "Cost") if isinstance(cost, Mapping) and cost else None,
            more("Settings", facts(parts.flat(folder.settings), "Settings")),
            tag("p", f"phase_ppl {phase_ppl.__version__}", class_="soft"),
        ),
    )


def _state(folder: ResultsFolder, finished: int) -> str:
    n = len(folder.events)
    words = f"{finished} of {n} events predicted"
    if finished < n and folder.metrics() is None:
        words += "; not finished: tables and figures are about these"
    return f"{words}."


def summary_table(observers: Iterable[Observer]) -> Html:
    """Return the table of everybody's metrics, without columns that nobody has."""
    shown = list(observers)
    used = {
        place: heading
        for place, heading in COLUMNS.items()
        if any(at(observer.metrics, place) is not None for observer in shown)
    }
    if not used:
        return tag("p", "There is nothing to compare with: neither truth nor people's judgments.")
    heads: list[Child] = ["", *used.values()]
    rows: list[list[Child]] = []
    for observer in shown:
        cells: list[Child] = [_with_interval(at(observer.metrics, place)) for place in used]
        rows.append([parts.named(observer), *cells])
    people = _between_people(shown)
    return tag(
        "div",
        table(heads, rows, "Metrics"),
        tag(
            "p",
            _INTERVALS,
            people,
            class_="soft",
        ),
    )


def _between_people(observers: list[Observer]) -> str:
    words = []
    for name, what in (("goal_split_half_r", "goals"), ("split_half_r", "relations")):
        for observer in observers:
            found = at(observer.metrics, ("human", name))
            if found is not None:
                words.append(f"{number(found['value'])} on {what}")
                break
    return f"Halves of the people correlate {' and '.join(words)}." if words else ""


def scenario_table(observers: Iterable[Observer]) -> Html | None:
    """Return accuracies by true scenario, folded away."""
    rows: list[list[Child]] = []
    shown = list(observers)
    for kind, word in (("goal", "goals"), ("relation", "relations")):
        for observer in shown:
            found = [
                at(observer.metrics, ("by_scenario", name, f"{kind}_accuracy"))
                for name in SCENARIOS
            ]
            if any(found):
                rows.append([parts.named(observer), word, *(_with_interval(one) for one in found)])
    if not rows:
        return None
    heads: list[Child] = ["", "right", *SCENARIOS]
    return more("By true scenario", table(heads, rows, "Accuracy by true scenario"))


def drawn_figures(results: Any, drawn: Mapping[str, Callable[[Any], Figure]]) -> list[Html]:
    """Return the figures that the results allow, and why others are not there.

    Args:
        results: as the functions take them.
        drawn: name of a figure -> what draws it.
    """
    found: list[Html] = []
    left_out = []
    for name, draw in drawn.items():
        try:
            picture = figure_of(draw(results), ALTS[name])
        except NothingToDrawError as reason:
            left_out.append(f"{TITLES[name]}: {reason}.")
            continue
        found += [tag("h3", TITLES[name]), tag("figure", rolled(picture, TITLES[name]))]
    if left_out:
        words = " ".join(left_out)
        found.append(tag("p", f"Not drawn. {words}", class_="soft"))
    return found


def _failures(folder: ResultsFolder) -> Html | None:
    found = folder.failures()
    if not found:
        return None
    pairs = [(event, parts.in_words(what)) for event, what in found.items()]
    return section("Failures", facts(pairs, "Events without a prediction, and why"))


def _with_interval(found: Mapping[str, Any] | None) -> Child:
    if found is None or found.get("value") is None:
        return number(None)
    low, high = found.get("ci_low"), found.get("ci_high")
    if low is None or high is None:
        return number(found["value"])
    return [number(found["value"]), tag("small", f"{number(low)} to {number(high)}")]
