"""Figures of posteriors, comparisons and sets of events, as ``ppl.plot``.

Every function returns a matplotlib figure that ``pyplot`` does not know. With ``path`` the figure
is also written to that file, as .png, .pdf or .svg; OutputError is raised if the file cannot be
written or has another ending. A function of your own gets the same style with the decorator
``in_style``, if it begins with ``new_figure`` and ends with ``written``.
"""

from phase_ppl.analysis.figures.beliefs import beliefs, search
from phase_ppl.analysis.figures.curves import (
    comparison,
    data_card,
    diagnostics,
    errors,
    goal_map,
)
from phase_ppl.analysis.figures.over_time import over_time, why
from phase_ppl.analysis.figures.posterior import posterior
from phase_ppl.analysis.figures.style import in_style, new_figure, written

__all__ = [
    "beliefs",
    "comparison",
    "data_card",
    "diagnostics",
    "errors",
    "goal_map",
    "in_style",
    "new_figure",
    "over_time",
    "posterior",
    "search",
    "why",
    "written",
]


def __dir__() -> list[str]:
    return __all__
