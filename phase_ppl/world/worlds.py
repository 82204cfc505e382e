"""Ready-made worlds: the paper's, and two with other casts and floor plans."""

from __future__ import annotations

from typing import Final

from phase_ppl.world.errors import check_name, instance_of
from phase_ppl.world.scene import PHASE, World

__all__ = ["PHASE", "SOLO", "TRIO", "available", "named"]

SOLO: Final = World(
    ["red agent"],
    ["ball", "box"],
    {"home": (4.0, 4.0), "field": (20.0, 4.0), "barn": (20.0, 14.0)},
    arena=(0.0, 24.0, 0.0, 18.0),
    walls=[((12, 0), (12, 5)), ((12, 10), (12, 18))],
    name="solo",
)
"""One agent and two items, one of them irrelevant to it; two rooms and a door."""

TRIO: Final = World(
    ["red agent", "green agent", "purple agent"],
    ["blue ball", "pink ball"],
    {"home": (4.0, 4.0), "field": (32.0, 20.0), "barn": (4.0, 20.0), "pond": (32.0, 4.0, 2.0)},
    arena=(0.0, 36.0, 0.0, 24.0),
    walls=[
        *[((12, 0), (12, 3)), ((12, 8), (12, 16)), ((12, 21), (12, 24))],
        *[((24, 0), (24, 3)), ((24, 8), (24, 16)), ((24, 21), (24, 24))],
        *[((0, 12), (4, 12)), ((9, 12), (27, 12)), ((32, 12), (36, 12))],
    ],
    name="trio",
)
"""Three agents and two items in an oblong arena of six rooms, in two rows of three."""

_READY: Final = {world.name: world for world in (PHASE, SOLO, TRIO)}


def available() -> dict[str, World]:
    """Return the ready-made worlds: name -> world."""
    return dict(_READY)


def named(world: str | World) -> World:
    """Return the ready-made world of a name; a world itself is returned as it is.

    Raises:
        UnknownNameError: no ready-made world has that name.
        InvalidSettingError: it is neither a world nor a name.
    """
    if isinstance(world, str):
        check_name("world", world, _READY)
        return _READY[world]
    instance_of("world", world, World, "a phase_ppl.World, or the name of one")
    return world


def __dir__() -> list[str]:
    return __all__
