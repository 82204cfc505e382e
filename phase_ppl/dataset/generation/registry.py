"""Families of events by name, a file each in ``phase_ppl.dataset.generation.families``.

A family of one's own is a function that draws a situation::

    @register_family("two_on_one", scenario="collaborative")
    def two_on_one(draw: Draw) -> Situation:
        ...

Families with variants take the variant's name as second argument.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.generation.situation import CannotDraw, Draw, Situation
from phase_ppl.dataset.generation.tables import LAYOUTS
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.plugins import load_registered
from phase_ppl.world.relations import RELATION_OF_SCENARIO, SCENARIOS, scenario
from phase_ppl.world.scene import Turning

ENTRY_POINTS: Final = "phase_ppl.families"

_TRIES: Final = 200
"""Draws that a layout may refuse before the family is said to be impossible."""


@dataclasses.dataclass(frozen=True)
class Family:
    """A family of events.

    Attributes:
        name: as users call it.
        function: ``function(draw)`` or, with variants, ``function(draw, variant)``.
        scenario: what its events show; the relation follows from it.
        layouts: numbers of the layouts it can be drawn in.
        variants: names of its variants; empty where there are none.
        summary: first line of the function's documentation.
    """

    name: str
    function: Callable[..., Situation]
    scenario: str
    layouts: tuple[int, ...]
    variants: tuple[str, ...]
    summary: str

    @property
    def relation(self) -> str:
        """What its events show."""
        return RELATION_OF_SCENARIO[self.scenario]

    def draw(
        self, rng: np.random.Generator, variant: str | None = None, turning: Turning = "both"
    ) -> Situation:
        """Return a situation in one of the layouts.

        Raises:
            InvalidSettingError: no layout allows it, or it is of another scenario than promised.
        """
        for _ in range(_TRIES):
            draw = Draw(rng, self.layouts[int(rng.integers(len(self.layouts)))], turning)
            try:
                return self.drawn_with(draw, variant)
            except CannotDraw:
                continue
        raise InvalidSettingError(
            f"family {self.name!r} found no situation in {_TRIES} draws from layouts "
            f"{list(self.layouts)}"
        )

    def drawn_with(self, draw: Draw, variant: str | None = None) -> Situation:
        """Return the situation of one draw.

        Raises:
            CannotDraw: the draw does not allow it.
            InvalidSettingError: it is of another scenario than promised.
        """
        drawn = self.function(draw) if variant is None else self.function(draw, variant)
        shown = scenario(*drawn.hypothesis.effective_goals)
        if shown != self.scenario:
            raise InvalidSettingError(
                f"family {self.name!r} drew {drawn.hypothesis}, which is {shown}, "
                f"not {self.scenario}"
            )
        return drawn


_FAMILIES: Final[dict[str, Family]] = {}


def register_family(
    name: str,
    *,
    scenario: str,
    layouts: Sequence[int] = tuple(LAYOUTS),
    variants: Sequence[str] = (),
) -> Callable[[Callable[..., Situation]], Callable[..., Situation]]:
    """Return a decorator that makes a family known under ``name``.

    Arguments as the attributes of :class:`Family`.

    Raises:
        UnknownNameError: an unknown scenario or layout.
        InvalidSettingError: the name is taken by another function, or holds a colon.
    """
    if scenario not in SCENARIOS:
        raise unknown_name("scenario", scenario, SCENARIOS)
    for layout in layouts:
        if layout not in LAYOUTS:
            raise unknown_name("layout", layout, map(str, LAYOUTS))
    if not layouts or ":" in name:
        raise InvalidSettingError(f"family {name!r}: expected layouts, and a name without ':'")

    def register(function: Callable[..., Situation]) -> Callable[..., Situation]:
        known = _FAMILIES.get(name)
        if known is not None and _origin(known.function) != _origin(function):
            raise InvalidSettingError(f"a family named {name!r} exists: {_origin(known.function)}")
        summary = (inspect.getdoc(function) or "").split("\n")[0]
        _FAMILIES[name] = Family(name, function, scenario, tuple(layouts), tuple(variants), summary)
        return function

    return register


def _origin(function: Any) -> str:
    return f"{function.__module__}.{getattr(function, '__qualname__', function)}"


@functools.cache
def _load_all() -> None:
    load_registered("family", "phase_ppl.dataset.generation.families", ENTRY_POINTS)


def available_families() -> list[str]:
    """Return the names of all families, sorted."""
    _load_all()
    return sorted(_FAMILIES)


def family_and_variant(cell: str) -> tuple[Family, str | None]:
    """Return what "FAMILY" or "FAMILY:VARIANT" names.

    Raises:
        UnknownNameError: there is no such family or variant; the message names close matches.
    """
    name, colon, variant = cell.partition(":")
    if name not in available_families():
        raise unknown_name("family", name, available_families())
    family = _FAMILIES[name]
    if not family.variants and not colon:
        return family, None
    if variant not in family.variants:
        allowed = [f"{name}:{known}" for known in family.variants] or [name]
        raise unknown_name("variant", cell, allowed)
    return family, variant
