"""A page per video: what happens in it, and what people and models say about it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from phase_ppl.evaluation.folder import ResultsFolder

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_page(
    folder: ResultsFolder, event_id: str, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw the page of an event; write it to ``path`` (.png, .pdf, .svg) as well.

    Raises:
        UnknownNameError: the evaluation has no such event.
        OutputError: it cannot be written there, or the ending is another.
    """
    raise NotImplementedError
