"""Figures with a row per model, those of what people say of videos, and what all have in common."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, TypeVar

import numpy as np

from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    NORMAL,
    in_style,
    new_figure,
    titled,
    written,
)
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.arrays import facts, kinds_of, true_scenario
from phase_ppl.evaluation.cells import KIND_WORDS, number
from phase_ppl.evaluation.comparison import ModelComparison
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
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.errors import shown as in_short
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PathLike: TypeAlias = str | os.PathLike[str]
Results: TypeAlias = Evaluation | ModelComparison
Source: TypeAlias = Results | PathLike

KIND_TITLES: Final = {kind: words.capitalize() for kind, words in KIND_WORDS.items()}

SCENARIO_COLOURS: Final = dict(
    zip(SCENARIOS, ("#009e73", "#4d6fb3", "#c98a00", "#b8336a"), strict=True)
)
"""To be told apart without seeing red and green apart."""

_CHARACTER: Final = 0.6  # mean width of a character, as a share of its size
_WIDEST: Final = 2.2  # inches that names of rows take at most; longer ones are written smaller


class NothingToDrawError(InvalidSettingError):
    """The results lack what a figure is about; the message says what."""


class Drawing(NamedTuple):
    """A kind of figure."""

    title: str  # what it shows, in a few words
    alt: str  # what stands in its place for those who do not see it
    draw: Callable[..., Figure]  # draws results, and writes the figure to a path
    compares: bool  # whether it is one of comparisons of models only


DRAWINGS: Final[dict[str, Drawing]] = {}
"""Name of a figure, and of its file -> what it is."""

_Draw = TypeVar("_Draw", bound=Callable[..., Any])


def drawing(title: str, alt: str, *, compares: bool = False) -> Callable[[_Draw], _Draw]:
    """Have a function draw in the common style, and keep it in :data:`DRAWINGS`."""

    def keep(draw: _Draw) -> _Draw:
        styled: Any = in_style(draw)
        DRAWINGS[draw.__name__] = Drawing(title, alt, styled, compares)
        return styled

    return keep


def opened(source: Source) -> Results:
    """Open the folder of an evaluation or of a comparison, where it is none of them itself."""
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
    """Return about how many inches names take beside a figure, with what surrounds them."""
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
    """Return how many there are, such as of the events of several models: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"


# --- right answers, and agreement with people -----------------------------------------------------

Part = tuple[str, ...]  # where the metrics have a part of the answers; (): all

_CORRELATIONS: Final = {
    "goal_r": ("Goals", "goal_split_half_r"),
    "relation_r": ("Relations", "split_half_r"),
    "relation_r_given_truth": ("Relations, given the truth", ""),
}
"""Correlation with people -> title, and that of people with each other."""


@drawing(
    "Accuracy by scenario, or by agent and pair",
    "Bars: share of right goals and relations of everybody, over all events and by true "
    "scenario, in other worlds than PHASE by agent and pair, with 95 % intervals; the numbers "
    "are in the tables above.",
)
def accuracy(source: Source, path: PathLike | None = None) -> Figure:
    """Draw the accuracy of goals and relations, over all events and by true scenario.

    In another world than PHASE that of goals by agent, of relations by pair.

    Raises:
        NothingToDrawError: no answer can be right or wrong.
    """
    results = opened(source)
    known = facts(results.events)
    masks = {kind: known.parts(kind) for kind in KIND_TITLES}
    blocks = {
        kind: [o for o in results.measured if o.metrics.get(f"{kind}_accuracy") is not None]
        for kind in KIND_TITLES
    }
    parts: dict[str, list[Part]] = {}
    for kind, of_parts in masks.items():
        true = known.truth[kind] >= 0
        present = [path for path, mask in of_parts.items() if path and (mask & true).any()]
        parts[kind] = present if len(present) > 1 else []  # one part is the whole

    def draw(axes: Axes, kind: str, part: Part) -> list[int]:
        found = [at(o.metrics, (*part, f"{kind}_accuracy")) for o in blocks[kind]]
        _bars(axes, blocks[kind], found)
        asked = (known.truth[kind] >= 0) & masks[kind][part]
        questions = kinds_of(known.world)[kind]
        pairs = [(results.events[i].id, questions[j]) for i, j in np.argwhere(asked)]
        return [
            sum(e in o.predictions and q in o.predictions[e].answers for e, q in pairs)
            for o in blocks[kind]
        ]

    figure = _by_part(
        blocks,
        parts,
        (1.2, 0.185),
        "Share of right answers (people: mean share of people who are right) with 95 % intervals "
        "over events; n: answers.",
        draw,
        "no truth is known of an event that somebody judged",
    )
    return written(figure, path)


