"""The figure of doubt: are models unsure where people are?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.figures.style import GREY, INK, NORMAL, new_figure, written
from phase_ppl.evaluation.doubt import label_places
from phase_ppl.evaluation.figures.frame import (
    NothingToDrawError,
    PathLike,
    Source,
    drawing,
    fitting,
    opened,
    scenario_colour,
    scenarios_of,
)
from phase_ppl.evaluation.table import Answers
from phase_ppl.world.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKS: Final = ("o", "s", "^")  # of the relations
_MOST: Final = 6
_PARTS: Final = ("relation_r", "relation_r_given_truth")


@drawing(
    "Doubt: models against people",
    "Points: probabilities of relations against people's shares, as they are and given the "
    "truth; bars: both correlations, beside what people reach among themselves.",
)
def people(source: Source, path: PathLike | None = None) -> Figure:
    """Draw models' probabilities of relations against people's shares, and the correlations.

    Each model has a row of three panels. The first shows probabilities against shares, the second
    the same minus the mean over events of the same true relation. The third shows both correlations
    with their intervals. Lines are people's split-half correlations: for halves (grey) and for all
    raters (dashed).

    Raises:
        NothingToDrawError: nobody judged relations to which a model gives probabilities.
    """
    results = opened(source)
    shown = [o for o in results.measured if o.kind != "people" and o.metrics.get("doubt")][:_MOST]
    if not shown:
        raise NothingToDrawError(
            "nobody judged the relation of two agents to which a model gives probabilities"
        )
    figure = new_figure(
        *(7.2, 0.7 + 2.15 * len(shown)),
        note="Marks: an answer to a video, circles friendly, squares neutral, triangles "
        "adversarial; colours: true scenario, green collaborative, blue independent, ochre "
        "competing, red opposing. Given the truth: less the mean of the videos with the same true "
        "relation. Right: 95 % intervals; lines: r of halves of the people, dashed: of all people, "
        "estimated by the Spearman-Brown formula.",
    )
    grid = figure.subplots(len(shown), 3, squeeze=False, width_ratios=(1, 1, 0.8))
    scenarios = scenarios_of(results)
    for (left, middle, right), answers in zip(grid, shown, strict=True):
        events = [event for event in results.events if event.id in answers.predictions]
        said = Answers.of(events, answers.predictions)
        columns = ("probability", "people", "truth")
        p, shares, true = (said.array("relation", name)[:, 0] for name in columns)
        colours = np.array([scenario_colour(scenarios.get(e.id, "")) for e in events])
        both, truth = ~np.isnan(p[:, 0]) & ~np.isnan(shares[:, 0]), label_places(true)
        _doubts(left, p[both], shares[both], colours[both], (0.0, 1.0))
        left.set_ylabel("people")
        size = fitting([answers.label], 2.0)
        left.set_title(answers.label, color=answers.colour, fontweight="bold", fontsize=size)
        p, shares = p.copy(), shares.copy()
        for group in np.unique(truth[both]):
            chosen = both & (truth == group)
            for values in (p, shares):
                values[chosen] -= values[chosen].mean(axis=0)
        known = both & (truth >= 0)
        _doubts(middle, p[known], shares[known], colours[known], (-1.0, 1.0))
        middle.set_title("given the truth", fontsize=NORMAL, color=GREY)
        _correlation_bars(right, answers.metrics["doubt"], answers.colour)
    for axes in grid[-1, :2]:
        axes.set_xlabel("model")
    return written(figure, path)


def _doubts(
    axes: Axes, x: FloatArray, y: FloatArray, colours: np.ndarray, ends: tuple[float, float]
) -> None:
    axes.plot(ends, ends, color="#bbbbbb", lw=0.7, zorder=0)
    style: dict[str, Any] = {"s": 13, "alpha": 0.65, "linewidths": 0, "clip_on": False}
    for answer, mark in enumerate(_MARKS):
        axes.scatter(x[:, answer], y[:, answer], c=colours, marker=mark, **style)
    ticks = sorted({*ends, 0.0})
    axes.set(xlim=ends, ylim=ends, xticks=ticks, yticks=ticks)
    axes.set_aspect("equal", adjustable="box")


def _correlation_bars(axes: Axes, doubt: dict[str, Any], colour: str) -> None:
    """Draw both correlations with their intervals, and the ceilings."""
    for place, name in enumerate(_PARTS):
        found = doubt[name]
        if found is None:
            continue
        axes.bar(place, found["value"], width=0.55, color=colour, alpha=0.85)
        if found["ci_low"] is not None:
            axes.vlines(place, found["ci_low"], found["ci_high"], INK, lw=1.1)
        suffix = name.removeprefix("relation_r")
        for ceiling, line in ((f"split_half_r{suffix}", "-"), (f"spearman_brown{suffix}", "--")):
            value = doubt["ceiling"].get(ceiling)
            if value is not None:
                axes.plot([place - 0.38, place + 0.38], [value, value], line, color=GREY, lw=1.3)
        axes.annotate(
            f"{found['value']:.2f}", (place, 0), (9, 3), textcoords="offset points", ha="center",
            color="white" if found["value"] > 0.2 else INK,
        )  # fmt: skip
    axes.axhline(0, color=INK, lw=0.6)
    axes.set_xticks([0, 1], ["r", "r given\nthe truth"])
    lows = [found["ci_low"] or 0.0 for found in map(doubt.get, _PARTS) if found]
    axes.set(xlim=(-0.6, 1.6), ylim=(min([0.0, *lows]), 1.0))
