"""How well models agree with people: correlations, and probability against probability."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.figures.accuracies import bar, finish
from phase_ppl.evaluation.figures.sheet import (
    GREY,
    SCENARIO_COLOURS,
    NothingToDrawError,
    Results,
    Sheet,
    fitting,
    label_column,
)
from phase_ppl.evaluation.observers import Observer
from phase_ppl.evaluation.tables import KINDS
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CORRELATIONS: Final = {
    "goal_r": ("Goals", "goal_split_half_r"),
    "relation_r": ("Relations", "split_half_r"),
    "relation_r_given_truth": ("Relations, given the truth", None),
}
"""Correlation with people -> title, and that of people with each other."""

_PANEL: Final = 1.95
_NUMBER: Final = 0.36
_ROW: Final = 0.21

_GRID: Final = 0.02
"""Points nearer than this, in each probability, are drawn as one, with the area of all."""

_AREA: Final = 9.0
_SIDE: Final = 1.27


def correlation(results: Results) -> Figure:
    """Draw the correlations of models with people, beside that of people with each other.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    models = [o for o in results.measured if o.kind != "people"]
    panels = {name: [o for o in models if _human(o, name) is not None] for name in CORRELATIONS}
    panels = {name: shown for name, shown in panels.items() if shown}
    if not panels:
        raise NothingToDrawError("people judged nothing that a model gives probabilities for")
    shown = [o for o in models if any(o in part for part in panels.values())]
    head, below = 0.5, 0.5
    height = _ROW * len(shown)
    names = label_column(observer.label for observer in shown)
    sheet = Sheet(names + _PANEL * len(panels), head + height + below)
    size = min(fitting(observer.label, 1.19 * (names - 0.16)) for observer in shown)
    for row, observer in enumerate(shown):
        y = head + _ROW * (row + 0.5)
        sheet.write(
            names - 0.08, y, observer.label, size=size, colour=observer.colour,
            ha="right", va="center_baseline",
        )  # fmt: skip
    for column, name in enumerate(panels):
        left = names + column * _PANEL
        title, between_people = CORRELATIONS[name]
        sheet.write(left, 0.2, title, size=NORMAL + 0.5, weight="bold")
        axes = sheet.axes(left, head, _PANEL - _NUMBER - 0.1, height)
        found = [_human(o, name) for o in shown]
        for row, (observer, value) in enumerate(zip(shown, found, strict=True)):
            bar(axes, row, value, observer.colour)
        low = min([0.0, *(v[k] for v in found if v for k in ("value", "ci_low") if v[k])])
        finish(axes, len(shown), max(-1.0, low * 1.05))
        axes.set_xlabel("r with people", fontsize=NORMAL, color=INK, labelpad=2)
        people = next((p for o in shown if (p := _human(o, between_people)) is not None), None)
        if people is not None:
            _line(axes, people)
    return sheet.figure


