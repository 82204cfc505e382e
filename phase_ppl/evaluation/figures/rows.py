"""Figures with a row for each model: right answers, and agreement with people."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis.figures.style import GREY, INK, NORMAL, new_figure, titled, written
from phase_ppl.evaluation.cells import number
from phase_ppl.evaluation.figures.frame import (
    KIND_TITLES,
    NothingToDrawError,
    PathLike,
    Source,
    compared,
    drawing,
    in_words,
    name_rows,
    opened,
    width_of,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.table import Answers, AnswerSet, parts_of, world_of
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Row = dict[str, Any]  # value, ends of its interval, and further fields
_Blocks = Mapping[str, Mapping[str, Mapping[AnswerSet, "_Row | None"]]]


@drawing(
    "Accuracy by scenario, or by agent and pair",
    "Bars: share of right goals and relations of everybody, over all events and by true "
    "scenario, in other worlds than PHASE by agent and pair, with 95 % intervals; the numbers "
    "are in the tables above.",
)
def accuracy(source: Source, path: PathLike | None = None) -> Figure:
    """Draw the accuracy of goals and relations, over all events and by true scenario.

    In other worlds than PHASE accuracy is by agent for goals, by pair for relations.

    Raises:
        NothingToDrawError: no answer can be right or wrong.
    """
    results = opened(source)
    counts = {o: _answered(results.events, o) for o in results.measured}
    blocks: dict[str, Any] = {}
    for kind, title in KIND_TITLES.items():
        name = f"{kind}_accuracy"
        shown = [o for o in results.measured if o.metrics.get(name) is not None]
        parts = parts_of(world_of(results.events), kind)
        parts = [p for p in parts if any(counts[o].get((kind, p[-1]), 0) for o in shown)]
        blocks[title] = {
            path[-1] if path else "all": {
                o: (at(o.metrics, (*path, name)) or {"value": None})
                | {"n": counts[o].get((kind, path[-1] if path else "all"), 0)}
                for o in shown
            }
            for path in ((), *(parts if len(parts) > 1 else ()))  # a single part equals the whole
        }
    figure = _panels(
        blocks, (1.2, 0.185), _bars, "no truth is known of an event that somebody judged",
        "Share of right answers (people: mean share of people who are right) with 95 % intervals "
        "over events; n: answers.",
    )  # fmt: skip
    return written(figure, path)


def _answered(events: Sequence[Event], answers: AnswerSet) -> dict[tuple[str, str], int]:
    """Return (kind, part) -> number of answered questions with known truth."""
    rows = Answers.of(events, answers.predictions).whole
    known = rows.groupby(["event", "question"], sort=False).first().reset_index()
    known = known[known["truth"].notna() & known["answer"].notna()]
    of_parts = known.groupby(["kind", "part"]).size().to_dict()
    return of_parts | {(kind, "all"): int((known["kind"] == kind).sum()) for kind in KIND_TITLES}


@drawing(
    "Models beside people",
    "Points with intervals: right answers of models minus those of people, beside the margin "
    "of equivalence; the numbers are in the table.",
    compares=True,
)
def equivalence(source: Source, path: PathLike | None = None) -> Figure:
    """Draw models' accuracy minus people's, with the margin of equivalence.

    Raises:
        NothingToDrawError: people judged no event with truth, or it is no comparison of models.
    """
    comparison = compared(source)
    found = {
        (r["model"], r["measure"], r["scenario"]): {**r, "n": r["n_events"]}
        for r in comparison.equivalence
    }
    ends = [r[k] for r in found.values() for k in ("value", "ci_low", "ci_high")]
    reach = max(0.5, *(abs(end) for end in ends if end is not None), 0)
    parts = [None, *(name for name in SCENARIOS if any(name == part for *_, part in found))]
    blocks: dict[str, Any] = {}
    for kind, title in KIND_TITLES.items():
        name = f"{kind}_accuracy"
        shown = [o for o in comparison.answers if (o.name, name, None) in found]
        blocks[title] = {
            part or "all": {o: found.get((o.name, name, part)) for o in shown} for part in parts
        }

    def draw(axes: Axes, rows: Mapping[AnswerSet, _Row | None]) -> None:
        margin = comparison.settings["margin"]
        axes.axvspan(-margin, margin, color="#dfe7dc", lw=0)
        axes.axvline(0, color="#8a8a8a", lw=0.8)
        for place, (answers, row) in enumerate(rows.items()):
            if row is None:
                continue
            for low, high, width in (("ci_low", "ci_high", 0.9), ("low", "high", 2.4)):
                if row[low] is not None:
                    axes.hlines(place, row[low], row[high], answers.colour, lw=width)
            face = answers.colour if "equivalent" in row["verdict"] else "white"
            axes.plot(row["value"], place, "o", ms=5, mec=answers.colour, mew=1.2, mfc=face)
        axes.set(xlim=(-reach * 1.05, reach * 1.05), xticks=[-0.5, 0, 0.5])

    figure = _panels(
        blocks, (1.4, 0.21), draw, "people judged no event whose truth is known",
        "Share right, model minus people, event by event. Thin: 95 %, thick: 90 % intervals. "
        "Band: margin of equivalence. Filled: equivalence is shown, after Holm's correction.",
    )  # fmt: skip
    return written(figure, path)


def _panels(
    blocks: _Blocks,
    cell: tuple[float, float],
    draw: Callable[[Axes, Mapping[AnswerSet, _Row | None]], object],
    nothing: str,
    note: str,
) -> Figure:
    """Draw kinds of questions below each other, a column for each part of the answers.

    ``blocks`` are title -> part -> whose -> row; ``draw`` draws the rows. ``n`` in a row counts its
    events or answers. Kinds without rows are left out; without any, ``nothing`` is the error's
    text. ``cell`` are the inches of a column and of a row.
    """
    blocks = {kind: parts for kind, parts in blocks.items() if any(parts.values())}
    if not blocks:
        raise NothingToDrawError(nothing)
    names = {kind: list(next(iter(parts.values()))) for kind, parts in blocks.items()}
    n_columns = max(map(len, blocks.values()))
    heights = [len(rows) for rows in names.values()]
    width = max(width_of(o for rows in names.values() for o in rows), 1.0) + cell[0] * n_columns
    figure = new_figure(width, cell[1] * sum(heights) + 0.8 * len(blocks) + 0.35, note=note)
    grid = figure.subplots(len(blocks), n_columns, squeeze=False, height_ratios=heights)
    for (kind, parts), line in zip(blocks.items(), grid, strict=True):
        for axes in line[len(parts) :]:
            axes.set_visible(False)
        for axes, (part, rows) in zip(line, parts.items(), strict=False):
            draw(axes, rows)
            counts = [row["n"] for row in rows.values() if row is not None and row["n"]]
            axes.set(ylim=(len(rows) - 0.5, -0.5), yticks=[])
            axes.spines["left"].set_visible(False)
            axes.xaxis.set_major_formatter("{x:g}")
            titled(axes, part, in_words(counts or [0]), fontsize=NORMAL)
            axes.set_visible(bool(counts))
        name_rows(line[0], names[kind])
        line[0].annotate(
            kind, (0, 1), (-6, 15), xycoords="axes fraction",
            textcoords="offset points", ha="right", fontsize=NORMAL + 1, fontweight="bold",
            annotation_clip=False,
        )  # fmt: skip
    return figure


def _bars(axes: Axes, rows: Mapping[AnswerSet, _Row | None], low: float = 0.0) -> None:
    """Draw measures as bars with intervals from ``low`` to 1, and as numbers to the right."""
    for place, (answers, row) in enumerate(rows.items()):
        if row is None or row["value"] is None:
            axes.text(0.01, place, number(None), va="center", color=GREY)
            continue
        axes.barh(place, row["value"], 0.7, color=answers.colour, alpha=0.5, lw=0)
        axes.vlines(row["value"], place - 0.35, place + 0.35, answers.colour, lw=1.6, clip_on=False)
        if row["ci_low"] is not None:
            axes.hlines(place, row["ci_low"], row["ci_high"], INK, lw=0.9, clip_on=False)
        axes.annotate(
            number(row["value"]), (1, place), (5, 0), xycoords=axes.get_yaxis_transform(),
            textcoords="offset points", va="center", annotation_clip=False,
        )  # fmt: skip
    axes.set(xlim=(low, 1), xticks=[tick for tick in (-1, -0.5, 0, 0.5, 1) if tick >= low])
    axes.grid(axis="x")


_CORRELATIONS: Final = {
    "goal_r": ("Goals", "goal_split_half_r"),
    "relation_r": ("Relations", "split_half_r"),
    "relation_r_given_truth": ("Relations, given the truth", ""),
}
"""Correlation with people -> title, and people's correlation with each other."""


