"""The data card: the statistics of a set of events beside those of another, on one page."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.data_table import (
    Row,
    Statistics,
    about,
    clipped,
    goal_grid,
    number,
    other_text,
    rows,
)
from phase_ppl.analysis.figures.style import GREY, INK, SMALL, in_style, new_figure, written
from phase_ppl.dataset.statistics import LEVELS, PHASE, SPEED_EDGES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HERE: Final = "#0072b2"
BESIDE: Final = "#b4b4b4"
"""Colours: of the set, of the other."""

LONGEST_LABEL: Final = 22  # characters of a label at most

GOAL_TYPE_NAMES: Final = {
    "LMO+": "item to landmark",
    "LMO-": "item from landmark",
    "LMA+": "agent to landmark",
    "LMA-": "agent from landmark",
    "TE+": "to other agent",
    "TE-": "from other agent",
}

_TIME_NAMES: Final = {
    "at_rest": "agent at rest",
    **{f"at_rest_{level}": f"same, {level} N" for level in LEVELS},
    "items_move": "item moves",
    "holding": "agent holds item",
}

_SPEED_MARKS: Final = {"mean": ("mean", "o"), "p99": ("99 %", "|"), "max": ("most", "o")}
_SPEED_TEXT: Final = SPEED_EDGES[-1] + 7.0  # where the columns of numbers begin, units/s
_FEW: Final = 6  # goals that are about no landmark; of more, those that occur are drawn

_ROW: Final = 3.2  # height of a row of panels, inches

_WIDTHS: Final = ((2.2, 2.2, 4), (2.1, 2, 3, 1.7), (4.4, 2.75, 2))
"""Per row, the widths of the panels beside each other."""


@in_style
def data_card(
    statistics: Statistics,
    path: str | os.PathLike[str] | None = None,
    *,
    beside: Statistics = PHASE,
) -> Figure:
    """Draw the statistics of a set of events beside those of another, on a page 12 inches wide.

    A figure of the set with a star differs from the other's by more than chance explains (95 %). A
    third row of panels shows what only the manifest of a generated set tells. Both are of
    :func:`phase_ppl.dataset.statistics.statistics`, the other by default the original events.
    """
    told = {"family", "layout", "reflection", "split"} & set(statistics["tables"])
    n_rows = 3 if told or statistics["draws"] else 2
    figure = new_figure(
        *(12, n_rows * _ROW + 0.4),
        about({**statistics, "name": clipped(statistics["name"], 24)}),
        f"in grey: {clipped(beside['name'], 24)}; * differs by more than chance explains (95 %)",
    )
    figure.texts[0].set(color=HERE, weight="bold")
    found = rows(statistics, beside)
    parts = figure.subfigures(n_rows, 1, squeeze=False)[:, 0]
    panels = [
        part.subplots(1, len(w), width_ratios=w) for part, w in zip(parts, _WIDTHS, strict=False)
    ]

    def groups(*names: str) -> list[list[Row]]:
        return [[row for row in found if row.key.startswith(f"{name}/")] for name in names]

    kinds, types, goals = panels[0]
    _paired_bars(kinds, "Relation, and scenario", groups("relation", "scenario"))
    (of_types,) = groups("goal_type")
    named = [row._replace(label=GOAL_TYPE_NAMES.get(row.label, row.label)) for row in of_types]
    _paired_bars(types, "Goals of agents, by type", [named])
    _goals(goals, statistics)
    bodies, durations, speeds, times = panels[1]
    labels = ("{} N", "agent {}", "item {}")
    sizes = [
        [row._replace(label=label.format(row.label)) for row in group]
        for label, group in zip(labels, groups("strength", "agent_size", "item_size"), strict=True)
    ]
    _paired_bars(bodies, "Strength, size of agents, of items", sizes)
    _durations(durations, statistics, beside, found)
    _speeds(speeds, statistics, beside, found)
    of_time = {row.key: row for row in found}
    shares = [of_time[k]._replace(label=v) for k, v in _TIME_NAMES.items() if k in of_time]
    _paired_bars(times, "Share of time", [shares])
    if statistics["holding_from"] == "geometry" and shares:
        times.set_xlabel("holding is estimated", color=GREY)
    if n_rows == 3:
        draws, layouts, looks = panels[2]
        if statistics["draws"]:
            _draws(draws, statistics["draws"])
        else:
            _paired_bars(draws, "Families", groups("family"))
        _layouts(layouts, statistics)
        _paired_bars(looks, "Reflections, and splits", groups("reflection", "split"))
    return written(figure, path)


def _unknown(axes: Axes) -> None:
    """Say in a panel that there is nothing to tell."""
    axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", color=GREY)
    axes.set_axis_off()


def _with_star(row: Row) -> tuple[str, dict[str, Any]]:
    """Return the value as text and its style, with a star where it stands out."""
    style = {"weight": "bold" if row.stands_out else "normal"}
    return number(row.value, row) + ("*" if row.stands_out else ""), style


def _paired_bars(axes: Axes, title: str, groups: Sequence[Sequence[Row]]) -> None:
    """Draw shares of two sets as pairs of bars, groups apart, the set's value at the end."""
    axes.set_title(title)
    groups = [group for group in groups if group]
    shown = [row for group in groups for row in group]
    if not shown:
        _unknown(axes)
        return
    gaps = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    places = np.arange(len(shown)) + 0.7 * gaps
    ends = [max(row.value, *np.atleast_1d(row.other or 0.0)) for row in shown]
    for place, row, end in zip(places, shown, ends, strict=True):
        alone = row.other is None
        axes.barh(place if alone else place - 0.2, row.value, 0.7 if alone else 0.4, color=HERE)
        if row.other is not None:
            low, top = row.other if isinstance(row.other, tuple) else (0.0, row.other)
            axes.barh(place + 0.2, top - low, 0.4, left=low, color=BESIDE)
        text, style = _with_star(row)
        axes.text(end + 0.02 * max(ends), place, text, va="center", **style)
    axes.set_yticks(places, [clipped(row.label, LONGEST_LABEL) for row in shown])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(0, 1.2 * max(*ends, 0.01))
    axes.locator_params(axis="x", nbins=4)
    axes.tick_params(axis="y", length=0)


