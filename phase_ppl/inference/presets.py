"""SIMPLE in one word: as the paper prints it, as it means it, and as it is by default.

>>> ppl.infer(event, **ppl.preset("as_printed"))
>>> ppl.evaluate(events, "simple", **ppl.preset("as_intended"))

A preset is a dictionary of arguments, so that any of them can be replaced or left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.world.errors import unknown_name


def _as_printed() -> dict[str, Any]:
    """Appendix 4 to the letter: the proposal of goals with its printed sign, the printed ratio.

    Both are held to be misprints: goals that are far are proposed, and the stationary law is not
    the posterior.
    """
    settings = SimpleSettings(proposal="paper", sign="printed")
    return {**_of_the_paper(settings), "rule": "paper"}


def _as_intended() -> dict[str, Any]:
    """The paper's proposal with the sign that its text describes, and Hastings' exact ratio."""
    return {**_of_the_paper(SimpleSettings(proposal="paper")), "rule": "exact"}


def _of_the_paper(settings: SimpleSettings) -> dict[str, Any]:
    return {
        "kernel": "local_mh",
        "planner": "paper",
        "settings": settings,
        "weights": "count",
        "chains": 15,
        "iterations": 6,
    }


def _default() -> dict[str, Any]:
    """What ``infer`` does unasked: learned proposals, the exact rule, the fast planner."""
    return {}


PRESETS: Final[Mapping[str, Callable[[], dict[str, Any]]]] = {
    "as_printed": _as_printed,
    "as_intended": _as_intended,
    "default": _default,
}


def preset(name: str) -> dict[str, Any]:
    """Return arguments of :func:`phase_ppl.infer`, and of the model "simple", by one word.

    Args:
        name: "as_printed", "as_intended" or "default"; what differs stands in the page of
            deviations of the documentation.

    Raises:
        UnknownNameError: there is no such preset.
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return PRESETS[name]()
