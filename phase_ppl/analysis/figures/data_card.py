"""The data card: the statistics of a set of events beside those of another, on one page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.data_table import Row, number
from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from phase_ppl.analysis.data_table import other_text
from phase_ppl.dataset.statistics import LEVELS, SPEED_EDGES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from typing import TYPE_CHECKING

from phase_ppl.analysis.data_table import goal_grid
from phase_ppl.world.names import LANDMARKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
import os
from typing import TYPE_CHECKING

from phase_ppl.analysis.data_table import counted, rows
from phase_ppl.analysis.figures import data_card as motion
from phase_ppl.analysis.figures import data_card as panel
from phase_ppl.analysis.figures.style import new_figure, written
from phase_ppl.dataset.statistics import PHASE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


HERE: Final = "#0072b2"
BESIDE: Final = "#b4b4b4"
WORDS: Final = "#666666"
"""Colours: of the set, of the other, of what explains."""

LONGEST_LABEL: Final = 22
"""Characters of a label at most."""


def of(found: Sequence[Row], start: str) -> list[Row]:
    """Return the rows whose keys begin so."""
    return [row for row in found if row.key.startswith(start)]


def named(found: Sequence[Row], key: str) -> Row:
    """Return the row with this key."""
    return next(row for row in found if row.key == key)


def with_star(row: Row) -> str:
    """Return the value as text, with a star where it stands out."""
    return number(row.value, row) + ("*" if row.stands_out else "")


def short(text: str, length: int) -> str:
    """Return a text cut to a length."""
    return text if len(text) <= length else text[: length - 1] + "…"


def title(axes: Axes, text: str) -> None:
    """Write the title of a panel."""
    axes.set_title(text, fontsize=NORMAL + 1, loc="left", color=INK)


def unknown(axes: Axes) -> None:
    """Say in a panel that there is nothing to tell."""
    axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", fontsize=NORMAL,
              color=WORDS)  # fmt: skip
    axes.set_axis_off()


def paired_bars(axes: Axes, groups: Sequence[Sequence[Row]]) -> None:
    """Draw shares of two sets as pairs of bars, groups apart, the set's value at the end."""
    shown = [row for group in groups for row in group]
    if not shown:
        unknown(axes)
        return
    gaps = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    places = np.arange(len(shown)) + 0.7 * gaps
    high = max(max(row.value, *np.atleast_1d(row.other or 0.0)) for row in shown)
    for place, row in zip(places, shown, strict=True):
        alone = row.other is None
        axes.barh(place if alone else place - 0.2, row.value, 0.7 if alone else 0.4, color=HERE)
        if row.other is not None:
            low, top = row.other if isinstance(row.other, tuple) else (0.0, row.other)
            axes.barh(place + 0.2, top - low, 0.4, left=low, color=BESIDE)
        end = max(row.value, *np.atleast_1d(row.other or 0.0))
        axes.text(end + 0.02 * high, place, with_star(row), va="center", fontsize=SMALL, color=INK,
                  weight="bold" if row.stands_out else "normal")  # fmt: skip
    axes.set_yticks(places, [short(row.label, LONGEST_LABEL) for row in shown])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(0, 1.2 * max(high, 0.01))
    axes.locator_params(axis="x", nbins=4)
    bare(axes)
    axes.tick_params(axis="y", length=0)


# --- panels of the data card: how long events are, and how fast agents go -------------------------

_S1 = Mapping[str, Any]

_SPEED_MARKS: Final = {"mean": ("mean", "o"), "p99": ("99 %", "|"), "max": ("most", "o")}
_SPEED_TEXT: Final = SPEED_EDGES[-1] + 7.0
"""Where the columns of numbers begin, units/s."""


