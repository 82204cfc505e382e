"""Statistics of a set of events beside those of another: as text, and as the data card, a page."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from phase_ppl.analysis.estimate import cautious, widened
from phase_ppl.analysis.figures.style import GREY, INK, SMALL, in_style, new_figure, written
from phase_ppl.dataset.statistics import LEVELS, PHASE, SPEED_EDGES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Statistics = Mapping[str, Any]
WIDTH: Final = 88  # columns of the text at most
Z: Final = 1.96
FEWEST: Final = 10  # events from which on a bootstrap's error is believed

TABLES: Final[Mapping[str, str]] = {
    "relation": "relation",
    "scenario": "scenario",
    "goal_type": "goal type, of agents",
    "strength": "strength of agents [N]",
    "agent_size": "size of agents [units]",
    "item_size": "size of items [units]",
    "family": "family",
    "layout": "layout of walls",
    "reflection": "reflection",
    "split": "split",
}
"""Name of a table -> heading."""

VALUES: Final[Mapping[str, Mapping[str, str]]] = {
    "duration [frames]": {
        "frames_min": "least",
        "frames_median": "median",
        "frames_max": "greatest",
        "untrimmed": "share that moves to the end",
    },
    "speed of agents [units/s], by strength": {
        "speed_mean": "mean, all",
        **{f"speed_mean_{level}": f"mean, {level} N" for level in LEVELS},
        "speed_p99": "99 %, all",
        **{f"speed_p99_{level}": f"99 %, {level} N" for level in LEVELS},
        "speed_max": "greatest, all",
        **{f"speed_max_{level}": f"greatest, {level} N" for level in LEVELS},
    },
    "step of agents [units per frame]": {"step_median": "median", "step_max": "greatest"},
    "share of time": {
        "at_rest": "agent slower than 0.5 units/s",
        **{f"at_rest_{level}": f"agent slower than 0.5, {level} N" for level in LEVELS},
        "items_move": "item moves (0.5 units/s or more)",
        "holding": "agent holds an item",
    },
}
"""Heading -> name of a value -> label."""

# heading -> digits after the point; of others 2
_DIGITS: Final = {"duration [frames]": 0, "speed of agents [units/s], by strength": 1}


class Row(NamedTuple):
    """One figure of two sets.

    The key is its name in the statistics, with the label where it is a count:
    "relation/friendly".
    """

    heading: str
    key: str
    label: str
    n: int | None  # how many in the first set, where they are counted
    value: float
    margin: float | None  # half of the 95 % interval
    other_n: int | None = None
    other: float | tuple[float, float] | None = None  # in the other set; two numbers are bounds
    stands_out: bool = False  # whether the two differ by more than chance explains

    def text(self, value: float) -> str:
        """Return a figure as it is printed."""
        digits = 2 if self.key == "untrimmed" else _DIGITS.get(self.heading, 2)
        return f"{value:.{digits}f}"

    @property
    def other_text(self) -> str:
        """The other set's figure as it is printed."""
        bounds = () if self.other is None else np.atleast_1d(self.other).tolist()
        return "..".join(map(self.text, bounds))


def rows(here: Statistics, beside: Statistics = PHASE) -> list[Row]:
    """Return the figures of a set beside those of another, in the order they are shown."""
    found = []
    for name, heading in TABLES.items():
        if name in here["tables"]:
            found += _table_rows(name, heading, here["tables"][name], beside["tables"].get(name))
    for heading, labels in VALUES.items():
        for name, label in labels.items():
            if name in here["values"]:
                value, other = here["values"][name], beside["values"].get(name)
                found.append(_value_row(name, heading, label, value, other))
    return found


def _table_rows(
    name: str, heading: str, here: Mapping[str, Any], beside: Mapping[str, Any] | None
) -> list[Row]:
    found = []
    for label in {**here["counts"], **(beside["counts"] if beside else {})}:
        share, count = here["shares"].get(label, 0.0), here["counts"].get(label, 0)
        margin = Z * cautious(share, here["units"])[1]
        row = Row(heading, f"{name}/{label}", label, count, share, margin)
        if beside is not None:
            other, other_n = beside["shares"].get(label, 0.0), beside["counts"].get(label, 0)
            differs = shares_differ(share, here["units"], other, beside["units"])
            row = row._replace(other_n=other_n, other=other, stands_out=differs)
        found.append(row)
    return found


def shares_differ(first: float, n_first: int, second: float, n_second: int) -> bool:
    """Whether two shares differ by more than samples of such sizes do in 95 of 100 cases.

    The interval of Agresti and Caffo (2000), good for small samples too.
    """
    p, p_error = cautious(first, n_first)
    q, q_error = cautious(second, n_second)
    return abs(p - q) > Z * math.hypot(p_error, q_error)


