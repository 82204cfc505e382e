"""Accuracy against what it costs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.figures.accuracies import TITLES, measure
from phase_ppl.evaluation.figures.sheet import (
    GREY,
    NothingToDrawError,
    Results,
    Sheet,
    fitting,
    label_column,
)
from phase_ppl.evaluation.observers import Observer

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIDE: Final = 2.5
_LEFT: Final = 0.55
_HEAD: Final = 0.42
_GAP: Final = 0.135
"""Least distance of two names, inches."""

_NOTE: Final = (
    "Means over events with 95 % intervals. Dashed: people. Models without a cost: left out."
)


def costs(results: Results) -> Figure:
    """Draw the accuracy of goals and relations against CPU seconds per event.

    Raises:
        NothingToDrawError: of no model both are known.
    """
    kinds = {kind: _shown(results, kind) for kind in TITLES}
    kinds = {kind: shown for kind, shown in kinds.items() if shown}
    if not kinds:
        raise NothingToDrawError("of no model are both CPU seconds and accuracy known")
    names = label_column(o.label for shown in kinds.values() for o in shown)
    step = _LEFT + _SIDE + names
    sheet = Sheet(step * len(kinds), _HEAD + _SIDE + 0.72)
    for column, (kind, shown) in enumerate(kinds.items()):
        left = _LEFT + column * step
        sheet.write(left, 0.24, TITLES[kind], size=NORMAL + 1, weight="bold")
        axes = sheet.axes(left, _HEAD, _SIDE, _SIDE)
        _points(axes, shown, kind)
        axes.set_ylabel("share right" if column == 0 else "", fontsize=NORMAL, color=INK)
        for o in results.measured:
            found = measure(o.metrics, f"{kind}_accuracy") if o.kind == "people" else None
            if found is not None:
                axes.axhline(found["value"], color=o.colour, lw=1.1, ls=(0, (4, 2)), zorder=1)
        _write_names(sheet, (left + _SIDE + 0.12, _HEAD), names - 0.2, shown, kind)
    sheet.write(0.08, sheet.height - 0.09, _NOTE, size=SMALL - 0.5, colour=GREY)
    return sheet.figure


def _shown(results: Results, kind: str) -> list[Observer]:
    name = f"{kind}_accuracy"
    return [
        o
        for o in results.measured
        if measure(o.metrics, name) and _positive(o.metrics.get("cpu_seconds"), "value")
    ]


def _positive(figure: Mapping[str, Any] | None, part: str) -> bool:
    """Whether part of a figure is known and has a place on an axis without 0."""
    return figure is not None and figure[part] is not None and figure[part] > 0


def _points(axes: Axes, shown: Sequence[Observer], kind: str) -> None:
    ends: list[float] = []
    for observer in shown:
        cost, right = observer.metrics["cpu_seconds"], measure(observer.metrics, f"{kind}_accuracy")
        x, y = cost["value"], right["value"]
        style: dict[str, Any] = {"color": observer.colour, "lw": 1.2, "zorder": 2}
        if right["ci_low"] is not None:
            axes.plot([x, x], [right["ci_low"], right["ci_high"]], **style)
        if _positive(cost, "ci_low"):
            axes.plot([cost["ci_low"], cost["ci_high"]], [y, y], **style)
            ends += [cost["ci_low"], cost["ci_high"]]
        axes.plot([x], [y], "o", ms=5.5, color=observer.colour, mec="white", mew=0.8, zorder=3)
        ends.append(x)
    bare(axes)
    axes.set_xscale("log")
    low, high = math.floor(math.log10(min(ends))), math.ceil(math.log10(max(ends)))
    axes.set_xlim(10.0**low * 0.7, 10.0 ** max(high, low + 1) * 1.4)
    axes.set_ylim(0, 1.02)
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
    axes.minorticks_off()
    decades = range(low, max(high, low + 1) + 1)
    each = max(1, -(-len(decades) // 6))
    ticks = [10.0**d for d in decades][::each]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("CPU seconds per event", fontsize=NORMAL, color=INK, labelpad=2)


def _write_names(
    sheet: Sheet, place: tuple[float, float], width: float, shown: Sequence[Observer], kind: str
) -> None:
    """Write the names beside the axes, in the order of the points, moved apart."""
    left, top = place
    order = sorted(shown, key=lambda o: -measure(o.metrics, f"{kind}_accuracy")["value"])
    wanted = [
        top + _SIDE * (1 - measure(o.metrics, f"{kind}_accuracy")["value"] / 1.02) for o in order
    ]
    places: list[float] = []
    for y in wanted:
        places.append(max(y, places[-1] + _GAP if places else y))
    over = places[-1] - (top + _SIDE)
    if over > 0:  # push up from the bottom
        places[-1] -= over
        for i in range(len(places) - 2, -1, -1):
            places[i] = min(places[i], places[i + 1] - _GAP)
    for observer, y in zip(order, places, strict=True):
        size = fitting(observer.label, 1.19 * width, NORMAL)
        sheet.write(left, y, observer.label, size=size, colour=observer.colour,
                    va="center_baseline")  # fmt: skip
