"""Figures of what people said beside the three questions: labels, and likeness to people."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.figures.style import COLOURS, GREY, INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.figures.layout import laid_out
from phase_ppl.evaluation.likeness import MARGIN, RATINGS, Likeness
from phase_ppl.evaluation.tags import MAJORITY, Tags

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PathLike = str | os.PathLike[str]

_LABEL_WIDTH: Final = 2.6
_FAINT: Final = "#e6e6e6"


def tags(given: Tags, majority: float = MAJORITY) -> Figure:
    """Draw the percentage of videos that have each label as a category."""
    found = given.summary(majority)
    order = list(found.index)[::-1]
    fewest, most = given.viewers.min(), given.viewers.max()
    each = f"{most} each" if fewest == most else f"{fewest} to {most} each"
    note = (
        f"Percentage of the {len(given.viewers)} videos for which at least {100 * majority:g} % of "
        f"their viewers ({each}) chose the label. Hollow: chosen by somebody, in no video by that "
        "many."
    )
    figure = laid_out(_LABEL_WIDTH + 3.8, 0.9 + 0.19 * len(order), note)
    axes = figure.subplots()
    percent = found.loc[order, "percent"].to_numpy(float)
    axes.barh(range(len(order)), percent, color=COLOURS[0], height=0.68)
    for place, (label, value) in enumerate(zip(order, percent, strict=True)):
        if value == 0 and found.loc[label, "used"]:
            axes.plot(0, place, "o", ms=3.5, mfc="white", mec=COLOURS[0], clip_on=False, zorder=3)
        axes.annotate(
            f"{value:.0f}", (value, place), xytext=(5, 0), textcoords="offset points",
            va="center", fontsize=SMALL, color=GREY,
        )  # fmt: skip
    bare(axes)
    axes.set_yticks(range(len(order)), order, fontsize=NORMAL)
    axes.set_ylim(-0.6, len(order) - 0.4)
    axes.set_xlim(0, max(10.0, 1.12 * float(percent.max(initial=0))))
    axes.set_xlabel("videos, %", fontsize=NORMAL, color=INK)
    axes.grid(axis="x", color=_FAINT, lw=0.6)
    axes.set_axisbelow(True)
    return figure


def likeness(given: Likeness, margin: float = MARGIN) -> Figure:
    """Draw the ratings of both groups, mean ratings of their videos, and the difference."""
    found = given.summary()
    test = given.equivalence(margin)
    shown = "shown" if test["equivalent"] else "not shown"
    note = (
        "Left: share of each rating. Middle: mean rating of each video, and mean over videos. "
        "Right: difference of the mean ratings of participants with its 90 % interval, beside the "
        f"margin; equivalence is {shown} (two one-sided tests, p = {test['p']:.2g})."
    )
    figure = laid_out(7.2, 2.7, note)
    shares, means, difference = figure.subplots(1, 3, width_ratios=(1.3, 1.0, 1.0))
    for index, group in enumerate(given.groups):
        ratings = given.table.loc[given.table["group"] == group, "rating"]
        share = [float((ratings == rating).mean()) for rating in RATINGS]
        places = np.array(RATINGS) + 0.4 * (index - 0.5)
        shares.bar(places, share, width=0.38, color=COLOURS[index], label=group)
        _points(means, index, given.means("videos")[group], COLOURS[index])
    bare(shares)
    shares.set_xticks(RATINGS)
    shares.set_xlabel("rating", fontsize=NORMAL, color=INK)
    shares.set_ylabel("share", fontsize=NORMAL, color=INK)
    shares.legend(frameon=False, fontsize=SMALL, loc="upper left")
    bare(means)
    means.set_xticks(
        [0, 1],
        [f"{g}\n{r['mean']:.2f} ± {r['sd_videos']:.2f}" for g, r in found.iterrows()],
        fontsize=SMALL,
    )
    means.set_xlim(-0.5, 1.5)
    means.set_ylim(0.9, 5.1)
    means.set_yticks(RATINGS)
    low, high = test["ci_low"], test["ci_high"]
    difference.axhspan(-margin, margin, color=_FAINT)
    difference.axhline(0, color="#999999", lw=0.7)
    difference.plot([0, 0], [low, high], color=INK, lw=2.2)
    face = INK if test["equivalent"] else "white"
    difference.plot(0, test["difference"], "o", ms=5, mfc=face, mec=INK)
    bare(difference)
    reach = 1.2 * max(margin, abs(low), abs(high))
    difference.set(xlim=(-1, 1), ylim=(-reach, reach))
    first, second = given.groups
    difference.set_xticks([0], [f"{first} \N{MINUS SIGN}\n{second}"], fontsize=SMALL)
    return figure


def _points(axes: Axes, place: int, values: np.ndarray, colour: str) -> None:
    """Draw points side by side, those with the same value beside each other, and their mean."""
    rounded = np.round(values, 1)
    for value in np.unique(rounded):
        here = values[rounded == value]
        aside = (np.arange(len(here)) - (len(here) - 1) / 2) * min(0.05, 0.8 / max(1, len(here)))
        axes.plot(place + aside, here, "o", ms=2.6, color=colour, alpha=0.6, mew=0)
    axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)