@drawing(
    "Models beside people",
    "Points with intervals: right answers of models minus those of people, beside the margin "
    "of equivalence; the numbers are in the table.",
    compares=True,
)
def equivalence(source: Source, path: PathLike | None = None) -> Figure:
    """Draw how much more often models are right than people, beside the margin of equivalence.

    Raises:
        NothingToDrawError: people judged no event with truth, or it is no comparison of models.
    """
    comparison = compared(source)
    found = {(r["model"], r["measure"], r["scenario"]): r for r in comparison.equivalence}
    blocks = {
        kind: [o for o in comparison.answers if (o.name, f"{kind}_accuracy", None) in found]
        for kind in KIND_TITLES
    }
    ends = [r[k] for r in found.values() for k in ("value", "ci_low", "ci_high")]
    reach = max(0.5, *(abs(end) for end in ends if end is not None), 0)

    def draw(axes: Axes, kind: str, part: Part) -> list[int]:
        scenario = part[-1] if part else None
        rows = [found.get((o.name, f"{kind}_accuracy", scenario)) for o in blocks[kind]]
        _against_people(axes, blocks[kind], rows, comparison.settings["margin"], reach)
        return [row["n_events"] for row in rows if row is not None]

    judged = {scenario for _, _, scenario in found}
    figure = _by_part(
        blocks,
        dict.fromkeys(blocks, tuple(("by_scenario", s) for s in SCENARIOS if s in judged)),
        (1.4, 0.21),
        "Share right, model minus people, event by event. Thin: 95 %, thick: 90 % intervals. "
        "Band: margin of equivalence. Filled: equivalence is shown, after Holm's correction.",
        draw,
        "people judged no event whose truth is known",
    )
    return written(figure, path)


def _by_part(
    blocks: Mapping[str, Sequence[AnswerSet]],
    parts: Mapping[str, Sequence[Part]],
    cell: tuple[float, float],
    note: str,
    draw: Callable[[Axes, str, Part], list[int]],
    nothing: str,
) -> Figure:
    """Draw kinds of questions below each other, a column for all answers and for each part.

    ``blocks`` has the rows of each kind; kinds without rows are left out. ``parts`` are those of
    the metrics, of each kind. ``cell`` are the inches of a column and of a row; ``draw`` draws the
    rows of a kind and a part, and returns of how many events or answers; ``nothing`` says what is
    missing where there are no rows.
    """
    blocks = {kind: rows for kind, rows in blocks.items() if rows}
    if not blocks:
        raise NothingToDrawError(nothing)
    columns: dict[str, list[Part]] = {kind: [(), *parts[kind]] for kind in blocks}
    n_columns = max(map(len, columns.values()))
    heights = [len(rows) for rows in blocks.values()]
    width = max(width_of(o for rows in blocks.values() for o in rows), 1.0)
    width += cell[0] * n_columns
    figure = new_figure(width, cell[1] * sum(heights) + 0.8 * len(blocks) + 0.35, note=note)
    grid = figure.subplots(len(blocks), n_columns, squeeze=False, height_ratios=heights)
    for (kind, rows), line in zip(blocks.items(), grid, strict=True):
        for axes in line[len(columns[kind]) :]:
            axes.set_visible(False)
        for axes, part in zip(line, columns[kind], strict=False):
            counts = [n for n in draw(axes, kind, part) if n]
            axes.set(ylim=(len(rows) - 0.5, -0.5), yticks=[])
            titled(axes, part[-1] if part else "all", in_words(counts or [0]), fontsize=NORMAL)
            axes.set_visible(bool(counts))
        name_rows(line[0], rows)
        line[0].annotate(
            KIND_TITLES[kind], (0, 1), (-6, 15), xycoords="axes fraction",
            textcoords="offset points", ha="right", fontsize=NORMAL + 1, fontweight="bold",
            annotation_clip=False,
        )  # fmt: skip
    return figure


