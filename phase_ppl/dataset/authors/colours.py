"""Which of the four bodies of a recording has which colour.

Recordings number their bodies: agents 0 and 1, items 2 and 3. ``entity_color_code`` maps bodies to
colours (0 red, 1 green, 2 blue, 3 pink), but counts items from 3 on; where the colours of the
agents were not shuffled it has lost agent 1, whose number an item took.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.names import AGENTS, ENTITIES

BODIES_OF_KEYS: Final[Mapping[frozenset[int], Mapping[int, int]]] = {
    frozenset((0, 1, 3, 4)): {0: 0, 1: 1, 3: 2, 4: 3},
    frozenset((0, 1, 2)): {0: 0, 1: 2, 2: 3},
    frozenset((0, 1, 2, 3)): {0: 0, 1: 1, 2: 2, 3: 3},
}
"""Per set of keys the body that each key means; the last is that of records without shuffling."""

COLOUR_CODE: Final = {0: 0, 1: 1, 3: 2, 4: 3}
"""The code of bodies that are in the order of the colours."""


def bodies_by_colour(code: Mapping[Any, Any]) -> tuple[int, ...]:
    """Return the numbers of the red, green, blue and pink body.

    Raises:
        InvalidEventError: the code is none of the known forms.
    """
    bodies = BODIES_OF_KEYS.get(frozenset(code))
    if bodies is None or any(type(colour) is not int for colour in code.values()):
        raise _unknown(code)
    colours = {body: code[key] for key, body in bodies.items()}
    if 1 not in colours:
        colours[1] = 1 - colours[0]  # the colour that is left
    order = [colours[body] for body in range(len(ENTITIES))]
    n = len(AGENTS)
    if sorted(order[:n]) != [0, 1] or sorted(order[n:]) != [2, 3]:
        raise _unknown(code)
    return tuple(order.index(colour) for colour in range(len(ENTITIES)))


def _unknown(code: Mapping[Any, Any]) -> InvalidEventError:
    return InvalidEventError(
        f"entity_color_code is {shown(dict(code))}, expected a code such as {COLOUR_CODE}"
    )
