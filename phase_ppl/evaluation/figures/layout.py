"""What the figures of an evaluation are drawn from, and what they have in common."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from phase_ppl.analysis.figures.style import NORMAL, SMALL
from phase_ppl.evaluation.answer_sets import AnswerSet
from phase_ppl.evaluation.comparison import ModelComparison
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.folder import COMPARISON
from phase_ppl.evaluation.tables import true_scenario
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PathLike: TypeAlias = str | os.PathLike[str]
Results: TypeAlias = Evaluation | ModelComparison
Source: TypeAlias = Results | PathLike

KIND_TITLES: Final = {"goal": "Goals", "relation": "Relations"}

SCENARIO_COLOURS: Final = dict(
    zip(SCENARIOS, ("#009e73", "#4d6fb3", "#c98a00", "#b8336a"), strict=True)
)
"""To be told apart without seeing red and green apart."""

_CHARACTER: Final = 0.6  # mean width of a character, as a share of its size
_WIDEST: Final = 2.2  # inches that names of rows take at most; longer ones are written smaller


class NothingToDrawError(InvalidSettingError):
    """The results lack what a figure is about; the message says what."""


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


def cells(
    axes: Axes, colours: FloatArray, texts: Mapping[tuple[int, int], tuple[str, dict[str, Any]]]
) -> None:
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


def in_words(counts: Iterable[int]) -> str:
    """Return how many there are, such as of the events of several models: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"
