"""Figures with a row per model: right answers, correlation with people, equivalence with people."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.figures.style import COLOURS, INK, NORMAL, SMALL, bare
from phase_ppl.analysis.figures.style import GREY as TEXT_GREY
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.cells import number
from phase_ppl.evaluation.experiments import MAJORITY, MARGIN, RATINGS, Likeness, Tags
from phase_ppl.evaluation.figures.layout import (
    GREY,
    KIND_TITLES,
    SCENARIO_COLOURS,
    NothingToDrawError,
    Results,
    fitting,
    head,
    in_words,
    laid_out,
    name_rows,
    tint,
    title_row,
    width_of,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.tables import facts, said
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Blocks = Mapping[str, Sequence[AnswerSet]]  # kind of question -> the rows about it

_CORRELATIONS: Final = {
    "goal_r": ("Goals", "goal_split_half_r"),
    "relation_r": ("Relations", "split_half_r"),
    "relation_r_given_truth": ("Relations, given the truth", ""),
}
"""Correlation with people -> title, and that of people with each other."""


def accuracy(results: Results) -> Figure:
    """Draw the accuracy of goals and relations, over all events and by true scenario.

    Raises:
        NothingToDrawError: no answer can be right or wrong.
    """
    blocks = {
        kind: [o for o in results.source.measured if o.metrics.get(f"{kind}_accuracy") is not None]
        for kind in KIND_TITLES
    }
    present = [name for name in SCENARIOS if name in results.scenarios.values()]

    def draw(axes: Axes, kind: str, scenario: str | None) -> list[int]:
        place = () if scenario is None else ("by_scenario", scenario)
        found = [at(o.metrics, (*place, f"{kind}_accuracy")) for o in blocks[kind]]
        _bars(axes, blocks[kind], found)
        return [results.count(o, kind, scenario) for o in blocks[kind]]

    return _by_scenario(
        blocks,
        # of one scenario all is the same
        present if len(present) > 1 else [],
        (1.2, 0.185),
        "Share of right answers (people: mean share of people who are right) with 95 % intervals "
        "over events; n: answers.",
        draw,
        "no truth is known of an event that somebody judged",
    )


def equivalence(results: Results) -> Figure:
    """Draw how much more often models are right than people, beside the margin of equivalence.

    Raises:
        NothingToDrawError: people judged no event with truth, or it is no comparison of models.
    """
    comparison = results.comparison
    found = {(r["model"], r["measure"], r["scenario"]): r for r in comparison.equivalence}
    blocks = {
        kind: [o for o in results.source.answers if (o.name, f"{kind}_accuracy", None) in found]
        for kind in KIND_TITLES
    }
    ends = [r[k] for r in found.values() for k in ("value", "ci_low", "ci_high")]
    reach = max(0.5, *(abs(end) for end in ends if end is not None), 0)

    def draw(axes: Axes, kind: str, scenario: str | None) -> list[int]:
        rows = [found.get((o.name, f"{kind}_accuracy", scenario)) for o in blocks[kind]]
        _against_people(axes, blocks[kind], rows, comparison.settings["margin"], reach)
        return [row["n_events"] for row in rows if row is not None]

    return _by_scenario(
        blocks,
        [name for name in SCENARIOS if any(scenario == name for _, _, scenario in found)],
        (1.4, 0.21),
        "Share right, model minus people, event by event. Thin: 95 %, thick: 90 % intervals. "
        "Band: margin of equivalence. Filled: equivalence is shown, after Holm's correction.",
        draw,
        "people judged no event whose truth is known",
    )


def _by_scenario(
    blocks: Blocks,
    scenarios: Sequence[str],
    cell: tuple[float, float],
    note: str,
    draw: Callable[[Axes, str, str | None], list[int]],
    nothing: str,
) -> Figure:
    """Draw kinds of questions below each other, a column for all events and for each scenario.

    Kinds without rows are left out. ``cell`` are the inches of a column and of a row; ``draw``
    draws the rows of a kind and a scenario, and returns of how many events or answers; ``nothing``
    says what is missing where there are no rows.
    """
    blocks = {kind: rows for kind, rows in blocks.items() if rows}
    if not blocks:
        raise NothingToDrawError(nothing)
    columns: list[str | None] = [None, *scenarios]
    heights = [len(rows) for rows in blocks.values()]
    width = width_of([o.label for rows in blocks.values() for o in rows])
    width = max(width, 1.0) + cell[0] * len(columns)
    figure = laid_out(width, cell[1] * sum(heights) + 0.8 * len(blocks) + 0.35, note)
    grid = figure.subplots(len(blocks), len(columns), squeeze=False, height_ratios=heights)
    for (kind, rows), line in zip(blocks.items(), grid, strict=True):
        for axes, scenario in zip(line, columns, strict=True):
            counts = [n for n in draw(axes, kind, scenario) if n]
            axes.set_ylim(len(rows) - 0.5, -0.5)
            axes.set_yticks([])
            head(axes, scenario or "all", in_words(counts or [0]))
            axes.set_visible(bool(counts))
        name_rows(line[0], rows)
        title_row(line[0], KIND_TITLES[kind])
    return figure


def _bars(axes: Axes, rows: Sequence[AnswerSet], found: Sequence[Any], low: float = 0.0) -> None:
    """Draw figures as bars with intervals from ``low`` to 1, and as numbers to the right."""
    for row, (answers, figure) in enumerate(zip(rows, found, strict=True)):
        if figure is None:
            axes.text(0.01, row, number(None), va="center", fontsize=SMALL, color=GREY)
            continue
        value, ends = figure["value"], [figure["ci_low"], figure["ci_high"]]
        axes.barh(row, value, height=0.7, color=tint(answers.colour, 0.5), lw=0)
        axes.plot(
            [value] * 2, [row - 0.35, row + 0.35], color=answers.colour, lw=1.6, clip_on=False
        )
        if None not in ends:
            axes.plot(ends, [row, row], color=INK, lw=0.9, clip_on=False)
        axes.annotate(
            number(value), (1, row), xycoords=axes.get_yaxis_transform(), xytext=(5, 0),
            textcoords="offset points", va="center", fontsize=SMALL, color=INK,
            annotation_clip=False,
        )  # fmt: skip
    bare(axes, "left")
    axes.set_xlim(low, 1)
    ticks = [0, 0.5, 1] if low > -0.25 else [-0.5, 0, 0.5, 1] if low > -0.75 else [-1, 0, 1]
    axes.set_xticks(ticks, [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in ticks])
    axes.grid(axis="x", color="#e2e2e2", lw=0.6)
    axes.set_axisbelow(True)


def _against_people(
    axes: Axes,
    shown: Sequence[AnswerSet],
    rows: Sequence[Mapping[str, Any] | None],
    margin: float,
    reach: float,
) -> None:
    axes.axvspan(-margin, margin, color="#dfe7dc", lw=0)
    axes.axvline(0, color="#8a8a8a", lw=0.8)
    for place, (answers, row) in enumerate(zip(shown, rows, strict=True)):
        if row is None:
            continue
        colour = answers.colour
        for low, high, width in (("ci_low", "ci_high", 0.9), ("low", "high", 2.4)):
            if row[low] is not None:
                axes.plot([row[low], row[high]], [place, place], color=colour, lw=width,
                          solid_capstyle="butt")  # fmt: skip
        filled = "equivalent" in row["verdict"]
        axes.plot([row["value"]], [place], "o", ms=5, mec=colour, mew=1.2,
                  mfc=colour if filled else "white")  # fmt: skip
    bare(axes, "left")
    axes.set_xlim(-reach * 1.05, reach * 1.05)
    axes.set_xticks([-0.5, 0, 0.5], ["\N{MINUS SIGN}0.5", "0", "0.5"])


def correlation(results: Results) -> Figure:
    """Draw how well models, and people among themselves, correlate with people's answers.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    models = [o for o in results.source.measured if o.kind != "people"]
    found = {name: [at(o.metrics, ("human", name)) for o in models] for name in _CORRELATIONS}
    panels = [name for name, values in found.items() if any(values)]
    if not panels:
        raise NothingToDrawError("people judged nothing that a model gives probabilities for")
    places = [i for i in range(len(models)) if any(found[name][i] for name in panels)]
    shown = [models[i] for i in places]
    width = width_of([o.label for o in shown]) + 1.95 * len(panels)
    figure = laid_out(width, 0.21 * len(shown) + 0.95)
    for column, name in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), column + 1)
        values = [found[name][i] for i in places]
        ends = [v[k] for v in values if v for k in ("value", "ci_low") if v[k]]
        _bars(axes, shown, values, max(-1.0, 1.05 * min([0.0, *ends])))
        axes.set_ylim(len(shown) - 0.5, -0.5)
        axes.set_yticks([])
        if column == 0:
            name_rows(axes, shown)
        axes.set_xlabel("r with people", fontsize=NORMAL, color=INK, labelpad=2)
        title, halves = _CORRELATIONS[name]
        head(axes, title, "", fontweight="bold")
        people = next(filter(None, (at(o.metrics, ("human", halves)) for o in shown)), None)
        if people is not None:
            _people_line(axes, people)
    return figure


