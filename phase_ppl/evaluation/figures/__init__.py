"""Figures of an evaluation or of a comparison of models, for an article.

They show who is right and who agrees with people. Every function takes an evaluation or a
comparison, or the folder of one, and returns a matplotlib figure that ``pyplot`` does not know.
With ``path`` the figure is also written to that file, as .png, .pdf or .svg. If the results lack
the data of a figure, :class:`~phase_ppl.evaluation.figures.frame.NothingToDrawError` is raised.
"""

# pages show the figures in the order of these imports
# isort: off
from phase_ppl.evaluation.figures.frame import DRAWINGS
from phase_ppl.evaluation.figures.rows import accuracy, correlation, confusion
from phase_ppl.evaluation.figures.people import over_time, people
# isort: on

__all__ = [
    "DRAWINGS",
    "accuracy",
    "confusion",
    "correlation",
    "over_time",
    "people",
]


def __dir__() -> list[str]:
    return __all__
