"""Figures of an evaluation or of a comparison of models, for an article.

They show who is right and who agrees with people. Every function takes an evaluation or a
comparison, or the folder of one, and returns a matplotlib figure. With ``path`` (.png, .pdf, .svg)
the figure is also written. Matplotlib's global state is left alone. If the results lack the data of
a figure, it raises :class:`NothingToDrawError`.
"""

from __future__ import annotations

import itertools
import math
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, TypeVar

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    NORMAL,
    SMALL,
    direct_labels,
    in_style,
    new_figure,
    titled,
    written,
)
from phase_ppl.evaluation.cells import KIND_WORDS, number
from phase_ppl.evaluation.comparison import ALPHA, ModelComparison
from phase_ppl.evaluation.doubt import label_places
from phase_ppl.evaluation.evaluation import COMPARISON, Evaluation
from phase_ppl.evaluation.experiments import (
    MAJORITY,
    MARGIN,
    RATINGS,
    Likeness,
    Tags,
    load_likeness,
    load_tags,
)
from phase_ppl.evaluation.metrics import at
from phase_ppl.evaluation.table import (
    Answers,
    AnswerSet,
    parts_of,
    true_answers,
    true_scenario,
    world_of,
)
from phase_ppl.render.frames import draw_strip
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.errors import shown as in_short
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    *("DRAWINGS", "accuracy", "confusion", "correlation", "costs", "differences", "draw_figures"),
    *("equivalence", "film_strips", "likeness", "people", "scatter_goals", "scatter_relations"),
    "tags",
]

PathLike: TypeAlias = str | os.PathLike[str]
Results: TypeAlias = Evaluation | ModelComparison
Source: TypeAlias = Results | PathLike

KIND_TITLES: Final[dict[str, str]] = {
    kind: words.capitalize() for kind, words in KIND_WORDS.items()
}

SCENARIO_COLOURS: Final = dict(
    zip(SCENARIOS, ("#009e73", "#4d6fb3", "#c98a00", "#b8336a"), strict=True)
)
"""Colours that people with red-green blindness can tell apart."""

FOLDER: Final = "figures"  # subfolder of the results

_WIDTH: Final = 7.2  # inches: both columns of a journal's page
_CHARACTER: Final = 0.6  # mean width of a character, as a share of its size
_WIDEST: Final = 2.2  # most inches for names of rows; longer names get a smaller font


class NothingToDrawError(InvalidSettingError):
    """The results lack what a figure is about; the message says what."""


class Drawing(NamedTuple):
    """A kind of figure."""

    title: str  # its content, in a few words
    alt: str  # alternative text for people who cannot see it
    draw: Callable[..., Figure]  # draws results, and writes the figure to a path
    compares: bool  # whether it needs a comparison of models


DRAWINGS: Final[dict[str, Drawing]] = {}
"""Name of a figure, and of its file -> its drawing."""

_Draw = TypeVar("_Draw", bound=Callable[..., Any])


def drawing(title: str, alt: str, *, compares: bool = False) -> Callable[[_Draw], _Draw]:
    """Return a decorator: draw in the common style, and register in :data:`DRAWINGS`."""

    def keep(draw: _Draw) -> _Draw:
        styled: Any = in_style(draw)
        DRAWINGS[draw.__name__] = Drawing(title, alt, styled, compares)
        return styled

    return keep


def opened(source: Source) -> Results:
    """Return results, read from their folder if ``source`` is a path."""
    if not isinstance(source, str | os.PathLike):
        return source
    comparison = (Path(source) / COMPARISON).is_file()
    return (ModelComparison if comparison else Evaluation).load(source)


def compared(source: Source) -> ModelComparison:
    """Open a comparison of models; NothingToDrawError: the results are of an evaluation."""
    found = opened(source)
    if not isinstance(found, ModelComparison):
        raise NothingToDrawError("the results are of an evaluation, not of a comparison of models")
    return found


def scenarios_of(results: Results) -> dict[str, str]:
    """Return event -> true scenario, of the events of PHASE whose truth is known."""
    return {event.id: name for event in results.events if (name := true_scenario(event))}


# --- layout ---------------------------------------------------------------------------------------


def fitting(texts: Iterable[str], width: float = _WIDEST, most: float = NORMAL) -> float:
    """Return the font size, points, at which the longest text fits into ``width`` inches."""
    return min(most, 72 * width / (_CHARACTER * max((len(text) for text in texts), default=1)))


