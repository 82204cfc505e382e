"""The cast of the world PHASE, in the order of its arrays; predicates and goals of every world.

Other worlds have casts of their own, see ``World.entities``.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Final, NamedTuple

ENTITIES: Final = ("red agent", "green agent", "blue item", "pink item")
AGENTS: Final = ENTITIES[:2]
ITEMS: Final = ENTITIES[2:]
LANDMARKS: Final = ("blue lm", "green lm", "red lm", "yellow lm")

RED, GREEN, BLUE_ITEM, PINK_ITEM = range(4)
NOTHING: Final = -1
"""Index of the held item of an agent that holds nothing."""

DOORS: Final = ("upper door", "left door", "lower door", "right door")
"""The doors, named by the ray of the wall that they are in."""


class PredicateKind(enum.IntEnum):
    """The paper's predicates, and STOP: nothing is left to do.

    Source: paper, Appendix "Predicates, Symbolic States, Goals, and Subgoals".
    """

    ON = 0
    """ON(agent | item, landmark): the centre is inside the landmark's square."""
    TOUCH = 1
    """TOUCH(agent, agent | item): the shapes meet when one is enlarged 1.2 times."""
    ATTACH = 2
    """ATTACH(agent, item): the item is welded to the agent."""
    CLOSE = 3
    """CLOSE(agent | item, place): it is in a room or in a door. The target numbers the rooms first,
    then the doors."""
    STOP = 4
    USERS = 5
    """USERS(entity, number), in literals of goals only: a predicate that the user defined."""


class Literal(NamedTuple):
    """A predicate about an entity, or its negation; ``World.words(literal)`` writes it in names.

    Attributes:
        predicate: a ``PredicateKind``. In goals its ``name`` is "ON", "TOUCH" or "USERS".
        subject: index of the entity.
        target: for ON the index of a landmark; for TOUCH and ATTACH of an entity; for CLOSE of a
            place, rooms first, then doors; for USERS of one of ``world.predicates``.
        positive: whether it is the predicate; False: its negation.
    """

    predicate: PredicateKind
    subject: int
    target: int
    positive: bool = True

    def negated(self) -> Literal:
        """Return the negation of this literal."""
        return self._replace(positive=not self.positive)

    def says(self, other: Literal) -> bool:
        """Whether this literal is equivalent to ``other``. TOUCH is symmetric."""
        if self.predicate is not PredicateKind.TOUCH:
            return self == other
        return self == other or other == self._replace(subject=self.target, target=self.subject)


STOP = Literal(PredicateKind.STOP, 0, 0)


# --- goals in words -------------------------------------------------------------------------------


def goals_of(
    agents: Sequence[str], items: Sequence[str], landmarks: Sequence[str], touchable: Sequence[str]
) -> tuple[str, ...]:
    """Return the goals that a cast can have, as in ``World.goals``."""
    ways, touchable = ("to", "away from"), sorted(touchable)
    to_landmarks = [
        f"Get {entity} {way} {landmark}"
        for entity in sorted((*agents, *items))
        for way in ways
        for landmark in landmarks
    ]
    other = [one for one in touchable if one not in agents or len(agents) > 1]
    own = [f"get {way} {entity}" for way in reversed(ways) for entity in other]
    third = [
        f"Get {agent} {way} {entity}"
        for agent in sorted(agents)
        for way in ways
        for entity in touchable
        if len(agents) > 2 - (entity in items) and (entity in items or agent < entity)
    ]
    return (*to_landmarks, *own, *third)


def plain_goal(goal: str) -> str:
    """Return a goal in natural words as one of ``World.goals``, in lower case."""
    words = " ".join(word for word in goal.lower().split() if word != "the")
    for said, meant in (("touch ", "get to "), ("avoid ", "get away from ")):
        if words.startswith(said):
            return meant + words.removeprefix(said)
    return words if words.startswith("get ") else f"get {words}"
