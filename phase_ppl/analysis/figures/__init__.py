"""Figures of posteriors, comparisons and sets of events, as ``ppl.plot``.

Every function of an object returns a matplotlib figure that belongs to no global state, and where
``path`` is given writes it there as well, as .png, .pdf or .svg; OutputError: it cannot be written
there, or the ending is another. Figures of one's own look the same if a function that is decorated
by ``in_style`` begins with ``new_figure`` and ends with ``written``.
"""

from phase_ppl.analysis.figures.beliefs import beliefs, search
from phase_ppl.analysis.figures.curves import comparison, data_card, sensitivity, training_curves
from phase_ppl.analysis.figures.diagnostics import chains, diagnostics, errors, goal_map
from phase_ppl.analysis.figures.over_time import over_time, why
from phase_ppl.analysis.figures.posterior import posterior, posteriors
from phase_ppl.analysis.figures.style import in_style, new_figure, written

__all__ = [
    "beliefs",
    "chains",
    "comparison",
    "data_card",
    "diagnostics",
    "errors",
    "goal_map",
    "in_style",
    "new_figure",
    "over_time",
    "posterior",
    "posteriors",
    "search",
    "sensitivity",
    "training_curves",
    "why",
    "written",
]


def __dir__() -> list[str]:
    return __all__
