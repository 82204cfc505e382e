"""Progress bars: work done, and time left."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from tqdm.auto import tqdm

from phase_ppl.world import errors
from phase_ppl.world.errors import InvalidSettingError

WARMING_UP: Final = "warming up (compiles the first time)"
Item = TypeVar("Item")


def progress_is_shown(shown: bool | None) -> bool:
    """Return whether to show a progress bar on stderr.

    Args:
        shown: what the user asked for. None: show it if stderr is a terminal, and in notebooks.
            Nothing is shown if stderr is closed.

    Raises:
        InvalidSettingError: ``shown`` is none of None, True and False.
    """
    if shown is not None and not isinstance(shown, int | np.bool_):
        raise InvalidSettingError(f"progress={errors.shown(shown)}, expected True, False or None")
    # a program without a console has no stderr, and a closed one cannot be asked
    there = sys.stderr is not None and not sys.stderr.closed
    if shown is None:
        return there and (sys.stderr.isatty() or "ipykernel" in sys.modules)
    return bool(shown) and there


class Bar(tqdm):
    """A bar on stderr; ``shown`` None: where that is a terminal, and in notebooks."""

    # for threads alone: tqdm's default is also a semaphore of the system, which is reported as
    # leaked if a worker process is killed
    _lock: ClassVar = threading.RLock()

    def __init__(
        self,
        total: int | None,
        done: int,
        shown: bool | None,
        unit: str,
        what: str,
        items: Iterable[Any] | None = None,
    ) -> None:
        super().__init__(
            items, total=total, initial=done, disable=not progress_is_shown(shown),
            file=sys.stderr, unit=unit, desc=what,
        )  # fmt: skip

    @property
    def format_dict(self) -> dict[str, Any]:
        # None: the mean since the beginning; tqdm's own follows the last few items
        return {**super().format_dict, "rate": None}


def counted(
    items: Iterable[Item], shown: bool | None, unit: str, what: str, total: int | None = None
) -> Iterator[Item]:
    """Yield the items, and count them with a progress bar on stderr.

    Args:
        items: what to count, such as events or answers.
        shown: whether to show the bar. None: only if stderr is a terminal, and in notebooks.
        unit: one word for an item, such as "event"; the bar shows items per second.
        what: label before the bar.
        total: number of items; needed only if ``items`` has no ``len``.
    """
    yield from Bar(total, 0, shown, unit, what, items)


class Progress(Bar):
    """A bar on stderr that counts simulations; its rate is the mean since the first one ended."""

    def __init__(self, total: int, shown: bool | None = None, *, done: int = 0) -> None:
        self._began = False
        super().__init__(total, done, shown, "sim", WARMING_UP)

    def one_more(self, *_: object) -> None:
        """Count one simulation, stopped early or not."""
        self.update(1)
        if not self._began and not self.disable:
            self._began = True
            self.set_description("simulating", refresh=False)
            # the time before was mostly compiling
            self.start_t = self.last_print_t = self._time()
            self.initial = self.n

    def reach(self, done: int) -> None:
        """Count up to ``done``: hypotheses without prior mass need no simulation."""
        self.update(max(done - self.n, 0))

    def expect(self, total: int) -> None:
        """Set the number of simulations; a budget of seconds learns it on the way."""
        self.total = total