def _people_line(axes: Axes, people: Mapping[str, Any]) -> None:
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


# --- what people say of videos --------------------------------------------------------------------

PathLike = str | os.PathLike[str]

_LABEL_WIDTH: Final = 2.6
_FAINT: Final = "#e6e6e6"


def tags(given: Tags, majority: float = MAJORITY) -> Figure:
    """Draw the percentage of videos that have each label as a category."""
    found = given.summary(majority)
    order = list(found.index)[::-1]
    fewest, most = given.viewers.min(), given.viewers.max()
    each = f"{most} each" if fewest == most else f"{fewest} to {most} each"
    note = (
        f"Percentage of the {len(given.viewers)} videos for which at least {100 * majority:g} % of "
        f"their viewers ({each}) chose the label. Hollow: chosen by somebody, in no video by that "
        "many."
    )
    figure = laid_out(_LABEL_WIDTH + 3.8, 0.9 + 0.19 * len(order), note)
    axes = figure.subplots()
    percent = found.loc[order, "percent"].to_numpy(float)
    axes.barh(range(len(order)), percent, color=COLOURS[0], height=0.68)
    for place, (label, value) in enumerate(zip(order, percent, strict=True)):
        if value == 0 and found.loc[label, "used"]:
            axes.plot(0, place, "o", ms=3.5, mfc="white", mec=COLOURS[0], clip_on=False, zorder=3)
        axes.annotate(
            f"{value:.0f}", (value, place), xytext=(5, 0), textcoords="offset points",
            va="center", fontsize=SMALL, color=TEXT_GREY,
        )  # fmt: skip
    bare(axes)
    axes.set_yticks(range(len(order)), order, fontsize=NORMAL)
    axes.set_ylim(-0.6, len(order) - 0.4)
    axes.set_xlim(0, max(10.0, 1.12 * float(percent.max(initial=0))))
    axes.set_xlabel("videos, %", fontsize=NORMAL, color=INK)
    axes.grid(axis="x", color=_FAINT, lw=0.6)
    axes.set_axisbelow(True)
    return figure


