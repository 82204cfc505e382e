"""Figures with a row per model: right answers, correlation with people, equivalence with people."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.cells import number
from phase_ppl.evaluation.figures.layout import (
    GREY,
    KIND_TITLES,
    NothingToDrawError,
    Results,
    head,
    in_words,
    laid_out,
    name_rows,
    tint,
    title_row,
    width_of,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Blocks = Mapping[str, Sequence[AnswerSet]]
"""Kind of question -> the rows about it."""

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

    Args:
        blocks: kinds without rows are left out.
        scenarios: that have a column.
        cell: inches of a column, and of a row.
        note: below the figure.
        draw: draws rows of a kind and a scenario; returns of how many events or answers.
        nothing: what is missing where there are no rows.
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
