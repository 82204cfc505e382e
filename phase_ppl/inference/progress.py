"""The progress bar of a run: simulations done, and the time that is left."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Final, Self

from tqdm import tqdm

WARMING_UP: Final = "warming up (compiles the first time)"


def is_shown(shown: bool | None) -> bool:
    """Return whether to show a bar; None: where stderr is a terminal, and in notebooks."""
    return (sys.stderr.isatty() or "ipykernel" in sys.modules) if shown is None else shown


class Progress:
    """A bar on stderr that counts simulations.

    Args:
        total: simulations to be done.
        shown: True or False; None: where stderr is a terminal, and in notebooks.
    """

    def __init__(self, total: int, shown: bool | None = None) -> None:
        self._bar = tqdm(
            total=total, disable=not is_shown(shown), file=sys.stderr, unit="sim", desc=WARMING_UP
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    def one_more(self, *_: object) -> None:
        """Count one simulation."""
        if self._bar.n == 0:
            self._bar.set_description("simulating", refresh=False)
        self._bar.update(1)

    def reach(self, done: int) -> None:
        """Count up to ``done``: what had no prior mass needed no simulation."""
        self._bar.update(max(done - self._bar.n, 0))