def likeness(given: Likeness, margin: float = MARGIN) -> Figure:
    """Draw the ratings of both groups, mean ratings of their videos, and the difference."""
    found = given.summary()
    test = given.equivalence(margin)
    shown = "shown" if test["equivalent"] else "not shown"
    note = (
        "Left: share of each rating. Middle: mean rating of each video, and mean over videos. "
        "Right: difference of the mean ratings of participants with its 90 % interval, beside the "
        f"margin; equivalence is {shown} (two one-sided tests, p = {test['p']:.2g})."
    )
    figure = laid_out(7.2, 2.7, note)
    shares, means, difference = figure.subplots(1, 3, width_ratios=(1.3, 1.0, 1.0))
    for index, group in enumerate(given.groups):
        ratings = given.table.loc[given.table["group"] == group, "rating"]
        share = [float((ratings == rating).mean()) for rating in RATINGS]
        places = np.array(RATINGS) + 0.4 * (index - 0.5)
        shares.bar(places, share, width=0.38, color=COLOURS[index], label=group)
        _points(means, index, given.means("videos")[group], COLOURS[index])
    bare(shares)
    shares.set_xticks(RATINGS)
    shares.set_xlabel("rating", fontsize=NORMAL, color=INK)
    shares.set_ylabel("share", fontsize=NORMAL, color=INK)
    shares.legend(frameon=False, fontsize=SMALL, loc="upper left")
    bare(means)
    means.set_xticks(
        [0, 1],
        [f"{g}\n{r['mean']:.2f} ± {r['sd_videos']:.2f}" for g, r in found.iterrows()],
        fontsize=SMALL,
    )
    means.set_xlim(-0.5, 1.5)
    means.set_ylim(0.9, 5.1)
    means.set_yticks(RATINGS)
    low, high = test["ci_low"], test["ci_high"]
    difference.axhspan(-margin, margin, color=_FAINT)
    difference.axhline(0, color="#999999", lw=0.7)
    difference.plot([0, 0], [low, high], color=INK, lw=2.2)
    face = INK if test["equivalent"] else "white"
    difference.plot(0, test["difference"], "o", ms=5, mfc=face, mec=INK)
    bare(difference)
    reach = 1.2 * max(margin, abs(low), abs(high))
    difference.set(xlim=(-1, 1), ylim=(-reach, reach))
    first, second = given.groups
    difference.set_xticks([0], [f"{first} \N{MINUS SIGN}\n{second}"], fontsize=SMALL)
    return figure


