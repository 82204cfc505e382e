"""Figures of how the chains went."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.analysis.diagnostic_panels import (
    NAMES,
    acceptance,
    best_chain,
    chains_note,
    goal_panels,
    ranks,
    step_errors,
    trace,
)
from phase_ppl.analysis.diagnostics import scalars
from phase_ppl.analysis.style import INK, NORMAL, SMALL, new_figure, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

    from phase_ppl.analysis.posterior import Posterior

_PAGE: Final = 10.25
"""Height of the page below the verdict, inches."""


def diagnostics(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw on one page whether a posterior can be trusted.

    The verdict; goals per particle and draw (:func:`goal_map`); trace and ranks of log joint,
    total error and strengths (:func:`chains`); error per frame (:func:`errors`); acceptance.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure, 10 inches wide, about 11 high: the verdict decides.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    found = post.diagnostics()
    verdict = textwrap.wrap(found["verdict"], 150)
    height = _PAGE + 0.5 + 0.155 * len(verdict)
    figure = new_figure(10, height)
    figure.text(0.012, 1 - 0.12 / height, post.event_id, va="top", fontsize=10, color=INK)
    figure.text(
        0.012, 1 - 0.34 / height, "\n".join(verdict), va="top", fontsize=NORMAL, color=INK,
        linespacing=1.3,
    )  # fmt: skip

    def grid(rows: int, columns: int, bottom: float, top: float, **options: Any) -> GridSpec:
        return figure.add_gridspec(
            rows, columns, left=0.06, bottom=bottom / height, top=top / height, **options
        )

    goals = grid(1, 2, 7.65, 10.05, right=0.715, wspace=0.16)
    goal_panels(figure, [figure.add_subplot(goals[i]) for i in range(2)], post, 0.735)
    figure.text(0.06, 7.1 / height, chains_note(post), fontsize=SMALL, color="#666666")
    middle = grid(
        2, 4, 3.55, 6.88, right=0.985, hspace=0.5, wspace=0.28, width_ratios=(2.1, 1, 2.1, 1)
    )
    values = scalars(post.tree)
    for place, name in enumerate(NAMES):
        row, column = divmod(place, 2)
        trace(figure.add_subplot(middle[row, 2 * column]), values[name], best_chain(post), name)
        ranks(figure.add_subplot(middle[row, 2 * column + 1]), values[name])
    low = grid(1, 2, 0.5, 2.75, right=0.985, wspace=0.16, width_ratios=(2.4, 1))
    step_errors(figure.add_subplot(low[0]), post, found)
    acceptance(figure.add_subplot(low[1]), found["acceptance_by_iteration"])
    return written(figure, path)


def goal_map(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw which goal each particle held at each draw, for both agents, in shared colours.

    The goals held most have colours of their own; the rest are grey.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 10 x 3.2 inches.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    figure = new_figure(10, 3.2)
    grid = figure.add_gridspec(1, 2, left=0.055, right=0.715, top=0.89, bottom=0.14, wspace=0.16)
    goal_panels(figure, [figure.add_subplot(grid[i]) for i in range(2)], post, 0.735)
    return written(figure, path)


def chains(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw traces of the real quantities, and where each particle's draws rank among all.

    Orange is the particle with the best draw. In the panels of ranks, a row is a particle: where
    chains have mixed all cells are pale; blue cells have fewer draws than expected, orange more.

    Args:
        post: what to draw; real sites of the user's own are drawn as well.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure, 8 inches wide, 1.75 high for each quantity.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    values = scalars(post.tree)
    height = 1.75 * len(values) + 0.4
    figure = new_figure(8, height)
    grid = figure.add_gridspec(
        len(values), 2, left=0.085, right=0.985, top=1 - 0.28 / height, bottom=0.65 / height,
        hspace=0.5, wspace=0.14, width_ratios=(2.2, 1),
    )  # fmt: skip
    note = chains_note(post)
    figure.text(0.085, 0.09 / height, note, fontsize=SMALL, color="#666666")
    for row, (name, numbers) in enumerate(values.items()):
        trace(figure.add_subplot(grid[row, 0]), numbers, best_chain(post), name)
        ranks(figure.add_subplot(grid[row, 1]), numbers)
    return written(figure, path)


def errors(post: Posterior, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw how far each particle's last draw is from the observation in every frame.

    Orange is the best draw of all. The background is the darker, the more proposals came from a
    window with that frame.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 7.5 x 3 inches.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    figure = new_figure(7.5, 3)
    axes = figure.add_axes((0.075, 0.155, 0.91, 0.7))
    step_errors(axes, post, post.diagnostics())
    return written(figure, path)
