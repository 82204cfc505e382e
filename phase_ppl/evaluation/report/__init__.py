"""Pages that hold everything about a run, an evaluation, a comparison of models or an event."""

from __future__ import annotations

import base64
import functools
import io
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import phase_ppl
from phase_ppl.analysis import figures as plots
from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.analysis.posterior import Posterior, load_posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.analysis.verdict import JUDGED, as_html
from phase_ppl.evaluation.cells import Table, metric_tables, number
from phase_ppl.evaluation.comparison import (
    ModelComparison,
    difference_tables,
    equivalence_tables,
)
from phase_ppl.evaluation.evaluation import COMPARISON, POSTERIOR, SETTINGS, Evaluation
from phase_ppl.evaluation.figures.frame import Results, drawings_of
from phase_ppl.evaluation.prediction import pairs_of, questions_of
from phase_ppl.evaluation.ratings import REHEARSAL, rehearsed
from phase_ppl.evaluation.table import (
    PEOPLE,
    AnswerSet,
    label_of,
    titles_of,
    true_answers,
    true_scenario,
)
from phase_ppl.render.frames import draw_strip
from phase_ppl.render.video import video
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, check_output, write_bytes
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.progress import counted
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

    Drawn = tuple[str, str, Callable[[], Figure]]  # title, words, what draws it

NAME: Final = "report.html"
REPLAY: Final = "replay.mp4"  # the film in the folder of a run

MAX_ROWS: Final = 6  # most goals that are shown of an agent
_WORTH_A_ROW: Final = 0.02  # probability from which on a goal is
_PANELS: Final = 6
_STRIP_WIDTH: Final = 1200  # pixels

INTERVALS: Final = (
    "In brackets: 95 % intervals, of right answers Clopper-Pearson for as many independent answers "
    "as they are worth, of the rest over resampled events."
)
NOTHING_TO_COMPARE: Final = "There is nothing to compare with: neither truth nor judgments."


def report(
    folder: str | os.PathLike[str],
    path: str | os.PathLike[str] | None = None,
    *,
    videos: bool = False,
    progress: bool | None = None,
) -> Path:
    """Write one self-contained HTML page about what a folder holds; return its path.

    The page holds its pictures, films and style, runs no script, and fetches nothing.

    Args:
        folder: of a run, with posterior.nc, of an evaluation, or of a comparison of models.
        path: of the page, ending in .html; default ``report.html`` in the folder.
        videos: film every event of an evaluation as well, some seconds and 0.1 MB each. If a run
            has a film, the page always shows it.
        progress: show a bar over the events on stderr; by default if stderr is a terminal.

    Raises:
        InvalidEventError: the folder is none of these, or a file in it is damaged.
        OutputError: the page cannot be written there, or its name does not end in .html.
    """
    source = as_path(folder)
    target = source / NAME if path is None else as_path(path)
    if not source.is_dir():
        raise InvalidEventError(f"{source}: no such folder")
    of_evaluation = (source / SETTINGS).is_file()
    of_comparison = (source / COMPARISON).is_file()
    if not (of_evaluation or of_comparison or (source / POSTERIOR).is_file()):
        raise InvalidEventError(
            f"{source} holds neither a run (it has no {POSTERIOR}) nor an evaluation (it has no "
            f"{SETTINGS}) nor a comparison (it has no {COMPARISON})"
        )
    check_output(target, (".html",))
    if of_evaluation:
        text = evaluation_page(Evaluation.load(source), videos, progress)
    elif of_comparison:
        text = comparison_page(ModelComparison.load(source), progress=progress)
    else:
        text = run_page(source)
    return write_page(text, target)


def write_page(text: str, path: str | os.PathLike[str]) -> Path:
    """Write a page, whole or not at all; return its path."""
    write_bytes(path, (".html",), text.encode())
    return Path(path)


# --- an event --------------------------------------------------------------------------------


def event_page(event: Event, shown: Sequence[AnswerSet], post: EventPosterior | None = None) -> str:
    """Return the page of an event, with a column for each who said something of it.

    With the model's posterior its best hypothesis' simulation is shown as well.
    """
    truth = "Truth not known."
    if isinstance(event.truth, Hypothesis):
        truth = f"Truth: {event.truth}."
    elif event.truth is not None:
        truth = f"Truth: {event.truth.scenario}, {event.truth.relation}."
    return page(title=event.id, notes=[truth], alone=_item(event, shown, post))


def page_of(evaluation: Evaluation, event_id: str) -> str:
    """Return the page of an event of an evaluation."""
    post = evaluation.posterior(event_id)
    event = next(event for event in evaluation.events if event.id == event_id)
    return event_page(event, evaluation.answers, post)


