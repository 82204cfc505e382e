"""Figures of who is right: a row for each model, and which scenario is taken for which."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import GREY, INK, NORMAL, SMALL, new_figure, titled
from phase_ppl.evaluation.cells import number
from phase_ppl.evaluation.comparison import Source
from phase_ppl.evaluation.figures.frame import (
    KIND_TITLES,
    NothingToDrawError,
    PathLike,
    Results,
    drawing,
    fitting,
    in_words,
    opened,
    scenarios_of,
    width_of,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.table import Answers, parts_of, world_of
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Row = dict[str, Any]  # value, ends of its interval, and further fields
_Rows = Mapping[Source, "_Row | None"]

_DARK: Final = 0.65  # least share of a row at which its number is white


@drawing("Accuracy by scenario, or by agent and pair")
def accuracy(source: Results, path: PathLike | None = None) -> Figure:
    """Draw the accuracy of goals and relations, over all events and by true scenario.

    In other worlds than PHASE accuracy is by agent for goals, by pair for relations.

    Raises:
        NothingToDrawError: no answer can be right or wrong.
    """
    results = opened(source)
    counts = {o: _answered(results.events, o) for o in results.sources}
    blocks: dict[str, Any] = {}
    for kind, title in KIND_TITLES.items():
        name = f"{kind}_accuracy"
        shown = [o for o in results.sources if o.metrics.get(name) is not None]
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
    return _panels(
        blocks, (1.2, 0.185), _bars, "no truth is known of an event that somebody judged",
        "Share of right answers (people: mean share of people who are right) with 95 % intervals "
        "over events; n: answers.",
    )  # fmt: skip


def _answered(events: Sequence[Event], answers: Source) -> dict[tuple[str, str], int]:
    """Return (kind, part) -> number of answered questions with known truth."""
    rows = Answers.of(events, answers.predictions).whole
    known = rows.groupby(["event", "question"], sort=False).first().reset_index()
    known = known[known["truth"].notna() & known["answer"].notna()]
    of_parts = known.groupby(["kind", "part"]).size().to_dict()
    return of_parts | {(kind, "all"): int((known["kind"] == kind).sum()) for kind in KIND_TITLES}


_CORRELATIONS: Final = {
    "Goals": ("goal_r", "goal_split_half_r"),
    "Relations": ("relation_r", "split_half_r"),
    "given the truth": ("relation_r_given_truth", ""),
}
"""Title -> correlation with people, and people's correlation with each other."""


@drawing("Correlation with people")
def correlation(source: Results, path: PathLike | None = None) -> Figure:
    """Draw how well models, and people among themselves, correlate with people's answers.

    Raises:
        NothingToDrawError: nobody judged anything that a model gives probabilities for.
    """
    models = [o for o in opened(source).sources if o.kind != "people"]
    found = {
        title: {o: at(o.metrics, ("human", name)) for o in models}
        for title, (name, _) in _CORRELATIONS.items()
    }
    found = {title: rows for title, rows in found.items() if any(rows.values())}
    shown = [o for o in models if any(rows[o] for rows in found.values())]
    parts: dict[str, dict[Source, _Row | None]] = {
        title: {o: rows[o] and {**rows[o], "n": o.metrics["n_events"]} for o in shown}
        for title, rows in found.items()
    }

    def draw(axes: Axes, part: str, rows: _Rows) -> None:
        _bars(axes, part, rows)
        halves = _CORRELATIONS[part][1]
        among = next(filter(None, (at(o.metrics, ("human", halves)) for o in shown)), None)
        if among is not None:  # split-half correlation of people, a line with its interval
            if among["ci_low"] is not None:
                axes.axvspan(among["ci_low"], among["ci_high"], color=INK, alpha=0.13, lw=0)
            axes.axvline(among["value"], color=INK, lw=1.1, ls=(0, (4, 2)))

    return _panels(
        {"r with people": parts} if parts else {}, (1.6, 0.21), draw,
        "people judged nothing that a model gives probabilities for",
        "Pearson's r with 95 % intervals over events. Dashed: r of halves of the people.",
    )  # fmt: skip


