"""Accuracy of goals and relations, over all events and by scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.figures.sheet import (
    GREY,
    NothingToDrawError,
    Results,
    Sheet,
    fitting,
    in_words,
    label_column,
    tint,
)
from phase_ppl.evaluation.observers import Observer
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLES: Final = {"goal": "Goals", "relation": "Relations"}

_PANEL: Final = 1.17
_NUMBER: Final = 0.33
_ROW: Final = 0.185
_HEADING: Final = 0.52
_BELOW: Final = 0.36
_NOTE: Final = (
    "Share of right answers (people: mean share of people who are right) with 95 % intervals "
    "over events; n: answers."
)


def accuracy(results: Results) -> Figure:
    """Draw the accuracy of everybody, goals above relations, a column per true scenario.

    Raises:
        NothingToDrawError: no answer can be right or wrong.
    """
    blocks = {kind: _rows(results, kind) for kind in TITLES}
    blocks = {kind: rows for kind, rows in blocks.items() if rows}
    if not blocks:
        raise NothingToDrawError("no truth is known of an event that somebody judged")
    present = [name for name in SCENARIOS if name in results.scenarios.values()]
    # one scenario is all there is
    columns: list[str | None] = [None, *present] if len(present) > 1 else [None]
    heights = {kind: _HEADING + _ROW * len(rows) + _BELOW for kind, rows in blocks.items()}
    left = label_column(o.label for rows in blocks.values() for o in rows)
    sheet = Sheet(left + _PANEL * max(len(columns), 3), sum(heights.values()) + 0.22)
    top = 0.0
    for kind, rows in blocks.items():
        _block(sheet, (left, top), results, kind, rows, columns)
        top += heights[kind]
    size = fitting(_NOTE, 1.3 * (sheet.width - 0.16), SMALL - 0.5)  # the font is not bold
    sheet.write(0.08, sheet.height - 0.07, _NOTE, size=size, colour=GREY)
    return sheet.figure


def measure(metrics: Mapping[str, Any], name: str, scenario: str | None = None) -> Any:
    """Return a figure {value, ci_low, ci_high} of the metrics, or None."""
    place = metrics if scenario is None else metrics.get("by_scenario", {}).get(scenario) or {}
    return place.get(name)


def _rows(results: Results, kind: str) -> list[Observer]:
    name = f"{kind}_accuracy"
    return [o for o in results.asking(kind) if measure(o.metrics, name) is not None]


def _block(
    sheet: Sheet,
    place: tuple[float, float],
    results: Results,
    kind: str,
    rows: Sequence[Observer],
    columns: Sequence[str | None],
) -> None:
    names, top = place
    sheet.write(0.08, top + 0.2, TITLES[kind], size=NORMAL + 1, weight="bold")
    size = min(fitting(observer.label, 1.19 * (names - 0.16), NORMAL) for observer in rows)
    for row, observer in enumerate(rows):
        y = top + _HEADING + _ROW * (row + 0.5)
        sheet.write(
            names - 0.08, y, observer.label, size=size, colour=observer.colour,
            ha="right", va="center_baseline",
        )  # fmt: skip
    for column, scenario in enumerate(columns):
        left = names + column * _PANEL
        counts = [n for n in (results.count(o, kind, scenario) for o in rows) if n]
        if not counts:
            continue
        sheet.write(left, top + 0.2, scenario or "all")
        sheet.write(left, top + 0.37, in_words(counts), size=SMALL, colour=GREY)
        axes = sheet.axes(left, top + _HEADING, _PANEL - _NUMBER - 0.06, _ROW * len(rows))
        for row, observer in enumerate(rows):
            found = measure(observer.metrics, f"{kind}_accuracy", scenario)
            bar(axes, row, found, observer.colour)
        finish(axes, len(rows))


def bar(axes: Axes, row: int, found: Mapping[str, float | None] | None, colour: str) -> None:
    """Draw a value with its interval, and in figures to the right of the axes."""
    if found is None or found["value"] is None:
        axes.text(0.01, row, "\N{EN DASH}", va="center", fontsize=SMALL, color=GREY)
        return
    value, low, high = found["value"], found["ci_low"], found["ci_high"]
    axes.barh(row, value, height=0.7, color=tint(colour, 0.5), lw=0)
    axes.plot([value, value], [row - 0.35, row + 0.35], color=colour, lw=1.6, clip_on=False)
    if low is not None and high is not None:
        axes.plot([low, high], [row, row], color=INK, lw=0.9, clip_on=False)
    axes.annotate(
        f"{value:.2f}".replace("-", "\N{MINUS SIGN}"), (1, row),
        xycoords=axes.get_yaxis_transform(), xytext=(5, 0), textcoords="offset points",
        va="center", fontsize=SMALL, color=INK, annotation_clip=False,
    )  # fmt: skip


def finish(axes: Axes, n_rows: int, low: float = 0.0) -> None:
    """Set the axes of rows of bars from ``low`` to 1."""
    bare(axes, "left")
    axes.set_xlim(low, 1)
    axes.set_ylim(n_rows - 0.5, -0.5)
    axes.set_yticks([])
    ticks = [0, 0.5, 1] if low > -0.25 else [-0.5, 0, 0.5, 1] if low > -0.75 else [-1, 0, 1]
    axes.set_xticks(ticks, [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in ticks])
    axes.grid(axis="x", color="#e2e2e2", lw=0.6)
    axes.set_axisbelow(True)
