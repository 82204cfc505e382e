"""What the figures of an evaluation are drawn from."""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.evaluation.observers import Observer, measured, observers
from phase_ppl.evaluation.tables import KINDS
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.relations import SCENARIOS

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
