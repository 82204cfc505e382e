"""The paper's 36 goals, goals of other worlds, and effective goals.

A goal is given as a string, such as "Get pink item to red lm", or as its index in ``world.goals``
(in PHASE :data:`GOALS`). An *effective* goal is what an agent acts on: its own goal, the other
agent's goal (helping, alpha > 0) or the negation of the other agent's goal (hindering, alpha < 0).

A goal makes a literal true: ``is_true(goal_literal(goal, agent, world), poses, scene)`` says
whether the goal is reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import unknown_name
from phase_ppl.world.geometry import is_on, touches
from phase_ppl.world.names import Literal, PredicateKind
from phase_ppl.world.scene import PHASE, Scene, World

__all__ = ["GOALS", "Literal", "goal_literal", "is_true", "possible_goals"]

GOALS: Final = PHASE.goals
"""The 36 goals of PHASE, in the order of the paper's data: 32 about landmarks, 4 about agents."""

N_GOALS: Final = len(GOALS)


def goal_index(goal: str | int, world: World = PHASE) -> int:
    """Return the index of ``goal`` in the goals of a world."""
    return world.goal_index(goal)


def goal_literal(goal: str | int, holder: int, world: World = PHASE) -> Literal:
    """Return the literal that makes ``goal`` true for the agent ``holder``.

    If a goal names its own holder ("get to red agent" held by red), subject and target of the
    literal are equal.

    Args:
        goal: one of ``world.goals``, or its index there.
        holder: index of the agent that has the goal.
        world: the world of agent and goal.

    Raises:
        UnknownNameError: the world has no such goal.
    """
    index = world.goal_index(goal)
    words, users = world.goals[index], index - (len(world.goals) - 2 * len(world.predicates))
    if users >= 0:  # each with its negation, at the end
        moved = world.entity(world.predicates[users // 2].subject)
        return Literal(PredicateKind.USERS, moved, users // 2, users % 2 == 0)
    positive = " away from " not in words
    # "get ball to home", or "get to red agent" without a subject
    subject, target = words[len("get") :].split(" to " if positive else " away from ")
    if target in world.landmark_names:
        place = world.landmark_names.index(target)
        return Literal(PredicateKind.ON, world.entity(subject.strip()), place, positive)
    one, other = world.entity(subject.strip()) if subject else holder, world.entity(target)
    if holder == other:  # the holder takes part in it and is the subject
        one, other = other, one if subject else other
    return Literal(PredicateKind.TOUCH, one, other, positive)


def literal_goal(literal: Literal, holder: int | None = None, world: World = PHASE) -> int:
    """Return the goal index whose literal is ``literal`` (inverse of :func:`goal_literal`).

    It is the goal of ``holder``, by default of the literal's subject.
    """
    predicate, subject, target, positive = literal
    way = "to" if positive else "away from"
    words = ""
    if predicate is PredicateKind.USERS:
        words = world.words(literal)
    elif predicate is PredicateKind.ON:
        words = f"Get {world.entities[subject]} {way} {world.landmark_names[target]}"
    elif predicate is PredicateKind.TOUCH and holder in (None, subject):
        words = f"get {way} {world.entities[target]}"
    elif predicate is PredicateKind.TOUCH:
        ends = [world.entities[subject], world.entities[target]]
        if target < len(world.agents):
            ends.sort()
        words = f"Get {ends[0]} {way} {ends[1]}"
    if words not in world.goals:
        raise unknown_name("goal literal", world.words(literal), world.goals)
    return world.goals.index(words)


def is_true(literal: Literal, poses: FloatArray, scene: Scene) -> bool:
    """Whether a literal of :func:`goal_literal` is true.

    Args:
        literal: the literal.
        poses: (entity, coord) x, y [units], angle [rad] of all entities.
        scene: sizes, landmarks and walls.
    """
    subject, target = literal.subject, literal.target
    if literal.predicate is PredicateKind.USERS:
        found = bool(scene.world.predicates[target].holds(poses, scene))
    elif literal.predicate is PredicateKind.TOUCH:
        found = touches(subject, target, poses, scene.radius, len(scene.world.agents))
    else:
        centre, half_width = scene.landmark_centres[target], scene.half_widths[target]
        found = is_on(poses[subject, :2], centre, float(half_width))
    return bool(found) is literal.positive


def planned_as(literal: Literal, holder: int, scene: Scene) -> Literal:
    """Return the literal that an agent plans for: a world's own predicate becomes a common one.

    If the holder is one of the two bodies, it is the subject. Else an item is the target, and
    is brought.
    """
    if literal.predicate is not PredicateKind.USERS:
        return literal
    world, subject = scene.world, literal.subject
    predicate = world.predicates[literal.target]
    positive = literal.positive is predicate.brings_near
    if predicate.target is None:
        return Literal(PredicateKind.CLOSE, subject, predicate.room_in(scene), positive)
    if predicate.target in world.landmark_names:
        place = world.landmark_names.index(predicate.target)
        return Literal(PredicateKind.ON, subject, place, positive)
    other = world.entity(predicate.target)
    if holder == other or (holder != subject and subject >= len(world.agents)):
        subject, other = other, subject
    return Literal(PredicateKind.TOUCH, subject, other, positive)


def is_self_referring(goal: str | int, holder: int, world: World = PHASE) -> bool:
    """Whether ``holder`` cannot have ``goal`` (prior mass 0).

    Either the goal names its holder as the agent to approach or avoid. Or it is about an agent and
    another entity, and the holder is one of the two: it has an equivalent goal of its own.
    """
    literal = goal_literal(goal, holder, world)
    own = world.goals[world.goal_index(goal)].startswith("get ")
    return literal.predicate is PredicateKind.TOUCH and (
        literal.subject == literal.target if own else literal.subject == holder
    )


def possible_goals(holder: int, world: World = PHASE) -> list[int]:
    """Return the goals that the agent of index ``holder`` can have, indices into ``world.goals``.

    Goals of touching that name the agent itself, such as "get to red agent" for red, are left out.
    """
    return [goal for goal in range(len(world.goals)) if not is_self_referring(goal, holder, world)]


def shared_goal(
    goal: str | int, owner: int, helper: int | None = None, world: World = PHASE
) -> int:
    """Return the goal that ``helper``, by default the other of two, has when it helps ``owner``.

    It is the same goal, except for touching: there a helper who takes part becomes the subject.
    """
    helper = 1 - owner if helper is None else helper
    literal = goal_literal(goal, owner, world)
    if literal.predicate is not PredicateKind.TOUCH:
        return goal_index(goal, world)
    return literal_goal(shared_literal(literal, helper), helper, world)


def shared_literal(literal: Literal, helper: int) -> Literal:
    """Return the literal of an owner's goal as a helper has it."""
    if literal.predicate is not PredicateKind.TOUCH:
        return literal
    if literal.target == helper:
        return literal._replace(subject=helper, target=literal.subject)
    if literal.subject == literal.target:  # the owner's goal names itself
        return literal._replace(subject=helper)
    return literal


def opposed_goal(
    goal: str | int, owner: int, rival: int | None = None, world: World = PHASE
) -> int:
    """Return the goal of ``rival`` when it hinders ``owner`` in ``goal``."""
    rival = 1 - owner if rival is None else rival
    helping = goal_literal(shared_goal(goal, owner, rival, world), rival, world)
    return literal_goal(helping.negated(), rival, world)


def effective_goals(
    goal_red: str | int, goal_green: str | int, alpha: tuple[int, int]
) -> tuple[int, int]:
    """Return the effective goals of (red, green) in PHASE from their stated ones.

    ``alpha`` holds the alphas (red -> green, green -> red). At 0 the agent pursues its own goal,
    above 0 the other's, below 0 the negation of the other's.
    """
    stated = [goal_index(goal_red), goal_index(goal_green)]
    red, green = (
        effective_goal(stated, agent, None if not sign else (1 - agent, sign))
        for agent, sign in enumerate(alpha)
    )
    return red, green


def effective_goal(
    stated: Sequence[int], agent: int, towards: tuple[int, int] | None, world: World = PHASE
) -> int:
    """Return an agent's effective goal, an index into the world's goals, from all stated goals.

    ``towards`` is another agent and 1 if it is helped, -1 if it is hindered. None: the agent
    pursues its own goal.
    """
    if towards is None:
        return stated[agent]
    other, sign = towards
    return (shared_goal if sign > 0 else opposed_goal)(stated[other], other, agent, world)


def __dir__() -> list[str]:
    return __all__
