"""Pages that hold everything about a run, an evaluation, a comparison of models or an event."""

from __future__ import annotations

import base64
import functools
import hashlib
import io
import itertools
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import phase_ppl
from phase_ppl.analysis import figures as plots
from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.analysis.figures.posterior import titles
from phase_ppl.analysis.hypotheses import HDI_PROBABILITY
from phase_ppl.analysis.posterior import Posterior, load_posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.analysis.verdict import JUDGED, as_html
from phase_ppl.evaluation.answer_sets import MODEL_COLOUR, PEOPLE, AnswerSet, label_of
from phase_ppl.evaluation.arrays import titles_of, true_answers, true_scenario
from phase_ppl.evaluation.cells import metric_tables, number
from phase_ppl.evaluation.comparison import (
    ModelComparison,
    difference_tables,
    equivalence_tables,
)
from phase_ppl.evaluation.evaluation import COMPARISON, POSTERIOR, SETTINGS, Evaluation
from phase_ppl.evaluation.figures import drawings_of
from phase_ppl.evaluation.figures.rows import NothingToDrawError, Results, scenarios_of
from phase_ppl.evaluation.paper import LOOSE, NO_REPRODUCTION, NOT_DRAWN, VERDICTS, Reproduction
from phase_ppl.evaluation.prediction import Prediction, pairs_of, questions_of
from phase_ppl.render.frames import draw_strip
from phase_ppl.render.video import video
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, check_name
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, check_output, write_bytes
from phase_ppl.world.hypothesis import ALPHA_WORDS, ALPHAS, SCENARIOS, Roles
from phase_ppl.world.picture import trail_colour
from phase_ppl.world.progress import counted
from phase_ppl.world.scene import PHASE, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

NAME: Final = "report.html"
REPLAY: Final = "replay.mp4"  # the film in the folder of a run

MAX_ROWS: Final = 6  # most goals that are shown of an agent
_WORTH_A_ROW: Final = 0.02  # probability from which on a goal is
_PANELS: Final = 6
_STRIP_WIDTH: Final = 1200  # pixels
_DIAGNOSTICS: Final = {
    "kernel": "kernel",
    "validity": "validity",
    "weights": "weights",
    "particles": "particles",
    "iterations": "iterations",
    "acceptance_rate": "proposals accepted",
    "move_rate": "iterations with a change of goals",
    "distinct_goal_pairs": "distinct pairs of goals",
    "agreement": "particles that agree on the goal",
    "monte_carlo_error": "Monte-Carlo error of the leading goal",
    "simulations": "simulations",
    "frames_saved_share": "frames saved by stopping early",
    "best_error_per_frame": "error of the best draw, units per frame",
    "planner_seeds": "sets of searches",
    "surprising_share": "frames that surprise whatever the goals",
}
"""Diagnostic -> how it is called where a few are shown."""

_OUTCOMES: Final = {
    "right": "all right",
    "wrong": "something wrong",
    "unknown": "truth not known",
    "none": "no prediction",
}
"""What became of an event -> how the filter calls it."""

_ORDERS: Final = {
    "file": "order of the file",
    "surprise": "least belief in the truth first",
    "name": "name",
}


