"""The report of a comparison of models: scores, differences, equivalence, and every event."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import phase_ppl
from phase_ppl.evaluation.comparison.comparison import ModelComparison
from phase_ppl.evaluation.comparison.results import ComparedResults
from phase_ppl.evaluation.figures import COMPARED
from phase_ppl.evaluation.observers import Observer, label_of
from phase_ppl.evaluation.pages import TITLES
from phase_ppl.evaluation.report import parts
from phase_ppl.evaluation.report.html import (
    Child,
    Html,
    facts,
    join,
    more,
    number,
    page,
    section,
    table,
    tag,
)
from phase_ppl.evaluation.report.results import drawn_figures, scenario_table, summary_table
from phase_ppl.evaluation.report.videos import answers_table
from phase_ppl.evaluation.tables import true_answer
from phase_ppl.inference.runs.progress import counted
from phase_ppl.world.event import Event

_MEASURES = {
    "goal_accuracy": "goals right",
    "relation_accuracy": "relations right",
    "goal_log_score_truth": "log probability of true goals, nats",
    "relation_log_score_truth": "log probability of true relation, nats",
}


def comparison_report(comparison: ModelComparison, *, progress: bool | None = None) -> str:
    """Return the page of a comparison.

    Args:
        comparison: of models.
        progress: show a bar over the events; None: where stderr is a terminal.
    """
    results = ComparedResults(comparison)
    title = "Comparison of models"
    labels = {observer.name: observer.label for observer in results.observers}
    # a model that predicts nothing observes nothing
    names = ", ".join(labels.get(name, label_of(name)) for name in comparison.models)
    settings = [pair for one in comparison.contenders for pair in parts.flat(
        {one.name: {"folder": one.folder, **one.settings}})]  # fmt: skip
    events = counted(comparison.events, progress, "event", "showing")
    return page(
        title,
        tag("h1", title),
        tag("p", f"{names} on {len(comparison.events)} events.", class_="soft"),
        [tag("p", f"{note}.") for note in comparison.notes],
        section("Summary", summary_table(results.measured), scenario_table(results.measured)),
        _differences(comparison, results),
        _equivalence(comparison, results),
        section("Figures", *drawn_figures(results, COMPARED)),
        section("Videos", tag("div", [_item(event, results) for event in events], id="videos")),
        section(
            "Settings",
            facts(parts.flat(comparison.settings), "Settings of the comparison"),
            more("Settings of the models", facts(settings, "Settings of the models")),
            tag("p", f"phase_ppl {phase_ppl.__version__}", class_="soft"),
        ),
    )


def _named(results: ComparedResults) -> dict[str, Html]:
    return {observer.name: parts.named(observer) for observer in results.observers}


def _differences(comparison: ModelComparison, results: ComparedResults) -> Html | None:
    named = _named(results)
    rows: list[list[Child]] = [
        [
            [named[row["one"]], " minus ", named[row["other"]]],
            _MEASURES[row["measure"]],
            *_figure(row, "ci_low", "ci_high"),
            number(row["p_holm"], 3),
            str(row["n_events"]),
        ]
        for row in comparison.differences
        if row["scenario"] is None and row["measure"] in _MEASURES
    ]
    if not rows:
        return None
    heads: list[Child] = ["", "", "difference", "95 % interval", "p, corrected", "events"]
    words = "Intervals and p from resampled events; p corrected by Holm over the pairs."
    shown = table(heads, rows, "Paired differences between models")
    return section("Differences", tag("p", words, class_="soft"), shown)


def _equivalence(comparison: ModelComparison, results: ComparedResults) -> Html | None:
    named = _named(results)
    rows: list[list[Child]] = [
        [
            named[row["model"]],
            _MEASURES[row["measure"]],
            *_figure(row, "low", "high"),
            number(row["p_equivalent_holm"], 3),
            number(row["p_holm"], 3),
            row["verdict"],
        ]
        for row in comparison.equivalence
        if row["scenario"] is None
    ]
    if not rows:
        return None
    words = (
        "A model's being right minus the share of people who are right, event by event. "
        "Equivalent: two one-sided tests reject a difference of "
        f"{comparison.settings['margin']:g} or more, after Holm's correction over the models."
    )
    heads: list[Child] = ["", "", "difference", "90 % interval", "p of equivalence",
                          "p of no difference", "verdict"]  # fmt: skip
    shown = table(heads, rows, "Models beside people")
    return section("Equivalence with people", tag("p", words, class_="soft"), shown)


def _figure(row: dict[str, Any], low: str, high: str) -> list[Child]:
    between = None if row[low] is None else f"{number(row[low])} to {number(row[high])}"
    return [number(row["value"]), between]


def _item(event: Event, results: ComparedResults) -> Html:
    shown = [o for o in results.observers if event.id in o.predictions]
    found: list[Child] = [
        parts.film_strip(
            event.observation.trajectory,
            event.scene,
            "Observed",
            f"Film strip of {event.id}, from first to last frame.",
        )
    ]
    for question, title in TITLES.items():
        if any(question in o.predictions[event.id].answers for o in shown):
            found.append(answers_table(event, question, title, shown))
    words = results.scenarios.get(event.id, "truth not known")
    line = tag("span", words, _right(event, shown), class_="marks")
    return tag("details", tag("summary", tag("h3", event.id), line), join(found))


def _right(event: Event, shown: Sequence[Observer]) -> str:
    """Return who is right about all that they answered."""
    if event.truth is None:
        return ""
    given = [(o.label, o.predictions[event.id].answers) for o in shown if o.kind != "people"]
    names = [
        label
        for label, answers in given
        if answers and all(a == true_answer(event, q) for q, a in answers.items())
    ]
    return f" \N{MIDDLE DOT} right in all they answered: {', '.join(names) or 'nobody'}"
