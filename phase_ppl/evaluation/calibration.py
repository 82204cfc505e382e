"""Is a model as sure as it should be? Simulation-based calibration (Talts et al. 2018).

A hypothesis is drawn from the prior, and a video of it from the simulator. A posterior of that
video is calibrated if the truth cannot be told from its draws. Then, over many videos,

* the rank of the truth among n draws is even on 0..n;
* of the answers with probability p a share p is right;
* the log score of the truth is, in the mean, what the posterior itself expects.

Strengths are ranked by their value, goals and relations by their probability, a test quantity that
depends on the data (Modrak et al. 2023). Ties are broken by chance. Draws are the last ones of
chains. Hypotheses with weights are drawn by these, so the ranks are as good as the weights. Log
scores have the lapse of :mod:`phase_ppl.evaluation.doubt`, on both sides.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import tempfile
import textwrap
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binom, kstest

from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.analysis.figures.style import COLOURS, in_style, new_figure, written
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import are_weighted
from phase_ppl.data.documents import read_json
from phase_ppl.evaluation.bootstrap import clopper_pearson
from phase_ppl.evaluation.doubt import log_probabilities
from phase_ppl.evaluation.evaluate import evaluate
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import Answer, Predict
from phase_ppl.evaluation.table import true_answers
from phase_ppl.simulator.contract import next_frames
from phase_ppl.simulator.joint import simulate
from phase_ppl.simulator.processes import Failure, results, slots_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    SimulationError,
    check_name,
    instance_of,
    shown,
    whole_number,
)
from phase_ppl.world.event import MIN_FRAMES, Event, Observation, Truth
from phase_ppl.world.files import write_bytes, write_json
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.picture import WIDTH, Printed, wrapped
from phase_ppl.world.progress import Bar
from phase_ppl.world.scene import PHASE, Scene, World
from phase_ppl.world.space import space_of
from phase_ppl.world.worlds import named

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.models.model import Model

TABLE: Final = "calibration.csv"
"""The file in the folder of results that has the table."""

DRAWS: Final = "draws.json"
"""The file of each video with draws of its posterior."""

RANKED: Final = 99
"""Draws that the truth is ranked among, where a posterior is no set of independent chains."""

DOUBTFUL: Final = 0.01
"""p-values below this are told."""

_ID: Final = "draw-"  # of events, before their number
_TRIES: Final = 200  # draws of a hypothesis and a video, until the video can be an event
_DRAWN: Final = 10_000  # sets of truths, against which scores are tested
_ROUNDING: Final = 1e-9  # of sums of scores, nats
_BARS: Final = 10  # of histograms and of reliability, at most
_IN_BAR: Final = 6  # videos for each of them, at least
_HELD: Final = (0.5, 0.8, 0.9, 0.95)  # of central intervals of strengths
_LEGEND: Final = (
    "rank: where the truth falls among draws that are sorted by strength, or by the probability of "
    "their goal or relation: 0 lowest, 1 highest, mean 0.5 if calibrated. p_even: p-value of a "
    f"test that ranks are uniform. Below {DOUBTFUL:g} a remark follows, also if log_score and "
    "expected differ that improbably. right: share of right "
    "answers, low to high its 95 % interval. confidence: mean probability of the answers. "
    "log_score: mean log probability of the truth, nats; expected: its mean if the model "
    "were calibrated."
)


_SUMMARY: Final = (
    *("n", "rank", "p_even", "right", "low", "high"),
    *("confidence", "log_score", "expected", "p_score", "verdict"),
)


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration(Printed):
    """How well calibrated a model is on videos drawn from it. ``print`` shows it.

    Attributes:
        table: a row per video and quantity. Columns: ``event``; ``quantity``, such as "goal_red",
            "relation" or "strength_red"; ``n``, number of draws of the posterior; ``rank``, how
            many of them lie below the truth, from 0 to n, with ties at random: by newtons for a
            strength, by the posterior probability of the answer for a goal or relation; and
            ``place``, from 0 to 1, (rank + u) / (n + 1) with u uniform in [0, 1). For goals and
            relations also ``truth`` and ``top``, the probabilities of the true and of the most
            probable answer; ``right``, whether the top answer is the truth (1 or 0);
            ``log_score``, log(0.99 p + 0.01 / K), nats, of the truth's probability p among K
            answers; and ``expected``, the log score that the posterior expects, nats. For
            strengths these are NaN.
        evaluation: the evaluation with the answers; its events are the videos.
        notes: known reasons why the model cannot be calibrated.
    """

    table: pd.DataFrame
    evaluation: Evaluation
    notes: tuple[str, ...] = ()

    @functools.cached_property
    def summary(self) -> pd.DataFrame:
        """A row per quantity.

        Columns: ``n``, number of videos; ``rank``, the mean place of the truth (calibrated: 0.5);
        ``p_even``, the p-value of Kolmogorov and Smirnov's test that places are uniform. For goals
        and relations also the share of ``right`` answers with its 95 % interval ``low`` to
        ``high``; ``confidence``, the answers' mean probability; mean ``log_score`` and ``expected``
        log score, nats; and ``p_score``, the probability of such a difference between them by
        chance. For that, 10 000 sets of truths are drawn from the stated probabilities p; to
        judge scores that are too low, from 0.99 p + 0.01 / K. The last column is
        the ``verdict``, in words.
        """
        rows = {name: self._summed(name, part) for name, part in self._parts.items()}
        found = pd.DataFrame.from_dict(rows, orient="index", columns=[*_SUMMARY])
        return found.rename_axis("quantity")

    def reliability(self, quantity: str) -> pd.DataFrame:
        """Return the share of right answers beside the probability that the model gave them.

        Args:
            quantity: a name in the column ``quantity`` of the table, such as "goal_red".

        Returns:
            For a goal or a relation a row per bin of top answers, sorted by probability, with equal
            numbers of videos: their mean ``probability`` and the ``share`` of right ones. For a
            strength a row per central interval of the posterior: its ``probability`` and the
            ``share`` of intervals that hold the truth. Both have the 95 % interval ``low`` to
            ``high`` of the share (Clopper and Pearson) and the number ``n`` of videos.

        Raises:
            UnknownNameError: there is no such quantity.
        """
        check_name("quantity", quantity, self._parts)
        part = self._parts[quantity]
        if part["top"].isna().all():
            off = (2 * part["place"] - 1).abs().to_numpy()
            found = [(held, off <= held) for held in _HELD]
        else:
            part = part.sort_values("top", kind="stable")
            split = np.array_split(np.arange(len(part)), _n_bars(len(part)))
            top, right = part["top"].to_numpy(), part["right"].to_numpy()
            found = [(top[some].mean(), right[some]) for some in split]
        rows = [
            (p, so.mean(), *clopper_pearson(float(so.sum()), len(so)), len(so)) for p, so in found
        ]
        return pd.DataFrame(rows, columns=["probability", "share", "low", "high", "n"])

    @in_style
    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw ranks and reliability, a row per quantity; with ``path`` also write the figure."""
        n, parts = len(self.evaluation.predictions), self._parts
        note = (
            "Left: how many videos have the truth at this place among draws of the posterior, and "
            "the band that holds 99 % of the bars of a calibrated model. Right: shares of right "
            "top answers, or of central intervals that hold the true strength, with 95 % "
            "intervals; the line is a calibrated model. "
        )
        figure = new_figure(
            *(6.4, 1.0 + 1.55 * len(parts) + 0.12 * sum(map(len, self.notes)) / 100),
            f"{self._name}: {n} video{'s' * (n != 1)} drawn from the prior",
            note + " ".join(self.notes),
        )
        grid = figure.subplots(len(parts), 2, squeeze=False, width_ratios=(1.7, 1))
        for (left, right), (quantity, part) in zip(grid, parts.items(), strict=True):
            _draw_ranks(left, part["place"])
            words = quantity.replace("_", " of ")
            left.set_title(words if quantity.startswith("strength") else f"probability of {words}")
            _draw_reliability(right, self.reliability(quantity))
        grid[-1, 0].set_xlabel("place of the truth")
        grid[-1, 1].set_xlabel("probability said")
        return written(figure, path)

    def __str__(self) -> str:
        n, failed = len(self.evaluation.predictions), len(self.evaluation.failures)
        head = f"{self._name}: {n} videos drawn from prior and simulator"
        head += f", and {failed} without an answer" if failed else ""
        lines = wrapped("calibration", head)
        shown = self.summary.drop(columns=["n", "p_score", "verdict"]).rename_axis(None)
        lines += ["", *shown.to_string(float_format="{:.3f}".format, na_rep="").splitlines()]
        lines += textwrap.wrap(_LEGEND, WIDTH)
        verdicts = self.summary["verdict"].items()
        said = [
            line
            for name, verdict in verdicts
            for line in textwrap.wrap(f"{name}: {verdict}", WIDTH, subsequent_indent="  ")
        ]
        return "\n".join(
            [*lines, "", *said, *(line for n in self.notes for line in wrapped("note", n))]
        )

    def __repr__(self) -> str:
        return f"<Calibration of {self._name}: {len(self.evaluation.predictions)} videos>"

    @property
    def _name(self) -> str:
        settings, name = self.evaluation.settings, self.evaluation.name
        # "simple" is the name of any kernel's runs, with any simulator
        kernel = settings["options"].get("kernel")
        return str(kernel or ("closed loop" if name == "closed_loop" else name))

    @functools.cached_property
    def _parts(self) -> dict[str, pd.DataFrame]:
        """The rows of each quantity."""
        return {str(name): part for name, part in self.table.groupby("quantity", sort=False)}

    def _summed(self, name: str, part: pd.DataFrame) -> dict[str, Any]:
        place, n, verdicts = part["place"].to_numpy(), len(part), []
        found = dict.fromkeys(_SUMMARY, np.nan)
        found |= {"n": n, "rank": place.mean(), "p_even": kstest(place, "uniform").pvalue}
        if part["top"].notna().all():
            right, top = part["right"].to_numpy(), part["top"].to_numpy()
            gain = (part["log_score"] - part["expected"]).to_numpy()
            predictions = self.evaluation.predictions
            said = [predictions[event].probabilities[name] for event in part["event"]]
            found["low"], found["high"] = clopper_pearson(float(right.sum()), n)
            found |= {"right": right.mean(), "confidence": top.mean()}
            found |= {score: part[score].mean() for score in ("log_score", "expected")}
            found["p_score"] = _p_score(np.array(said), float(gain.sum()))
            if found["p_score"] < DOUBTFUL:
                above = gain.mean() > 0
                how = "not sure enough" if above else "too sure"
                beyond = f"{abs(gain.mean()):.2f} nats {'above' if above else 'below'} expectation"
                verdicts.append(f"{how}: the truth scores {beyond}")
        if found["p_even"] < DOUBTFUL:
            verdicts.append(
                f"ranks are not uniform (p = {found['p_even']:.2g}): biased, too sure or not sure "
                "enough; .plot() shows which"
            )
        return {**found, "verdict": ", ".join(verdicts) or f"no deviation shown ({n} videos)"}


