"""Statistics of a set of events beside those of another, and which of them differ."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from phase_ppl.analysis.estimate import cautious, widened
from phase_ppl.dataset.statistics import LEVELS, PHASE

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
    other_n: int | None
    other: float | tuple[float, float] | None  # in the other set; two numbers are bounds
    stands_out: bool  # whether the two differ by more than chance explains


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
    only_there = [] if beside is None else [k for k in beside["counts"] if k not in here["counts"]]
    for label in [*here["counts"], *only_there]:
        share, count = here["shares"].get(label, 0.0), here["counts"].get(label, 0)
        other = other_count = None
        differs = False
        if beside is not None:
            other, other_count = beside["shares"].get(label, 0.0), beside["counts"].get(label, 0)
            differs = shares_differ(share, here["units"], other, beside["units"])
        _, error = cautious(share, here["units"])
        key, margin = f"{name}/{label}", Z * error
        found.append(Row(heading, key, label, count, share, margin, other_count, other, differs))
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
    error = here["se"] if here["units"] >= FEWEST else None
    error = None if error is None else _widened(error, here["units"])
    margin = None if error is None else Z * error
    other: float | tuple[float, float] | None = None
    differs = False
    if beside is not None:
        low, high = beside.get("between") or (beside["value"], beside["value"])
        other = low if low == high else (low, high)
        if error is not None:
            # an error that is not told is taken to be as here, but for the number of events
            known = beside.get("se")
            share = math.sqrt(here["units"] / beside["units"])
            theirs = _widened(known, beside["units"]) if known else error * share
            beyond = max(low - here["value"], here["value"] - high)
            differs = beyond > Z * math.hypot(error, theirs)
    return Row(heading, name, label, None, here["value"], margin, None, other, differs)


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
    words = f"{here['name']}: {_counted(here['events'], 'event')}"
    if here["units"] != here["events"]:
        words += f", {here['units']} without copies"
    if here["without_truth"]:
        words += f", {here['without_truth']} without truth"
    if here["without_strength"]:
        words += f", {_counted(here['without_strength'], 'agent')} of unknown strength"
    return words


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _line(label: str, here: str, beside: str, mark: str = "") -> str:
    return f"{label:<40}{here:>23}{beside:>18} {mark}".rstrip()


def _row_line(row: Row) -> str:
    margin = " " * 7 if row.margin is None else f" ±{number(row.margin, row):>5}"
    count = "" if row.n is None else str(row.n)
    here = f"{count:>7} {number(row.value, row):>6}{margin}"
    other_count = "" if row.other_n is None else str(row.other_n)
    other = f"{other_count:>7} {other_text(row):>8}"
    return _line(f"  {clipped(row.label, 37)}", here, other, "*" if row.stands_out else "")


def other_text(row: Row) -> str:
    """Return the other set's figure as it is printed."""
    if row.other is None:
        return ""
    if isinstance(row.other, tuple):
        return "..".join(number(bound, row) for bound in row.other)
    return number(row.other, row)


def number(value: float, row: Row) -> str:
    """Return a figure of a row as it is printed."""
    digits = 2 if row.key == "untrimmed" else _DIGITS.get(row.heading, 2)
    return f"{value:.{digits}f}"


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
