"""What the figures of results share: whose results, where names stand, how all are written."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, TypeVar

from phase_ppl.analysis.figures.style import GREY, NORMAL, in_style, warned, written
from phase_ppl.evaluation.cells import KIND_WORDS
from phase_ppl.evaluation.comparison import ModelComparison, Source
from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.folder import COMPARISON
from phase_ppl.evaluation.ratings import REHEARSAL, rehearsed
from phase_ppl.evaluation.table import true_scenario
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.picture import SCENARIO_COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PathLike: TypeAlias = str | os.PathLike[str]
Results: TypeAlias = Evaluation | ModelComparison | PathLike

KIND_TITLES: Final[dict[str, str]] = {
    kind: words.capitalize() for kind, words in KIND_WORDS.items()
}

_CHARACTER: Final = 0.6  # mean width of a character, as a share of its size
_WIDEST: Final = 2.2  # most inches for names of rows; longer names get a smaller font


class NothingToDrawError(InvalidSettingError):
    """The results lack what a figure is about; the message says what."""


class Drawing(NamedTuple):
    """A kind of figure."""

    title: str  # its content, in a few words
    alt: str  # alternative text for people who cannot see it
    draw: Callable[..., Figure]  # draws results, and writes the figure to a path


DRAWINGS: Final[dict[str, Drawing]] = {}
"""Name of a figure, and of its file -> its drawing."""

_Draw = TypeVar("_Draw", bound=Callable[..., Any])


def drawing(title: str) -> Callable[[_Draw], _Draw]:
    """Return a decorator: draw in the common style, write, and register in :data:`DRAWINGS`.

    The first line of the function's documentation is the alternative text. Figures of a rehearsal
    say so.
    """

    def keep(draw: _Draw) -> _Draw:
        @functools.wraps(draw)
        def marked(source: Results, path: PathLike | None = None) -> Figure:
            results = opened(source)
            figure: Figure = draw(results)
            if rehearsed(results.events):
                warned(figure, REHEARSAL)
            return written(figure, path)

        styled: Any = in_style(marked)
        alt = str(draw.__doc__).partition("\n")[0]
        DRAWINGS[draw.__name__] = Drawing(title, alt, styled)
        return styled

    return keep


def opened(source: Results) -> ModelComparison:
    """Return results as a comparison; an evaluation beside people and models of the events."""
    if isinstance(source, str | os.PathLike):
        comparison = (Path(source) / COMPARISON).is_file()
        source = (ModelComparison if comparison else Evaluation).load(source)
    return source.compared if isinstance(source, Evaluation) else source


def scenarios_of(events: Iterable[Event]) -> dict[str, str]:
    """Return event -> true scenario, of the events of PHASE whose truth is known."""
    return {event.id: name for event in events if (name := true_scenario(event))}


def scenario_colour(name: str) -> str:
    """Return the colour of a scenario as matplotlib takes it; grey, if it is none."""
    colour = SCENARIO_COLOURS.get(name)
    return GREY if colour is None else "#{:02x}{:02x}{:02x}".format(*colour)


# --- layout ---------------------------------------------------------------------------------------


def fitting(texts: Iterable[str], width: float = _WIDEST, most: float = NORMAL) -> float:
    """Return the font size, points, at which the longest text fits into ``width`` inches."""
    return min(most, 72 * width / (_CHARACTER * max((len(text) for text in texts), default=1)))


def width_of(shown: Iterable[Source]) -> float:
    """Return the approximate inches for names beside a figure, margins included."""
    labels = [answers.label for answers in shown]
    return _CHARACTER * max(map(len, labels), default=0) * fitting(labels) / 72 + 0.2


def in_words(counts: Iterable[int]) -> str:
    """Return counts, such as models' numbers of events, as text: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"
