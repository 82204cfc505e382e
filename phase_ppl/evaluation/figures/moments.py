"""Figures of people and models at moments of a film."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import GREY, INK, NORMAL, new_figure, titled, written
from phase_ppl.evaluation.cells import KIND_WORDS
from phase_ppl.evaluation.doubt import rows_of
from phase_ppl.evaluation.figures.frame import (
    NothingToDrawError,
    PathLike,
    Source,
    drawing,
    fitting,
    opened,
)
from phase_ppl.evaluation.metrics import PREFIX
from phase_ppl.evaluation.prediction import pairs_of, questions_of
from phase_ppl.evaluation.table import PEOPLE_COLOUR, Answers, AnswerSet, responses_of, titles_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

_MOST: Final = 4  # events that are drawn
_COLUMNS: Final = 5  # answers that are
_DRAWN: Final = 1000  # resamples of the people
_TICKS: Final = 5  # moments that the axis names
_ALONE: Final = {"marker": "o", "ms": 4}  # of a line with one moment
_BESIDE: Final = 0.08  # inches from mark to mark there
_NOTHING: Final = "nobody judged at a moment of a film"


def _models(source: Source) -> tuple[list[Event], list[AnswerSet]]:
    """Return the events that people judged at moments, and models' answers at these."""
    results = opened(source)
    models = [
        one for one in results.measured if one.kind != "people" and one.metrics.get("moments")
    ]
    judged = Answers.of(results.events, {}).rows.dropna(subset="at")["event"].unique()
    if not len(judged) or not models:
        raise NothingToDrawError(_NOTHING)
    return [event for event in results.events if event.id in set(judged)], models


@drawing(
    "People and models over time",
    "Lines: people's shares of an answer and models' probabilities of it over the film, a row for "
    "each of up to four events.",
    of_moments=True,
)
def over_time(source: Source, path: PathLike | None = None) -> Figure:
    """Draw people and models over the film, for up to four events and five answers each.

    The answers are the relations of two agents, and of every other question the one that people
    gave most. Bands are 95 % intervals of people's mean, over resampled people.

    Raises:
        NothingToDrawError: nobody judged at a moment of a film.
    """
    events, models = _models(source)
    shown = events[:_MOST]
    some = f"{len(shown)} of {len(events)} events. " if len(shown) < len(events) else ""
    tables = {one: Answers.of(shown, one.predictions).rows.dropna(subset="at") for one in models}
    people = next(iter(tables.values()))
    chosen = {event.id: _asked(people[people["event"] == event.id], event) for event in shown}
    n_columns = max(map(len, chosen.values()))
    figure = new_figure(
        0.7 + 1.75 * n_columns, 0.6 + 1.5 * len(shown),
        note=f"{some}Share or probability of the answer, given the film until then [s]. Black: "
        "people, with the 95 % interval of their mean; coloured: models.",
    )  # fmt: skip
    grid = figure.subplots(len(shown), n_columns, squeeze=False, sharey=True)
    drawn = set()
    for event, line in zip(shown, grid, strict=True):
        for axes in line[len(chosen[event.id]) :]:
            axes.set_visible(False)
        for axes, (question, label) in zip(line, chosen[event.id], strict=False):
            for place, (one, table) in enumerate(tables.items(), 1):
                keys = ("event", event.id), ("question", question), ("label", label)
                rows = table[np.all([table[name] == value for name, value in keys], axis=0)]
                if one is models[0]:
                    at, share, within = _of_people(event, rows, question, label)
                    _line(axes, at, share, within, PEOPLE_COLOUR, marker="o", ms=3)
                rows = rows.dropna(subset="probability")
                if len(rows):
                    _line(axes, rows["at"], rows["probability"], None, one.colour, place, lw=1.4)
                    drawn.add(one)
            axes.set(ylim=(-0.02, 1.02), yticks=[0, 1])
            _timed(axes, people.loc[people["event"] == event.id, "at"])
            words = titles_of(event.scene.world)[question]
            titled(axes, "", words, fontsize=NORMAL)
            axes.set_title(label, pad=15, fontsize=fitting([label], 1.6), fontweight="bold")
        line[0].set_ylabel(event.id, fontsize=fitting([event.id], 1.2))
    _named(figure, [one for one in models if one in drawn])
    return written(figure, path)


def _asked(rows: pd.DataFrame, event: Event) -> list[tuple[str, str]]:
    """Return the questions and answers that are drawn of an event."""
    pairs, found = pairs_of(event.scene.world), []
    for question, labels in questions_of(event.scene.world).items():
        shares = rows[rows["question"] == question].groupby("label", sort=False)["people"].mean()
        if shares.notna().any():
            several = question in pairs and len(pairs) == 1
            found += [(question, one) for one in (labels if several else [shares.idxmax()])]
    return sorted(found, key=lambda one: one[0] not in pairs)[:_COLUMNS]