@drawing(
    "Correlation with people",
    "Bars: correlation of each model with people; the numbers are in the table.",
)
def correlation(source: Source, path: PathLike | None = None) -> Figure:
    """Draw how well models, and people among themselves, correlate with people's answers.

    Raises:
        NothingToDrawError: nobody judged what a model gives probabilities for.
    """
    models = [o for o in opened(source).measured if o.kind != "people"]
    found = {n: {o: at(o.metrics, ("human", n)) for o in models} for n in _CORRELATIONS}
    found = {name: rows for name, rows in found.items() if any(rows.values())}
    if not found:
        raise NothingToDrawError("people judged nothing that a model gives probabilities for")
    shown = [o for o in models if any(rows[o] for rows in found.values())]
    figure = new_figure(width_of(shown) + 1.95 * len(found), 0.21 * len(shown) + 0.95)
    grid = figure.subplots(1, len(found), squeeze=False)[0]
    for axes, (name, rows) in zip(grid, found.items(), strict=True):
        ends = [row[k] for row in rows.values() if row for k in ("value", "ci_low") if row[k]]
        _bars(axes, {o: rows[o] for o in shown}, max(-1.0, 1.05 * min([0.0, *ends])))
        axes.set(ylim=(len(shown) - 0.5, -0.5), yticks=[], xlabel="r with people")
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_formatter("{x:g}")
        title, halves = _CORRELATIONS[name]
        axes.set_title(title, pad=15, fontsize=NORMAL, fontweight="bold")
        among = next(filter(None, (at(o.metrics, ("human", halves)) for o in shown)), None)
        if among is not None:  # split-half correlation of people, a line with its interval
            if among["ci_low"] is not None:
                axes.axvspan(among["ci_low"], among["ci_high"], color=INK, alpha=0.13, lw=0)
            axes.axvline(among["value"], color=INK, lw=1.1, ls=(0, (4, 2)))
            axes.annotate(
                f"people, split half: {among['value']:.2f}", (among["value"], 1), (0, 3),
                xycoords=axes.get_xaxis_transform(), textcoords="offset points",
                ha="right" if among["value"] > 0.5 else "left", annotation_clip=False,
            )  # fmt: skip
    name_rows(grid[0], shown)
    return written(figure, path)
