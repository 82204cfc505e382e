"""SIMPLE in one word: as the paper prints it, as it means it, by default, and with rivals tried.

>>> ppl.infer(event, **ppl.preset("as_printed"))
>>> ppl.evaluate(events, "simple", preset="as_intended")

A preset is a dictionary of arguments, so that any of them can be replaced or left out.
:func:`completed` does so: it puts what is given before what a preset says.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.world.errors import InvalidSettingError, unknown_name

_OF_THE_PAPER: Final = {
    "kernel": "local_mh",
    "planner": "paper",
    "weights": "count",
    "chains": 15,
    "iterations": 6,
}

PRESETS: Final[Mapping[str, Mapping[str, Any]]] = {
    # Appendix 4 to the letter. Sign and ratio are held to be misprints: goals that are far are
    # proposed, and the stationary law is not the posterior
    "as_printed": {
        **_OF_THE_PAPER,
        "settings": SimpleSettings(proposal="paper", sign="printed"),
        "rule": "paper",
    },
    # the paper's proposal with the sign that its text describes, and Hastings' exact ratio
    "as_intended": {
        **_OF_THE_PAPER,
        "settings": SimpleSettings(proposal="paper"),
        "rule": "exact",
    },
    # what ``infer`` does unasked: learned proposals, the exact rule, the fast planner
    "default": {},
    # twice the simulations: the paper's 15 chains, and as many particles that race
    "raced": {"kernel": "racing", "chains": 30},
}
"""Name -> arguments of :func:`phase_ppl.infer`."""

SETTINGS: Final = tuple(field.name for field in dataclasses.fields(SimpleSettings))
"""Names of SIMPLE's settings, which :func:`completed` takes one by one too."""

_OF_ITS_KERNEL: Final = ("kernel", "rule", "weights", "iterations", "chains")


def preset(name: str) -> dict[str, Any]:
    """Return arguments of :func:`phase_ppl.infer`, and of the model "simple", by one word.

    Args:
        name: "as_printed", "as_intended", "default" or "raced"; what differs stands in the page of
            deviations of the documentation.

    Raises:
        UnknownNameError: there is no such preset.
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return dict(PRESETS[name])


def completed(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is given and not None, and of a preset the rest.

    Another kernel takes the place of the preset's with all that is of it, another length that of
    its iterations; single settings of SIMPLE, such as ``beta=0.1``, change those of the preset.
    """
    usual = preset(name)
    told = {argument: value for argument, value in given.items() if value is not None}
    if told.get("kernel", usual.get("kernel")) != usual.get("kernel"):
        usual = {name: v for name, v in usual.items() if name not in _OF_ITS_KERNEL}
    if not {"budget", "iterations"}.isdisjoint(told):
        usual.pop("iterations", None)
    single = {argument: told.pop(argument) for argument in SETTINGS if argument in told}
    if single and "settings" in told:
        raise InvalidSettingError(f"give either settings or {', '.join(single)}")
    if single:
        told["settings"] = dataclasses.replace(usual.get("settings", SimpleSettings()), **single)
    return {**usual, **told}
