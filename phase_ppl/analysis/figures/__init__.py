"""Figures of posteriors, comparisons and sets of events, as ``ppl.plot``.

Every function returns a matplotlib figure that belongs to no global state, and where ``path`` is
given writes it there as well, as .png, .pdf or .svg; OutputError: it cannot be written there, or
the ending is another.
"""

from phase_ppl.analysis.figures.beliefs import beliefs, search
from phase_ppl.analysis.figures.curves import comparison, design, sensitivity, training_curves
from phase_ppl.analysis.figures.data_card import data_card
from phase_ppl.analysis.figures.diagnostics import chains, diagnostics, errors, goal_map
from phase_ppl.analysis.figures.over_time import over_time, why
from phase_ppl.analysis.figures.posterior import posterior, posteriors

__all__ = [
    "beliefs",
    "chains",
    "comparison",
    "data_card",
    "design",
    "diagnostics",
    "errors",
    "goal_map",
    "over_time",
    "posterior",
    "posteriors",
    "search",
    "sensitivity",
    "training_curves",
    "why",
]


def __dir__() -> list[str]:
    return __all__
