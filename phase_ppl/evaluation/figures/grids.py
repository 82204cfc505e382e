"""Figures with axes for each model or event: matrices, clouds of points, film strips."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import (
    GREY,
    INK,
    NORMAL,
    SMALL,
    direct_labels,
    new_figure,
    titled,
    written,
)
from phase_ppl.evaluation.cells import number
from phase_ppl.evaluation.differences import ALPHA
from phase_ppl.evaluation.figures.frame import (
    KIND_TITLES,
    NothingToDrawError,
    PathLike,
    Source,
    compared,
    drawing,
    fitting,
    in_words,
    name_rows,
    opened,
    scenario_colour,
    scenarios_of,
    width_of,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.table import Answers, AnswerSet, true_answers
from phase_ppl.render.frames import draw_strip
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH: Final = 7.2  # inches: both columns of a journal's page
_PANELS: Final = 6
_DARK: Final = 0.65  # least share of a row at which its number is white

_HIGHER, _LOWER = "#1b6ca8", "#b5482a"

_POINT: Final = 0.02
"""Points closer than this, in each probability, are drawn as one with their total area."""

_AREA: Final = 9.0

_Texts = dict[tuple[int, int], tuple[str, dict[str, Any]]]


@drawing(
    "Which scenario is taken for which",
    "Matrices of counts: true scenario against the scenario of the goals answered.",
)
def confusion(source: Source, path: PathLike | None = None) -> Figure:
    """Draw confusion matrices: true scenario against the scenario of the goals answered.

    Cells hold numbers of events, shades are shares of their row.

    Raises:
        NothingToDrawError: nobody answered both goals of an event with known scenario. Only PHASE
            has scenarios.
    """
    from matplotlib import colormaps

    results = opened(source)
    true = scenarios_of(results)
    shown: dict[AnswerSet, IntArray] = {}
    for o in results.measured:
        pairs = [(true[e], p.scenario) for e, p in o.predictions.items() if e in true]
        counted = pd.DataFrame(pairs, columns=["true", "answered"]).value_counts()
        cells = itertools.product(SCENARIOS, SCENARIOS)
        shown[o] = np.array([counted.get(cell, 0) for cell in cells]).reshape(len(SCENARIOS), -1)
    shown = {o: counts for o, counts in shown.items() if counts.any()}
    if not shown:
        raise NothingToDrawError(
            "nobody answered the goals of an event of the world PHASE whose scenario is known"
        )
    n_columns = min(len(shown), 3 if len(shown) <= 6 else 4)
    n_rows = -(-len(shown) // n_columns)
    note = "numbers: events; shade: share of the row"
    figure = new_figure(1.4 + 1.75 * n_columns, 1.15 + 1.85 * n_rows, note=note)
    figure.suptitle("scenario of the goals answered", fontsize=NORMAL)
    figure.supylabel("true scenario", fontsize=NORMAL)
    grid = figure.subplots(n_rows, n_columns, squeeze=False)
    events = np.sum([*shown.values()], axis=2).T
    labels = [f"{name}\n{in_words(row)}" for name, row in zip(SCENARIOS, events, strict=True)]
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for place, (answers, counts) in enumerate(shown.items()):
        row, column = divmod(place, n_columns)
        axes = grid[row, column]
        shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        texts: _Texts = {}
        for (i, j), n in np.ndenumerate(counts):
            colour = "white" if shares[i, j] > _DARK else INK
            style = {"fontsize": NORMAL, "color": colour, "fontweight": ("normal", "bold")[i == j]}
            texts[i, j] = (str(n) if n else "\N{MIDDLE DOT}", style)
        _cells(axes, colormaps["Blues"](shares / 1.15), texts)
        slanted: dict[str, Any] = {"rotation": 40, "ha": "left", "rotation_mode": "anchor"}
        axes.set_xticks(range(len(SCENARIOS)), SCENARIOS if row == 0 else [], **slanted)
        axes.set_yticks(range(len(SCENARIOS)), labels if column == 0 else [])
        name = f"{answers.label}, majority" if answers.kind == "people" else answers.label
        style = {"fontsize": NORMAL, "color": answers.colour, "fontweight": "bold"}
        axes.set_title(textwrap.fill(name, 20), **style)
    return written(figure, path)


def _cells(axes: Axes, colours: FloatArray, texts: _Texts) -> None:
    """Draw a matrix of cells of colours (row, column, RGBA), with texts, each with its style."""
    axes.imshow(colours, aspect="auto")
    for (row, column), (text, style) in texts.items():
        axes.text(column, row, text, ha="center", va="center", **style)
    n_rows, n_columns = colours.shape[:2]
    axes.hlines(np.arange(1, n_rows) - 0.5, -0.5, n_columns - 0.5, color="white", lw=1.2)
    axes.vlines(np.arange(1, n_columns) - 0.5, -0.5, n_rows - 0.5, color="white", lw=1.2)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelsize=SMALL, pad=3)
    axes.xaxis.tick_top()


@drawing(
    "Goals: models against people",
    "Points: probability of a goal for a model against that for people.",
)
def scatter_goals(source: Source, path: PathLike | None = None) -> Figure:
    """Draw models' probabilities of goals against people's.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    return _scatter(source, path, "goal", "agents' goals")