def calibrate(
    model: Model,
    n: int = 100,
    *,
    reader: str | Model | Predict | None = None,
    frames: int = 31,
    scenes: str | World | Scene | Sequence[Scene] = PHASE,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    workers: int | None = None,
    executor: Executor | None = None,
    seed: int = 0,
    progress: bool | None = None,
    **options: Any,
) -> Calibration:
    """Draw hypotheses and videos from a model, infer each, and test the posteriors' calibration.

    The hypothesis comes from the model's prior, and the video from its simulator. The video is one
    whole simulation. It is drawn frame by frame, by ``next_frames``, if the simulator has nothing
    else or the model's likelihood is a :class:`phase_ppl.ClosedLoopLikelihood`. A likelihood with a
    method ``replicate``, such as :class:`phase_ppl.RadialLikelihood`, adds its noise to positions.
    If the model's ``likelihood`` is None, there is no noise.

    If a body leaves the arena or the simulator fails, hypothesis and video are drawn anew. This
    does not change the posterior given a valid video.

    A posterior can be calibrated only if videos are drawn from its likelihood. Videos of the
    package's own simulator are not quite: the closed loop takes actions to be more random than they
    are there. Its likelihood and the default likelihood of kernels are tempered; the result says
    so.

    Args:
        model: the model: prior, simulator and likelihood.
        n: number of videos.
        reader: what infers, as ``phase_ppl.evaluate`` takes a model; by default ``model``. Another
            model shows the effect of a wrong assumption.
        frames: length of each video, in frames.
        scenes: a world or its name, for random scenes; or scenes, taken in turn.
        out: folder to keep the evaluation (see :func:`phase_ppl.evaluate`) and the table in; by
            default nothing is kept.
        resume: whether to continue in ``out``, if it holds a calibration; ``n`` may be larger.
            Videos are drawn again, which takes little time.
        workers, executor, progress: as in :func:`phase_ppl.evaluate`.
        seed: seed of videos and answers, a whole number >= 0.
        **options: options of :func:`phase_ppl.infer`, such as ``kernel="local_mh"``, ``chains=15``.

    Raises:
        SimulationError: the simulator fails, draws no videos, or draws none that can be an event;
            the message says why.
        InvalidSettingError: ``model`` is not a ``phase_ppl.Model``, a number is out of range, or
            there are no scenes.

    Further errors are those of :func:`phase_ppl.evaluate`.
    """
    from phase_ppl.models.model import Model

    instance_of("model", model, Model, "a phase_ppl.Model")
    whole_number("n", n)
    drawing = _Drawing(
        model, _scenes(scenes), whole_number("frames", frames, MIN_FRAMES),
        whole_number("seed", seed, 0),
    )  # fmt: skip
    events: dict[int, Event] = {}
    drawn = results(_draw, drawing, range(n), slots_of(workers, executor), "the model", executor)
    with Bar(n, 0, progress, "video", "drawing") as bar, contextlib.closing(drawn):
        for number, event in drawn:
            if isinstance(event, Failure):
                raise SimulationError(f"video {number} cannot be drawn: {event.reason}")
            events[number] = event
            bar.update()
    with contextlib.ExitStack() as stack:
        folder = out or stack.enter_context(tempfile.TemporaryDirectory())
        evaluation = evaluate(
            [events[number] for number in range(n)], model if reader is None else reader,
            out=folder, resume=resume, workers=workers, executor=executor, seed=seed,
            progress=progress, observer=_WithDraws(out is not None), **options,
        )  # fmt: skip
        assert evaluation.folder is not None, "it is kept"
        rows: list[dict[str, Any]] = []
        notes: list[str] = []
        for name, prediction in evaluation.predictions.items():
            said = read_json(evaluation.folder.folder_of(name) / DRAWS)
            place = int(name.removeprefix(_ID))
            rng = np.random.default_rng([seed, place, 1])
            rows += _ranked(events[place], prediction, said, rng)
            tempering = said.get("", {}).get("tempering", "")
            if "tempered" in tempering:
                notes.append(f"{tempering.capitalize()}; this alone makes answers too unsure")
    if out is None:
        evaluation = dataclasses.replace(evaluation, folder=None)
    found = Calibration(
        pd.DataFrame(rows, columns=_COLUMNS), evaluation, tuple(dict.fromkeys(notes))
    )
    if out is not None:
        write_bytes(Path(out) / TABLE, (".csv",), found.table.to_csv(index=False).encode())
    return found


