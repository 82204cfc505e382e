"""The page of an evaluation or a comparison of models: tables, figures, who answered what."""

from __future__ import annotations

import base64
import functools
import io
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import phase_ppl
from phase_ppl.evaluation.cells import INTERVALS, metric_tables, number
from phase_ppl.evaluation.comparison import ModelComparison, Source, label_of
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.figures.frame import DRAWINGS
from phase_ppl.evaluation.folder import COMPARISON
from phase_ppl.evaluation.prediction import Prediction, questions_of
from phase_ppl.evaluation.ratings import REHEARSAL, rehearsed
from phase_ppl.evaluation.table import titles_of, true_answers, true_scenario
from phase_ppl.render.frames import draw_strip
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, check_output, write_bytes
from phase_ppl.world.picture import plain
from phase_ppl.world.progress import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

NAME: Final = "report.html"

_WORTH_A_ROW: Final = 0.05  # probability from which on an answer is
_PANELS: Final = 6
_STRIP_WIDTH: Final = 1000  # pixels

NOTHING_TO_COMPARE: Final = "There is nothing to compare with: neither truth nor judgments."


def report(
    folder: str | os.PathLike[str],
    path: str | os.PathLike[str] | None = None,
    *,
    progress: bool | None = None,
) -> Path:
    """Write one self-contained HTML page about what a folder holds; return its path.

    The page holds its pictures and style, runs no script, and fetches nothing.

    Args:
        folder: folder of an evaluation, or of a comparison of models.
        path: the page's file, ending in .html; default ``report.html`` in the folder.
        progress: whether to show a bar over the events on stderr; by default if stderr is a
            terminal.

    Raises:
        InvalidEventError: the folder holds neither, or a file in it is damaged.
        OutputError: the page cannot be written there, or its name does not end in .html.
    """
    source = as_path(folder)
    target = source / NAME if path is None else as_path(path)
    one = (ModelComparison if (source / COMPARISON).is_file() else Evaluation).load(source)
    check_output(target, (".html",))
    if isinstance(one, ModelComparison):
        text = page_of(one, progress=progress)
    else:
        state = f"{len(one.predictions)} of {len(one.events)} events predicted"
        settings = {"failures": one.failures, **one.settings, "cost": one.cost}
        text = page_of(
            one.compared, [f"{state}." if one.finished else f"{state}; not finished."],
            title=f"Evaluation of {label_of(one.name)}", settings=settings, progress=progress,
        )  # fmt: skip
    write_bytes(target, (".html",), text.encode())
    return target


def page_of(
    results: ModelComparison,
    notes: Sequence[str] = (),
    *,
    title: str = "Comparison of models",
    settings: Mapping[str, Any] | None = None,
    progress: bool | None = None,
) -> str:
    """Return a page with all that there is of results, below further notes.

    ``settings`` are of a single evaluation, which is not compared.
    """
    if settings is None:
        found = results.tables
    else:
        found = {"Summary": list(metric_tables(results.metrics, results.people))}
    told = [f"In brackets: {INTERVALS}." if found["Summary"] else NOTHING_TO_COMPARE]
    if settings is None:
        about = f"{', '.join(results.models)} on {len(results.events)} events."
        told = [about, *(f"{note}." for note in results.notes), *told]
        settings = {**results.settings, "models": {o.name: o.settings for o in results.entries}}
    drawn, left_out = [], []
    for one in DRAWINGS.values():
        try:
            drawn.append((one.title, _figure(one.draw(results), one.alt)))
        except InvalidSettingError as reason:
            left_out.append(f"{one.title}: {reason}.")
    warning = f"{REHEARSAL[:1].upper()}{REHEARSAL[1:]}." if rehearsed(results.events) else ""
    content = {
        **{"title": title, "warning": warning, "notes": [*notes, *told]},
        "tables": found,
        **{"drawn": drawn, "left_out": left_out, "version": phase_ppl.__version__},
        "items": [
            _item(e, results.sources) for e in counted(results.events, progress, "event", "showing")
        ],
        "settings": json.dumps(plain(settings), indent=1),
    }
    return _environment().get_template("page.html").render(content) + "\n"


