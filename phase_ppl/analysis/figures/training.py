"""The figure of a training: losses and accuracies per epoch."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.figures.style import COLOURS, INK, NORMAL, SMALL, bare, new_figure, written

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_PANELS: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "Loss": {
        "training": (COLOURS[0], "training events"),
        "validation": (COLOURS[1], "validation events"),
    },
    "Right answers on the validation events": {
        "relation": (COLOURS[2], "relation"),
        "goals": (COLOURS[3], "goals"),
    },
}
"""Title of a panel -> curve -> its colour and name."""


def training_curves(
    report: Mapping[str, Any], path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw the curves of all networks of a training; a dot marks the epoch that was kept.

    Args:
        report: what :func:`phase_ppl.train_socialgnn` returns.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 7.5 x 3 inches.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    figure = new_figure(7.5, 3)
    grid = figure.add_gridspec(1, 2, left=0.075, right=0.985, top=0.8, bottom=0.16, wspace=0.2)
    members = report["members"]
    networks = "network" if len(members) == 1 else "networks"
    events = report["data"]["events"]
    figure.text(
        0.012,
        0.975,
        f"SocialGNN, {report['settings']['variant']}: {len(members)} {networks}, "
        f"{events['train']} training and {events['validation']} validation events",
        va="top",
        fontsize=NORMAL + 1,
        color=INK,
    )
    for place, (title, lines) in enumerate(_PANELS.items()):
        axes = figure.add_subplot(grid[place])
        _panel(axes, members, lines)
        axes.set_title(title, fontsize=NORMAL, loc="left", color=INK)
    return written(figure, path)


def _panel(axes: Axes, members: list[dict[str, Any]], lines: Mapping[str, tuple[str, str]]) -> None:
    drawn = [name for name in lines if name in members[0]["curves"]]
    for name in drawn:
        colour, label = lines[name]
        for number, member in enumerate(members):
            values = member["curves"][name]
            epochs = np.arange(1, len(values) + 1)
            axes.plot(epochs, values, color=colour, lw=0.9, alpha=0.75,
                      label=None if number else label)  # fmt: skip
            if name != "training":
                kept = member["best_epoch"]
                axes.plot(kept, values[kept - 1], "o", ms=4, color=colour, mec="white", mew=0.6)
    longest = max(len(member["curves"]["training"]) for member in members)
    axes.set_xlim(1, max(longest, 2))
    axes.set_ylim(0, 1.02 if "relation" in lines else None)
    axes.set_xlabel("epoch", fontsize=NORMAL, color=INK)
    axes.grid(axis="y", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.legend(frameon=False, fontsize=SMALL + 0.5)
    bare(axes)