# --- drawing --------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Drawing:
    """What videos are drawn from."""

    model: Model
    scenes: World | Sequence[Scene]
    frames: int
    seed: int


def _scenes(given: object) -> World | Sequence[Scene]:
    if isinstance(given, str | World):
        return named(given)
    found = [given] if isinstance(given, Scene) else given
    several = isinstance(found, Sequence) and all(isinstance(one, Scene) for one in found)
    if not (found and several):
        raise InvalidSettingError(f"scenes={shown(given)}, expected a world, its name, or scenes")
    return cast("Sequence[Scene]", found)


def _draw(drawing: _Drawing, number: int) -> Event:
    """Return a video with its truth."""
    import jax

    from phase_ppl.models.density import draw

    rng = np.random.default_rng([drawing.seed, number])
    scenes = drawing.scenes
    scene = scenes.random_scene(rng) if isinstance(scenes, World) else scenes[number % len(scenes)]
    model = drawing.model.in_world(scene)
    video = _video_of(model, scene, drawing.frames)
    replicate = getattr(model.likelihood, "replicate", None)
    why = ""
    for _ in range(_TRIES):
        key = jax.random.key(int(rng.integers(2**31)))
        hypothesis = space_of(scene.world).hypothesis(draw(model.prior, key))
        if not hypothesis.is_possible:
            why = "agents that help or hinder have no goals"
            continue
        try:
            frames = video(hypothesis, int(rng.integers(2**31)))
            if replicate is not None:
                frames[..., :2] = replicate(frames[..., :2], rng)
            truth = Truth.of(hypothesis)
            return Event(scene, Observation(frames), id=f"{_ID}{number:04d}", truth=truth)
        except (InvalidEventError, SimulationError) as error:
            why = str(error)
    raise SimulationError(f"none of {_TRIES} draws can be an event; the last: {why}")