def _bars(axes: Axes, rows: Sequence[AnswerSet], found: Sequence[Any], low: float = 0.0) -> None:
    """Draw figures as bars with intervals from ``low`` to 1, and as numbers to the right."""
    for row, (answers, figure) in enumerate(zip(rows, found, strict=True)):
        if figure is None:
            axes.text(0.01, row, number(None), va="center", color=GREY)
            continue
        value, ends = figure["value"], [figure["ci_low"], figure["ci_high"]]
        axes.barh(row, value, 0.7, color=answers.colour, alpha=0.5, lw=0)
        axes.vlines(value, row - 0.35, row + 0.35, answers.colour, lw=1.6, clip_on=False)
        if None not in ends:
            axes.hlines(row, ends[0], ends[1], INK, lw=0.9, clip_on=False)
        axes.annotate(
            number(value), (1, row), (5, 0), xycoords=axes.get_yaxis_transform(),
            textcoords="offset points", va="center", annotation_clip=False,
        )  # fmt: skip
    axes.spines["left"].set_visible(False)
    axes.set(xlim=(low, 1), xticks=[tick for tick in (-1, -0.5, 0, 0.5, 1) if tick >= low])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(axis="x")


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
                axes.hlines(place, row[low], row[high], colour, lw=width)
        face = colour if "equivalent" in row["verdict"] else "white"
        axes.plot(row["value"], place, "o", ms=5, mec=colour, mew=1.2, mfc=face)
    axes.spines["left"].set_visible(False)
    axes.set(xlim=(-reach * 1.05, reach * 1.05), xticks=[-0.5, 0, 0.5])
    axes.xaxis.set_major_formatter("{x:g}")


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
    found = {name: [at(o.metrics, ("human", name)) for o in models] for name in _CORRELATIONS}
    panels = [name for name, values in found.items() if any(values)]
    if not panels:
        raise NothingToDrawError("people judged nothing that a model gives probabilities for")
    places = [i for i in range(len(models)) if any(found[name][i] for name in panels)]
    shown = [models[i] for i in places]
    figure = new_figure(width_of(shown) + 1.95 * len(panels), 0.21 * len(shown) + 0.95)
    grid = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, name in zip(grid, panels, strict=True):
        values = [found[name][i] for i in places]
        ends = [v[k] for v in values if v for k in ("value", "ci_low") if v[k]]
        _bars(axes, shown, values, max(-1.0, 1.05 * min([0.0, *ends])))
        axes.set(ylim=(len(shown) - 0.5, -0.5), yticks=[], xlabel="r with people")
        title, halves = _CORRELATIONS[name]
        people = next(filter(None, (at(o.metrics, ("human", halves)) for o in shown)), None)
        axes.set_title(title, pad=15, fontsize=NORMAL, fontweight="bold")
        if people is not None:
            _people_line(axes, people)
    name_rows(grid[0], shown)
    return written(figure, path)


def _people_line(axes: Axes, people: Mapping[str, Any]) -> None:
    """Draw how well halves of the people agree, as a line with its interval."""
    value, low, high = people["value"], people["ci_low"], people["ci_high"]
    if low is not None and high is not None:
        axes.axvspan(low, high, color=INK, alpha=0.13, lw=0)
    axes.axvline(value, color=INK, lw=1.1, ls=(0, (4, 2)))
    axes.annotate(
        f"people, split half: {value:.2f}", (value, 1), (0, 3),
        xycoords=axes.get_xaxis_transform(), textcoords="offset points",
        ha="right" if value > 0.5 else "left", annotation_clip=False,
    )  # fmt: skip


# --- what people say of videos --------------------------------------------------------------------

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
    """Draw in how many videos people see what, as the paper does of its 23 labels.

    The labels, or their CSV file (:mod:`phase_ppl.evaluation.experiments`), may be anybody's; a
    video has a category from which on that share of its viewers, ``majority``, chose it.

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
    """Draw how likely people find it that people behave like this, in two groups of videos.

    The ratings, or their CSV file (:mod:`phase_ppl.evaluation.experiments`), may be anybody's;
    groups are equivalent if their mean ratings differ by less than ``margin``.

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
    """Draw points side by side, those with the same value beside each other, and their mean."""
    rounded = np.round(values, 1)
    for value in np.unique(rounded):
        here = values[rounded == value]
        aside = (np.arange(len(here)) - (len(here) - 1) / 2) * min(0.05, 0.8 / max(1, len(here)))
        axes.plot(place + aside, here, "o", ms=2.6, color=colour, alpha=0.6, mew=0)
    axes.plot([place - 0.25, place + 0.25], [values.mean()] * 2, color=INK, lw=1.5)