# --- an event ------------------------------------------------------------------------------------


def _item(event: Event, everybody: Sequence[Source]) -> dict[str, Any]:
    """Return what the page shows of an event."""
    said = {one: one.predictions[event.id] for one in everybody if event.id in one.predictions}
    image = draw_strip(event, min(_PANELS, event.observation.n_frames))
    true, titles = true_answers(event), titles_of(event.scene.world)
    told = [true_scenario(event) or ", ".join(true.values()) or "truth not known"]
    models = {one.label: given.answers for one, given in said.items() if one.kind != "people"}
    if true:
        right = [name for name, given in models.items() if given and given.items() <= true.items()]
        told.append(f"right in all they answered: {', '.join(right) or 'nobody'}")
    if all(one.kind != "model" for one in said):
        told.append("no prediction")
    return {
        "id": event.id,
        "told": " \N{MIDDLE DOT} ".join(told),
        "strip": _picture(image, f"Film strip of {event.id}, from first to last frame."),
        "tables": [
            answers_table(
                name, {one.label: given for one, given in said.items()}, event
            ).rename_axis(title)
            for name, title in titles.items()
            if any(name in given.answers for given in said.values())
        ],
    }


def answers_table(question: str, said: Mapping[str, Prediction], event: Event) -> pd.DataFrame:
    """Return answer x whose it is -> its probability, with the error where that is known.

    Rows are the answers given, the true one, and those probable to somebody.
    """
    true = true_answers(event).get(question)

    def cell(given: Prediction, label: str) -> str:
        if question not in given.probabilities:
            return "answer" if given.answers.get(question) == label else ""
        value = given.estimate(question, label)
        return number(value) + ("" if np.isnan(value.error) else f" ± {number(value.error)}")

    labels = questions_of(event.scene.world)[question]
    given = [one.probabilities[question] for one in said.values() if question in one.probabilities]
    highest = np.max([np.zeros(len(labels)), *given], axis=0)
    asked = {true, *(one.answers.get(question) for one in said.values())}
    pairs = zip(labels, highest, strict=True)
    rows = [label for label, p in pairs if p >= _WORTH_A_ROW or label in asked]
    return pd.DataFrame(
        {name: [cell(given, label) for label in rows] for name, given in said.items()},
        [f"{label} (true)" if label == true else label for label in rows],
    )


# --- made from a template (Jinja2), with their pictures and style inside -------------------------
# Whatever it is given becomes text: it is escaped. The page's policy lets the browser fetch nothing
# and run no script.

_COLOURS: Final = 256
"""Colours of pictures of events, flat areas and a few thin lines; fewer change those of items."""

_SCREEN: Final = 104
"""Pixels on the screen for an inch of a figure: its small print can just be read."""


class Picture(NamedTuple):
    """A picture as part of a page: its content as an address, and its size on the screen."""

    source: str
    alt: str
    width: int
    height: int


def _picture(image: Image.Image, alt: str) -> Picture:
    """Return a film strip."""
    width = min(image.width, _STRIP_WIDTH)
    small = image.resize((width, round(image.height * width / image.width)))
    buffer = io.BytesIO()
    small.quantize(_COLOURS).save(buffer, "PNG", optimize=True)
    return Picture(_embedded(buffer), alt, small.width, small.height)


def _figure(figure: Figure, alt: str) -> Picture:
    """Return a matplotlib figure, a little larger than on paper."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=160)
    width, height = (round(inches * _SCREEN) for inches in figure.get_size_inches())
    return Picture(_embedded(buffer), alt, width, height)


def _embedded(picture: io.BytesIO) -> str:
    """Return an address that holds its content."""
    return f"data:image/png;base64,{base64.b64encode(picture.getvalue()).decode()}"


@functools.cache
def _environment() -> Environment:
    made = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["table"] = _table
    return made


def _table(cells: pd.DataFrame) -> Markup:
    """Return a table; pandas escapes its texts."""
    with pd.option_context("display.max_colwidth", None):
        return Markup(cells.to_html(border=0))