def _video_of(model: Model, scene: Scene, n_frames: int) -> Callable[[Hypothesis, int], FloatArray]:
    """Return a function of a hypothesis and a seed that draws (time, entity, coord) a video."""
    from phase_ppl.models.likelihood import is_closed_loop

    simulator: Any = model.build_simulator()
    goes_on = callable(getattr(simulator, "next_frames", None))
    if not callable(simulator) and not goes_on:
        raise InvalidSettingError(
            f"{shown(simulator)} draws no videos: it has log_prob_next, expected next_frames or "
            "__call__ too"
        )
    if goes_on and (is_closed_loop(model.likelihood) or not callable(simulator)):

        def step_by_step(hypothesis: Hypothesis, seed: int) -> FloatArray:
            rng, seen = np.random.default_rng(seed), scene.start[None]
            while len(seen) < n_frames:
                new = next_frames(simulator, scene, hypothesis.effective(), seen, rng, 1)
                seen = np.concatenate([seen, new])
            return seen

        return step_by_step

    def whole(hypothesis: Hypothesis, seed: int) -> FloatArray:
        event = simulate(scene, hypothesis, frames=n_frames, seed=seed, simulator=simulator)
        return event.observation.trajectory.copy()

    return whole


# --- ranks ----------------------------------------------------------------------------------------

