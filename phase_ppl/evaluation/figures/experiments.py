"""Figures of people's labels and ratings of videos (:mod:`phase_ppl.evaluation.experiments`)."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    in_style,
    new_figure,
    warned,
    written,
)
from phase_ppl.evaluation.experiments import (
    MAJORITY,
    MARGIN,
    RATINGS,
    Likeness,
    Tags,
    load_likeness,
    load_tags,
)
from phase_ppl.evaluation.figures.frame import PathLike
from phase_ppl.evaluation.ratings import REHEARSAL, Judgments
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.errors import shown as in_short

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Data = TypeVar("_Data")
_FAINT: Final = "#e6e6e6"


def _read(source: Any, kind: type[_Data], load: Callable[[Any], _Data]) -> _Data:
    if isinstance(source, str | os.PathLike):
        return load(source)
    if not isinstance(source, kind):
        raise InvalidSettingError(f"{in_short(source)}, expected {kind.__name__} or their file")
    return source


def _warn_of_scripted(figure: Figure, table: pd.DataFrame) -> None:
    if table["participant"].str.startswith(Judgments.SCRIPTED).any():
        warned(figure, REHEARSAL)


@in_style
def tags(
    source: Tags | PathLike, path: PathLike | None = None, *, majority: float = MAJORITY
) -> Figure:
    """Draw the share of videos in each category, as the paper does for its 23 labels.

    Labels are given directly or as a CSV file (:mod:`phase_ppl.evaluation.experiments`). A video
    has a category if at least the share ``majority`` of its viewers chose the label.

    Raises:
        InvalidSettingError: ``source`` is neither labels nor a file, or ``majority`` no share.
        InvalidEventError: the file holds no labels; the message names file and line.
    """
    given = _read(source, Tags, load_tags)
    found = given.summary(majority)[::-1]
    fewest, most = given.viewers.min(), given.viewers.max()
    each = f"{most} each" if fewest == most else f"{fewest} to {most} each"
    figure = new_figure(
        *(6.4, 0.9 + 0.19 * len(found)),
        note=f"Percentage of the {len(given.viewers)} videos for which at least "
        f"{100 * majority:g} % of their viewers ({each}) chose the label. Hollow: chosen by "
        "somebody, in no video by that many.",
    )
    axes = figure.subplots()
    bars = axes.barh(found.index, found["percent"], 0.68, color=COLOURS[0])
    axes.bar_label(bars, fmt="%.0f", padding=5, color=GREY)
    for label in found.index[(found["percent"] == 0) & found["used"]]:
        axes.plot(0, label, "o", ms=3.5, mfc="white", mec=COLOURS[0], clip_on=False, zorder=3)
    axes.set(xlim=(0, max(10.0, 1.12 * found["percent"].max())), ylim=(-0.6, len(found) - 0.4))
    axes.set_xlabel("videos, %")
    axes.grid(axis="x")
    _warn_of_scripted(figure, given.table)
    return written(figure, path)


@in_style
def likeness(
    source: Likeness | PathLike, path: PathLike | None = None, *, margin: float = MARGIN
) -> Figure:
    """Draw people's ratings of how likely the behaviour is, in two groups of videos.

    Ratings are given directly or as a CSV file (:mod:`phase_ppl.evaluation.experiments`). Groups
    are equivalent if their mean ratings differ by less than ``margin``.

    Raises:
        InvalidSettingError: ``source`` is neither ratings nor a file, or ``margin`` not positive.
        InvalidEventError: the file holds no ratings; the message names file and line.
    """
    given = _read(source, Likeness, load_likeness)
    found = given.summary()
    test = given.equivalence(margin)
    shown = "shown" if test["equivalent"] else "not shown"
    p = "none where nobody differs" if test["p"] is None else f"{test['p']:.2g}"
    figure = new_figure(
        *(7.2, 2.7),
        note="Left: share of each rating. Middle: mean rating of each video, and mean over videos. "
        "Right: difference of the mean ratings of participants with its 90 % interval, beside the "
        f"margin; equivalence is {shown} (two one-sided tests, p = {p}).",
    )
    shares, means, difference = figure.subplots(1, 3, width_ratios=(1.3, 1.0, 1.0))
    for index, group in enumerate(given.groups):
        ratings = given.table.loc[given.table["group"] == group, "rating"]
        share = [float((ratings == rating).mean()) for rating in RATINGS]
        places = np.array(RATINGS) + 0.4 * (index - 0.5)
        shares.bar(places, share, width=0.38, color=COLOURS[index], label=group)
        _points(means, index, given.means("videos")[group], COLOURS[index])
    shares.set(xticks=RATINGS, xlabel="rating", ylabel="share")
    shares.legend(loc="upper left")
    labels = [f"{g}\n{r['mean']:.2f} ± {r['sd_videos']:.2f}" for g, r in found.iterrows()]
    means.set_xticks([0, 1], labels)
    means.set(xlim=(-0.5, 1.5), ylim=(0.9, 5.1), yticks=RATINGS)
    low, high = test["ci_low"], test["ci_high"]
    difference.axhspan(-margin, margin, color=_FAINT)
    difference.axhline(0, color="#999999", lw=0.7)
    if low is not None:
        difference.plot([0, 0], [low, high], color=INK, lw=2.2)
    face = INK if test["equivalent"] else "white"
    difference.plot(0, test["difference"], "o", ms=5, mfc=face, mec=INK)
    reach = 1.2 * max(margin, *(abs(end or 0.0) for end in (low, high, test["difference"])))
    difference.set(xlim=(-1, 1), ylim=(-reach, reach))
    difference.set_xticks([0], [" \N{MINUS SIGN}\n".join(given.groups)])
    _warn_of_scripted(figure, given.table)
    return written(figure, path)


def _points(axes: Axes, place: int, values: np.ndarray, colour: str) -> None:
    """Draw points and their mean; points of equal value are spread sideways."""
    rounded = np.round(values, 1)
    for value in np.unique(rounded):
        here = values[rounded == value]
        aside = (np.arange(len(here)) - (len(here) - 1) / 2) * min(0.05, 0.8 / max(1, len(here)))
        axes.plot(place + aside, here, "o", ms=2.6, color=colour, alpha=0.6, mew=0)
    axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)