def _value_row(
    name: str, heading: str, label: str, here: Mapping[str, Any], beside: Mapping[str, Any] | None
) -> Row:
    value, n = here["value"], here["units"]
    error = None if here["se"] is None or n < FEWEST else _widened(here["se"], n)
    row = Row(heading, name, label, None, value, None if error is None else Z * error)
    if beside is None:
        return row
    low, high = beside.get("between") or (beside["value"], beside["value"])
    row = row._replace(other=low if low == high else (low, high))
    if error is None:
        return row
    # an error that is not told is taken to be as here, but for the number of events
    known, other_n = beside.get("se"), beside["units"]
    theirs = _widened(known, other_n) if known else error * math.sqrt(n / other_n)
    beyond = max(low - value, value - high)
    return row._replace(stands_out=beyond > Z * math.hypot(error, theirs))


def _widened(error: float, n: int) -> float:
    """Return a bootstrap's error over n events, so that 1.96 of it hold 95 % of means.

    It has the spread of the events themselves, not of what they were drawn from, and takes that to
    be known.
    """
    return error * math.sqrt(n / max(n - 1, 1)) * widened(n)


def data_table(here: Statistics, beside: Statistics = PHASE) -> str:
    """Return the statistics of a set beside those of another as text of at most 88 columns."""
    head = _line("", clipped(here["name"], 21), clipped(beside["name"], 16))
    lines, heading = [*textwrap.wrap(about(here), WIDTH), "", head], ""
    shown = rows(here, beside)
    for row in shown:
        if row.heading != heading:
            heading = row.heading
            lines += [_line(heading, "", "")]
        lines.append(_row_line(row))
    if any(row.stands_out for row in shown):
        note = (
            f"* differs from {beside['name']} by more than chance explains, given how many events "
            "there are (95\u00a0%); about one in twenty does by chance"
        )
        lines += ["", *textwrap.wrap(note, WIDTH, subsequent_indent="  ")]
    if here["values"].get("holding") and here["holding_from"] == "geometry":
        lines += ["", "Holding is estimated from where items are."]
    return "\n".join([*lines, *_goals(here), *_draws(here)])


def about(here: Statistics) -> str:
    """Return of how many events the statistics are, and what is not known of these."""
    events, unknown = here["events"], here["without_strength"]
    words = f"{here['name']}: {events} event{'' if events == 1 else 's'}"
    if here["units"] != events:
        words += f", {here['units']} without copies"
    if here["without_truth"]:
        words += f", {here['without_truth']} without truth"
    if unknown:
        words += f", {unknown} agent{'' if unknown == 1 else 's'} of unknown strength"
    return words


def _line(label: str, here: str, beside: str, mark: str = "") -> str:
    return f"{label:<40}{here:>23}{beside:>18} {mark}".rstrip()


def _row_line(row: Row) -> str:
    margin = " " * 7 if row.margin is None else f" ±{row.text(row.margin):>5}"
    count, other_count = ("" if n is None else str(n) for n in (row.n, row.other_n))
    here = f"{count:>7} {row.text(row.value):>6}{margin}"
    other = f"{other_count:>7} {row.other_text:>8}"
    return _line(f"  {clipped(row.label, 37)}", here, other, "*" if row.stands_out else "")


class GoalGrid(NamedTuple):
    """How often each goal occurs: those about landmarks as a grid, the others by name."""

    landmarks: list[str]
    rows: dict[str, list[int]]  # such as "Get blue item to" -> (landmark,) counts
    others: dict[str, int]


def goal_grid(here: Statistics) -> GoalGrid:
    """Return how often each goal of a set's world occurs."""
    counts = here["tables"].get("goal", {}).get("counts", {})
    found = GoalGrid(list(here["landmarks"]), {}, {})
    for goal, count in counts.items():
        about_it = [n for n, name in enumerate(found.landmarks) if goal.endswith(f" {name}")]
        if about_it and goal.startswith("Get "):
            row = goal.removesuffix(f" {found.landmarks[about_it[0]]}")
            found.rows.setdefault(row, [0] * len(found.landmarks))[about_it[0]] = int(count)
        else:
            found.others[goal] = int(count)
    return found


def _goals(here: Statistics) -> list[str]:
    if "goal" not in here["tables"]:
        return []
    landmarks, rows, others = goal_grid(here)
    lines = ["", f"{'goals':<28}" + "".join(f"{landmark:>11}" for landmark in landmarks)]
    for name, counts in rows.items():
        lines.append(f"  {name:<26}" + "".join(f"{count:>11}" for count in counts))
    width = max([26, *map(len, others)])
    return lines + [f"  {goal:<{width}}{count:>11}" for goal, count in others.items()]


def _draws(here: Statistics) -> list[str]:
    if not here["draws"]:
        return []
    lines = ["", f"{'draws':<28}{'kept':>6}{'of':>6}{'share':>7}  why not"]
    for cell, draw in here["draws"].items():
        share = "" if draw["share"] is None else f"{draw['share']:.2f}"
        start = f"  {clipped(cell, 25):<26}{draw['kept']:>6}{draw['tried']:>6}{share:>7}  "
        why = ", ".join(f"{reason} {n}" for reason, n in draw["reasons"].items())
        indent = " " * len(start)
        lines += textwrap.wrap(start + why, WIDTH, subsequent_indent=indent) or [start.rstrip()]
    return lines


