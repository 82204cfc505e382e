"""The paper's 36 goals, and what an agent pursues once its social utility is counted in.

A goal is a string of the paper or its index in :data:`GOALS`. An *effective* goal is what
the agent acts on: its own goal, the other's (helping, alpha > 0) or the negation of the
other's (hindering, alpha < 0).
"""

from __future__ import annotations

from typing import Final

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.geometry import is_on, touches
from phase_ppl.world.names import AGENTS, ENTITIES, GREEN, LANDMARKS, RED, Literal, Predicate
from phase_ppl.world.scene import Scene

_ALPHABETICAL = ("blue item", "green agent", "pink item", "red agent")

GOALS: Final[tuple[str, ...]] = tuple(
    [
        f"Get {entity} {way} {landmark}"
        for entity in _ALPHABETICAL
        for way in ("to", "away from")
        for landmark in LANDMARKS
    ]
    + [f"get {way} {agent}" for way in ("away from", "to") for agent in sorted(AGENTS)]
)
"""The goal space of the paper, in the order of its data: 32 about landmarks, 4 about agents."""

N_GOALS: Final = len(GOALS)
_INDEX: Final = {goal: index for index, goal in enumerate(GOALS)}
_INDEX_LOWER: Final = {goal.lower(): index for index, goal in enumerate(GOALS)}


def goal_index(goal: str | int) -> int:
    """Return the index of ``goal`` in :data:`GOALS`.

    Raises:
        UnknownNameError: ``goal`` is no goal; the message names close matches.
    """
    if isinstance(goal, str):
        index = _INDEX_LOWER.get(" ".join(goal.split()).lower())
        if index is None:
            raise unknown_name("goal", goal, GOALS)
        return index
    try:
        index = int(goal)
    except (TypeError, ValueError, OverflowError):
        index = -1
    if isinstance(goal, bool) or not 0 <= index < N_GOALS or index != goal:
        raise unknown_name("goal", goal, [f"0..{N_GOALS - 1}"])
    return index


def goal_literal(goal: str | int, holder: int) -> Literal:
    """Return the literal that makes ``goal`` true for the agent ``holder`` (0 red, 1 green).

    A goal that names its own holder ("get to red agent" held by red) has subject = target.
    """
    words = GOALS[goal_index(goal)]
    if words.startswith("get"):
        positive = words.startswith("get to")
        named = AGENTS.index(words.removeprefix("get to ").removeprefix("get away from "))
        return Literal(Predicate.TOUCH, holder, named, positive)
    positive = " away from " not in words
    entity, landmark = words.removeprefix("Get ").split(" to " if positive else " away from ")
    return Literal(Predicate.ON, ENTITIES.index(entity), LANDMARKS.index(landmark), positive)


def literal_goal(literal: Literal) -> int:
    """Return the goal index whose literal is ``literal`` (inverse of :func:`goal_literal`)."""
    if literal.predicate is Predicate.ON:
        way = "to" if literal.positive else "away from"
        return _INDEX[f"Get {ENTITIES[literal.subject]} {way} {LANDMARKS[literal.target]}"]
    if literal.predicate is Predicate.TOUCH and literal.target in (RED, GREEN):
        way = "to" if literal.positive else "away from"
        return _INDEX[f"get {way} {AGENTS[literal.target]}"]
    raise unknown_name("goal literal", literal, GOALS)


def is_true(literal: Literal, poses: FloatArray, scene: Scene) -> bool:
    """Whether a goal's literal is true where the bodies are.

    Args:
        literal: of a goal, see :func:`goal_literal`.
        poses: (entity, coord) x, y [units], angle [rad].
        scene: sizes and landmarks.
    """
    subject, target = literal.subject, literal.target
    if literal.predicate is Predicate.TOUCH:
        found = touches(subject, target, poses, scene.radius)
    else:
        centre = scene.landmark_centres[target]
        found = is_on(poses[subject, :2], centre, scene.landmark_half_width)
    return bool(found) is literal.positive


def is_self_referring(goal: str | int, holder: int) -> bool:
    """Whether ``goal`` names its own holder as the agent to approach or avoid (prior mass 0)."""
    literal = goal_literal(goal, holder)
    return literal.predicate is Predicate.TOUCH and literal.subject == literal.target


def neighbouring_goals(goal: str | int) -> tuple[int, ...]:
    """Return the goals that differ from ``goal`` in one thing.

    A goal says who or what is to be where, and whether it is to get there or away; being at the
    goal's holder counts as a place beside the landmarks. So "Get red agent to red lm" neighbours
    on the same with another entity or another landmark, on its negation, and on "get to red
    agent". If one goal is a neighbour of another, so is the other of it.
    """
    parts = _parts(goal_index(goal))

    def differences(other: int) -> int:
        return sum(a != b for a, b in zip(parts, _parts(other), strict=True))

    return tuple(other for other in range(N_GOALS) if differences(other) == 1)


def _parts(index: int) -> tuple[int, int | None, bool]:
    """Return a goal's entity, its landmark (None: its holder), and whether it is to get there."""
    literal = goal_literal(index, RED)
    if literal.predicate is Predicate.TOUCH:
        return literal.target, None, literal.positive
    return literal.subject, literal.target, literal.positive


def shared_goal(goal: str | int, owner: int) -> int:
    """Return the goal that the other agent has when it helps ``owner`` with ``goal``.

    The same goal, but for "get to" and "get away from", whose literal is seen from the other side.
    """
    index = goal_index(goal)
    literal = goal_literal(index, owner)
    if literal.predicate is not Predicate.TOUCH:
        return index
    return literal_goal(literal._replace(subject=1 - owner, target=owner))


def opposed_goal(goal: str | int, owner: int) -> int:
    """Return the goal that the other agent has when it hinders ``owner`` in ``goal``."""
    helping = goal_literal(shared_goal(goal, owner), 1 - owner)
    return literal_goal(helping.negated())


def effective_goals(
    goal_red: str | int, goal_green: str | int, alpha: tuple[int, int]
) -> tuple[int, int]:
    """Return the effective goals of (red, green).

    Args:
        goal_red: stated goal of the red agent.
        goal_green: stated goal of the green agent.
        alpha: signs of (alpha red -> green, alpha green -> red); 0 means the agent pursues
            its own goal, > 0 the other's, < 0 the negation of the other's.
    """

    def effective(own: int, sign: int, other: int, owner: int) -> int:
        if sign == 0:
            return own
        return (shared_goal if sign > 0 else opposed_goal)(other, owner)

    red, green = goal_index(goal_red), goal_index(goal_green)
    return effective(red, alpha[0], green, GREEN), effective(green, alpha[1], red, RED)
