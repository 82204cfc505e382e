"""Whether models doubt where people do: scatter, what is left given the truth, and the ceiling."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.figures.layout import (
    GREY,
    SCENARIO_COLOURS,
    NothingToDrawError,
    Results,
    fitting,
    laid_out,
)
from phase_ppl.evaluation.tables import facts, said
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.hypothesis import RELATIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKS: Final = dict(zip(RELATIONS, ("o", "s", "^"), strict=True))
_MOST: Final = 6
_PARTS: Final = ("relation_r", "relation_r_given_truth")


def people(results: Results) -> Figure:
    """Draw models' probabilities of relations against people's shares, and how near r can come.

    For each model a row: probabilities against shares; the same less the mean over events of the
    same true relation; and both correlations with their intervals over events and raters, beside
    what halves of the people reach, as they are (grey line) and for all raters (dashed).

    Raises:
        NothingToDrawError: nobody judged relations to which a model gives probabilities.
    """
    shown = [
        one for one in results.source.measured if one.kind != "people" and one.metrics.get("doubt")
    ]
    if not shown:
        raise NothingToDrawError("nobody judged relations to which a model gives probabilities")
    shown = shown[:_MOST]
    note = (
        "Marks: an answer to a video, circles friendly, squares neutral, triangles adversarial; "
        "colours: true scenario. Given the truth: less the mean of the videos with the same true "
        "relation. Right: 95 % intervals over videos and raters; line: halves of the people, "
        "dashed: of all people, by Spearman and Brown."
    )
    figure = laid_out(7.2, 0.7 + 2.15 * len(shown), note)
    for (left, middle, right), answers in zip(
        figure.subplots(len(shown), 3, squeeze=False, width_ratios=(1, 1, 0.8)), shown, strict=True
    ):
        p, shares, truth, colours = _points(answers, results)
        _scatter(left, p, shares, colours, (0.0, 1.0))
        left.set_ylabel("people", fontsize=NORMAL, color=INK)
        left.set_title(
            answers.label, loc="left", color=answers.colour, fontweight="bold", parse_math=False,
            fontsize=fitting([answers.label], 2.0),
        )  # fmt: skip
        known = truth >= 0
        _scatter(
            middle,
            _given_truth(p[known], truth[known]),
            _given_truth(shares[known], truth[known]),
            [colour for colour, is_known in zip(colours, known, strict=True) if is_known],
            (-1.0, 1.0),
        )
        middle.set_title("given the truth", loc="left", fontsize=NORMAL, color=GREY)
        _bars(right, answers.metrics["doubt"], answers.colour)
    for axes in figure.axes[-3:-1]:
        axes.set_xlabel("model", fontsize=NORMAL, color=INK)
    return figure


def _points(
    answers: AnswerSet, results: Results
) -> tuple[FloatArray, FloatArray, IntArray, list[str]]:
    """Return probabilities and shares (event, answer), true relations, and colours of events."""
    events = [event for event in results.source.events if event.id in answers.predictions]
    known, model = facts(events), said(events, answers.predictions)
    p, shares = model.probabilities["relation"][:, 0], known.people["relation"][:, 0]
    there = ~np.isnan(p[:, 0]) & ~np.isnan(shares[:, 0])
    names = [results.scenarios.get(events[i].id, "") for i in np.flatnonzero(there)]
    colours = [SCENARIO_COLOURS.get(name, GREY) for name in names]
    return p[there], shares[there], known.truth["relation"][there, 0], colours


def _given_truth(values: FloatArray, truth: IntArray) -> FloatArray:
    found = values.copy()
    for group in np.unique(truth):
        found[truth == group] -= values[truth == group].mean(axis=0)
    return found


def _scatter(
    axes: Axes, x: FloatArray, y: FloatArray, colours: list[str], ends: tuple[float, float]
) -> None:
    bare(axes)
    axes.plot(ends, ends, color="#bbbbbb", lw=0.7, zorder=0)
    style: dict[str, Any] = {"s": 13, "alpha": 0.65, "linewidths": 0, "clip_on": False}
    for answer, mark in enumerate(_MARKS.values()):
        axes.scatter(x[:, answer], y[:, answer], c=colours, marker=mark, **style)
    ticks = sorted({*ends, 0.0})
    axes.set(xlim=ends, ylim=ends, xticks=ticks, yticks=ticks)
    axes.set_aspect("equal", adjustable="box")


def _bars(axes: Axes, doubt: dict[str, Any], colour: str) -> None:
    """Draw both correlations with their intervals, and the ceilings."""
    bare(axes)
    for place, name in enumerate(_PARTS):
        found = doubt[name]
        if found is None:
            continue
        axes.bar(place, found["value"], width=0.55, color=colour, alpha=0.85)
        if found["ci_low"] is not None:
            axes.plot([place, place], [found["ci_low"], found["ci_high"]], color=INK, lw=1.1)
        suffix = name.removeprefix("relation_r")
        for ceiling, line in ((f"split_half_r{suffix}", "-"), (f"spearman_brown{suffix}", "--")):
            value = doubt["ceiling"].get(ceiling)
            if value is not None:
                ends = [place - 0.38, place + 0.38]
                axes.plot(ends, [value, value], line, color=GREY, lw=1.3)
        axes.annotate(
            f"{found['value']:.2f}", (place, 0), xytext=(9, 3), textcoords="offset points",
            ha="center", fontsize=SMALL, color="white" if found["value"] > 0.2 else INK,
        )  # fmt: skip
    axes.axhline(0, color=INK, lw=0.6)
    axes.set_xticks([0, 1], ["r", "r given\nthe truth"], fontsize=SMALL)
    lowest = min(found["ci_low"] or 0.0 for found in map(doubt.get, _PARTS) if found)
    axes.set(xlim=(-0.6, 1.6), ylim=(min(lowest, 0.0), 1.0))
