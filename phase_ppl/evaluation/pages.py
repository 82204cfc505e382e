"""A page per video: what happens in it, and what people and models say about it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.style import INK, NORMAL, SMALL, written
from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.observers import Observer, observers
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.evaluation.sheet import GREY, WIDTH, Sheet, fitting, in_lines
from phase_ppl.evaluation.tables import true_answer
from phase_ppl.render.stills import draw_strip
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.relations import RELATIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

TITLES: Final = {
    "goal_red": "Goal of the red agent",
    "goal_green": "Goal of the green agent",
    "relation": "Relation",
}
"""Question -> how it is put to a reader."""

MAX_ROWS: Final = 6
"""Most goals that are shown of an agent."""

_LEAST: Final = 0.02
"""Probability from which on a goal is worth a row."""

_STRIP_PANELS: Final = 6
_HEAD: Final = 0.42
_LEFT: Final = 2.27
_ROW: Final = 0.175
_HEADING: Final = 0.30
_OVER_STRIP: Final = 0.23
_NAMES: Final = 0.28
_LINE: Final = 0.12
_COLUMN: Final = 0.82
_NUMBER: Final = 0.36
_LEAST_NUMBER: Final = 0.005
_NOTE: Final = 0.25
_DIAMOND: Final = "\N{BLACK DIAMOND}"
_NONE: Final = "\N{EN DASH}"
_TRUE: Final = "#f3ecd2"
"""Band behind the true answer."""


def draw_page(
    folder: ResultsFolder, event_id: str, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw the page of an event; write it to ``path`` (.png, .pdf, .svg) as well.

    Film strips of the event and, where the folder of the event has a posterior, of the best
    hypothesis' stored simulation; below, what people and every model answer, a column each. The
    true answers are marked where they are known.

    Raises:
        UnknownNameError: the evaluation has no such event.
        InvalidEventError: a file of the event is damaged.
        OutputError: it cannot be written there, or the ending is another.
    """
    event = next((event for event in folder.events if event.id == event_id), None)
    if event is None:
        raise unknown_name("event", event_id, [event.id for event in folder.events])
    shown = [one for one in observers(folder, [event]) if event_id in one.predictions]
    return written(page_of(event, shown, best_simulation(folder, event_id)), path)


def best_simulation(folder: ResultsFolder, event_id: str) -> FloatArray | None:
    """Return the best hypothesis' simulation (time, entity, coord); None without one.

    Raises:
        InvalidEventError: the posterior is damaged.
    """
    source = folder.folder_of(event_id) / POSTERIOR
    if not source.is_file():
        return None
    from phase_ppl.analysis.load import load_posterior
    from phase_ppl.analysis.posterior import Posterior

    post = load_posterior(source)
    return post.replay() if isinstance(post, Posterior) else None


def rows_of(question: str, shown: Sequence[Observer], event: Event) -> list[str]:
    """Return the answers worth a row: those given, the true one, those probable to somebody.

    Relations are always all shown. Goals are at most :data:`MAX_ROWS`, unless more were given,
    sorted by the highest probability that anybody has for them.
    """
    if question == "relation":
        return list(RELATIONS)
    labels = QUESTIONS[question]
    highest = np.zeros(len(labels))
    asked: list[str] = [answer for answer in [true_answer(event, question)] if answer]
    for observer in shown:
        prediction = observer.predictions[event.id]
        if question in prediction.answers:
            asked.append(prediction.answers[question])
        if question in prediction.probabilities:
            highest = np.maximum(highest, prediction.probabilities[question])
    order = [labels[i] for i in np.argsort(-highest, kind="stable") if highest[i] >= _LEAST]
    chosen = list(dict.fromkeys([*asked, *order]))
    kept = chosen[: max(MAX_ROWS, len(set(asked)))]
    return sorted(kept, key=lambda goal: (-highest[labels.index(goal)], labels.index(goal)))


def page_of(event: Event, shown: Sequence[Observer], replay: FloatArray | None = None) -> Figure:
    """Draw what those say about an event who are shown, each of whom said something.

    Args:
        event: it.
        shown: a column each; with many the page becomes wider.
        replay: a simulation (time, entity, coord) to be shown as well.
    """
    questions = [
        name for name in QUESTIONS if any(name in o.predictions[event.id].answers for o in shown)
    ]
    rows = {name: rows_of(name, shown, event) for name in questions}
    n = min(_STRIP_PANELS, event.observation.n_frames)
    strips = [("observed", np.asarray(draw_strip(event, n)))]
    if replay is not None:
        simulated = draw_strip(replay, min(n, len(replay)), event.scene)
        strips.append(("best hypothesis, simulated", np.asarray(simulated)))
    width = _page_width(len(shown))
    inches = width / strips[0][1].shape[1]  # per pixel, the same for both
    height = _HEAD + sum(picture.shape[0] * inches + _OVER_STRIP for _, picture in strips) + 0.12
    if questions:
        height += (
            _names_height(shown) + sum(_block_height(rows[name]) for name in questions) + _NOTE
        )
    sheet = Sheet(width, height)
    sheet.write(0.1, 0.24, event.id, size=fitting(event.id, 4.6, 10), weight="bold")
    sheet.write(width - 0.1, 0.24, _truth_in_words(event), colour=GREY, ha="right")
    top = _HEAD
    for name, picture in strips:
        sheet.write(0.1, top + 0.14, name, colour=GREY)
        top += _OVER_STRIP
        size = picture.shape[0] * inches
        axes = sheet.axes(0.0, top, picture.shape[1] * inches, size)
        axes.imshow(picture, interpolation="antialiased")
        axes.set_axis_off()
        top += size
    if questions:
        _answers(sheet, top, rows, shown, event)
    return sheet.figure


