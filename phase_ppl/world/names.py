"""The fixed cast of every event, in the order used by every array of the package.

And the predicates over it: the language of goals, subgoals and symbolic states.
"""

from __future__ import annotations

import enum
from typing import Final, NamedTuple

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

DOORS: Final = ("upper door", "left door", "lower door", "right door")
"""The doors by the ray of the wall that they are in."""

PLACES: Final = (*LANDMARKS, *DOORS)


class Predicate(enum.IntEnum):
    """The paper's predicates, and STOP for "nothing is left to do".

    Source: paper, Appendix "Predicates, Symbolic States, Goals, and Subgoals".
    """

    ON = 0
    """ON(agent | item, landmark): the centre is inside the landmark's square."""
    TOUCH = 1
    """TOUCH(agent, agent | item): the shapes meet when one is enlarged 1.2 times."""
    ATTACH = 2
    """ATTACH(agent, item): the item is welded to the agent."""
    CLOSE = 3
    """CLOSE(agent | item, place): in a landmark's room (0..3), or in a door (4..7, see DOORS)."""
    STOP = 4


class Literal(NamedTuple):
    """A predicate or its negation over entity ``subject`` and entity or landmark ``target``."""

    predicate: Predicate
    subject: int
    target: int
    positive: bool = True

    def negated(self) -> Literal:
        return self._replace(positive=not self.positive)

    def __str__(self) -> str:
        if self.predicate is Predicate.STOP:
            return "STOP"
        over_landmarks = self.predicate in (Predicate.ON, Predicate.CLOSE)
        target = (PLACES if over_landmarks else ENTITIES)[self.target]
        sign = "" if self.positive else "not "
        return f"{sign}{self.predicate.name}({ENTITIES[self.subject]}, {target})"


STOP = Literal(Predicate.STOP, 0, 0)
