"""Figures of an evaluation."""

from __future__ import annotations

from pathlib import Path

from phase_ppl.evaluation.folder import ResultsFolder


def draw_figures(folder: ResultsFolder, *, progress: bool = True) -> list[Path]:
    """Write all figures that the results allow into ``figures/``; return the files.

    Args:
        folder: with metrics.json, or they are computed from the finished events.
        progress: say on the standard error output which are left out, and why.

    Raises:
        OutputError: a file cannot be written.
    """
    raise NotImplementedError
