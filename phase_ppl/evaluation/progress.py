"""The progress bar of an evaluation: events done, and the time that is left."""

from __future__ import annotations

import sys
from collections.abc import Mapping

from phase_ppl.inference.runs.progress import Bar


class Progress(Bar):
    """A bar on stderr that counts events.

    Long events come first and take longer, so the time left rests on the seconds per frame.

    Args:
        frames: event id -> frames, of the events to be done.
        done: events done before.
        workers: that work side by side.
        shown: True or False; None: where stderr is a terminal, and in notebooks.
    """

    def __init__(
        self, frames: Mapping[str, int], done: int, workers: int, shown: bool | None = None
    ) -> None:
        self._left = dict(frames)
        self._workers = workers
        self._frames = 0
        self._seconds = 0.0
        super().__init__(done + len(frames), done, shown, "event", "predicting")

    def one_more(self, event_id: str, seconds: float | None) -> None:
        """Count an event that took so many seconds; None: it failed."""
        frames = self._left.pop(event_id)
        if seconds is not None:
            self._frames += frames
            self._seconds += seconds
        left = self.seconds_left()
        self._bar.steady_rate = len(self._left) / left if left else None
        self._bar.update(1)

    def seconds_left(self) -> float | None:
        """Return how long the rest takes at the pace until now; None: too early to say."""
        if not self._frames:
            return None
        each = self._seconds / self._frames
        together = min(self._workers, max(len(self._left), 1))
        return each * sum(self._left.values()) / together

    def say(self, text: str) -> None:
        """Write a line above the bar, where there is one."""
        if not self._bar.disable:
            self._bar.write(text, file=sys.stderr)