def _of_people(
    event: Event, rows: pd.DataFrame, question: str, label: str
) -> tuple[list[float], FloatArray, FloatArray]:
    """Return moments, people's mean share of an answer, and its interval (low and high, moment)."""
    known = rows.dropna(subset="people")
    within = []
    labels = questions_of(event.scene.world)[question]
    for at in known["at"]:
        given = responses_of([event], at)
        ((_, answers),) = rows_of(given, [event.id], [question], labels).given.values()
        shares = answers[:, labels.index(label)]
        times = np.random.default_rng(0).multinomial(
            len(shares), np.full(len(shares), 1 / len(shares)), size=_DRAWN
        )
        within.append(np.quantile(times @ shares / len(shares), [0.025, 0.975]))
    return known["at"].tolist(), known["people"].to_numpy(), np.array(within).T


@drawing(
    "Agreement with people over time",
    "Lines: each model's correlation with people and its log score by moment of the film, beside "
    "what people reach among themselves.",
    of_moments=True,
)
def by_moment(source: Source, path: PathLike | None = None) -> Figure:
    """Draw models' correlation with people and log score by moment, with 95 % intervals.

    Grey lines are people's: the r of their halves, and their own log score, which is in-sample.

    Raises:
        NothingToDrawError: nobody judged at a moment of a film.
    """
    _, models = _models(source)
    kinds = [
        kind
        for kind, prefix in PREFIX.items()
        if any(one.metrics["moments"][f"{prefix}log_score"] for one in models)
    ]
    if not kinds:
        raise NothingToDrawError(f"{_NOTHING} to which a model gives probabilities")
    figure = new_figure(
        7.2, 0.6 + 1.9 * len(kinds),
        note="Moments of the film [s]. Bands: 95 % intervals over events. Grey: people, r of "
        "halves, and their own log score (in-sample).",
    )  # fmt: skip
    grid = figure.subplots(len(kinds), 2, squeeze=False)
    drawn, moments = set(), [of["at"] for of in models[0].metrics["moments"]["by_moment"]]
    for kind, line in zip(kinds, grid, strict=True):
        prefix = PREFIX[kind]
        names = {f"{kind}_r": f"{prefix}split_half_r",
                 f"{prefix}log_score": f"{prefix}log_score_people"}  # fmt: skip
        for axes, (name, among) in zip(line, names.items(), strict=True):
            for place, one in enumerate(models, 1):
                rows = [
                    {"at": of["at"], **of[name]}
                    for of in one.metrics["moments"]["by_moment"]
                    if of[name] is not None
                ]
                table = pd.DataFrame(rows, columns=["at", "value", "ci_low", "ci_high"])
                if rows:
                    table = table.astype(float)
                    within = table[["ci_low", "ci_high"]].to_numpy().T
                    _line(axes, table["at"], table["value"], within, one.colour, place, marker=".")
                    drawn.add(one)
            found = [(of["at"], of[among]["value"])
                     for of in models[0].metrics["moments"]["by_moment"] if of[among]]  # fmt: skip
            if found:
                at, value = zip(*found, strict=True)
                _line(axes, at, value, None, GREY, lw=1.3, ls=(0, (4, 2)))
            _timed(axes, moments)
            if name.endswith("_r"):
                axes.axhline(0, color=INK, lw=0.6)
            what = "r with people" if name.endswith("_r") else "log score, nats"
            axes.set_title(f"{KIND_WORDS[kind].capitalize()}: {what}", fontsize=NORMAL)
    _named(figure, [one for one in models if one in drawn])
    return written(figure, path)


def _line(
    axes: Axes,
    at: ArrayLike,
    value: ArrayLike,
    within: FloatArray | None,
    colour: str,
    place: int = 0,
    **style: Any,
) -> None:
    """Draw a line and its band (low and high, moment).

    One moment is a mark with a bar: people's at the moment, models' beside it, by ``place``.
    """
    from matplotlib.transforms import ScaledTranslation

    alone = len(np.asarray(at)) == 1
    drawn: list[Any] = axes.plot(
        at, value, color=colour, **{"lw": 1.8, **style, **(_ALONE if alone else {})}
    )
    if within is not None and alone:
        drawn.append(axes.vlines(at, *within, lw=1.4, color=colour))
    elif within is not None:
        axes.fill_between(at, *within, color=colour, alpha=0.14, lw=0)
    if alone:
        beside = ScaledTranslation(_BESIDE * place, 0, axes.figure.dpi_scale_trans)
        for one in drawn:
            one.set_transform(axes.transData + beside)


def _timed(axes: Axes, moments: Iterable[float]) -> None:
    """Let the horizontal axis begin with the film, with ticks at the moments where they are few."""
    ticks = np.unique(list(moments))
    axes.set_xlim(0, (1.08 if len(ticks) > 1 else 1.5) * max(ticks[-1], 0.1))
    if len(ticks) <= _TICKS:
        axes.set_xticks(ticks, [f"{at:g}" for at in ticks])


def _named(figure: Figure, models: list[AnswerSet]) -> None:
    """Write whose lines are which above the axes."""
    from matplotlib.lines import Line2D

    figure.legend(
        [Line2D([], [], color=one.colour, lw=1.8) for one in models],
        [one.label for one in models],
        loc="outside upper right", ncols=len(models), frameon=False,
    )  # fmt: skip