_COLUMNS: Final = (
    *("event", "quantity", "rank", "n", "place"),
    *("truth", "top", "right", "log_score", "expected"),
)


@dataclasses.dataclass(frozen=True)
class _WithDraws:
    """Has a model also tell draws of its posterior, which the truth is then ranked among."""

    keeps: bool  # the posteriors, too

    @property
    def record(self) -> dict[str, Any]:
        return {"calibration": RANKED}

    def seeing(self, model: Predict, world: World) -> Predict:
        return functools.partial(_asked, model, self.keeps)


def _asked(
    model: Predict, keeps: bool, scene: Scene, observation: Observation, seed: int
) -> Answer:
    """Return the answer of a model, with draws."""
    answer = Answer.of(model(scene, observation, seed))
    prediction = Prediction.of(answer.given, world=scene.world)
    post = answer.given if isinstance(answer.given, EventPosterior) else answer.posterior
    record = _draws_of(prediction, post, np.random.default_rng(seed))
    files = dict(answer.artefacts) if keeps else {}
    return Answer(prediction, {**files, DRAWS: functools.partial(write_json, record=record)})


def _draws_of(
    prediction: Prediction, post: Any, rng: np.random.Generator
) -> dict[str, dict[str, Any]]:
    """Return what a model says of each quantity, without knowing the truth, in JSON's types."""
    if not isinstance(post, EventPosterior):
        return {
            question: {
                "drawn": rng.choice(len(p), RANKED, p=p / p.sum()).tolist(),
                "by": p.tolist(),
            }
            for question, p in prediction.probabilities.items()
        }
    drawn, others = _independent(post, rng)
    found: dict[str, dict[str, Any]] = {}
    for question, p in prediction.probabilities.items():
        codes = post.table.values[question]
        # what is ranked by is not of the draws that are ranked
        by = np.bincount(codes, others, len(p))
        found[question] = {"drawn": codes[drawn].tolist(), "by": by.tolist()}
    for name in post.strengths_of.values():
        values = post.table.values[name]
        grid = None if post.settings.get("kernel") != "enumerate" else np.unique(values).tolist()
        if isinstance(post, ClosedLoopPosterior):
            grid = list(post.settings["likelihood"]["tracking"]["strengths"])
        found[name] = {"drawn": values[drawn].tolist(), "grid": grid}
    return {**found, "": {"tempering": post.tempering}}