def _panels(
    blocks: Mapping[str, Mapping[str, _Rows]],
    cell: tuple[float, float],
    draw: Callable[[Axes, str, _Rows], object],
    nothing: str,
    note: str,
) -> Figure:
    """Draw kinds of questions below each other, a column for each part of the answers.

    ``blocks`` are title -> part -> whose -> row; ``draw`` draws the rows of a part. ``n`` in a row
    counts its events or answers. Kinds without rows are left out; without any, ``nothing`` is the
    error's text. ``cell`` are the inches of a column and of a row.
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
            draw(axes, part, rows)
            counts = [row["n"] for row in rows.values() if row is not None and row["n"]]
            axes.set(ylim=(len(rows) - 0.5, -0.5), yticks=[])
            axes.spines["left"].set_visible(False)
            axes.xaxis.set_major_formatter("{x:g}")
            titled(axes, part, in_words(counts or [0]), fontsize=NORMAL)
            axes.set_visible(bool(counts))
        _name_rows(line[0], names[kind])
        line[0].annotate(
            kind, (0, 1), (-6, 15), xycoords="axes fraction",
            textcoords="offset points", ha="right", fontsize=NORMAL + 1, fontweight="bold",
            annotation_clip=False,
        )  # fmt: skip
    return figure


def _name_rows(axes: Axes, shown: Sequence[Source]) -> None:
    """Write the names of the rows on the left, in their colours."""
    labels = [answers.label for answers in shown]
    axes.set_yticks(range(len(shown)), labels, fontsize=fitting(labels))
    axes.tick_params(axis="y", length=0)
    for text, answers in zip(axes.get_yticklabels(), shown, strict=True):
        text.set_color(answers.colour)


def _bars(axes: Axes, part: str, rows: _Rows) -> None:
    """Draw measures as bars up to 1 with intervals, and as numbers to the right."""
    ends = [row[k] for row in rows.values() if row for k in ("value", "ci_low") if row.get(k)]
    low = max(-1.0, 1.05 * min([0.0, *ends]))
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


@drawing("Which scenario is taken for which")
def confusion(source: Results, path: PathLike | None = None) -> Figure:
    """Draw confusion matrices: true scenario against the scenario of the goals answered.

    Cells hold numbers of events, shades are shares of their row.

    Raises:
        NothingToDrawError: nobody answered both goals of an event with known scenario. Only PHASE
            has scenarios.
    """
    results = opened(source)
    true = scenarios_of(results.events)
    shown: dict[Source, np.ndarray] = {}
    for o in results.sources:
        pairs = [(true[e], p.scenario) for e, p in o.predictions.items() if e in true]
        told = pd.DataFrame(pairs, columns=["true", "answered"]).dropna()
        counts = pd.crosstab(told["true"], told["answered"])
        shown[o] = counts.reindex(SCENARIOS, columns=SCENARIOS, fill_value=0).to_numpy(int)
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
    ticks = range(len(SCENARIOS))
    slanted: dict[str, Any] = {"rotation": 40, "ha": "left", "rotation_mode": "anchor"}
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for place, (answers, counts) in enumerate(shown.items()):
        row, column = divmod(place, n_columns)
        axes = grid[row, column]
        shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        axes.imshow(shares, cmap="Blues", vmin=0, vmax=1.15, aspect="auto")
        for (i, j), n in np.ndenumerate(counts):
            axes.text(
                j, i, str(n) if n else "\N{MIDDLE DOT}", ha="center", va="center", fontsize=NORMAL,
                color="white" if shares[i, j] > _DARK else INK,
                fontweight=("normal", "bold")[i == j],
            )  # fmt: skip
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0, labelsize=SMALL, pad=3)
        axes.xaxis.tick_top()
        axes.set_xticks(ticks, SCENARIOS if row == 0 else [], **slanted)
        axes.set_yticks(ticks, labels if column == 0 else [])
        name = f"{answers.label}, majority" if answers.kind == "people" else answers.label
        axes.set_title(
            textwrap.fill(name, 20), fontsize=NORMAL, color=answers.colour, fontweight="bold"
        )
    return figure
