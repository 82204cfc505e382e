"""The data card: the main figures of a set of events, beside those of the original ones."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import in_style, new_figure, written

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HERE: Final = "#0072b2"
BESIDE: Final = "#b4b4b4"
"""Colours: of the set, of the original events."""

_PANELS: Final = {
    "Relation, scenario": ("relation", "scenario"),
    "Goals of agents, by type": ("goal_type",),
    "Strength [N], sizes": ("strength", "agent_size", "item_size"),
    "Time, and events": (*("agent_rests", "agent_holds", "item_moves", "moves_to_the_end"),),
    "How they were made": ("family", "reflection", "split"),
}

_LABELS: Final = {
    "goal_type": {
        "LMO+": "item to landmark", "LMO-": "item from landmark", "LMA+": "agent to landmark",
        "LMA-": "agent from landmark", "TE+": "to other agent", "TE-": "from other agent",
    },
    "agent_rests": {"mean": "agent rests"},
    "agent_holds": {"mean": "agent holds item"},
    "item_moves": {"mean": "item moves"},
    "moves_to_the_end": {"mean": "moves to the end"},
}  # fmt: skip
_PREFIXES: Final = {"agent_size": "agent ", "item_size": "item "}
_LONGEST: Final = 22  # characters of a label at most


@in_style
def data_card(statistics: pd.DataFrame, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the main shares of :func:`phase_ppl.statistics`, with their errors, as pairs of bars.

    The original events are in grey, where it is known; 12 inches wide.
    """
    there = statistics.index.get_level_values("quantity")
    panels = {title: [name for name in names if name in there] for title, names in _PANELS.items()}
    panels = {title: names for title, names in panels.items() if names}
    events = statistics.attrs.get("events")
    title = "" if events is None else f"{events} event{'s' * (events != 1)}"
    figure = new_figure(12.0, 3.6, title, "bars: standard errors over events; in grey: PHASE")
    for axes, (heading, names) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True
    ):
        axes.set_title(heading)
        _paired_bars(axes, pd.concat([statistics.loc[[name]] for name in names]))
    return written(figure, path)


def _paired_bars(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw values beside those of the original events; quantities stand apart."""
    quantities = rows.index.get_level_values("quantity")
    places = np.arange(len(rows)) + 0.7 * np.cumsum(np.r_[False, quantities[1:] != quantities[:-1]])
    axes.barh(places - 0.2, rows["value"], 0.4, xerr=rows["error"], color=HERE,
              error_kw={"elinewidth": 0.8})  # fmt: skip
    axes.barh(places + 0.2, rows["phase"], 0.4, color=BESIDE)
    words = (_LABELS.get(of, {}).get(one, _PREFIXES.get(of, "") + one) for of, one in rows.index)
    axes.set_yticks(places, [name[:_LONGEST] for name in words])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(left=0)
    axes.locator_params(axis="x", nbins=4)
    axes.tick_params(axis="y", length=0)