def _goals(axes: Axes, here: Statistics) -> None:
    """Draw how often each goal occurs, as a grid of numbers on shades."""
    axes.set_title("Goals of agents, numbers")
    if "goal" not in here["tables"]:
        _unknown(axes)
        return
    landmarks, of_landmarks, others = goal_grid(here)
    if len(others) > _FEW:
        others = {goal: count for goal, count in others.items() if count}
    rest = [[count, *[np.nan] * (len(landmarks) - 1)] for count in others.values()]
    numbers = np.array([*of_landmarks.values(), *rest], float)
    axes.imshow(numbers, aspect="auto", cmap="Blues", vmin=0, vmax=1.6 * max(np.nanmax(numbers), 1))
    for (row, column), count in np.ndenumerate(numbers):
        if not np.isnan(count):
            colour = INK if count else GREY
            axes.text(column, row, f"{count:.0f}", ha="center", va="center", color=colour)
    names = [name.removeprefix("Get ") for name in of_landmarks]
    axes.set_yticks(range(len(numbers)), [*names, *others])
    axes.set_xticks(range(len(landmarks)), landmarks)
    axes.xaxis.tick_top()
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, pad=2)
    axes.axhline(len(of_landmarks) - 0.5, color="white", lw=4)


def _durations(axes: Axes, here: Statistics, beside: Statistics, found: Sequence[Row]) -> None:
    """Draw how long events are, with the least, the median and the greatest length."""
    axes.set_title("Duration")
    histogram = here["histograms"]["frames"]
    edges, counts = np.array(histogram["edges"], float), np.array(histogram["counts"], float)
    share = counts / counts.sum()
    width = edges[1] - edges[0]  # the last bin is open, and drawn as wide as the others
    axes.bar(edges[:-1], share, width, align="edge", color=HERE, ec="white", lw=0.8)
    top = float(share.max())
    for colour, ink, values, y in (
        (HERE, INK, here["values"], 1.42 * top),
        (BESIDE, GREY, beside["values"], 1.17 * top),
    ):
        if "frames_median" not in values:
            continue
        figures = [values[f"frames_{what}"]["value"] for what in ("min", "median", "max")]
        places = np.minimum(figures, edges[-1])
        axes.plot(places[[0, 2]], [y, y], color=colour, lw=2, solid_capstyle="butt")
        axes.plot(places[1], y, "o", ms=5, color=colour)
        sides = (("right", (-3, 0)), ("center", (0, 7)), ("left", (3, 0)))
        for value, x, (side, shift) in zip(figures, places, sides, strict=True):
            style: dict[str, Any] = {"ha": side, "va": "center", "color": ink}
            axes.annotate(f"{value:.0f}", (x, y), shift, textcoords="offset points", **style)
    untrimmed = next(row for row in found if row.key == "untrimmed")
    words = f"share that moves to the end: {_with_star(untrimmed)[0]}"
    if untrimmed.other is not None:
        words += f" (grey: {other_text(untrimmed)})"
    axes.set_xlim(0, edges[-2] + 1.6 * width)
    axes.set_ylim(0, top * 1.6)
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.set_yticks([0, top], ["0", f"{top:.2f}"])
    axes.set_xlabel(f"frames (12 per simulated second)\n{words}", fontsize=SMALL)