def width_of(shown: Iterable[AnswerSet]) -> float:
    """Return the approximate inches for names beside a figure, margins included."""
    labels = [answers.label for answers in shown]
    return _CHARACTER * max(map(len, labels), default=0) * fitting(labels) / 72 + 0.2


def name_rows(axes: Axes, shown: Sequence[AnswerSet]) -> None:
    """Write the names of the rows on the left, in their colours."""
    labels = [answers.label for answers in shown]
    axes.set_yticks(range(len(shown)), labels, fontsize=fitting(labels))
    axes.tick_params(axis="y", length=0)
    for text, answers in zip(axes.get_yticklabels(), shown, strict=True):
        text.set_color(answers.colour)


def in_words(counts: Iterable[int]) -> str:
    """Return counts, such as models' numbers of events, as text: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"


def draw_figures(source: Source, folder: Path, *, progress: bool = True) -> list[Path]:
    """Write all figures that the results allow into ``figures/``, as PNG; return the files.

    With ``progress`` the figures left out, and why, are printed on standard error.

    Raises:
        InvalidEventError, UnknownNameError: a file in the folder is damaged.
        OutputError: a file cannot be written.
    """
    results = opened(source)
    target = writable_folder(folder / FOLDER)
    files = []
    for name, drawing in drawings_of(results).items():
        file = target / f"{name}.png"
        try:
            drawing.draw(results, file)
        except NothingToDrawError as reason:
            file.unlink(missing_ok=True)  # outdated figure of earlier results
            if progress:
                print(f"no figure {name}: {reason}", file=sys.stderr)
        else:
            files.append(file)
    return files


def drawings_of(results: Results) -> dict[str, Drawing]:
    """Return the drawings for results of this kind."""
    compares = isinstance(results, ModelComparison)
    return {name: one for name, one in DRAWINGS.items() if compares or not one.compares}


# --- rows of names: right answers, and agreement with people --------------------------------------

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
    rows = Answers.of(events, answers.predictions).rows
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
    found = {(r["model"], r["measure"], r["scenario"]): r for r in comparison.equivalence}
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
            row["n"] = row["n_events"]
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


# --- axes per model or event ----------------------------------------------------------------------

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
        rows = Answers.of(results.events, o.predictions).rows
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
                        color=SCENARIO_COLOURS.get(name, GREY), edgecolor="white", clip_on=False,
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
        style = {"color": SCENARIO_COLOURS.get(name, GREY), "fontweight": "bold"}
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

    If no scenario is known, the first event is drawn.
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
        style = {"color": SCENARIO_COLOURS.get(name, GREY), "fontweight": "bold"}
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


# --- doubt ----------------------------------------------------------------------------------------

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
        "adversarial; colours: true scenario. Given the truth: less the mean of the videos with "
        "the same true relation. Right: 95 % intervals; line: halves of "
        "the people, dashed: of all people, by Spearman and Brown.",
    )
    grid = figure.subplots(len(shown), 3, squeeze=False, width_ratios=(1, 1, 0.8))
    scenarios = scenarios_of(results)
    for (left, middle, right), answers in zip(grid, shown, strict=True):
        events = [event for event in results.events if event.id in answers.predictions]
        said = Answers.of(events, answers.predictions)
        columns = ("probability", "people", "truth")
        p, shares, true = (said.array("relation", name)[:, 0] for name in columns)
        colours = np.array([SCENARIO_COLOURS.get(scenarios.get(e.id, ""), GREY) for e in events])
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


# --- people's labels and ratings of videos --------------------------------------------------------

_Data = TypeVar("_Data")
_FAINT: Final = "#e6e6e6"


def _read(source: Any, kind: type[_Data], load: Callable[[Any], _Data]) -> _Data:
    if isinstance(source, str | os.PathLike):
        return load(source)
    if not isinstance(source, kind):
        raise InvalidSettingError(f"{in_short(source)}, expected {kind.__name__} or their file")
    return source


@in_style
def tags(
    source: Tags | PathLike, path: PathLike | None = None, *, majority: float = MAJORITY
) -> Figure:
    """Draw the share of videos in each category, as the paper does for its 23 labels.

    Labels are given directly or as a CSV file (:mod:`phase_ppl.evaluation.experiments`). A video
    has a category if at least the share ``majority`` of its viewers chose the label.

    Raises:
        InvalidSettingError: ``source`` is neither labels nor a file, or ``majority`` no share.
        InvalidEventError: the file holds no labels; the message names file and line.
    """
    given = _read(source, Tags, load_tags)
    found = given.summary(majority)[::-1]
    fewest, most = given.viewers.min(), given.viewers.max()
    each = f"{most} each" if fewest == most else f"{fewest} to {most} each"
    figure = new_figure(
        *(6.4, 0.9 + 0.19 * len(found)),
        note=f"Percentage of the {len(given.viewers)} videos for which at least "
        f"{100 * majority:g} % of their viewers ({each}) chose the label. Hollow: chosen by "
        "somebody, in no video by that many.",
    )
    axes = figure.subplots()
    bars = axes.barh(found.index, found["percent"], 0.68, color=COLOURS[0])
    axes.bar_label(bars, fmt="%.0f", padding=5, color=GREY)
    for label in found.index[(found["percent"] == 0) & found["used"]]:
        axes.plot(0, label, "o", ms=3.5, mfc="white", mec=COLOURS[0], clip_on=False, zorder=3)
    axes.set(xlim=(0, max(10.0, 1.12 * found["percent"].max())), ylim=(-0.6, len(found) - 0.4))
    axes.set_xlabel("videos, %")
    axes.grid(axis="x")
    return written(figure, path)


@in_style
def likeness(
    source: Likeness | PathLike, path: PathLike | None = None, *, margin: float = MARGIN
) -> Figure:
    """Draw people's ratings of how likely the behaviour is, in two groups of videos.

    Ratings are given directly or as a CSV file (:mod:`phase_ppl.evaluation.experiments`). Groups
    are equivalent if their mean ratings differ by less than ``margin``.

    Raises:
        InvalidSettingError: ``source`` is neither ratings nor a file, or ``margin`` not positive.
        InvalidEventError: the file holds no ratings; the message names file and line.
    """
    given = _read(source, Likeness, load_likeness)
    found = given.summary()
    test = given.equivalence(margin)
    shown = "shown" if test["equivalent"] else "not shown"
    p = "none where nobody differs" if test["p"] is None else f"{test['p']:.2g}"
    figure = new_figure(
        *(7.2, 2.7),
        note="Left: share of each rating. Middle: mean rating of each video, and mean over videos. "
        "Right: difference of the mean ratings of participants with its 90 % interval, beside the "
        f"margin; equivalence is {shown} (two one-sided tests, p = {p}).",
    )
    shares, means, difference = figure.subplots(1, 3, width_ratios=(1.3, 1.0, 1.0))
    for index, group in enumerate(given.groups):
        ratings = given.table.loc[given.table["group"] == group, "rating"]
        share = [float((ratings == rating).mean()) for rating in RATINGS]
        places = np.array(RATINGS) + 0.4 * (index - 0.5)
        shares.bar(places, share, width=0.38, color=COLOURS[index], label=group)
        _points(means, index, given.means("videos")[group], COLOURS[index])
    shares.set(xticks=RATINGS, xlabel="rating", ylabel="share")
    shares.legend(loc="upper left")
    labels = [f"{g}\n{r['mean']:.2f} ± {r['sd_videos']:.2f}" for g, r in found.iterrows()]
    means.set_xticks([0, 1], labels)
    means.set(xlim=(-0.5, 1.5), ylim=(0.9, 5.1), yticks=RATINGS)
    low, high = test["ci_low"], test["ci_high"]
    difference.axhspan(-margin, margin, color=_FAINT)
    difference.axhline(0, color="#999999", lw=0.7)
    if low is not None:
        difference.plot([0, 0], [low, high], color=INK, lw=2.2)
    face = INK if test["equivalent"] else "white"
    difference.plot(0, test["difference"], "o", ms=5, mfc=face, mec=INK)
    reach = 1.2 * max(margin, *(abs(end or 0.0) for end in (low, high, test["difference"])))
    difference.set(xlim=(-1, 1), ylim=(-reach, reach))
    difference.set_xticks([0], [" \N{MINUS SIGN}\n".join(given.groups)])
    return written(figure, path)


def _points(axes: Axes, place: int, values: np.ndarray, colour: str) -> None:
    """Draw points and their mean; points of equal value are spread sideways."""
    rounded = np.round(values, 1)
    for value in np.unique(rounded):
        here = values[rounded == value]
        aside = (np.arange(len(here)) - (len(here) - 1) / 2) * min(0.05, 0.8 / max(1, len(here)))
        axes.plot(place + aside, here, "o", ms=2.6, color=colour, alpha=0.6, mew=0)
    axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)


def __dir__() -> list[str]:
    return __all__
