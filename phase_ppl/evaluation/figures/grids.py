"""Figures with axes per model or event: confusion, probabilities, costs, differences, films."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.cells import number
from phase_ppl.evaluation.differences import ALPHA
from phase_ppl.evaluation.figures.layout import (
    GREY,
    KIND_TITLES,
    SCENARIO_COLOURS,
    NothingToDrawError,
    Results,
    cells,
    fitting,
    head,
    in_words,
    laid_out,
    name_rows,
    tint,
    width_of,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.tables import KINDS
from phase_ppl.render.stills import draw_strip
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH: Final = 7.2  # inches: both columns of a journal's page
_PANELS: Final = 6
_DARK: Final = 0.65  # share of a row from which on its number is white

_HIGHER, _LOWER = "#1b6ca8", "#b5482a"

_POINT: Final = 0.02
"""Points nearer than this, in each probability, are drawn as one, with the area of all."""

_AREA: Final = 9.0

_HIGHEST: Final = 1.02
_NAME_GAP: Final = 0.07
"""Least distance of two names beside axes, as a share of their height."""

_Cloud = Counter[tuple[float, float]]
_Texts = dict[tuple[int, int], tuple[str, dict[str, Any]]]


def confusion(results: Results) -> Figure:
    """Draw, for all who answered both goals, true scenario against scenario of their goals.

    Cells hold numbers of events, shades are shares of their row.

    Raises:
        NothingToDrawError: nobody answered the goals of events whose truth is known.
    """
    shown = [(o, counts) for o in results.source.measured if (counts := _counts(o, results)).any()]
    if not shown:
        raise NothingToDrawError("nobody answered the goals of an event whose truth is known")
    n_columns = min(len(shown), 3 if len(shown) <= 6 else 4)
    n_rows = -(-len(shown) // n_columns)
    figure = laid_out(
        1.4 + 1.75 * n_columns, 1.15 + 1.85 * n_rows, "numbers: events; shade: share of the row"
    )
    figure.suptitle("scenario of the goals answered", fontsize=NORMAL, color=INK)
    figure.supylabel("true scenario", fontsize=NORMAL, color=INK)
    grid = figure.subplots(n_rows, n_columns, squeeze=False)
    events = np.sum([counts for _, counts in shown], axis=2).T
    labels = [f"{name}\n{in_words(row)}" for name, row in zip(SCENARIOS, events, strict=True)]
    for place, axes in enumerate(grid.flat):
        axes.set_visible(place < len(shown))
        if place >= len(shown):
            continue
        answers, counts = shown[place]
        _confusion(axes, counts)
        row, column = divmod(place, n_columns)
        axes.xaxis.tick_top()
        style: dict[str, Any] = {"rotation": 40, "ha": "left", "rotation_mode": "anchor"}
        axes.set_xticks(range(len(SCENARIOS)), SCENARIOS if row == 0 else [], **style)
        axes.set_yticks(range(len(SCENARIOS)), labels if column == 0 else [])
        name = f"{answers.label}, majority" if answers.kind == "people" else answers.label
        axes.set_title(
            textwrap.fill(name, 20), loc="left", fontsize=NORMAL, color=answers.colour,
            fontweight="bold", parse_math=False,
        )  # fmt: skip
    return figure


def _counts(answers: AnswerSet, results: Results) -> IntArray:
    """Return (true, answered) numbers of events."""
    counts = np.zeros((len(SCENARIOS), len(SCENARIOS)), np.int64)
    for name, prediction in answers.predictions.items():
        if name in results.scenarios and prediction.scenario is not None:
            true = SCENARIOS.index(results.scenarios[name])
            counts[true, SCENARIOS.index(prediction.scenario)] += 1
    return counts


def _confusion(axes: Axes, counts: IntArray) -> None:
    from matplotlib import colormaps

    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    texts: _Texts = {}
    for (row, column), n in np.ndenumerate(counts):
        colour = "white" if shares[row, column] > _DARK else INK
        weight = "bold" if row == column else "normal"
        style = {"fontsize": NORMAL, "color": colour, "fontweight": weight}
        texts[row, column] = (str(n) if n else "\N{MIDDLE DOT}", style)
    cells(axes, colormaps["Blues"](shares / 1.15)[..., :3], texts)


def scatter_goals(results: Results) -> Figure:
    """Draw models' probabilities of goals against people's.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    return _scatter(results, "goal", "goals of both agents")