def _speeds(axes: Axes, here: Statistics, beside: Statistics, found: Sequence[Row]) -> None:
    """Draw the agents' speeds for each strength: distribution, mean, 99 % and greatest."""
    axes.set_title("Speed of agents, by strength")
    kinds = {"": "all", **{f"_{level}": f"{level} N" for level in LEVELS}}
    shown = [kind for kind in kinds if f"speed_mean{kind}" in here["values"]]
    of_speed = {row.key: row for row in found}
    for place, kind in enumerate(shown):
        histogram = here["histograms"][f"speed{kind}"]
        edges, counts = np.array(histogram["edges"], float), np.array(histogram["counts"], float)
        heights = 0.62 * np.sqrt(counts / counts.max())
        axes.stairs(place - heights, edges, baseline=place, fill=True, color=HERE, alpha=0.25)
        for values, colour, y in (
            (beside["values"], BESIDE, place + 0.18),
            (here["values"], HERE, place + 0.05),
        ):
            if f"speed_mean{kind}" in values:
                _speed_marks(axes, values, kind, y, colour)
        for column, what in enumerate(_SPEED_MARKS):
            text, style = _with_star(of_speed[f"speed_{what}{kind}"])
            x = _SPEED_TEXT + column * 12
            axes.text(x, place - 0.02, text, va="bottom", ha="center", **style)
    for column, (words, mark) in enumerate(_SPEED_MARKS.values()):
        x = _SPEED_TEXT + column * 12
        axes.plot(x, -0.88, mark, ms=4.5, mew=1.4, color=HERE, mfc="white" if column else HERE)
        axes.text(x, -0.76, words, color=GREY, ha="center", va="top")
    axes.set_yticks(range(len(shown)), [kinds[kind] for kind in shown])
    axes.set_ylim(len(shown) - 0.6, -0.95)
    axes.set_xlim(0, _SPEED_TEXT + 30)
    axes.set_xticks(range(0, SPEED_EDGES[-1] + 1, 10))
    axes.set_xlabel("units/s; shaded: root of the frequency")
    axes.tick_params(axis="y", length=0)


def _speed_marks(axes: Axes, values: Mapping[str, Any], kind: str, y: float, colour: str) -> None:
    mean, high, most = (
        min(values[f"speed_{what}{kind}"]["value"], SPEED_EDGES[-1]) for what in _SPEED_MARKS
    )
    axes.plot([mean, most], [y, y], color=colour, lw=1)
    axes.plot(mean, y, "o", ms=4.5, color=colour)
    axes.plot(high, y, "|", ms=6, mew=2, color=colour)
    axes.plot(most, y, "o", ms=4, mfc="white", mec=colour)


def _draws(axes: Axes, draws: Mapping[str, Any]) -> None:
    """Draw the share of draws kept, with the main reason against the others."""
    axes.set_title("Draws kept, of how many, and why not")
    tried = [(cell, draw) for cell, draw in draws.items() if draw["tried"]]
    for place, (_, draw) in enumerate(tried):
        axes.barh(place, draw["share"], 0.7, color=HERE)
        why = next(iter(draw["reasons"]), "")
        words = f"{draw['kept']} of {draw['tried']}" + (f": {clipped(why, 38)}" if why else "")
        axes.text(draw["share"] + 0.02, place, words, va="center")
    axes.set_yticks(range(len(tried)), [clipped(cell, LONGEST_LABEL) for cell, _ in tried])
    axes.set_ylim(len(tried) - 0.4, -0.6)
    axes.set_xlim(0, 3.3)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.tick_params(axis="y", length=0)


def _layouts(axes: Axes, here: Statistics) -> None:
    """Draw how many events each layout has."""
    axes.set_title("Layouts of walls, events")
    counts = here["tables"].get("layout", {}).get("counts")
    if not counts:
        _unknown(axes)
        return
    axes.bar(range(len(counts)), list(counts.values()), 0.75, color=HERE)
    axes.set_xticks(range(len(counts)), list(counts))
    axes.locator_params(axis="y", integer=True)
    axes.set_xlabel("number of the layout")
    axes.tick_params(axis="x", length=0, labelsize=SMALL - 0.5)