def _answers(
    sheet: Sheet, top: float, rows: dict[str, list[str]], shown: Sequence[Observer], event: Event
) -> None:
    """Draw all questions below ``top`` inches, under the names of the observers."""
    width = _column_width(len(shown))
    names = [in_lines(observer.label, width - 0.06) for observer in shown]
    size = min(fitting(line, width - 0.06) for lines in names for line in lines)
    top += _names_height(shown)
    for place, (observer, lines) in enumerate(zip(shown, names, strict=True)):
        for line, text in enumerate(reversed(lines)):
            sheet.write(
                _LEFT + place * width, top - 0.08 - _LINE * line, text, size=size,
                colour=observer.colour, weight="bold",
            )  # fmt: skip
    for question, labels in rows.items():
        sheet.write(0.1, top + 0.19, TITLES[question], size=NORMAL + 0.5)
        _block(sheet, top + _HEADING, question, labels, shown, event)
        top += _block_height(labels)
    note = _note(list(rows), shown, event.id)
    sheet.write(_LEFT, top + 0.22, note, size=SMALL - 0.5, colour=GREY)


def _block(
    sheet: Sheet,
    top: float,
    question: str,
    labels: Sequence[str],
    shown: Sequence[Observer],
    event: Event,
) -> None:
    """Draw one question: a row per answer, a column per observer."""
    truth = true_answer(event, question)
    width = _column_width(len(shown))
    if truth is not None:
        band = sheet.axes(0.06, top + _ROW * labels.index(truth), sheet.width - 0.12, _ROW)
        band.set_facecolor(_TRUE)
        band.tick_params(left=False, bottom=False, labelleft=False, labelbottom=False)
        for spine in band.spines.values():
            spine.set_visible(False)
    for row, label in enumerate(labels):
        text = f"{label}  (true)" if label == truth else label
        y = top + _ROW * (row + 0.5)
        sheet.write(_LEFT - 0.1, y, text, ha="right", va="center_baseline", size=SMALL)
    for place, observer in enumerate(shown):
        # beside the longest bar there is room for its number
        axes = sheet.axes(_LEFT + place * width, top, width - _NUMBER, _ROW * len(labels))
        axes.set_facecolor("none")
        axes.set_xlim(0, 1)
        axes.set_ylim(len(labels) - 0.5, -0.5)
        axes.set_axis_off()
        _column(axes, question, labels, observer, event.id)


def _column(
    axes: Axes, question: str, labels: Sequence[str], observer: Observer, event_id: str
) -> None:
    prediction = observer.predictions[event_id]
    values = prediction.probabilities.get(question)
    answer = prediction.answers.get(question)
    if answer is None:
        axes.text(0, (len(labels) - 1) / 2, _NONE, fontsize=SMALL, color=GREY, va="center")
        return
    axes.plot([0, 0], [-0.5, len(labels) - 0.5], color="#bbbbbb", lw=0.7, clip_on=False)
    if values is None:
        # an answer without probabilities: where it is, not how sure
        row = labels.index(answer)
        axes.plot([0.1], [row], "D", ms=4, color=observer.colour, clip_on=False)
        return
    for row, label in enumerate(labels):
        value = float(values[QUESTIONS[question].index(label)])
        axes.barh(row, value, height=0.68, color=observer.colour, lw=0)
        if value >= _LEAST_NUMBER:
            axes.annotate(
                f"{value:.2f}", (value, row), (2.5, 0), textcoords="offset points",
                fontsize=SMALL - 0.5, va="center", color=INK, annotation_clip=False,
            )  # fmt: skip


def _note(questions: Sequence[str], shown: Sequence[Observer], event_id: str) -> str:
    """Return the key to the signs that the columns need."""
    given = [o.predictions[event_id] for o in shown]
    pairs = [(prediction, question) for prediction in given for question in questions]
    words = []
    if any(q in p.answers and q not in p.probabilities for p, q in pairs):
        words.append(f"{_DIAMOND} answer without probabilities")
    if any(q not in p.answers for p, q in pairs):
        words.append(f"{_NONE} no answer")
    return "     ".join(words)


def _truth_in_words(event: Event) -> str:
    if event.truth is None:
        return "truth not known"
    return f"truth: {event.truth.scenario}, {event.truth.relation}"


def _block_height(labels: Sequence[str]) -> float:
    return _HEADING + _ROW * len(labels)


def _column_width(n: int) -> float:
    return min(1.25, (_page_width(n) - _LEFT - 0.05) / max(n, 1))


def _page_width(n: int) -> float:
    return max(WIDTH, _LEFT + _COLUMN * n + 0.05)


def _names_height(shown: Sequence[Observer]) -> float:
    width = _column_width(len(shown)) - 0.06
    return _NAMES + _LINE * (max(len(in_lines(o.label, width)) for o in shown) - 1)
