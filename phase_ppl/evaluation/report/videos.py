"""The part of a report that shows every event."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from phase_ppl.analysis.load import load_posterior
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.evaluation.figures.results import FolderResults
from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.observers import Observer
from phase_ppl.evaluation.pages import TITLES, rows_of
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.report import parts
from phase_ppl.evaluation.report.html import (
    Child,
    Html,
    film,
    join,
    more,
    number,
    section,
    table,
    tag,
)
from phase_ppl.evaluation.tables import true_answer
from phase_ppl.inference.runs.progress import counted
from phase_ppl.render.video import video
from phase_ppl.world.event import Event
from phase_ppl.world.relations import SCENARIOS

OUTCOMES: Final = {
    "right": "all right",
    "wrong": "something wrong",
    "unknown": "truth not known",
    "none": "no prediction",
}
"""What became of an event -> how the filter calls it."""

ORDERS: Final = {
    "file": "order of the file",
    "surprise": "least belief in the truth first",
    "name": "name",
}

_SHORT: Final = {"goal_red": "red's goal", "goal_green": "green's goal", "relation": "relation"}


def videos_section(results: FolderResults, *, films: bool, progress: bool | None) -> Html:
    """Return a folded part per event, which a line of menus sorts and filters.

    Args:
        results: of the evaluation.
        films: film every event.
        progress: show a bar over the events; None: where stderr is a terminal.
    """
    items = [
        _item(event, results, films=films)
        for event in counted(results.events, progress, "event", "showing")
    ]
    return section("Videos", _filters(results), tag("div", items, id="videos"))


def _filters(results: FolderResults) -> Html:
    """Return the menus; they stay hidden where no script runs."""
    present = [name for name in SCENARIOS if name in results.scenarios.values()]
    return tag(
        "form",
        _menu("scenario", "Scenario", {"": "all", **{name: name for name in present}}),
        _menu("outcome", "Answers", {"": "all", **OUTCOMES}),
        _menu("order", "Order", ORDERS),
        tag("button", "Open or close all", type="button", name="all"),
        tag("output", name="count", role="status"),
        id="filters",
        hidden=True,
    )


def _menu(name: str, label: str, choices: dict[str, str]) -> Html:
    options = [tag("option", words, value=value) for value, words in choices.items()]
    return tag("label", f"{label} ", tag("select", options, name=name))


def _item(event: Event, results: FolderResults, *, films: bool) -> Html:
    shown = [o for o in results.observers if event.id in o.predictions]
    own = next((o.predictions[event.id] for o in shown if o.kind == "model"), None)
    outcome, marks = _outcome(event, own)
    belief = _belief(event, own)
    scenario = results.scenarios.get(event.id, "")
    line = tag("span", scenario or "truth not known", marks, class_="marks")
    return tag(
        "details",
        tag("summary", tag("h3", event.id), line),
        _content(event, shown, own, results.folder, films=films),
        data_name=event.id,
        data_scenario=scenario,
        data_outcome=outcome,
        data_belief=None if belief is None else f"{belief:.6f}",
    )


def _outcome(event: Event, own: Prediction | None) -> tuple[str, Html]:
    """Return the key of the outcome, and the answers with what they are."""
    if own is None:
        return "none", join(" \N{MIDDLE DOT} ", tag("span", "no prediction", class_="bad"))
    right = {q: answer == true_answer(event, q) for q, answer in own.answers.items()}
    if event.truth is None or not right:
        return "unknown", Html("")
    marks: list[Child] = []
    for question, good in right.items():
        words = f"{_SHORT[question]} {'right' if good else 'wrong'}"
        marks += [" \N{MIDDLE DOT} ", tag("span", words, class_="good" if good else "bad")]
    return ("right" if all(right.values()) else "wrong"), join(marks)


def _belief(event: Event, own: Prediction | None) -> float | None:
    """Return the product of the probabilities of the true answers; None where unknown."""
    if event.truth is None or own is None or not own.probabilities:
        return None
    belief = 1.0
    for question, values in own.probabilities.items():
        belief *= float(values[QUESTIONS[question].index(str(true_answer(event, question)))])
    return belief


def _content(
    event: Event,
    shown: Sequence[Observer],
    own: Prediction | None,
    folder: ResultsFolder,
    *,
    films: bool,
) -> Html:
    stored = folder.folder_of(event.id) / POSTERIOR
    post = load_posterior(stored) if own is not None and stored.is_file() else None
    sampled = post if isinstance(post, Posterior) else None
    found: list[Child] = []
    replay = None if sampled is None else sampled.replay()
    if films:
        words = "Film of the event"
        if replay is not None:
            words += ", beside the best hypothesis, simulated"
        found.append(tag("figure", film(_film(event, replay), f"{words}."), class_="film"))
    alt = f"Film strip of {event.id}, from first to last frame."
    trajectory = event.observation.trajectory
    found.append(parts.film_strip(trajectory, event.scene, "Observed", alt))
    if replay is not None:
        alt = f"Film strip of a simulation of {event.id}, from first to last frame."
        caption = "Best hypothesis, simulated"
        found.append(parts.film_strip(replay, event.scene, caption, alt))
    for question, title in TITLES.items():
        if any(question in o.predictions[event.id].answers for o in shown):
            found.append(answers_table(event, question, title, shown))
    if sampled is not None:
        found.append(tag("p", str(sampled.diagnostics()["verdict"]), class_="verdict"))
    if own is not None and own.cost:
        found.append(more("Cost", tag("p", parts.in_words(own.cost), class_="soft")))
    return join(found)


def answers_table(event: Event, question: str, title: str, shown: Sequence[Observer]) -> Html:
    """Return a table: a row per answer, a column per observer."""
    truth = true_answer(event, question)
    heads: list[Child] = [title, *map(parts.named, shown)]
    rows: list[list[Child]] = []
    for answer in rows_of(question, shown, event):
        mark = tag("span", "true", class_="true") if answer == truth else None
        cells: list[Child] = [_cell(o, question, answer, event.id) for o in shown]
        rows.append([[answer, mark], *cells])
    return table(heads, rows, f"{title}: answers about {event.id}", class_="answers")


def _cell(observer: Observer, question: str, answer: str, event_id: str) -> Child:
    prediction = observer.predictions[event_id]
    if question in prediction.probabilities:
        value = float(prediction.probabilities[question][QUESTIONS[question].index(answer)])
        return parts.bar(value, observer.colour)
    if question not in prediction.answers:
        return tag("span", number(None), class_="soft")
    if prediction.answers[question] != answer:
        return None
    # an answer without probabilities: where it is, not how sure
    diamond = tag("span", class_="answer", style=f"background:{observer.colour}")
    return [diamond, "answer"]


def _film(event: Event, replay: Any) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        video(event, path, compare=replay)
        return path.read_bytes()
