"""What the figures of an evaluation are drawn from, and what they have in common."""

from __future__ import annotations

import dataclasses
import functools
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, new_figure
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.comparison import ModelComparison
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.folder import COMPARISON
from phase_ppl.evaluation.tables import KINDS
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Source: TypeAlias = Evaluation | ModelComparison | str | os.PathLike[str]

KIND_TITLES: Final = {"goal": "Goals", "relation": "Relations"}

GREY: Final = "#6b6b6b"

SCENARIO_COLOURS: Final = dict(
    zip(SCENARIOS, ("#009e73", "#4d6fb3", "#c98a00", "#b8336a"), strict=True)
)
"""To be told apart without seeing red and green apart."""

_CHARACTER: Final = 0.6  # mean width of a character, as a share of its size
_WIDEST: Final = 2.2  # inches that names of rows take at most; longer ones are written smaller


class NothingToDrawError(InvalidSettingError):
    """The results lack what a figure is about; the message says what."""


@dataclasses.dataclass(frozen=True)
class Results:
    """Who answered what about which events, read once for all figures."""

    source: Evaluation | ModelComparison

    @classmethod
    def of(cls, source: Source) -> Results:
        """Open the folder of an evaluation or of a comparison, where it is none of them itself."""
        if not isinstance(source, str | os.PathLike):
            return cls(source)
        comparison = (Path(source) / COMPARISON).is_file()
        return cls((ModelComparison if comparison else Evaluation).load(source))

    @property
    def comparison(self) -> ModelComparison:
        """The comparison of models (NothingToDrawError: the results are of an evaluation)."""
        if not isinstance(self.source, ModelComparison):
            raise NothingToDrawError("the results are of an evaluation, not of a comparison")
        return self.source

    @functools.cached_property
    def scenarios(self) -> dict[str, str]:
        """Event -> true scenario, of the events whose truth is known."""
        return {e.id: e.truth.scenario for e in self.source.events if e.truth is not None}

    def count(self, answers: AnswerSet, kind: str, scenario: str | None = None) -> int:
        """Return how many answers can be right or wrong, of one true scenario or of all."""
        return sum(
            question in given.answers
            for name, given in answers.predictions.items()
            if name in self.scenarios and scenario in (None, self.scenarios[name])
            for question in KINDS[kind]
        )


# --- layout ---------------------------------------------------------------------------------------


def laid_out(width: float, height: float, note: str = "") -> Figure:
    """Return an empty figure, inches, that finds the place of its parts; with a note below."""
    figure = new_figure(width, height)
    figure.set_layout_engine("constrained", w_pad=0.05, h_pad=0.04, hspace=0.03, wspace=0.02)
    if note:
        size = SMALL - 0.5
        characters = int(72 * width / (0.54 * size))
        style: dict[str, Any] = {"fontsize": size, "color": GREY, "ha": "left", "x": 0.08 / width}
        figure.supxlabel(textwrap.fill(note, characters), **style)
    return figure


def fitting(texts: Iterable[str], width: float = _WIDEST, most: float = NORMAL) -> float:
    """Return the font size, points, at which the longest text fits into ``width`` inches."""
    return min(most, 72 * width / (_CHARACTER * max((len(text) for text in texts), default=1)))


def width_of(texts: Sequence[str]) -> float:
    """Return about how many inches names take beside a figure, with what surrounds them."""
    longest = max(map(len, texts), default=0)
    return _CHARACTER * longest * fitting(texts) / 72 + 0.2


def name_rows(axes: Axes, shown: Sequence[AnswerSet]) -> None:
    """Write the names of the rows on the left, in their colours."""
    labels = [answers.label for answers in shown]
    axes.set_yticks(range(len(shown)), labels, fontsize=fitting(labels), parse_math=False)
    axes.tick_params(axis="y", length=0)
    for text, answers in zip(axes.get_yticklabels(), shown, strict=True):
        text.set_color(answers.colour)


def head(axes: Axes, title: str, below: str, **style: Any) -> None:
    """Write a title, and smaller what stands between it and the axes."""
    style = {"fontsize": NORMAL, "color": INK, **style}
    axes.set_title(title, loc="left", pad=15, parse_math=False, **style)
    axes.annotate(
        below, (0, 1), xycoords="axes fraction", xytext=(0, 4), textcoords="offset points",
        fontsize=SMALL, color=GREY, annotation_clip=False,
    )  # fmt: skip


def title_row(axes: Axes, title: str) -> None:
    """Write a title above the names of the rows of the axes."""
    axes.annotate(
        title, (0, 1), xycoords="axes fraction", xytext=(-6, 15), textcoords="offset points",
        ha="right", fontsize=NORMAL + 1, color=INK, fontweight="bold", annotation_clip=False,
    )  # fmt: skip


def cells(
    axes: Axes, colours: FloatArray, texts: Mapping[tuple[int, int], tuple[str, dict[str, Any]]]
) -> None:
    """Draw a matrix of cells of colours (row, column, RGB), with texts, each with its style."""
    axes.imshow(colours, aspect="auto")
    for (row, column), (text, style) in texts.items():
        axes.text(column, row, text, ha="center", va="center", **style)
    n_rows, n_columns = colours.shape[:2]
    axes.hlines(np.arange(1, n_rows) - 0.5, -0.5, n_columns - 0.5, color="white", lw=1.2)
    axes.vlines(np.arange(1, n_columns) - 0.5, -0.5, n_rows - 0.5, color="white", lw=1.2)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelsize=SMALL, pad=3, colors=INK)


def tint(colour: str, share: float) -> tuple[float, float, float]:
    """Return ``colour`` mixed with white; ``share`` is what is kept of it."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1 - share * (1 - part) for part in to_rgb(colour))
    return red, green, blue


def in_words(counts: Iterable[int]) -> str:
    """Return how many there are, such as of the events of several models: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"
