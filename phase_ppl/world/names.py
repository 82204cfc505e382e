"""The fixed cast of every event, in the order used by every array of the package."""

from __future__ import annotations

from typing import Final

ENTITIES: Final = ("red agent", "green agent", "blue item", "pink item")
AGENTS: Final = ENTITIES[:2]
ITEMS: Final = ENTITIES[2:]
LANDMARKS: Final = ("blue lm", "green lm", "red lm", "yellow lm")

RED: Final = 0
GREEN: Final = 1
BLUE_ITEM: Final = 2
PINK_ITEM: Final = 3
NOTHING: Final = -1
"""Index of the held item of an agent that holds nothing."""