def _points(axes: Axes, place: int, values: np.ndarray, colour: str) -> None:
    """Draw points side by side, those with the same value beside each other, and their mean."""
    rounded = np.round(values, 1)
    for value in np.unique(rounded):
        here = values[rounded == value]
        aside = (np.arange(len(here)) - (len(here) - 1) / 2) * min(0.05, 0.8 / max(1, len(here)))
        axes.plot(place + aside, here, "o", ms=2.6, color=colour, alpha=0.6, mew=0)
    axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)


# --- doubt ----------------------------------------------------------------------------------------

_MARKS: Final = dict(zip(RELATIONS, ("o", "s", "^"), strict=True))
_MOST: Final = 6
_PARTS: Final = ("relation_r", "relation_r_given_truth")


def people(results: Results) -> Figure:
    """Draw models' probabilities of relations against people's shares, and how near r can come.

    For each model a row: probabilities against shares; the same less the mean over events of the
    same true relation; and both correlations with their intervals over events and raters, beside
    what halves of the people reach, as they are (grey line) and for all raters (dashed).

    Raises:
        NothingToDrawError: nobody judged relations to which a model gives probabilities.
    """
    shown = [
        one for one in results.source.measured if one.kind != "people" and one.metrics.get("doubt")
    ]
    if not shown:
        raise NothingToDrawError("nobody judged relations to which a model gives probabilities")
    shown = shown[:_MOST]
    note = (
        "Marks: an answer to a video, circles friendly, squares neutral, triangles adversarial; "
        "colours: true scenario. Given the truth: less the mean of the videos with the same true "
        "relation. Right: 95 % intervals over videos and raters; line: halves of the people, "
        "dashed: of all people, by Spearman and Brown."
    )
    figure = laid_out(7.2, 0.7 + 2.15 * len(shown), note)
    for (left, middle, right), answers in zip(
        figure.subplots(len(shown), 3, squeeze=False, width_ratios=(1, 1, 0.8)), shown, strict=True
    ):
        p, shares, truth, colours = _probabilities(answers, results)
        _scatter(left, p, shares, colours, (0.0, 1.0))
        left.set_ylabel("people", fontsize=NORMAL, color=INK)
        left.set_title(
            answers.label, loc="left", color=answers.colour, fontweight="bold", parse_math=False,
            fontsize=fitting([answers.label], 2.0),
        )  # fmt: skip
        known = truth >= 0
        _scatter(
            middle,
            _given_truth(p[known], truth[known]),
            _given_truth(shares[known], truth[known]),
            [colour for colour, is_known in zip(colours, known, strict=True) if is_known],
            (-1.0, 1.0),
        )
        middle.set_title("given the truth", loc="left", fontsize=NORMAL, color=GREY)
        _correlation_bars(right, answers.metrics["doubt"], answers.colour)
    for axes in figure.axes[-3:-1]:
        axes.set_xlabel("model", fontsize=NORMAL, color=INK)
    return figure


