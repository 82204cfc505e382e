"""Panels of the data card: what is in a set, in numbers and shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.data_card_bars import (
    HERE,
    LONGEST_LABEL,
    WORDS,
    of,
    paired_bars,
    short,
    title,
    unknown,
)
from phase_ppl.analysis.data_table import Row, goal_grid
from phase_ppl.analysis.style import INK, NORMAL, SMALL, bare
from phase_ppl.dataset.counts import LEVELS
from phase_ppl.world.names import LANDMARKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Statistics = Mapping[str, Any]

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


def goals(axes: Axes, here: Statistics) -> None:
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


def times(axes: Axes, here: Statistics, found: Sequence[Row]) -> None:
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


def draws(axes: Axes, here: Statistics, found: Sequence[Row]) -> None:
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


def layouts(axes: Axes, here: Statistics) -> None:
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