def clipped(text: str, length: int) -> str:
    """Return a text of at most so many characters."""
    return text if len(text) <= length else text[: length - 1] + "…"


# --- the card -------------------------------------------------------------------------------------

HERE: Final = "#0072b2"
BESIDE: Final = "#b4b4b4"
"""Colours: of the set, of the other."""

_LONGEST: Final = 22  # characters of a label at most

_GOAL_TYPES: Final = {
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

    def groups(**labels: str) -> list[list[Row]]:
        """Return the rows of tables, with their labels in other words."""
        return [
            [row._replace(label=words.format(_GOAL_TYPES.get(row.label, row.label)))
             for row in found if row.key.startswith(f"{name}/")]
            for name, words in labels.items()
        ]  # fmt: skip

    kinds, types, goals = panels[0]
    _paired_bars(kinds, "Relation, and scenario", groups(relation="{}", scenario="{}"))
    _paired_bars(types, "Goals of agents, by type", groups(goal_type="{}"))
    _goal_numbers(goals, statistics)
    bodies, durations, speeds, times = panels[1]
    sizes = groups(strength="{} N", agent_size="agent {}", item_size="item {}")
    _paired_bars(bodies, "Strength, size of agents, of items", sizes)
    by_key = {row.key: row for row in found}
    _durations(durations, statistics, beside, by_key["untrimmed"])
    _speeds(speeds, statistics, beside, by_key)
    shares = [by_key[k]._replace(label=v) for k, v in _TIME_NAMES.items() if k in by_key]
    _paired_bars(times, "Share of time", [shares])
    if statistics["holding_from"] == "geometry" and shares:
        times.set_xlabel("holding is estimated", color=GREY)
    if n_rows == 3:
        draws, layouts, looks = panels[2]
        if statistics["draws"]:
            _draws_kept(draws, statistics["draws"])
        else:
            _paired_bars(draws, "Families", groups(family="{}"))
        _layouts(layouts, statistics)
        _paired_bars(looks, "Reflections, and splits", groups(reflection="{}", split="{}"))
    return written(figure, path)


def _unknown(axes: Axes) -> None:
    """Say in a panel that there is nothing to tell."""
    axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center", color=GREY)
    axes.set_axis_off()


def _with_star(row: Row) -> tuple[str, dict[str, Any]]:
    """Return the value as text and its style, with a star where it stands out."""
    style = {"weight": "bold" if row.stands_out else "normal"}
    return row.text(row.value) + ("*" if row.stands_out else ""), style


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
    axes.set_yticks(places, [clipped(row.label, _LONGEST) for row in shown])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(0, 1.2 * max(*ends, 0.01))
    axes.locator_params(axis="x", nbins=4)
    axes.tick_params(axis="y", length=0)


def _goal_numbers(axes: Axes, here: Statistics) -> None:
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


def _durations(axes: Axes, here: Statistics, beside: Statistics, untrimmed: Row) -> None:
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
    words = f"share that moves to the end: {_with_star(untrimmed)[0]}"
    if untrimmed.other is not None:
        words += f" (grey: {untrimmed.other_text})"
    axes.set_xlim(0, edges[-2] + 1.6 * width)
    axes.set_ylim(0, top * 1.6)
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.set_yticks([0, top], ["0", f"{top:.2f}"])
    axes.set_xlabel(f"frames (12 per simulated second)\n{words}", fontsize=SMALL)


def _speeds(axes: Axes, here: Statistics, beside: Statistics, rows: Mapping[str, Row]) -> None:
    """Draw the agents' speeds for each strength: distribution, mean, 99 % and greatest."""
    axes.set_title("Speed of agents, by strength")
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
                mean, high, most = (
                    min(values[f"speed_{what}{kind}"]["value"], SPEED_EDGES[-1])
                    for what in _SPEED_MARKS
                )
                axes.plot([mean, most], [y, y], color=colour, lw=1)
                axes.plot(mean, y, "o", ms=4.5, color=colour)
                axes.plot(high, y, "|", ms=6, mew=2, color=colour)
                axes.plot(most, y, "o", ms=4, mfc="white", mec=colour)
        for column, what in enumerate(_SPEED_MARKS):
            text, style = _with_star(rows[f"speed_{what}{kind}"])
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


def _draws_kept(axes: Axes, draws: Mapping[str, Any]) -> None:
    """Draw the share of draws kept, with the main reason against the others."""
    axes.set_title("Draws kept, of how many, and why not")
    tried = [(cell, draw) for cell, draw in draws.items() if draw["tried"]]
    for place, (_, draw) in enumerate(tried):
        axes.barh(place, draw["share"], 0.7, color=HERE)
        why = next(iter(draw["reasons"]), "")
        words = f"{draw['kept']} of {draw['tried']}" + (f": {clipped(why, 38)}" if why else "")
        axes.text(draw["share"] + 0.02, place, words, va="center")
    axes.set_yticks(range(len(tried)), [clipped(cell, _LONGEST) for cell, _ in tried])
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