def report(
    folder: str | os.PathLike[str],
    path: str | os.PathLike[str] | None = None,
    *,
    videos: bool = False,
    progress: bool | None = None,
) -> Path:
    """Write one self-contained HTML page about what a folder holds; return its path.

    The page holds its pictures, films, style and script, and fetches nothing.

    Args:
        folder: of a run, with posterior.nc, of an evaluation, or of a comparison of models.
        path: of the page, ending in .html; default ``report.html`` in the folder.
        videos: film every event of an evaluation as well, some seconds and 0.1 MB each. A film
            that a run has is always there.
        progress: whether to show a bar over the events on stderr; by default where that is a
            terminal.

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


class Question(NamedTuple):
    """What all answer to a question about an event: a row per answer, a column each."""

    name: str
    title: str
    rows: Sequence[str]
    truth: str | None
    answers: Sequence[AnswerSet]


def event_page(event: Event, shown: Sequence[AnswerSet], post: EventPosterior | None = None) -> str:
    """Return the page of an event, with a column for each who said something of it.

    With the model's posterior its best hypothesis' simulation is shown as well.
    """
    truth = "Truth not known."
    if isinstance(event.truth, Roles):
        truth = f"Truth: {event.truth}."
    elif event.truth is not None:
        truth = f"Truth: {event.truth.scenario}, {event.truth.relation}."
    return page("event.html", title=event.id, truth=truth, item=_item(event, shown, post))


def page_of(evaluation: Evaluation, event_id: str) -> str:
    """Return the page of an event of an evaluation."""
    events = {event.id: event for event in evaluation.events}
    check_name("event", event_id, events)
    return event_page(events[event_id], evaluation.answers, _posterior(evaluation, event_id))


def rows_of(question: str, shown: Sequence[AnswerSet], event: Event) -> list[str]:
    """Return the answers worth a row: those given, the true one, those probable to somebody.

    Relations are always all shown. Goals are at most :data:`MAX_ROWS`, unless more were given,
    sorted by the highest probability that anybody has for them.
    """
    labels = questions_of(event.scene.world)[question]
    if question in pairs_of(event.scene.world):
        return list(labels)
    highest = np.zeros(len(labels))
    truth = true_answers(event)
    asked = [truth[question]] if question in truth else []
    for answers in shown:
        prediction = answers.predictions[event.id]
        if question in prediction.answers:
            asked.append(prediction.answers[question])
        if question in prediction.probabilities:
            highest = np.maximum(highest, prediction.probabilities[question])
    order = [labels[i] for i in np.argsort(-highest, kind="stable") if highest[i] >= _WORTH_A_ROW]
    chosen = list(dict.fromkeys([*asked, *order]))
    kept = chosen[: max(MAX_ROWS, len(set(asked)))]
    return sorted(kept, key=lambda goal: (-highest[labels.index(goal)], labels.index(goal)))


def _item(
    event: Event,
    everybody: Sequence[AnswerSet],
    post: EventPosterior | None = None,
    film: bool = False,
) -> dict[str, Any]:
    """Return what pages show of an event: ``right`` are those right in all they answered.

    What is not known is None, or empty.
    """
    shown = [one for one in everybody if event.id in one.predictions]
    given = {one.label: one.predictions[event.id].answers for one in shown if one.kind != "people"}
    trajectory = event.observation.trajectory
    strips = [_strip("Observed", trajectory, event.scene, event.id)]
    replay = None if post is None else post.replay()
    if replay is not None:
        strips.append(_strip("Best hypothesis, simulated", replay, event.scene, event.id))
    truth = true_answers(event)
    questions = [
        Question(name, title, rows_of(name, shown, event), truth.get(name), shown)
        for name, title in titles_of(event.scene.world).items()
        if any(name in one.predictions[event.id].answers for one in shown)
    ]
    scenario = true_scenario(event) or ""
    right = [label for label, said in given.items() if said and said.items() <= truth.items()]
    return {
        "id": event.id,
        "scenario": scenario,
        "told": scenario or _told(event),
        "film": _film(event, replay) if film else None,
        "strips": strips,
        "questions": questions,
        "verdict": "" if post is None else str(post.diagnostics()["verdict"]),
        "cost": next((o.predictions[event.id].cost for o in shown if o.kind == "model"), {}),
        "right": None if event.truth is None else right,
    }


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


def _posterior(evaluation: Evaluation, event_id: str) -> EventPosterior | None:
    """Return the posterior of an event, if that is how it was predicted."""
    folder = evaluation.folder
    source = None if folder is None else folder.folder_of(event_id) / POSTERIOR
    return load_posterior(source) if source is not None and source.is_file() else None


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
    few = [
        (words, f"{found[name]:.0%}" if name.endswith(("_rate", "_share")) else in_words(v))
        for name, words in _DIAGNOSTICS.items()
        if (v := found.get(name)) is not None
    ]
    best_record = post.map_record()
    if post.scene.world == PHASE:
        best_record["alpha"] = ALPHA_WORDS[ALPHAS.index(post.map().alpha)]
    alt = "Goals, relation, scenario, tracks and strengths, as listed above."
    return page(
        "run.html",
        title=f"{post.event_id}: posterior",
        heading=post.event_id,
        film=_film_of_run(folder / REPLAY, f"Film: the observation on the left, {beside}"),
        strips=strips,
        bars=list(_bars(post)),
        strengths=[(agent, _strength(post, name)) for agent, name in post.strengths_of.items()],
        best=best_record,
        verdict=Markup(as_html(found)),
        posterior=figure_of(plots.posterior(post), alt),
        decided=_decided(post),
        few=few,
        rest={name: value for name, value in found.items() if name not in JUDGED},
        cost=post.cost,
        settings=post.settings,
    )


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


def _bars(
    post: Posterior | StepwisePosterior,
) -> Iterator[tuple[str, str, Sequence[tuple[str, float]]]]:
    """Yield title, colour and the most probable answers of each quantity."""
    named = titles(post) | {name: label.capitalize() for label, name in post.scenarios_of.items()}
    agents = dict(zip(post.goals_of.values(), post.scene.world.entity_colours, strict=False))
    for name, title in named.items():
        least = LEAST if name in agents else 0.0
        entries = [entry for entry in post.top(name, MAX_ROWS) if entry[1] >= least]
        colour = f"rgb{trail_colour(agents[name])}" if name in agents else MODEL_COLOUR
        yield title, colour, entries


def _strength(post: Posterior | StepwisePosterior, name: str) -> str:
    low, high = post.hdi(name).values
    return f"{post.mean(name)} N ({HDI_PROBABILITY:.0%} interval {low:.0f} to {high:.0f} N)"


# --- an evaluation ---------------------------------------------------------------------------


def _shown(results: Results) -> dict[str, Any]:
    """Return what pages show of results.

    ``tables`` of metrics, ``answers``, whose they are about, by name; ``drawn``, the figures that
    the results allow with their titles, and ``left_out``, why others are not there.
    """
    answers = {one.name: one for one in results.measured}
    models = [(name, one.metrics) for name, one in answers.items() if name != PEOPLE]
    people = answers[PEOPLE].metrics if PEOPLE in answers else None
    drawn, left_out = [], []
    for drawing in drawings_of(results).values():
        try:
            drawn.append((drawing.title, figure_of(drawing.draw(results), drawing.alt)))
        except NothingToDrawError as reason:
            left_out.append(f"{drawing.title}: {reason}.")
    tables = list(metric_tables(models, people))
    return {"tables": tables, "answers": answers, "drawn": drawn, "left_out": left_out}


def evaluation_page(evaluation: Evaluation, videos: bool, progress: bool | None) -> str:
    """Return the page of an evaluation."""
    scenarios = scenarios_of(evaluation)
    state = f"{len(evaluation.predictions)} of {len(evaluation.events)} events predicted"
    if not evaluation.finished:
        state += "; not finished: tables and figures are about these"
    present = {name: name for name in SCENARIOS if name in scenarios.values()}
    items = []
    for event in counted(evaluation.events, progress, "event", "showing"):
        item = _item(event, evaluation.answers, _posterior(evaluation, event.id), videos)
        items.append({**item, **_outcome(event, evaluation.predictions.get(event.id))})
    return page(
        "evaluation.html",
        title=f"Evaluation of {label_of(evaluation.name)}",
        state=f"{state}.",
        failures=[(event_id, in_words(what)) for event_id, what in evaluation.failures.items()],
        menus=[
            *([("scenario", "Scenario", {"": "all", **present})] if present else []),
            ("outcome", "Answers", {"": "all", **_OUTCOMES}),
            ("order", "Order", _ORDERS),
        ],
        items=items,
        cost=evaluation.cost,
        settings=evaluation.settings,
        **_shown(evaluation),
    )


def _outcome(event: Event, own: Prediction | None) -> dict[str, Any]:
    """Return what became of the model's answers about an event.

    ``outcome`` is one of those that the filter knows, ``marks`` what became of each answer with the
    class of its style, ``belief`` the product of the probabilities of the true answers.
    """
    if own is None:
        return {"outcome": "none", "marks": [("no prediction", "bad")], "belief": None}
    truth = true_answers(event)
    right = {q: answer == truth.get(q) for q, answer in own.answers.items()}
    if not truth or not right:
        return {"outcome": "unknown", "marks": [], "belief": None}
    belief = None
    if own.probabilities:
        belief = float(np.prod([own.estimate(q, truth[q]) for q in own.probabilities]))
    return {
        "outcome": "right" if all(right.values()) else "wrong",
        "marks": [
            (f"{_short(q)} {'right' if good else 'wrong'}", "good" if good else "bad")
            for q, good in right.items()
        ],
        "belief": belief,
    }


def _short(question: str) -> str:
    """Return what a question is about, such as "red's goal"."""
    agent = question.removeprefix("goal_")
    return question.replace("_", " ") if agent == question else f"{agent}'s goal"


# --- a comparison ----------------------------------------------------------------------------


def comparison_page(comparison: ModelComparison, *, progress: bool | None = None) -> str:
    """Return the page of a comparison of models."""
    labels = {answers.name: answers.label for answers in comparison.answers}
    return page(
        "comparison.html",
        title="Comparison of models",
        # a model that predicts nothing has no answers
        names=[labels.get(name) or label_of(name) for name in comparison.models],
        notes=comparison.notes,
        differences=difference_tables(comparison),
        equivalence=equivalence_tables(comparison),
        settings=comparison.settings,
        **_compared(comparison, progress),
    )


def _compared(comparison: ModelComparison, progress: bool | None) -> dict[str, Any]:
    """Return what is shown of a comparison, its models' settings, and what they said of events."""
    settings = {one.name: {"folder": one.folder, **one.settings} for one in comparison.entries}
    events = counted(comparison.events, progress, "event", "showing")
    return {
        **_shown(comparison),
        "items": [_item(event, comparison.answers) for event in events],
        "settings_of_models": list(flat(settings)),
    }