def _probabilities(
    answers: AnswerSet, results: Results
) -> tuple[FloatArray, FloatArray, IntArray, list[str]]:
    """Return probabilities and shares (event, answer), true relations, and colours of events."""
    events = [event for event in results.source.events if event.id in answers.predictions]
    known, model = facts(events), said(events, answers.predictions)
    p, shares = model.probabilities["relation"][:, 0], known.people["relation"][:, 0]
    there = ~np.isnan(p[:, 0]) & ~np.isnan(shares[:, 0])
    names = [results.scenarios.get(events[i].id, "") for i in np.flatnonzero(there)]
    colours = [SCENARIO_COLOURS.get(name, GREY) for name in names]
    return p[there], shares[there], known.truth["relation"][there, 0], colours


def _given_truth(values: FloatArray, truth: IntArray) -> FloatArray:
    found = values.copy()
    for group in np.unique(truth):
        found[truth == group] -= values[truth == group].mean(axis=0)
    return found


def _scatter(
    axes: Axes, x: FloatArray, y: FloatArray, colours: list[str], ends: tuple[float, float]
) -> None:
    bare(axes)
    axes.plot(ends, ends, color="#bbbbbb", lw=0.7, zorder=0)
    style: dict[str, Any] = {"s": 13, "alpha": 0.65, "linewidths": 0, "clip_on": False}
    for answer, mark in enumerate(_MARKS.values()):
        axes.scatter(x[:, answer], y[:, answer], c=colours, marker=mark, **style)
    ticks = sorted({*ends, 0.0})
    axes.set(xlim=ends, ylim=ends, xticks=ticks, yticks=ticks)
    axes.set_aspect("equal", adjustable="box")


def _correlation_bars(axes: Axes, doubt: dict[str, Any], colour: str) -> None:
    """Draw both correlations with their intervals, and the ceilings."""
    bare(axes)
    for place, name in enumerate(_PARTS):
        found = doubt[name]
        if found is None:
            continue
        axes.bar(place, found["value"], width=0.55, color=colour, alpha=0.85)
        if found["ci_low"] is not None:
            axes.plot([place, place], [found["ci_low"], found["ci_high"]], color=INK, lw=1.1)
        suffix = name.removeprefix("relation_r")
        for ceiling, line in ((f"split_half_r{suffix}", "-"), (f"spearman_brown{suffix}", "--")):
            value = doubt["ceiling"].get(ceiling)
            if value is not None:
                ends = [place - 0.38, place + 0.38]
                axes.plot(ends, [value, value], line, color=GREY, lw=1.3)
        axes.annotate(
            f"{found['value']:.2f}", (place, 0), xytext=(9, 3), textcoords="offset points",
            ha="center", fontsize=SMALL, color="white" if found["value"] > 0.2 else INK,
        )  # fmt: skip
    axes.axhline(0, color=INK, lw=0.6)
    axes.set_xticks([0, 1], ["r", "r given\nthe truth"], fontsize=SMALL)
    lowest = min(found["ci_low"] or 0.0 for found in map(doubt.get, _PARTS) if found)
    axes.set(xlim=(-0.6, 1.6), ylim=(min(lowest, 0.0), 1.0))