def scatter(results: Results, kind: str) -> Figure:
    """Draw models' probabilities against people's, a row per model, a column per true scenario.

    Args:
        results: of the evaluation.
        kind: "goal" or "relation".

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    people = next((o for o in results.measured if o.kind == "people"), None)
    models = [o for o in results.measured if o.kind != "people"]
    rows = []
    if people is not None:
        rows = [(o, points) for o in models if (points := _points(o, people, results, kind))]
    if people is None or not rows:
        raise NothingToDrawError(f"people judged no {kind} that a model gives probabilities for")
    columns = [name for name in (*SCENARIOS, "") if any(name in points for _, points in rows)]
    step = _SIDE + 0.13
    head, below = 0.42, 0.74
    names = label_column(observer.label for observer, _ in rows)
    sheet = Sheet(
        names + 0.42 + step * max(len(columns), 2) + 0.05, head + step * len(rows) - 0.13 + below
    )
    left = names + 0.42
    largest = max(n for _, points in rows for part in points.values() for n in part.values())
    scale = min(1.0, 40 / largest)
    size = min(fitting(observer.label, names - 0.1) for observer, _ in rows)
    for row, (observer, points) in enumerate(rows):
        top = head + row * step
        style: dict[str, Any] = {"size": size, "colour": observer.colour, "weight": "bold"}
        sheet.write(names, top + _SIDE / 2 - 0.06, observer.label, ha="right", **style)
        found = _human(observer, f"{kind}_r")
        if found is not None:
            words = f"r = {found['value']:.2f}".replace("-", "\N{MINUS SIGN}")
            sheet.write(names, top + _SIDE / 2 + 0.1, words, size=SMALL, ha="right")
        for column, name in enumerate(columns):
            axes = sheet.axes(left + column * step, top, _SIDE, _SIDE)
            _cloud(axes, points.get(name, Counter()), SCENARIO_COLOURS.get(name, GREY), scale)
            axes.tick_params(labelleft=column == 0, labelbottom=row == len(rows) - 1)
            if column == 0:
                axes.set_ylabel("model", fontsize=SMALL, color=INK, labelpad=1)
            if row == len(rows) - 1:
                axes.set_xlabel("people", fontsize=SMALL, color=INK, labelpad=1)
    for column, name in enumerate(columns):
        x = left + column * step
        colour = SCENARIO_COLOURS.get(name, GREY)
        sheet.write(x, 0.2, name or "scenario not known", colour=colour, weight="bold")
        n = sum(1 for event in people.predictions if results.scenarios.get(event, "") == name)
        sheet.write(x, 0.36, f"n = {n}", size=SMALL, colour=GREY)
    what = "goals of both agents" if kind == "goal" else "relations"
    notes = (
        f"Probabilities of the {what}; n: events.",
        "The area of a point grows with how many it stands for.",
    )
    for line, note in enumerate(notes):
        y = sheet.height - 0.19 + 0.12 * line
        sheet.write(0.08, y, note, size=SMALL - 0.5, colour=GREY)
    return sheet.figure


def _human(observer: Observer, name: str | None) -> Any:
    return (observer.metrics.get("human") or {}).get(name)


def _line(axes: Axes, people: dict[str, Any]) -> None:
    """Draw how well halves of the people agree, as a line with its interval."""
    value, low, high = people["value"], people["ci_low"], people["ci_high"]
    if low is not None and high is not None:
        axes.axvspan(low, high, color="#3c3c3c", alpha=0.13, lw=0)
    axes.axvline(value, color="#3c3c3c", lw=1.1, ls=(0, (4, 2)))
    axes.annotate(
        f"people, split half: {value:.2f}", (value, 1),
        xycoords=axes.get_xaxis_transform(), xytext=(0, 3), textcoords="offset points",
        ha="right" if value > 0.5 else "left", fontsize=SMALL, color="#3c3c3c",
        annotation_clip=False,
    )  # fmt: skip


def _points(
    observer: Observer, people: Observer, results: Results, kind: str
) -> dict[str, Counter[tuple[float, float]]]:
    """Return true scenario -> how many answers have which (people's, model's) probability."""
    found: dict[str, Counter[tuple[float, float]]] = {}
    for event, judged in people.predictions.items():
        given = observer.predictions.get(event)
        for question in KINDS[kind]:
            if given is None or question not in given.probabilities:
                continue
            if question not in judged.probabilities:
                continue
            pairs = np.stack([judged.probabilities[question], given.probabilities[question]])
            rounded = np.round(np.round(pairs / _GRID) * _GRID, 6).T.tolist()
            cloud = found.setdefault(results.scenarios.get(event, ""), Counter())
            cloud.update((x, y) for x, y in rounded)
    return found


def _cloud(axes: Axes, points: Counter[tuple[float, float]], colour: str, scale: float) -> None:
    axes.plot([0, 1], [0, 1], color="#c4c4c4", lw=0.8, zorder=1)
    # large ones first, so that none hides a smaller one
    for (x, y), n in sorted(points.items(), key=lambda item: -item[1]):
        axes.scatter(
            x, y, s=_AREA * (1 + scale * (n - 1)), color=colour, alpha=0.55, lw=0.5,
            edgecolor="white", zorder=2, clip_on=False,
        )  # fmt: skip
    bare(axes)
    axes.set_xlim(-0.09, 1.09)
    axes.set_ylim(-0.09, 1.09)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