def durations(axes: Axes, here: _S1, beside: _S1, found: Sequence[Row]) -> None:
    """Draw how long events are, with the least, the median and the greatest length."""
    title(axes, "Duration")
    histogram = here["histograms"]["frames"]
    edges, counts = np.array(histogram["edges"], float), np.array(histogram["counts"], float)
    share = counts / counts.sum()
    width = edges[1] - edges[0]  # the last bin is open, and drawn as wide as the others
    axes.bar(edges[:-1], share, width, align="edge", color=HERE, ec="white", lw=0.8)
    top = float(share.max())
    for colour, ink, values, y in (
        (HERE, INK, here["values"], 1.42 * top),
        (BESIDE, WORDS, beside["values"], 1.17 * top),
    ):
        if "frames_median" not in values:
            continue
        figures = [values[f"frames_{what}"]["value"] for what in ("min", "median", "max")]
        places = np.minimum(figures, edges[-1])
        axes.plot(places[[0, 2]], [y, y], color=colour, lw=2, solid_capstyle="butt")
        axes.plot(places[1], y, "o", ms=5, color=colour)
        for value, x, side, shift in zip(
            figures, places, ("right", "center", "left"), ((-3, 0), (0, 7), (3, 0)), strict=True
        ):
            axes.annotate(f"{value:.0f}", (x, y), shift, textcoords="offset points", ha=side,
                          va="center", fontsize=SMALL, color=ink)  # fmt: skip
    untrimmed = named(found, "untrimmed")
    words = f"share that moves to the end: {with_star(untrimmed)}"
    if untrimmed.other is not None:
        words += f" (grey: {other_text(untrimmed)})"
    axes.set_xlim(0, edges[-2] + 1.6 * width)
    axes.set_ylim(0, top * 1.6)
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.set_yticks([0, top], ["0", f"{top:.2f}"])
    axes.set_xlabel(f"frames (12 per simulated second)\n{words}", fontsize=SMALL, color=INK)
    bare(axes)


def speeds(axes: Axes, here: _S1, beside: _S1, found: Sequence[Row]) -> None:
    """Draw the agents' speeds for each strength: distribution, mean, 99 % and greatest."""
    title(axes, "Speed of agents, by strength")
    kinds = {"": "all", **{f"_{level}": f"{level} N" for level in LEVELS}}
    shown = [kind for kind in kinds if f"speed_mean{kind}" in here["values"]]
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
            row = named(found, f"speed_{what}{kind}")
            axes.text(_SPEED_TEXT + column * 12, place - 0.02, with_star(row), fontsize=SMALL,
                      va="bottom", ha="center", color=INK,
                      weight="bold" if row.stands_out else "normal")  # fmt: skip
    for column, (words, mark) in enumerate(_SPEED_MARKS.values()):
        x = _SPEED_TEXT + column * 12
        axes.plot(x, -0.88, mark, ms=4.5, mew=1.4, color=HERE, mfc="white" if column else HERE)
        axes.text(x, -0.76, words, fontsize=SMALL, color=WORDS, ha="center", va="top")
    axes.set_yticks(range(len(shown)), [kinds[kind] for kind in shown])
    axes.set_ylim(len(shown) - 0.6, -0.95)
    axes.set_xlim(0, _SPEED_TEXT + 30)
    axes.set_xticks(range(0, SPEED_EDGES[-1] + 1, 10))
    axes.set_xlabel("units/s; shaded: root of the frequency", fontsize=NORMAL, color=INK)
    bare(axes)
    axes.tick_params(axis="y", length=0)


def _speed_marks(axes: Axes, values: Mapping[str, Any], kind: str, y: float, colour: str) -> None:
    mean, high, most = (
        min(values[f"speed_{what}{kind}"]["value"], SPEED_EDGES[-1]) for what in _SPEED_MARKS
    )
    axes.plot([mean, most], [y, y], color=colour, lw=1)
    axes.plot(mean, y, "o", ms=4.5, color=colour)
    axes.plot(high, y, "|", ms=6, mew=2, color=colour)
    axes.plot(most, y, "o", ms=4, mfc="white", mec=colour)


# --- panels of the data card: what is in a set, in numbers and shares -----------------------------

_S2 = Mapping[str, Any]

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


def kinds(axes: Axes, found: Sequence[Row]) -> None:
    """Draw the shares of relations and scenarios."""
    title(axes, "Relation, and scenario")
    paired_bars(axes, [of(found, "relation/"), of(found, "scenario/")])


