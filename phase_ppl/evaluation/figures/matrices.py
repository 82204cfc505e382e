"""Which scenario is taken for which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL
from phase_ppl.evaluation.figures.sheet import (
    GREY,
    NothingToDrawError,
    Results,
    Sheet,
    fitting,
    in_lines,
    in_words,
)
from phase_ppl.evaluation.observers import Observer
from phase_ppl.world.arrays import IntArray
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LEFT: Final = 1.4
_SIDE: Final = 1.55
_GAP: Final = 0.3
_HEADING: Final = 0.38
_BELOW: Final = 0.95
_PER_ROW: Final = 3
_DARK: Final = 0.65
"""Share of a row from which on its number is white."""


def confusion(results: Results) -> Figure:
    """Draw, for all who answered both goals, true scenario against scenario of their goals.

    Cells hold numbers of events, shades are shares of their row.

    Raises:
        NothingToDrawError: nobody answered the goals of events whose truth is known.
    """
    shown = [(o, counts) for o in results.measured if (counts := _counts(o, results)) is not None]
    if not shown:
        raise NothingToDrawError("nobody answered the goals of an event whose truth is known")
    per_row = _PER_ROW if len(shown) <= 2 * _PER_ROW else _PER_ROW + 1
    n_columns = min(len(shown), per_row)
    n_rows = -(-len(shown) // per_row)
    height = _HEADING + _SIDE
    labels = _row_labels([counts for _, counts in shown])
    sheet = Sheet(_LEFT + n_columns * (_SIDE + _GAP), n_rows * height + _BELOW + 0.1)
    for place, (observer, counts) in enumerate(shown):
        row, column = divmod(place, per_row)
        left, top = _LEFT + column * (_SIDE + _GAP), row * height
        label = observer.label if observer.kind != "people" else f"{observer.label}, majority"
        lines = in_lines(label, _SIDE)
        size = min(fitting(line, _SIDE, NORMAL + 0.5) for line in lines)
        for above, line in enumerate(reversed(lines)):
            y = top + 0.27 + 0.03 * (len(lines) > 1) - 0.12 * above
            sheet.write(left, y, line, size=size, colour=observer.colour, weight="bold")
        axes = sheet.axes(left, top + _HEADING, _SIDE, _SIDE)
        _matrix(axes, counts)
        lowest = place + per_row >= len(shown)
        # above the last row there is a matrix to the lower left, which slanted names would reach
        style = {"rotation": 40, "ha": "right"} if row == n_rows - 1 else {"rotation": 90}
        axes.set_xticks(range(len(SCENARIOS)), SCENARIOS if lowest else [], **style)
        axes.set_yticks(range(len(SCENARIOS)), labels if column == 0 else [])
        axes.tick_params(length=0, labelsize=SMALL, pad=3, colors=INK)
    middle = (n_rows * height + _HEADING) / 2
    sheet.figure.text(
        0.13 / sheet.width, 1 - middle / sheet.height, "true scenario", fontsize=NORMAL,
        color=INK, rotation=90, ha="center", va="center",
    )  # fmt: skip
    x = _LEFT + (n_columns * (_SIDE + _GAP) - _GAP) / 2
    sheet.write(x, sheet.height - 0.27, "scenario of the goals answered", ha="center")
    sheet.write(
        x, sheet.height - 0.1, "numbers: events; shade: share of the row",
        size=SMALL - 0.5, colour=GREY, ha="center",
    )  # fmt: skip
    return sheet.figure


def _counts(observer: Observer, results: Results) -> IntArray | None:
    """Return (true, answered) numbers of events; None without any."""
    counts = np.zeros((len(SCENARIOS), len(SCENARIOS)), np.int64)
    for name, prediction in observer.predictions.items():
        if name in results.scenarios and prediction.scenario is not None:
            true = SCENARIOS.index(results.scenarios[name])
            counts[true, SCENARIOS.index(prediction.scenario)] += 1
    return counts if counts.any() else None


def _matrix(axes: Axes, counts: IntArray) -> None:
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1.15, aspect="equal")
    for (row, column), n in np.ndenumerate(counts):
        colour = "white" if shares[row, column] > _DARK else INK
        weight = "bold" if row == column else "normal"
        text = str(n) if n else "\N{MIDDLE DOT}"
        axes.text(
            column, row, text, ha="center", va="center", fontsize=NORMAL, color=colour,
            fontweight=weight,
        )  # fmt: skip
    edges = np.arange(len(SCENARIOS) + 1) - 0.5
    axes.hlines(edges, -0.5, len(SCENARIOS) - 0.5, color="white", lw=1.2)
    axes.vlines(edges, -0.5, len(SCENARIOS) - 0.5, color="white", lw=1.2)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _row_labels(counts: Sequence[IntArray]) -> list[str]:
    """Return the scenarios with how many events of each everybody answered."""
    of_rows = np.sum(counts, axis=2).T
    return [f"{name}\n{in_words(row)}" for name, row in zip(SCENARIOS, of_rows, strict=True)]