def rows_of(question: str, shown: Sequence[AnswerSet], event: Event) -> list[str]:
    """Return the answers worth a row: those given, the true one, those probable to somebody.

    Relations are always all shown. Goals are at most :data:`MAX_ROWS`, unless more were given,
    sorted by the highest probability that anybody has for them.
    """
    labels = questions_of(event.scene.world)[question]
    if question in pairs_of(event.scene.world):
        return list(labels)
    made = [answers.predictions[event.id] for answers in shown]
    given = [one.probabilities[question] for one in made if question in one.probabilities]
    highest = np.max([np.zeros(len(labels)), *given], axis=0)
    asked = [true_answers(event).get(question), *(one.answers.get(question) for one in made)]
    order = [labels[i] for i in np.argsort(-highest, kind="stable") if highest[i] >= _WORTH_A_ROW]
    chosen = list(dict.fromkeys([*filter(None, asked), *order]))
    kept = chosen[: max(MAX_ROWS, len({*filter(None, asked)}))]
    return sorted(kept, key=lambda goal: (-highest[labels.index(goal)], labels.index(goal)))


def _item(
    event: Event,
    everybody: Sequence[AnswerSet],
    post: EventPosterior | None = None,
    film: bool = False,
) -> dict[str, Any]:
    """Return what pages show of an event."""
    shown = [one for one in everybody if event.id in one.predictions]
    strips = [_strip("Observed", event.observation.trajectory, event.scene, event.id)]
    replay = None if post is None else post.replay()
    if replay is not None:
        strips.append(_strip("Best hypothesis, simulated", replay, event.scene, event.id))
    tables = [
        (f"{title}: answers about {event.id}", _answers(name, shown, event).rename_axis(title))
        for name, title in titles_of(event.scene.world).items()
        if any(name in one.predictions[event.id].answers for one in shown)
    ]
    told = [true_scenario(event) or _told(event)]
    truth = true_answers(event).items()
    said = {o.label: o.predictions[event.id].answers for o in shown if o.kind != "people"}
    if truth:
        right = [label for label, given in said.items() if given and given.items() <= truth]
        told.append(f"right in all they answered: {', '.join(right) or 'nobody'}")
    if all(one.kind != "model" for one in shown):
        told.append("no prediction")
    return {
        "id": event.id,
        "told": " \N{MIDDLE DOT} ".join(told),
        "film": _film(event, replay) if film else None,
        "strips": strips,
        "tables": tables,
        "verdict": "" if post is None else str(post.diagnostics()["verdict"]),
        "cost": next((o.predictions[event.id].cost for o in shown if o.kind == "model"), {}),
    }


def _answers(question: str, shown: Sequence[AnswerSet], event: Event) -> pd.DataFrame:
    """Return answer x whose it is -> what a page shows of it."""
    true = true_answers(event).get(question)

    def cell(answers: AnswerSet, label: str) -> str:
        given = answers.predictions[event.id]
        if question in given.probabilities:
            return _bar(given.estimate(question, label), answers.colour)
        if question not in given.answers:
            return number(None)
        mark = Markup('<span class="answer" style="background:{}"></span>answer')
        return mark.format(answers.colour) if given.answers[question] == label else ""

    rows = rows_of(question, shown, event)
    named = Markup('<span class="swatch" style="background:{}"></span>{}')
    marked = [
        Markup('{}<span class="true">true</span>').format(r) if r == true else r for r in rows
    ]
    return pd.DataFrame(
        [[cell(answers, label) for answers in shown] for label in rows],
        marked,
        [named.format(answers.colour, answers.label) for answers in shown],
    )


def _bar(value: Any, colour: str) -> Markup:
    """Return a bar and the number beside it, with its error; that of 1 takes 62 % of its column."""
    if value < LEAST:
        return Markup('<span class="soft">0</span>')
    error = getattr(value, "error", np.nan)
    told = number(value) + ("" if np.isnan(error) else f" ± {number(error)}")
    bar = Markup('<span class="bar" style="width:{:.1f}%;background:{}"></span>{}')
    return bar.format(62 * float(value), colour, told)


def _told(event: Event) -> str:
    """Return in a few words what is true of an event that has no scenario."""
    true = true_answers(event)
    pairs = [
        f"{title.removeprefix('Relation of ')} {true[question]}"
        for question, title in titles_of(event.scene.world).items()
        if question in true and question in pairs_of(event.scene.world)
    ]
    return ", ".join(pairs or true.values()) or "truth not known"


