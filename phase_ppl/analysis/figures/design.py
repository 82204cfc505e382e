"""Which events tell models apart, and how many of them it takes."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.analysis.design import Design
from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    NORMAL,
    SMALL,
    figure_of,
    new_figure,
    titled,
    written,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NAME: Final = 32  # characters of an id that are shown


@figure_of(Design)
def design(found: Design, path: str | os.PathLike[str] | None = None, *, n: int = 12) -> Figure:
    """Draw the most telling events, and what the best chosen say together, 8 inches wide.

    Left, the expected information of each event, with its error where it is known. Right, that of
    the events of ``found.best`` together, beside as many taken by chance (mean and 90 % of 100
    orders); the dotted line is all that can be known.

    Args:
        found: of :func:`phase_ppl.design`.
        path: where to write the figure as well.
        n: events, at most.
    """
    table = found.table.head(n)
    figure = new_figure(8.0, max(2.6, 1.1 + 0.2 * len(table)))
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    places = np.arange(len(table))[::-1]
    left.barh(
        places, table["information"], 0.62, color=COLOURS[5],
    )  # fmt: skip
    known = np.isfinite(table["error"].to_numpy())
    left.errorbar(
        table["information"][known], places[known], xerr=table["error"][known],
        fmt="none", ecolor=INK, elinewidth=1,
    )  # fmt: skip
    people = "an answer" if found.answers == 1 else f"{found.answers} answers"
    note = f"expected information of {people} about the {found.question}"
    titled(left, "Events that tell models apart", note)
    left.set_xlabel("nats")
    left.set_yticks(places, [name[:_NAME] for name in table.index], fontsize=SMALL)
    left.set_xlim(left=0)

    chosen, random = found.best(n), found.at_random(n)
    counts = np.arange(1, len(chosen) + 1)
    right.axhline(found.most, color=GREY, lw=0.8, ls=":")
    end = {"color": GREY, "va": "bottom", "ha": "right"}
    right.text(len(chosen), found.most, "all that can be known", **end)
    right.fill_between(counts, random["low"], random["high"], color=GREY, alpha=0.16, lw=0)
    right.plot(counts, random["information"], color=GREY, lw=1.6)
    right.plot(counts, chosen["information"], "o-", ms=3, color=COLOURS[0], lw=1.8)
    middle = len(counts) // 2
    for text, y, colour, side, up in (
        ("chosen", chosen["information"], COLOURS[0], "bottom", 5),
        ("by chance", random["information"], GREY, "top", -7),
    ):
        right.annotate(
            text, (counts[middle], y.iloc[middle]), (0, up), textcoords="offset points",
            ha="center", va=side, fontsize=NORMAL, color=colour,
        )  # fmt: skip
    note = f"between {', '.join(found.models)}"
    titled(right, "Several events together", note[:64])
    right.set(xlabel="events", ylabel="nats", ylim=(0, found.most * 1.12))
    right.set_xticks(counts[:: max(1, len(counts) // 6)])
    right.grid(axis="y")
    return written(figure, path)
