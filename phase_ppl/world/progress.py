"""Progress bars: what was done, and of simulations the time that is left."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from tqdm.auto import tqdm

from phase_ppl.world import errors
from phase_ppl.world.errors import InvalidSettingError

WARMING_UP: Final = "warming up (compiles the first time)"
clock = time.monotonic  # seconds of wall time
Item = TypeVar("Item")

_ROUNDS: Final = 2


def is_shown(shown: bool | None) -> bool:
    """Return whether to show a bar; None: where stderr is a terminal, and in notebooks.

    Raises:
        InvalidSettingError: it is neither, nor True or False.
    """
    if shown is not None and not isinstance(shown, int | np.bool_):
        raise InvalidSettingError(f"progress={errors.shown(shown)}, expected True, False or None")
    # there is none in a program without a console, and one that was closed cannot be asked
    there = sys.stderr is not None and not sys.stderr.closed
    if shown is None:
        return there and (sys.stderr.isatty() or "ipykernel" in sys.modules)
    return bool(shown) and there


class Bar(tqdm):
    """A bar on stderr; ``shown`` None: where that is a terminal, and in notebooks.

    Its rate is ``steady_rate`` or, without one, the mean since the beginning.
    """

    # of threads alone: tqdm's own is also a semaphore of the system, which is reported as leaked
    # where a worker process is killed
    _lock: ClassVar = threading.RLock()
    steady_rate: float | None = None

    def __init__(
        self,
        total: int | None,
        done: int,
        shown: bool | None,
        unit: str,
        what: str,
        items: Iterable[Any] | None = None,
    ) -> None:
        how = {"disable": not is_shown(shown), "file": sys.stderr, "unit": unit, "desc": what}
        super().__init__(items, total=total, initial=done, **how)

    @property
    def format_dict(self) -> dict[str, Any]:
        return {**super().format_dict, "rate": self.steady_rate}


def counted(
    items: Iterable[Item], shown: bool | None, unit: str, what: str, total: int | None = None
) -> Iterator[Item]:
    """Yield the items, and count them with a progress bar on stderr.

    Args:
        items: such as events, or answers as they come.
        shown: whether to show the bar; None: where stderr is a terminal, and in notebooks.
        unit: what an item is, in a word.
        what: is done with them, before the bar.
        total: how many there are, where ``len`` does not say it.
    """
    yield from Bar(total, 0, shown, unit, what, items)


class Progress(Bar):
    """A bar on stderr that counts simulations, of which a ``batch`` runs side by side.

    Simulations are uneven: those stopped early end first, others come in bursts as workers end
    together. The time left therefore rests on whole rounds, the last two.
    """

    def __init__(
        self, total: int, shown: bool | None = None, *, done: int = 0, batch: int = 1
    ) -> None:
        self._n = done
        self._times = deque([(clock(), done)], maxlen=_ROUNDS * batch + 1)
        self._batch = batch
        self._began = False
        super().__init__(total, done, shown, "sim", WARMING_UP)

    def one_more(self, *_: object) -> None:
        """Count one simulation, stopped early or not."""
        if not self._began:
            self._began = True
            self.set_description("simulating", refresh=False)
        self._count(1)

    def reach(self, done: int) -> None:
        """Count up to ``done``: what had no prior mass needed no simulation."""
        if done > self._n:
            self._count(done - self._n)

    def expect(self, total: int) -> None:
        """Let there be ``total`` simulations: with a budget of seconds it shows on the way."""
        self.total = total

    def seconds_left(self) -> float | None:
        """Return how long the rest takes at the pace of the last two rounds; None: too early."""
        rate = self._rate()
        return None if rate is None else max(self.total - self._n, 0) / rate

    def _count(self, n: int) -> None:
        self._n += n
        self._times.append((clock(), self._n))
        self.steady_rate = self._rate()
        self.update(n)

    def _rate(self) -> float | None:
        (begin, before), (end, now) = self._times[0], self._times[-1]
        # not before a whole round, most of which may have been compiling
        if now - before < self._batch or end <= begin:
            return None
        return (now - before) / (end - begin)