def _strip(
    caption: str, trajectory: FloatArray, scene: Scene, event_id: str
) -> tuple[str, Picture]:
    """Return the caption and the film strip of a trajectory (time, entity, coord)."""
    image = draw_strip(trajectory, min(_PANELS, len(trajectory)), scene)
    alt = f"{caption}: film strip of {event_id}, from first to last frame."
    return caption, picture_of(image, alt, _STRIP_WIDTH * image.width // (300 * _PANELS))


def _film(event: Event, replay: FloatArray | None) -> tuple[str, str]:
    words = "Film of the event"
    if replay is not None:
        words += ", beside the best hypothesis, simulated"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        video(event, path, compare=replay)
        return embedded(path.read_bytes(), "video/mp4"), f"{words}."


# --- a run -----------------------------------------------------------------------------------


def run_page(folder: Path) -> str:
    """Return the page of the run of inference in ``folder``."""
    post = load_posterior(folder / POSTERIOR)
    strips = [_strip("Observed", post.observed(), post.scene, post.event_id)]
    replay, beside = post.replay(), "what can be believed until then on the right."
    if replay is not None:
        beside = "the best hypothesis, simulated, on the right."
        strips.append(_strip("Best hypothesis, simulated", replay, post.scene, post.event_id))
    found = post.diagnostics()
    film = _film_of_run(folder / REPLAY, f"Film: the observation on the left, {beside}")
    alt = "Goals, relation, scenario, tracks and strengths, as in the table above."
    decided = _decided(post)
    return page(
        title=f"{post.event_id}: posterior",
        notes=["Who wants what: a posterior over goals, relation and strengths."],
        alone={"film": film, "strips": strips, "tables": [], "cost": {},
               "verdict": Markup(as_html(found))},
        text=str(post),
        drawn=[
            ("The posterior", figure_of(plots.posterior(post), alt)),
            *([("What decided", decided)] if decided else []),
        ],
        records={
            "Best hypothesis": post.map_record(),
            "Diagnostics": {name: value for name, value in found.items() if name not in JUDGED},
            "Cost": post.cost,
            "Settings": post.settings,
        },
    )  # fmt: skip


def _decided(post: Posterior | StepwisePosterior) -> Picture | None:
    """Return the figure of the frames that decided between the two leading answers."""
    asked = next(iter((*post.relations_of.values(), *post.goals_of.values())))
    (best, _), (second, beside_it), *_ = [*post.top(asked, 2), ("", 0.0)]
    if not beside_it > 0:
        return None
    try:
        figure = plots.why(post, f"{asked}={best}", f"{asked}={second}")
    except InvalidEventError:  # a file that holds no likelihood of each frame
        return None
    alt = f"Log odds of {best} over {second} by frame, and the frames that changed them."
    return figure_of(figure, alt)


def _film_of_run(source: Path, words: str) -> tuple[str, str] | None:
    if not source.is_file():
        return None
    try:
        return embedded(source.read_bytes(), "video/mp4"), words
    except OSError as error:
        raise InvalidEventError(f"{source} cannot be read: {error.strerror}") from None


# --- results -------------------------------------------------------------------------------------


def _shown(results: Results, more: Iterable[Drawn] = ()) -> dict[str, Any]:
    """Return what pages show of results: tables of metrics, figures, and why others are not there.

    ``more`` are titles, words and functions that draw figures of something else.
    """
    metrics = {one.name: one.metrics for one in results.measured}
    people = metrics.pop(PEOPLE, None)
    drawn, left_out = [], []
    found: list[Drawn] = [
        (o.title, o.alt, functools.partial(o.draw, results)) for o in drawings_of(results).values()
    ]
    for title, alt, draw in [*found, *more]:
        try:
            drawn.append((title, figure_of(draw(), alt)))
        except InvalidSettingError as reason:
            left_out.append(f"{title}: {reason}.")
    summary = list(metric_tables(list(metrics.items()), people))
    told = INTERVALS if summary else NOTHING_TO_COMPARE
    found_of = {"tables": {"Summary": summary}, "drawn": drawn, "left_out": left_out}
    warning = f"{REHEARSAL[:1].upper()}{REHEARSAL[1:]}." if rehearsed(results.events) else ""
    return {**found_of, "notes": [told], "warning": warning}


def evaluation_page(evaluation: Evaluation, videos: bool, progress: bool | None) -> str:
    """Return the page of an evaluation."""
    state = f"{len(evaluation.predictions)} of {len(evaluation.events)} events predicted"
    if not evaluation.finished:
        state += "; not finished: tables and figures are about these"
    shown = _shown(evaluation)
    events = counted(evaluation.events, progress, "event", "showing")
    return page(
        title=f"Evaluation of {label_of(evaluation.name)}",
        items=[_item(e, evaluation.answers, evaluation.posterior(e.id), videos) for e in events],
        records={
            "Failures": evaluation.failures,
            "Cost": evaluation.cost,
            "Settings": evaluation.settings,
        },
        **{**shown, "notes": [f"{state}.", *shown["notes"]]},
    )


def comparison_page(comparison: ModelComparison, *, progress: bool | None = None) -> str:
    """Return the page of a comparison of models."""
    names = ", ".join(comparison.models)
    about = f"{names} on {len(comparison.events)} events."
    return compared_page(
        comparison, [about, *(f"{note}." for note in comparison.notes)], {}, progress,
        title="Comparison of models",
    )  # fmt: skip


def compared_page(
    comparison: ModelComparison,
    notes: Sequence[str],
    tables: Mapping[str, Sequence[Table]],
    progress: bool | None,
    more: Iterable[Drawn] = (),
    **content: Any,
) -> str:
    """Return a page with all that there is of a comparison, below more notes and tables."""
    shown = _shown(comparison, more)
    models = {one.name: {"folder": one.folder, **one.settings} for one in comparison.entries}
    events = counted(comparison.events, progress, "event", "showing")
    shown["tables"] = {
        **tables,
        **shown["tables"],
        "Differences": difference_tables(comparison),
        "Equivalence with people": equivalence_tables(comparison),
    }
    return page(
        items=[_item(event, comparison.answers) for event in events],
        records={
            "Settings of the comparison": comparison.settings,
            "Settings of the models": models,
        },
        **{**shown, "notes": [*notes, *shown["notes"]], **content},
    )


# --- made from a template (Jinja2), with their pictures and style inside -------------------------
# Whatever it is given becomes text: it is escaped unless it is Markup. The page's policy lets the
# browser fetch nothing and run no script.

COLOURS: Final = 256
"""Colours of pictures of events, flat areas and a few thin lines; fewer change those of items."""

LEAST: Final = 0.005  # probability below which it is 0 to a reader

_SCREEN: Final = 104
"""Pixels on the screen for an inch of a figure: its small print can just be read."""


class Picture(NamedTuple):
    """A picture as part of a page: its content as an address, and its size on the screen."""

    source: str
    alt: str
    width: int
    height: int


def page(title: str, **content: Any) -> str:
    """Return a page of its content, of which the template has sections."""
    parts = ("warning", "notes", "alone", "text", "drawn", "left_out", "items", "records")
    given = {**dict.fromkeys(parts, ""), "tables": {}, **content, "title": title}
    return _environment().get_template("page.html").render(given) + "\n"


def picture_of(image: Image.Image, alt: str, width: int) -> Picture:
    """Return a picture of an event, ``width`` pixels wide at most."""
    small = image
    if image.width > width:
        small = image.resize((width, round(image.height * width / image.width)))
    buffer = io.BytesIO()
    small.quantize(COLOURS).save(buffer, "PNG", optimize=True)
    return Picture(embedded(buffer.getvalue(), "image/png"), alt, small.width, small.height)


def figure_of(figure: Figure, alt: str) -> Picture:
    """Return a matplotlib figure, a little larger than on paper."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=160)
    width, height = (round(inches * _SCREEN) for inches in figure.get_size_inches())
    return Picture(embedded(buffer.getvalue(), "image/png"), alt, width, height)


def embedded(content: bytes, kind: str) -> str:
    """Return an address that holds its content, of a MIME type such as "video/mp4"."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def in_words(value: Any) -> str:
    """Return a plain value, such as of a JSON file, in a line of text."""
    if value is None:
        return number(None)
    if isinstance(value, Mapping):
        return ", ".join(f"{str(k).replace('_', ' ')} {in_words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(in_words(entry) for entry in value) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    return str(value)


def flat(record: Mapping[str, Any]) -> pd.DataFrame:
    """Return the path and the value, in words, of everything in nested mappings."""

    def leaves(given: Mapping[str, Any], above: str) -> Iterator[tuple[str, str]]:
        for key, value in given.items():
            if isinstance(value, Mapping) and value:
                yield from leaves(value, f"{above}{key}.")
            else:
                yield f"{above}{key}", in_words(value)

    found = dict(leaves(record, ""))
    return pd.DataFrame({"value": found.values()}, pd.Index(found, name="name"))


@functools.cache
def _environment() -> Environment:
    loader = PackageLoader(__package__)
    made = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"in_words": in_words, "flat": flat}
    made.globals["style"] = Markup(loader.get_source(made, "page.css")[0])
    made.globals["version"] = phase_ppl.__version__
    return made