# --- the paper, cell by cell -----------------------------------------------------------------


def reproduction_page(made: Reproduction, *, progress: bool | None = None) -> str:
    """Return the page of a reproduction."""
    shown = _compared(made.comparison, progress)
    for title, alt, draw in made.drawn:
        try:
            shown["drawn"].append((title, figure_of(draw(), alt)))
        except InvalidSettingError as reason:
            shown["left_out"].append(f"{title}: {reason}.")
    shown["left_out"].append(f"{NOT_DRAWN}.")
    return page(
        "reproduction.html",
        title="The paper, cell by cell" if made.real else "No reproduction: a try",
        warning="" if made.real else NO_REPRODUCTION,
        notes=made.notes,
        places=[
            (place, [(one, label_of(one.label)) for one in rows])
            for place, rows in itertools.groupby(made.cells, lambda one: one.printed.place)
        ],
        counts=[(kind, sum(one.verdict == kind for one in made.cells)) for kind in VERDICTS],
        loose=LOOSE,
        **shown,
    )


# --- made from templates (Jinja2), with their pictures, style and script inside -------------------
# Whatever a template is given becomes text: it is escaped unless a template itself made it. The
# page's policy lets the browser fetch nothing and run no script but its own, which it knows by its
# hash.

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


def page(template: str, **content: Any) -> str:
    """Return the page that a template, such as "run.html", makes of its content."""
    return _environment().get_template(template).render(content) + "\n"


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


def flat(record: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path and the value, in words, of everything in nested mappings."""
    for key, value in record.items():
        path = f"{above}{key}"
        if isinstance(value, Mapping) and value:
            yield from flat(value, f"{path}.")
        else:
            yield path, in_words(value)


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
    made.filters |= {"number": number, "in_words": in_words, "flat": flat}
    style, script = (Markup(loader.get_source(made, f"page.{kind}")[0]) for kind in ("css", "js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )
    made.globals |= {"style": style, "script": script, "policy": policy}
    made.globals |= {"least": LEAST, "version": phase_ppl.__version__}
    return made
