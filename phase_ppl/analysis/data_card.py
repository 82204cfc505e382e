"""The data card: the statistics of a set of events beside those of another, on one page."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis import data_card_motion as motion
from phase_ppl.analysis import data_card_panels as panel
from phase_ppl.analysis.data_card_bars import HERE, WORDS, short
from phase_ppl.analysis.data_table import counted, rows
from phase_ppl.analysis.style import new_figure, written
from phase_ppl.dataset.phase_statistics import PHASE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
