"""What the pages of a run, an evaluation, a comparison and an event show."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis import plots
from phase_ppl.analysis.hypotheses import HDI_PROBABILITY
from phase_ppl.analysis.posterior import Posterior, load_posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.evaluation.agreement import at
from phase_ppl.evaluation.comparison.comparison import ModelComparison
from phase_ppl.evaluation.comparison.results import ComparedResults
from phase_ppl.evaluation.figures import COMPARED, DRAWN, TITLES
from phase_ppl.evaluation.figures.sheet import FolderResults, NothingToDrawError
from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.observers import MODEL_COLOUR, Observer, label_of, observers
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.report.html import (
    LEAST,
    Picture,
    embedded,
    figure_of,
    flat,
    in_words,
    number,
    page,
    picture_of,
)
from phase_ppl.evaluation.tables import true_answer
from phase_ppl.inference.runs.progress import counted
from phase_ppl.render.stills import draw_strip
from phase_ppl.render.video import video
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS
from phase_ppl.world.names import AGENTS
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


REPLAY: Final = "replay.mp4"
"""The film in the folder of a run."""

ASKED: Final = {
    "goal_red": "Goal of the red agent",
    "goal_green": "Goal of the green agent",
    "relation": "Relation",
}
"""Question -> how it is put to a reader."""

MAX_ROWS: Final = 6
"""Most goals that are shown of an agent."""

_WORTH_A_ROW: Final = 0.02
"""Probability from which on a goal is."""

_PANELS: Final = 6
_STRIP_WIDTH: Final = 1200
"""Pixels."""

_COLOURS: Final = {"goal_red": "#d62f2f", "goal_green": "#1c8a3c"}

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
    "aborted_mass_bound": "mass that stopped simulations can hide",
    "best_error_per_frame": "error of the best draw, units per frame",
}
"""Diagnostic -> how it is called where a few are shown."""

_COLUMNS: Final = {
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

_MEASURES: Final = {
    "goal_accuracy": "goals right",
    "relation_accuracy": "relations right",
    "goal_log_score_truth": "log probability of true goals, nats",
    "relation_log_score_truth": "log probability of true relation, nats",
}

_ALTS: Final = {
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
_SHORT: Final = {"goal_red": "red's goal", "goal_green": "green's goal", "relation": "relation"}


# --- an event --------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Block:
    """What everybody answers to a question about an event: a row per answer, a column each."""

    name: str
    rows: list[str]
    truth: str | None
    observers: list[Observer]

    @property
    def title(self) -> str:
        return ASKED[self.name]

    def place(self, answer: str) -> int:
        """Return where the probability of an answer stands."""
        return QUESTIONS[self.name].index(answer)


@dataclasses.dataclass(frozen=True)
class Item:
    """An event as pages show it.

    Attributes:
        id: of the event.
        scenario: the true one, or "".
        strips: film strips with their captions.
        questions: those that anybody answered.
        film: its address and what it shows.
        verdict: of the posterior's diagnostics.
        cost: of the model's prediction.
        outcome: one of those that the filter knows.
        marks: what became of each answer, with the class of its style.
        belief: product of the probabilities that the model gives to the true answers.
        right: who is right in all they answered; None where the truth is not known.
    """

    id: str
    scenario: str
    strips: list[tuple[str, Picture]]
    questions: list[Block]
    film: tuple[str, str] | None = None
    verdict: str = ""
    cost: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    outcome: str = ""
    marks: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    belief: float | None = None
    right: list[str] | None = None


def event_page(event: Event, shown: Sequence[Observer], post: Posterior | None = None) -> str:
    """Return the page of an event.

    Args:
        event: it.
        shown: whose answers are shown, a column each; those who said nothing of it are left out.
        post: the model's posterior, whose best hypothesis' simulation is shown as well.
    """
    truth = "Truth not known."
    if event.truth is not None:
        truth = f"Truth: {event.truth.scenario}, {event.truth.relation}."
    return page("event.html", title=event.id, truth=truth, item=_item(event, shown, post))


def page_in_folder(folder: ResultsFolder, event_id: str) -> str:
    """Return the page of an event of an evaluation.

    Raises:
        UnknownNameError: the evaluation has no such event.
        InvalidEventError: a file of the event is damaged.
    """
    event = next((event for event in folder.events if event.id == event_id), None)
    if event is None:
        raise unknown_name("event", event_id, [event.id for event in folder.events])
    return event_page(event, observers(folder, [event]), _posterior(folder, event_id))


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
    order = [labels[i] for i in np.argsort(-highest, kind="stable") if highest[i] >= _WORTH_A_ROW]
    chosen = list(dict.fromkeys([*asked, *order]))
    kept = chosen[: max(MAX_ROWS, len(set(asked)))]
    return sorted(kept, key=lambda goal: (-highest[labels.index(goal)], labels.index(goal)))


def _item(
    event: Event,
    everybody: Sequence[Observer],
    post: Posterior | None = None,
    film: bool = False,
    **more: Any,
) -> Item:
    shown = [one for one in everybody if event.id in one.predictions]
    given = {one.label: one.predictions[event.id].answers for one in shown if one.kind != "people"}
    trajectory = event.observation.trajectory
    strips = [_strip("Observed", trajectory, event.scene, event.id)]
    replay = None if post is None else post.replay()
    if replay is not None:
        strips.append(_strip("Best hypothesis, simulated", replay, event.scene, event.id))
    questions = [
        Block(name, rows_of(name, shown, event), true_answer(event, name), shown)
        for name in QUESTIONS
        if any(name in one.predictions[event.id].answers for one in shown)
    ]
    right = [
        label
        for label, answers in given.items()
        if answers and all(answer == true_answer(event, q) for q, answer in answers.items())
    ]
    own = next((one.predictions[event.id] for one in shown if one.kind == "model"), None)
    return Item(
        event.id,
        "" if event.truth is None else event.truth.scenario,
        strips,
        questions,
        _film(event, replay) if film else None,
        "" if post is None else str(post.diagnostics()["verdict"]),
        {} if own is None else own.cost,
        right=None if event.truth is None else right,
        **more,
    )


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


def _posterior(folder: ResultsFolder, event_id: str) -> Posterior | None:
    """Return what was sampled of an event, if that is how it was predicted."""
    source = folder.folder_of(event_id) / POSTERIOR
    post = load_posterior(source) if source.is_file() else None
    return post if isinstance(post, Posterior) else None


# --- a run -----------------------------------------------------------------------------------


def run_page(folder: Path) -> str:
    """Return the page of the run of inference in ``folder``.

    Raises:
        InvalidEventError: its posterior is damaged, or its film cannot be read.
    """
    post = load_posterior(folder / POSTERIOR)
    strips = [_strip("Observed", post.observed(), post.scene, post.event_id)]
    shown: dict[str, Any] = {"decided": None}
    if isinstance(post, StepwisePosterior):
        beside = "what can be believed until then on the right."
        best, second = (name for name, _ in post.top("relation", 2))
        figure = plots.why(post, f"relation={best}", f"relation={second}")
        alt = f"Log odds of {best} over {second} by frame, and the frames that changed them most."
        shown["decided"] = figure_of(figure, alt)
    else:
        beside = "the best hypothesis, simulated, on the right."
        caption = "Best hypothesis, simulated"
        strips.append(_strip(caption, post.replay(), post.scene, post.event_id))
        found = post.diagnostics()
        few = {words: found.get(name) for name, words in _DIAGNOSTICS.items()}
        shown["diagnostics"] = found
        shown["few"] = [(words, in_words(v)) for words, v in few.items() if v is not None]
        shown["rest"] = {name: value for name, value in found.items() if name != "verdict"}
    alt = "Goals, relation, scenario, tracks and strengths, as listed above."
    return page(
        "run.html",
        title=f"{post.event_id}: posterior",
        heading=post.event_id,
        film=_film_of_run(folder / REPLAY, f"Film: the observation on the left, {beside}"),
        strips=strips,
        bars=_bars(post),
        strengths=[_strength(post, agent) for agent in AGENTS],
        best=post.map_record(),
        posterior=figure_of(plots.posterior(post), alt),
        cost=post.cost,
        settings=post.settings,
        **shown,
    )


def _film_of_run(source: Path, words: str) -> tuple[str, str] | None:
    if not source.is_file():
        return None
    try:
        return embedded(source.read_bytes(), "video/mp4"), words
    except OSError as error:
        raise InvalidEventError(f"{source} cannot be read: {error.strerror}") from None


def _bars(
    post: Posterior | StepwisePosterior,
) -> list[tuple[str, str, Sequence[tuple[str, float]]]]:
    """Return title, colour and the most probable answers of each quantity."""
    found: list[tuple[str, str, Sequence[tuple[str, float]]]] = []
    for name, colour in _COLOURS.items():
        entries = [entry for entry in post.top(name, MAX_ROWS) if entry[1] >= LEAST]
        found.append((ASKED[name], colour, entries))
    for name in ("relation", "scenario"):
        found.append((name.capitalize(), MODEL_COLOUR, post.top(name, len(post.marginal(name)))))
    return found


def _strength(post: Posterior | StepwisePosterior, agent: str) -> tuple[str, str]:
    name = f"strength_{agent.split()[0]}"
    low, high = post.hdi(name).values
    interval = f"{HDI_PROBABILITY:.0%} interval {low:.0f} to {high:.0f} N"
    return agent, f"{post.mean(name)} N ({interval})"


# --- an evaluation ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Summary:
    """Everybody's metrics: figures with or without an interval, None where there is none.

    Attributes:
        columns: headings of those that anybody has.
        rows: observer, and a figure per column.
        between_people: what halves of the people agree on, in words.
        by_scenario: observer, what is right, and a figure per true scenario.
    """

    columns: list[str]
    rows: list[tuple[Observer, list[Any]]]
    between_people: str
    by_scenario: list[tuple[Observer, str, list[Any]]]
    scenarios: list[str] = dataclasses.field(default_factory=lambda: list(SCENARIOS))

    @classmethod
    def of(cls, shown: Sequence[Observer]) -> Summary:
        used = [place for place in _COLUMNS if any(at(o.metrics, place) for o in shown)]
        halves = []
        for name, what in (("goal_split_half_r", "goals"), ("split_half_r", "relations")):
            found = next(filter(None, (at(o.metrics, ("human", name)) for o in shown)), None)
            if found is not None:
                halves.append(f"{number(found['value'])} on {what}")
        by_scenario = []
        for kind, word in (("goal", "goals"), ("relation", "relations")):
            for one in shown:
                places = [("by_scenario", name, f"{kind}_accuracy") for name in SCENARIOS]
                cells = [at(one.metrics, place) for place in places]
                if any(cells):
                    by_scenario.append((one, word, cells))
        return cls(
            [_COLUMNS[place] for place in used],
            [(one, [at(one.metrics, place) for place in used]) for one in shown],
            f"Halves of the people correlate {' and '.join(halves)}." if halves else "",
            by_scenario,
        )


def evaluation_page(
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
    metrics = folder.metrics()
    n, finished = len(folder.events), sum(folder.is_finished(event.id) for event in folder.events)
    state = f"{finished} of {n} events predicted"
    if finished < n and metrics is None:
        state += "; not finished: tables and figures are about these"
    cost = (metrics or {}).get("cost")
    drawn, left_out = _figures(results, DRAWN)
    present = {name: name for name in SCENARIOS if name in results.scenarios.values()}
    items = []
    for event in counted(results.events, progress, "event", "showing"):
        shown = [one for one in results.observers if event.id in one.predictions]
        own = next((o.predictions[event.id] for o in shown if o.kind == "model"), None)
        post = None if own is None else _posterior(folder, event.id)
        items.append(_item(event, shown, post, videos, **_outcome(event, own)))
    return page(
        "evaluation.html",
        title=f"Evaluation of {label_of(str(folder.settings.get('model', 'model')))}",
        state=f"{state}.",
        summary=Summary.of(results.measured),
        drawn=drawn,
        left_out=left_out,
        failures=[(event_id, in_words(what)) for event_id, what in folder.failures().items()],
        menus=[
            ("scenario", "Scenario", {"": "all", **present}),
            ("outcome", "Answers", {"": "all", **_OUTCOMES}),
            ("order", "Order", _ORDERS),
        ],
        items=items,
        cost=cost if isinstance(cost, Mapping) else {},
        settings=folder.settings,
    )


def _outcome(event: Event, own: Prediction | None) -> dict[str, Any]:
    """Return what became of the model's answers about an event, as of :class:`Item`."""
    if own is None:
        return {"outcome": "none", "marks": [("no prediction", "bad")]}
    right = {q: answer == true_answer(event, q) for q, answer in own.answers.items()}
    if event.truth is None or not right:
        return {"outcome": "unknown"}
    belief = None
    if own.probabilities:
        shares = [
            float(values[QUESTIONS[question].index(str(true_answer(event, question)))])
            for question, values in own.probabilities.items()
        ]
        belief = float(np.prod(shares))
    return {
        "outcome": "right" if all(right.values()) else "wrong",
        "marks": [
            (f"{_SHORT[q]} {'right' if good else 'wrong'}", "good" if good else "bad")
            for q, good in right.items()
        ],
        "belief": belief,
    }


