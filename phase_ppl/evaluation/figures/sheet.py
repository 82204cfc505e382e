"""A figure that is laid out in inches from its upper left corner, as a page is."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
import abc
import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.evaluation.observers import Observer, measured, observers
from phase_ppl.evaluation.tables import KINDS
from phase_ppl.render.stills import draw_strip
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


WIDTH: Final = 7.2
"""Inches: both columns of a journal's page."""

GREY: Final = "#6b6b6b"

_NARROWEST: Final = 1.3
_WIDEST: Final = 2.3
_REGULAR: Final = 0.58
"""Mean character of a text that is not bold, as a share of its size."""

_CHARACTER: Final = 0.69
"""Widest mean character of a bold text, as a share of its size."""

_UNBROKEN: Final = 1.3
"""How much too long, as a share, a word may be and is written smaller instead of broken."""


class Sheet:
    """An empty figure of ``width`` x ``height`` inches."""

    def __init__(self, width: float, height: float) -> None:
        self.figure: Figure = new_figure(width, height)
        self.width, self.height = width, height

    def axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Return new axes at a place in inches."""
        return self.figure.add_axes(
            (
                left / self.width,
                1 - (top + height) / self.height,
                width / self.width,
                height / self.height,
            )
        )

    def write(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = NORMAL,
        colour: str = INK,
        ha: str = "left",
        va: str = "baseline",
        weight: str = "normal",
    ) -> None:
        """Write at a place in inches; nothing in ``text`` is read as mathematics."""
        self.figure.text(
            x / self.width,
            1 - y / self.height,
            text,
            fontsize=size,
            color=colour,
            ha=ha,
            va=va,
            fontweight=weight,
            parse_math=False,
        )


def fitting(text: str, width: float, most: float = NORMAL) -> float:
    """Return the font size, points, at which ``text`` fits into ``width`` inches."""
    return min(most, 72 * width / (_CHARACTER * max(len(text), 1)))


def label_column(labels: Iterable[str]) -> float:
    """Return how many inches names of rows take on the left of a sheet, with what surrounds them.

    Names that are longer still are written smaller, see :func:`fitting`.
    """
    longest = max(map(len, labels), default=0)
    return min(_WIDEST, max(_NARROWEST, _REGULAR * longest * NORMAL / 72 + 0.2))


def in_lines(text: str, width: float) -> list[str]:
    """Return a name in as many lines as it needs to be legible in ``width`` inches.

    A word is broken only where it would otherwise be written much smaller than the rest.
    """
    if fitting(text, width) >= SMALL:
        return [text]
    characters = max(1, int(72 * width / (_CHARACTER * SMALL)))
    longest = max(map(len, text.split()), default=0)
    if longest <= _UNBROKEN * characters:
        characters = max(characters, longest)
    return textwrap.wrap(text, characters) or [text]


def in_words(counts: Iterable[int]) -> str:
    """Return how many there are, such as of the events of several models: "n = 9 to 10"."""
    known = sorted(counts)
    least, most = known[0], known[-1]
    return f"n = {most}" if least == most else f"n = {least} to {most}"


def tint(colour: str, share: float) -> tuple[float, float, float]:
    """Return ``colour`` mixed with white; ``share`` is what is kept of it."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1 - share * (1 - part) for part in to_rgb(colour))
    return red, green, blue


# --- what the figures of an evaluation are drawn from ---------------------------------------------

SCENARIO_COLOURS: Final = dict(
    zip(SCENARIOS, ("#009e73", "#4d6fb3", "#c98a00", "#b8336a"), strict=True)
)
"""To be told apart without seeing red and green apart."""


class NothingToDrawError(InvalidSettingError):
    """The results lack what a figure is about; the message says what."""


class Results(abc.ABC):
    """Who said what about which events, read once for all figures."""

    @property
    @abc.abstractmethod
    def events(self) -> Sequence[Event]:
        """All events."""

    @property
    @abc.abstractmethod
    def observers(self) -> list[Observer]:
        """Everybody who answered, about all events, without metrics."""

    @property
    @abc.abstractmethod
    def measured(self) -> list[Observer]:
        """Everybody who answered, with metrics."""

    @functools.cached_property
    def scenarios(self) -> dict[str, str]:
        """Event -> true scenario, of the events whose truth is known."""
        return {e.id: e.truth.scenario for e in self.events if e.truth is not None}

    def asking(self, kind: str) -> list[Observer]:
        """Return those who answered a kind of question."""
        return [o for o in self.measured if any(map(o.answered, KINDS[kind]))]

    def count(self, observer: Observer, kind: str, scenario: str | None = None) -> int:
        """Return how many answers can be right or wrong, of one true scenario or of all."""
        return sum(
            question in given.answers
            for name, given in observer.predictions.items()
            if name in self.scenarios and scenario in (None, self.scenarios[name])
            for question in KINDS[kind]
        )


@dataclasses.dataclass(frozen=True)
class FolderResults(Results):
    """The results in a folder.

    Args:
        folder: of the evaluation, finished or not.
    """

    folder: ResultsFolder

    @property
    def events(self) -> Sequence[Event]:
        return self.folder.events

    @functools.cached_property
    def observers(self) -> list[Observer]:
        return observers(self.folder)

    @functools.cached_property
    def measured(self) -> list[Observer]:
        return measured(self.folder)


# --- an example of every scenario, as film strips -------------------------------------------------

_PANELS: Final = 6
_HEADING: Final = 0.24


def film_strips(results: Results) -> Figure:
    """Draw the first event of every true scenario; without truth, the first event."""
    chosen = _examples(results)
    strips = [
        np.asarray(draw_strip(event, min(_PANELS, event.observation.n_frames)))
        for _, event in chosen
    ]
    inches = WIDTH / max(picture.shape[1] for picture in strips)
    sheet = Sheet(WIDTH, sum(_HEADING + picture.shape[0] * inches for picture in strips) + 0.05)
    top = 0.0
    for (name, event), picture in zip(chosen, strips, strict=True):
        colour = SCENARIO_COLOURS.get(name, GREY)
        sheet.write(0.1, top + 0.18, name or "scenario not known", colour=colour, weight="bold")
        goals = _goals(event)
        sheet.write(
            WIDTH - 0.1, top + 0.18, goals, size=fitting(goals, 5.6, SMALL), colour=GREY,
            ha="right",
        )  # fmt: skip
        top += _HEADING
        size = picture.shape[0] * inches
        axes = sheet.axes(0.0, top, picture.shape[1] * inches, size)
        axes.imshow(picture, interpolation="antialiased")
        axes.set_axis_off()
        top += size
    return sheet.figure


def _examples(results: Results) -> list[tuple[str, Event]]:
    found: dict[str, Event] = {}
    for event in results.events:
        found.setdefault(results.scenarios.get(event.id, ""), event)
    known: list[tuple[str, Event]] = [(name, found[name]) for name in SCENARIOS if name in found]
    return known or [("", found[""])]


def _goals(event: Event) -> str:
    if event.truth is None:
        return event.id
    return f"red: {event.truth.goal_red}; green: {event.truth.goal_green}"