def _independent(
    post: EventPosterior, rng: np.random.Generator
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return rows of the table that are independent draws, and weights of all other rows.

    They are the last draws of the chains. Where draws have weights they are drawn by these, and
    none is left out.
    """
    table = post.table
    if isinstance(post, Posterior) and post.weights == "count" and not are_weighted(post.tree):
        last = table.index["draw"] == table.index["draw"].max()
        if last.sum() > 1 and not last.all():
            others = np.where(last, 0.0, table.weights)
            return np.flatnonzero(last), others / others.sum()
    return rng.choice(len(table.weights), RANKED, p=table.weights), table.weights


def _ranked(
    event: Event, prediction: Prediction, said: Mapping[str, Any], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Return the rows of the table about a video."""
    from phase_ppl.models.effective import place_of_level

    assert event.truth is not None, "it was drawn"
    truth, rows = true_answers(event), []
    for question, p in prediction.probabilities.items():
        true = prediction.questions[question].index(truth[question])
        by = np.round(said[question]["by"], 12)
        logs = log_probabilities(p)
        of_answers = {
            "truth": p[true],
            "top": p.max(),
            "right": float(p.argmax() == true),
            "log_score": logs[true],
            "expected": float((p * logs).sum()),
        }
        row = _row(event, question, by[said[question]["drawn"]], by[true], rng)
        rows.append({**row, **of_answers})
    strengths = zip(space_of(event.scene.world).strength_sites, event.truth.strengths, strict=True)
    for name, strength in strengths:
        if name in said and strength is not None:
            grid = said[name]["grid"]
            # the level that stands for it
            value = strength if grid is None else grid[place_of_level(strength, np.array(grid))]
            rows.append(_row(event, name, np.array(said[name]["drawn"]), value, rng))
    return rows


def _row(
    event: Event, quantity: str, drawn: FloatArray, truth: float, rng: np.random.Generator
) -> dict[str, Any]:
    n, equal = len(drawn), int((drawn == truth).sum())
    rank = int((drawn < truth).sum()) + int(rng.integers(equal + 1))
    place = (rank + rng.random()) / (n + 1)
    return {"event": event.id, "quantity": quantity, "rank": rank, "n": n, "place": place}


# --- summed up ------------------------------------------------------------------------------------


def _n_bars(n: int) -> int:
    return max(1, min(_BARS, n // _IN_BAR))


def _p_score(p: FloatArray, gain: float) -> float:
    """Return how probable so large a sum of log scores beyond expectation is, were p right.

    ``p`` are (video, label). It is exact also where most answers are nearly certain, as scores then
    are far from normal. Against too sure a model the lapse counts: without it a single answer of
    probability 0, as samplers often give, would decide.
    """
    rng, logs = np.random.default_rng(0), log_probabilities(p)
    drawn = np.zeros((2, _DRAWN))
    for one, of in zip(p, logs, strict=True):
        for place, chances in enumerate((one, np.exp(of))):
            true = rng.choice(len(one), _DRAWN, p=chances / chances.sum())
            drawn[place] += of[true] - one @ of
    tails = (drawn[0] >= gain - _ROUNDING).sum(), (drawn[1] <= gain + _ROUNDING).sum()
    return min(1.0, 2 * (int(min(tails)) + 1) / (_DRAWN + 1))


# --- drawn ----------------------------------------------------------------------------------------

_BAND: Final = (0.005, 0.995)  # between these quantiles lie 99 % of the bars


def _draw_ranks(axes: Axes, places: pd.Series[float]) -> None:
    from matplotlib.ticker import MaxNLocator

    n, bars = len(places), max(3, _n_bars(len(places)))
    counts, _ = np.histogram(places, bars, (0.0, 1.0))
    axes.axhspan(*binom.ppf(_BAND, n, 1 / bars), color="0.9", lw=0)
    axes.axhline(n / bars, color="0.6", lw=0.8)
    axes.bar((np.arange(bars) + 0.5) / bars, counts, 0.9 / bars, color=COLOURS[0])
    axes.set(xlim=(0, 1), ylabel="videos")
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))


def _draw_reliability(axes: Axes, found: pd.DataFrame) -> None:
    axes.plot([0, 1], [0, 1], color="0.6", lw=0.8)
    axes.vlines(found["probability"], found["low"], found["high"], COLOURS[0], lw=1.2)
    axes.plot(found["probability"], found["share"], "o", ms=4, color=COLOURS[0], clip_on=False)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
    axes.set_ylabel("share")