def _figures(
    results: Any, drawn: Mapping[str, Callable[[Any], Figure]]
) -> tuple[list[tuple[str, Picture]], list[str]]:
    """Return the figures that the results allow with their titles, and why others are not there.

    Args:
        results: as the functions take them.
        drawn: name of a figure -> what draws it.
    """
    found, left_out = [], []
    for name, draw in drawn.items():
        try:
            found.append((TITLES[name], figure_of(draw(results), _ALTS[name])))
        except NothingToDrawError as reason:
            left_out.append(f"{TITLES[name]}: {reason}.")
    return found, left_out


# --- a comparison ----------------------------------------------------------------------------


def comparison_page(comparison: ModelComparison, *, progress: bool | None = None) -> str:
    """Return the page of a comparison of models.

    Args:
        comparison: of models.
        progress: show a bar over the events; None: where stderr is a terminal.
    """
    results = ComparedResults(comparison)
    shown = {observer.name: observer for observer in results.observers}
    drawn, left_out = _figures(results, COMPARED)
    settings = {one.name: {"folder": one.folder, **one.settings} for one in comparison.contenders}
    return page(
        "comparison.html",
        title="Comparison of models",
        # a model that predicts nothing observes nothing
        names=[shown[n].label if n in shown else label_of(n) for n in comparison.models],
        notes=comparison.notes,
        summary=Summary.of(results.measured),
        observers=shown,
        measures=_MEASURES,
        differences=[
            row
            for row in comparison.differences
            if row["scenario"] is None and row["measure"] in _MEASURES
        ],
        equivalence=[row for row in comparison.equivalence if row["scenario"] is None],
        margin=comparison.settings["margin"],
        drawn=drawn,
        left_out=left_out,
        items=[
            _item(event, results.observers)
            for event in counted(comparison.events, progress, "event", "showing")
        ],
        settings=comparison.settings,
        settings_of_models=list(flat(settings)),
    )