def scatter_relations(results: Results) -> Figure:
    """Draw models' probabilities of relations against people's.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    return _scatter(results, "relation", "relations")


def _scatter(results: Results, kind: str, what: str) -> Figure:
    """Draw a row per model, a column per true scenario."""
    people = next((o for o in results.source.measured if o.kind == "people"), None)
    models = [] if people is None else [o for o in results.source.measured if o.kind != "people"]
    clouds = [(o, _clouds(o, people, results, kind)) for o in models if people is not None]
    clouds = [(o, points) for o, points in clouds if points]
    if people is None or not clouds:
        raise NothingToDrawError(f"people judged no {kind} that a model gives probabilities for")
    columns = [name for name in (*SCENARIOS, "") if any(name in points for _, points in clouds)]
    width = width_of([o.label for o, _ in clouds]) + 0.3 + 1.4 * max(len(columns), 2)
    note = (
        f"Probabilities of the {what}; n: events. The area of a point grows with how many it "
        "stands for."
    )
    figure = laid_out(width, 1.0 + 1.4 * len(clouds), note)
    grid = figure.subplots(len(clouds), len(columns), squeeze=False, sharex=True, sharey=True)
    largest = max(n for _, points in clouds for part in points.values() for n in part.values())
    for line, (answers, points) in zip(grid, clouds, strict=True):
        for axes, name in zip(line, columns, strict=True):
            _cloud(axes, points.get(name, _Cloud()), SCENARIO_COLOURS.get(name, GREY),
                   min(1.0, 40 / largest))  # fmt: skip
        r = at(answers.metrics, ("human", f"{kind}_r"))
        label = answers.label if r is None else f"{answers.label}\nr = {number(r['value'])}"
        line[0].set_ylabel(
            label, rotation=0, ha="right", va="center", fontsize=fitting([answers.label]),
            color=answers.colour, parse_math=False,
        )  # fmt: skip
    for top, bottom, name in zip(grid[0], grid[-1], columns, strict=True):
        n = sum(results.scenarios.get(event, "") == name for event in people.predictions)
        colour = SCENARIO_COLOURS.get(name, GREY)
        title = name or "scenario not known"
        head(top, title, f"n = {n}", color=colour, fontweight="bold")
        bottom.set_xlabel("people", fontsize=SMALL, color=INK, labelpad=1)
    return figure


def _clouds(
    answers: AnswerSet, people: AnswerSet, results: Results, kind: str
) -> dict[str, _Cloud]:
    """Return true scenario -> how many answers have which (people's, model's) probability."""
    found: dict[str, _Cloud] = {}
    for event, judged in people.predictions.items():
        given = answers.predictions.get(event)
        for question in KINDS[kind]:
            if given is None or question not in given.probabilities:
                continue
            if question not in judged.probabilities:
                continue
            pairs = np.stack([judged.probabilities[question], given.probabilities[question]])
            rounded = np.round(np.round(pairs / _POINT) * _POINT, 6).T.tolist()
            cloud = found.setdefault(results.scenarios.get(event, ""), _Cloud())
            cloud.update((x, y) for x, y in rounded)
    return found


def _cloud(axes: Axes, points: _Cloud, colour: str, scale: float) -> None:
    axes.plot([0, 1], [0, 1], color="#c4c4c4", lw=0.8, zorder=1)
    # large ones first, so that none hides a smaller one
    for (x, y), n in sorted(points.items(), key=lambda item: -item[1]):
        axes.scatter(
            x, y, s=_AREA * (1 + scale * (n - 1)), color=colour, alpha=0.55, lw=0.5,
            edgecolor="white", zorder=2, clip_on=False,
        )  # fmt: skip
    bare(axes)
    axes.set(xlim=(-0.09, 1.09), ylim=(-0.09, 1.09))
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.set_yticks([0, 0.5, 1], ["0", "0.5", "1"])


def costs(results: Results) -> Figure:
    """Draw the accuracy of the models of a comparison against CPU seconds per event.

    Raises:
        NothingToDrawError: of no model both are known.
    """
    kinds = {
        kind: [
            o
            for o in results.source.measured
            if o.metrics.get(f"{kind}_accuracy")
            and _positive(o.metrics.get("cpu_seconds"), "value")
        ]
        for kind in KIND_TITLES
    }
    kinds = {kind: shown for kind, shown in kinds.items() if shown}
    if not kinds:
        raise NothingToDrawError("of no model are both CPU seconds and accuracy known")
    names = width_of([o.label for shown in kinds.values() for o in shown])
    note = "Means over events with 95 % intervals. Dashed: people. Models without a cost: left out."
    figure = laid_out((2.9 + names) * len(kinds), 3.5, note)
    for column, (kind, shown) in enumerate(kinds.items()):
        axes = figure.add_subplot(1, len(kinds), column + 1)
        axes.set_title(KIND_TITLES[kind], loc="left", fontsize=NORMAL + 1, fontweight="bold")
        _costs(axes, shown, kind)
        axes.set_ylabel("share right" if column == 0 else "", fontsize=NORMAL, color=INK)
        for o in results.source.measured:
            found = o.metrics.get(f"{kind}_accuracy") if o.kind == "people" else None
            if found is not None:
                axes.axhline(found["value"], color=o.colour, lw=1.1, ls=(0, (4, 2)), zorder=1)
    return figure


def _positive(figure: Mapping[str, Any] | None, part: str) -> bool:
    """Whether part of a figure is known and has a place on an axis without 0."""
    return figure is not None and figure[part] is not None and figure[part] > 0


def _costs(axes: Axes, shown: Sequence[AnswerSet], kind: str) -> None:
    ends: list[float] = []
    names = []
    for answers in shown:
        cost, right = answers.metrics["cpu_seconds"], answers.metrics[f"{kind}_accuracy"]
        x, y = cost["value"], right["value"]
        style: dict[str, Any] = {"color": answers.colour, "lw": 1.2, "zorder": 2}
        if right["ci_low"] is not None:
            axes.plot([x, x], [right["ci_low"], right["ci_high"]], **style)
        if _positive(cost, "ci_low"):
            axes.plot([cost["ci_low"], cost["ci_high"]], [y, y], **style)
            ends += [cost["ci_low"], cost["ci_high"]]
        axes.plot([x], [y], "o", ms=5.5, color=answers.colour, mec="white", mew=0.8, zorder=3)
        ends.append(x)
        names.append((y / _HIGHEST, answers.label, answers.colour))
    bare(axes)
    low, high = math.floor(math.log10(min(ends))), math.ceil(math.log10(max(ends)))
    high = max(high, low + 1)
    axes.set(xscale="log", xlim=(10.0**low * 0.7, 10.0**high * 1.4), ylim=(0, _HIGHEST))
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
    axes.minorticks_off()
    decades = range(low, high + 1)
    ticks = [10.0**decade for decade in decades][:: max(1, -(-len(decades) // 6))]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.grid(color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("CPU seconds per event", fontsize=NORMAL, color=INK, labelpad=2)
    _names_beside(axes, names)


def _names_beside(axes: Axes, names: Sequence[tuple[float, str, str]]) -> None:
    """Write names on the right at their heights (shares of the axes), moved apart downwards."""
    names = sorted(names, key=lambda name: -name[0])
    steps = _NAME_GAP * np.arange(len(names))
    places = np.minimum.accumulate([height for height, _, _ in names] + steps) - steps
    # none below the axes
    places = np.maximum(places, steps[::-1])
    size = fitting([label for _, label, _ in names])
    for place, (_, label, colour) in zip(places, names, strict=True):
        axes.annotate(
            label, (1.03, place), xycoords="axes fraction", va="center", fontsize=size,
            color=colour, annotation_clip=False, parse_math=False,
        )  # fmt: skip


def differences(results: Results) -> Figure:
    """Draw the differences in right answers between models: row minus column.

    They are those of every two models, or of all from one where the comparison is against one.

    Raises:
        NothingToDrawError: no two models answered the same question of an event with truth.
    """
    comparison = results.comparison
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
        named = [o for o in results.source.answers if any(o.name in pair for pair in found)]
        rows = [o for o in named if o.name != against]
        grids[kind] = rows, named if against is None else [o for o in named if o.name == against]
    # the slanted names of the columns reach up
    slanted = 0.7 * width_of([o.label for _, columns in grids.values() for o in columns])
    names = width_of([o.label for rows, _ in grids.values() for o in rows])
    widths = [len(columns) for _, columns in grids.values()]
    figure = laid_out(
        max(sum(names + 0.4 * n + slanted / 2 for n in widths), 2.6),
        0.75 + slanted + 0.27 * max(len(rows) for rows, _ in grids.values()),
        "Row minus column, in right answers. Bold: p up to 0.05 after Holm's correction.",
    )
    panels = figure.subplots(1, len(grids), squeeze=False, width_ratios=widths)
    for axes, (kind, (rows, columns)) in zip(panels[0], grids.items(), strict=True):
        _differences(axes, rows, columns, kinds[kind])
        axes.set_title(KIND_TITLES[kind], fontsize=NORMAL + 1, fontweight="bold", color=INK)
    return figure


def _differences(
    axes: Axes,
    rows: Sequence[AnswerSet],
    columns: Sequence[AnswerSet],
    found: Mapping[tuple[str, str], Mapping[str, Any]],
) -> None:
    colours: FloatArray = np.ones((len(rows), len(columns), 3))
    texts: _Texts = {}
    for (i, one), (j, other) in itertools.product(enumerate(rows), enumerate(columns)):
        row, sign = found.get((one.name, other.name)), 1
        if row is None:
            row, sign = found.get((other.name, one.name)), -1
        if row is None:
            text, colour, sure = "" if one is other else number(None), GREY, False
        else:
            value = sign * row["value"]
            colours[i, j] = tint(_HIGHER if value > 0 else _LOWER, min(0.75, abs(value)))
            sure = row["p_holm"] is not None and row["p_holm"] <= ALPHA
            text, colour = number(value, signed=True), INK
        weight = "bold" if sure else "normal"
        texts[i, j] = (text, {"fontsize": SMALL, "color": colour, "fontweight": weight})
    cells(axes, colours, texts)
    name_rows(axes, rows)
    axes.xaxis.tick_top()
    labels = [o.label for o in columns]
    axes.set_xticks(
        range(len(columns)), labels, rotation=45, ha="left", rotation_mode="anchor",
        fontsize=fitting(labels), parse_math=False,
    )  # fmt: skip
    for tick, answers in zip(axes.get_xticklabels(), columns, strict=True):
        tick.set_color(answers.colour)


def film_strips(results: Results) -> Figure:
    """Draw the first event of every true scenario as a film strip; without truth, the first."""
    first: dict[str, Event] = {}
    for event in results.source.events:
        first.setdefault(results.scenarios.get(event.id, ""), event)
    chosen = {name: first[name] for name in SCENARIOS if name in first} or first
    strips = [
        np.asarray(draw_strip(event, min(_PANELS, event.observation.n_frames)))
        for event in chosen.values()
    ]
    heights = [_WIDTH * strip.shape[0] / strip.shape[1] for strip in strips]
    figure = laid_out(_WIDTH, sum(heights) + 0.3 * len(strips))
    grid = figure.subplots(len(strips), 1, squeeze=False, height_ratios=heights)
    for axes, (name, event), strip in zip(grid[:, 0], chosen.items(), strips, strict=True):
        colour = SCENARIO_COLOURS.get(name, GREY)
        title, goals = name or "scenario not known", event.id
        axes.set_title(title, loc="left", fontsize=NORMAL, color=colour, fontweight="bold")
        if event.truth is not None:
            goals = f"red: {event.truth.goal_red}; green: {event.truth.goal_green}"
        size = fitting([goals], 5.6, SMALL)
        axes.set_title(goals, loc="right", fontsize=size, color=GREY, parse_math=False)
        axes.imshow(strip, interpolation="antialiased")
        axes.set_axis_off()
    return figure