@drawing(
    "Relations: models against people",
    "Points: probability of a relation for a model against that for people.",
)
def scatter_relations(source: Source, path: PathLike | None = None) -> Figure:
    """Draw models' probabilities of relations against people's.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    return _scatter(source, path, "relation", "relations")


def _scatter(source: Source, path: PathLike | None, kind: str, what: str) -> Figure:
    """Draw a row per model, a column per true scenario."""
    results = opened(source)
    scenarios = scenarios_of(results)
    clouds: dict[AnswerSet, pd.Series[int]] = {}
    for o in results.measured:
        rows = Answers.of(results.events, o.predictions).whole
        rows = rows[(rows["kind"] == kind) & rows["people"].notna() & rows["probability"].notna()]
        if o.kind != "people" and len(rows):
            places = [(rows[n] / _POINT).round() * _POINT for n in ("people", "probability")]
            of_event = rows["event"].map(lambda event: scenarios.get(event, ""))
            clouds[o] = rows.groupby([of_event, *places]).size()
    if not clouds:
        raise NothingToDrawError(f"people judged no {kind} that a model gives probabilities for")
    present = {name for points in clouds.values() for name, _, _ in points.index}
    columns = [name for name in (*SCENARIOS, "") if name in present]
    figure = new_figure(
        width_of(clouds) + 0.3 + 1.4 * max(len(columns), 2),
        1.0 + 1.4 * len(clouds),
        note=f"Probabilities of the {what}; n: events. The area of a point grows with how many it "
        "stands for.",
    )
    grid = figure.subplots(len(clouds), len(columns), squeeze=False, sharex=True, sharey=True)
    scale = min(1.0, 40 / max(points.max() for points in clouds.values()))
    for line, (answers, points) in zip(grid, clouds.items(), strict=True):
        for axes, name in zip(line, columns, strict=True):
            axes.plot([0, 1], [0, 1], color="#c4c4c4", lw=0.8, zorder=1)
            # large points first, so that none hides a smaller one
            for (of, x, y), n in points.sort_values(ascending=False).items():
                if of == name:
                    axes.scatter(
                        x, y, s=_AREA * (1 + scale * (n - 1)), alpha=0.55, lw=0.5, zorder=2,
                        color=scenario_colour(name), edgecolor="white", clip_on=False,
                    )  # fmt: skip
            axes.set(xlim=(-0.09, 1.09), ylim=(-0.09, 1.09))
            axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
            axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])
        r = at(answers.metrics, ("human", f"{kind}_r"))
        label = answers.label if r is None else f"{answers.label}\nr = {number(r['value'])}"
        line[0].set_ylabel(
            label, rotation=0, ha="right", va="center", fontsize=fitting([answers.label]),
            color=answers.colour,
        )  # fmt: skip
    judged = next(o.predictions for o in results.measured if o.kind == "people")
    for top, bottom, name in zip(grid[0], grid[-1], columns, strict=True):
        n = sum(scenarios.get(event, "") == name for event in judged)
        style = {"color": scenario_colour(name), "fontweight": "bold"}
        title = name or ("scenario not known" if scenarios else "all events")
        titled(top, title, f"n = {n}", fontsize=NORMAL, **style)
        bottom.set_xlabel("people", fontsize=SMALL)
    return written(figure, path)


@drawing(
    "Accuracy against CPU seconds",
    "Points: share of right answers against CPU seconds per event, with intervals.",
    compares=True,
)
def costs(source: Source, path: PathLike | None = None) -> Figure:
    """Draw the accuracy of the models of a comparison against CPU seconds per event.

    Raises:
        NothingToDrawError: of no model both are known, or it is no comparison of models.
    """
    measured = compared(source).measured
    # a logarithmic axis has no 0
    timed = [o for o in measured if (at(o.metrics, "cpu_seconds.value") or 0) > 0]
    kinds = {
        kind: shown
        for kind in KIND_TITLES
        if (shown := [o for o in timed if o.metrics.get(f"{kind}_accuracy")])
    }
    if not kinds:
        raise NothingToDrawError("of no model are both CPU seconds and accuracy known")
    names = width_of(o for shown in kinds.values() for o in shown)
    note = "Means over events with 95 % intervals. Dashed: people. Models without a cost: left out."
    figure = new_figure((2.9 + names) * len(kinds), 3.5, note=note)
    panels = figure.subplots(1, len(kinds), squeeze=False)[0]
    panels[0].set_ylabel("share right")
    for axes, (kind, shown) in zip(panels, kinds.items(), strict=True):
        axes.set_title(KIND_TITLES[kind], fontweight="bold")
        _costs(axes, shown, kind)
        for o in measured:
            if o.kind == "people" and (right := o.metrics.get(f"{kind}_accuracy")) is not None:
                axes.axhline(right["value"], color=o.colour, lw=1.1, ls=(0, (4, 2)), zorder=1)
    return written(figure, path)


def _costs(axes: Axes, shown: Sequence[AnswerSet], kind: str) -> None:
    ends: list[float] = []
    for answers in shown:
        cost, right = answers.metrics["cpu_seconds"], answers.metrics[f"{kind}_accuracy"]
        x, y = cost["value"], right["value"]
        style: dict[str, Any] = {"color": answers.colour, "lw": 1.2, "zorder": 2}
        if right["ci_low"] is not None:
            axes.plot([x, x], [right["ci_low"], right["ci_high"]], **style)
        if (cost["ci_low"] or 0) > 0:
            axes.plot([cost["ci_low"], cost["ci_high"]], [y, y], **style)
            ends += [cost["ci_low"], cost["ci_high"]]
        axes.plot([x], [y], "o", ms=5.5, color=answers.colour, mec="white", mew=0.8, zorder=3)
        ends.append(x)
    low, high = math.floor(math.log10(min(ends))), math.ceil(math.log10(max(ends)))
    high = max(high, low + 1)
    axes.set(xscale="log", xlim=(10.0**low * 0.7, 10.0**high * 1.4), ylim=(0, 1.02))
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
    axes.minorticks_off()
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid()
    axes.set_xlabel("CPU seconds per event")
    found = [(o.metrics[f"{kind}_accuracy"]["value"], o.label, o.colour) for o in shown]
    direct_labels(axes, found, gap=0.07)


@drawing(
    "Differences between models",
    "Matrices: difference in right answers between every two models.",
    compares=True,
)
def differences(source: Source, path: PathLike | None = None) -> Figure:
    """Draw the differences in right answers between models: row minus column.

    They are between every two models, or from one model if the comparison is against it.

    Raises:
        NothingToDrawError: no two models answered the same question of an event with truth, or it
            is no comparison of models.
    """
    comparison = compared(source)
    kinds = {
        kind: {
            (row["one"], row["other"]): row
            for row in comparison.differences
            if row["scenario"] is None and row["measure"] == f"{kind}_accuracy"
        }
        for kind in KIND_TITLES
    }
    kinds = {kind: found for kind, found in kinds.items() if found}
    if not kinds:
        raise NothingToDrawError("no two models answered the same question of an event with truth")
    against = comparison.settings["against"]
    grids = {}
    for kind, found in kinds.items():
        named = [o for o in comparison.answers if any(o.name in pair for pair in found)]
        rows = [o for o in named if o.name != against]
        grids[kind] = rows, named if against is None else [o for o in named if o.name == against]
    # the slanted names of the columns reach up
    slanted = 0.7 * width_of(o for _, columns in grids.values() for o in columns)
    names = width_of(o for rows, _ in grids.values() for o in rows)
    widths = [len(columns) for _, columns in grids.values()]
    figure = new_figure(
        max(sum(names + 0.4 * n + slanted / 2 for n in widths), 2.6),
        0.75 + slanted + 0.27 * max(len(rows) for rows, _ in grids.values()),
        note="Row minus column, in right answers. Bold: p up to 0.05 after Holm's correction.",
    )
    panels = figure.subplots(1, len(grids), squeeze=False, width_ratios=widths)
    for axes, (kind, (rows, columns)) in zip(panels[0], grids.items(), strict=True):
        _differences(axes, rows, columns, kinds[kind])
        axes.set_title(KIND_TITLES[kind], fontweight="bold", loc="center")
    return written(figure, path)


def _differences(
    axes: Axes,
    rows: Sequence[AnswerSet],
    columns: Sequence[AnswerSet],
    found: Mapping[tuple[str, str], Mapping[str, Any]],
) -> None:
    from matplotlib.colors import to_rgba

    colours: FloatArray = np.ones((len(rows), len(columns), 4))
    texts: _Texts = {}
    for (i, one), (j, other) in itertools.product(enumerate(rows), enumerate(columns)):
        row, sign = found.get((one.name, other.name)), 1
        if row is None:
            row, sign = found.get((other.name, one.name)), -1
        if row is None:
            text, colour, sure = "" if one is other else number(None), GREY, False
        else:
            value = sign * row["value"]
            colours[i, j] = to_rgba(_HIGHER if value > 0 else _LOWER, min(0.75, abs(value)))
            sure = row["p_holm"] is not None and row["p_holm"] <= ALPHA
            text, colour = number(value, signed=True), INK
        texts[i, j] = (text, {"color": colour, "fontweight": "bold" if sure else "normal"})
    _cells(axes, colours, texts)
    name_rows(axes, rows)
    labels = [o.label for o in columns]
    axes.set_xticks(
        range(len(columns)), labels, rotation=45, ha="left", rotation_mode="anchor",
        fontsize=fitting(labels),
    )  # fmt: skip
    for tick, answers in zip(axes.get_xticklabels(), columns, strict=True):
        tick.set_color(answers.colour)


@drawing(
    "An event of every scenario, or the first few",
    "Film strips: an event of every scenario, from first to last frame.",
)
def film_strips(source: Source, path: PathLike | None = None) -> Figure:
    """Draw the first event of every true scenario as a film strip, up to four.

    If no scenario is known, the first four events are drawn.
    """
    results = opened(source)
    scenarios = scenarios_of(results)
    first: dict[str, Event] = {}
    for event in results.events:
        first.setdefault(scenarios.get(event.id, ""), event)
    chosen = {str(name): first[name] for name in SCENARIOS if name in first}
    chosen = chosen or {event.id: event for event in results.events[: len(SCENARIOS)]}
    strips = [
        np.asarray(draw_strip(event, min(_PANELS, event.observation.n_frames)))
        for event in chosen.values()
    ]
    heights = [_WIDTH * strip.shape[0] / strip.shape[1] for strip in strips]
    figure = new_figure(_WIDTH, sum(heights) + 0.3 * len(strips))
    grid = figure.subplots(len(strips), 1, squeeze=False, height_ratios=heights)
    for axes, (name, event), strip in zip(grid[:, 0], chosen.items(), strips, strict=True):
        style = {"color": scenario_colour(name), "fontweight": "bold"}
        axes.set_title(name, fontsize=NORMAL, **style)
        goals = "; ".join(
            f"{question.removeprefix('goal_')}: {answer}"
            for question, answer in true_answers(event).items()
            if question.startswith("goal_")
        )
        goals = goals or event.id
        axes.set_title(goals, loc="right", fontsize=fitting([goals], 5.6, SMALL), color=GREY)
        axes.imshow(strip, interpolation="antialiased")
        axes.set_axis_off()
    return written(figure, path)