def goal_types(axes: Axes, found: Sequence[Row]) -> None:
    """Draw the shares of the types of goals."""
    title(axes, "Goals of agents, by type")
    types = of(found, "goal_type/")
    paired_bars(axes, [[row._replace(label=GOAL_TYPE_NAMES[row.label]) for row in types]])


def goals(axes: Axes, here: _S2) -> None:
    """Draw how often each of the 36 goals occurs, as a grid of numbers on shades."""
    title(axes, "Goals of agents, numbers")
    if "goal" not in here["tables"]:
        unknown(axes)
        return
    names, grid, others = goal_grid(here)
    landmarks = np.array(grid, float)
    rest = np.full((len(others), landmarks.shape[1]), np.nan)
    rest[:, 0] = list(others.values())
    numbers = np.concatenate([landmarks, rest])
    most = max(np.nanmax(numbers), 1)
    axes.imshow(numbers, aspect="auto", cmap="Blues", vmin=0, vmax=1.6 * most)
    for (row, column), count in np.ndenumerate(numbers):
        if not np.isnan(count):
            style: dict[str, Any] = {"fontsize": SMALL, "color": INK if count else WORDS}
            axes.text(column, row, f"{count:.0f}", ha="center", va="center", **style)
    labels = [name.removeprefix("Get ") for name in names]
    axes.set_yticks(range(len(numbers)), [*labels, *others])
    axes.set_xticks(range(len(LANDMARKS)), LANDMARKS)
    axes.xaxis.tick_top()
    bare(axes, "left", "bottom")
    axes.tick_params(length=0, pad=2)
    axes.axhline(len(names) - 0.5, color="white", lw=4)


def bodies(axes: Axes, found: Sequence[Row]) -> None:
    """Draw the shares of strengths and sizes."""
    title(axes, "Strength, size of agents, of items")
    groups = [
        [row._replace(label=f"{row.label} N") for row in of(found, "strength/")],
        [row._replace(label=f"agent {row.label}") for row in of(found, "agent_size/")],
        [row._replace(label=f"item {row.label}") for row in of(found, "item_size/")],
    ]
    paired_bars(axes, [group for group in groups if group])


def times(axes: Axes, here: _S2, found: Sequence[Row]) -> None:
    """Draw the shares of time at rest, with items in motion, and holding."""
    title(axes, "Share of time")
    shown = [
        row._replace(label=label)
        for key, label in _TIME_NAMES.items()
        for row in found
        if row.key == key
    ]
    paired_bars(axes, [shown])
    if here["holding_from"] == "geometry":
        axes.set_xlabel("holding is estimated", fontsize=SMALL, color=WORDS)


def draws(axes: Axes, here: _S2, found: Sequence[Row]) -> None:
    """Draw the share of draws kept, with the main reason against the others, or the families."""
    draws = here["draws"]
    if not draws:
        title(axes, "Families")
        paired_bars(axes, [of(found, "family/")])
        return
    title(axes, "Draws kept, of how many, and why not")
    tried = [(cell, draw) for cell, draw in draws.items() if draw["tried"]]
    for place, (_, draw) in enumerate(tried):
        axes.barh(place, draw["share"], 0.7, color=HERE)
        why = next(iter(draw["reasons"]), "")
        words = f"{draw['kept']} of {draw['tried']}" + (f": {short(why, 38)}" if why else "")
        axes.text(draw["share"] + 0.02, place, words, fontsize=SMALL, color=INK, va="center")
    axes.set_yticks(range(len(tried)), [short(cell, LONGEST_LABEL) for cell, _ in tried])
    axes.set_ylim(len(tried) - 0.4, -0.6)
    axes.set_xlim(0, 3.3)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    bare(axes)
    axes.tick_params(axis="y", length=0)


def layouts(axes: Axes, here: _S2) -> None:
    """Draw how many events each layout has."""
    title(axes, "Layouts of walls, events")
    counts = here["tables"].get("layout", {}).get("counts")
    if not counts:
        unknown(axes)
        return
    axes.bar(range(len(counts)), list(counts.values()), 0.75, color=HERE)
    axes.set_xticks(range(len(counts)), list(counts))
    axes.locator_params(axis="y", integer=True)
    axes.set_xlabel("number of the layout", fontsize=NORMAL, color=INK)
    bare(axes)
    axes.tick_params(axis="x", length=0, labelsize=SMALL - 0.5)


def looks(axes: Axes, found: Sequence[Row]) -> None:
    """Draw the shares of reflections and splits."""
    title(axes, "Reflections, and splits")
    groups = [of(found, "reflection/"), of(found, "split/")]
    paired_bars(axes, [group for group in groups if group])


# --- the data card: the statistics of a set of events beside those of another, on one... ----------

Statistics = Mapping[str, Any]

_WIDTH: Final = 12.0
_TOP: Final = 0.85
_PANEL: Final = 2.6
_ROW: Final = 3.4
"""Inches: width of the page, where the first row of panels begins, height of a panel, distance of
the rows."""

_COLUMNS: Final = (
    ((1.05, 2.2), (4.55, 2.0), (8.35, 3.5)),
    ((1.05, 2.1), (3.85, 2.0), (6.6, 2.75), (10.6, 1.25)),
    ((1.75, 3.9), (6.2, 2.75), (10.1, 1.75)),
)
"""Per row of panels their left sides and widths, inches."""


def data_card(
    statistics: Statistics,
    path: str | os.PathLike[str] | None = None,
    *,
    beside: Statistics = PHASE,
) -> Figure:
    """Draw the statistics of a set of events beside those of another, on one page.

    A figure of the set with a star differs from the other's by more than chance explains (95 %).

    Args:
        statistics: of :func:`phase_ppl.dataset.statistics.statistics`.
        path: where to write the figure as well, as .png, .pdf or .svg.
        beside: likewise; by default the original events.

    Returns:
        A matplotlib figure, 12 inches wide; a third row of panels shows what only the manifest of
        a generated set tells.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    told = {"family", "layout", "reflection", "split"} & set(statistics["tables"])
    columns = _COLUMNS if told or statistics["draws"] else _COLUMNS[:2]
    height = _TOP + len(columns) * _ROW - (_ROW - _PANEL) + 0.6
    figure = new_figure(_WIDTH, height)
    panels = [
        [
            figure.add_axes(
                (left / _WIDTH, 1 - (_TOP + row * _ROW + _PANEL) / height,
                 width / _WIDTH, _PANEL / height)
            )
            for left, width in places
        ]
        for row, places in enumerate(columns)
    ]  # fmt: skip
    found = rows(statistics, beside)
    _heading(figure, statistics, beside, height)
    panel.kinds(panels[0][0], found)
    panel.goal_types(panels[0][1], found)
    panel.goals(panels[0][2], statistics)
    panel.bodies(panels[1][0], found)
    motion.durations(panels[1][1], statistics, beside, found)
    motion.speeds(panels[1][2], statistics, beside, found)
    panel.times(panels[1][3], statistics, found)
    if len(panels) == 3:
        panel.draws(panels[2][0], statistics, found)
        panel.layouts(panels[2][1], statistics)
        panel.looks(panels[2][2], found)
    return written(figure, path)


def _heading(figure: Figure, here: Statistics, beside: Statistics, height: float) -> None:
    words = counted(here["events"], "event")
    if here["units"] != here["events"]:
        words += f", {here['units']} without copies"
    if here["without_truth"]:
        words += f", {here['without_truth']} without truth"
    y = 1 - 0.17 / height
    style: dict[str, Any] = {"va": "top", "fontsize": 9}
    name, other = (short(of["name"], 24) for of in (here, beside))
    figure.text(0.012, y, f"{name}: {words}", color=HERE, weight="bold", **style)
    note = f"in grey: {other}; * differs by more than chance explains (95 %)"
    figure.text(0.988, y, note, color=WORDS, ha="right", **style)
