"""Explanations of simulated agents' actions: in sentences, and as a film of their minds."""

from __future__ import annotations

import os
import re
import textwrap
from typing import Final, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from phase_ppl.render.frames import Painter, between_frames, panel, side_by_side
from phase_ppl.render.video import FRAMES_PER_STEP, film
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import FRAMES_PER_SECOND as SIMULATED_PER_SECOND
from phase_ppl.world.event import Event, Thoughts
from phase_ppl.world.goals import goal_literal, is_true, planned_as
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import DOORS, STOP, Literal, PredicateKind
from phase_ppl.world.scene import Scene

ROOMS: Final = ("top left room", "top right room", "bottom right room", "bottom left room")
"""Names of rooms that are quadrants, as in PHASE."""

_ABBREVIATED: Final = re.compile(r"\blm$")
"""The last word of the names of PHASE's landmarks."""

_BRIEF: Final = 4  # steps; a shorter change of mind is not told
_BELOW: Final = 74
_MARGIN: Final = 14
_TEXT_SIZE: Final = 15
_LETTERS: Final = 58 / 480
"""Letters in a line, per pixel of its width."""

_DOT: Final = 3.0
_INK: Final = (34, 34, 34)


class Episode(NamedTuple):
    """Steps ``begin`` to ``end`` of one agent, with the same subgoal and the same knowledge."""

    agent: int
    begin: int
    end: int
    subgoal: Literal
    knows: str


def explain(event: Event, path: str | os.PathLike[str] | None = None) -> str:
    """Return sentences on what the agents of a simulated event did, and why.

    Each line is about a stretch of time, in simulated seconds. In it an agent has one subgoal, and
    knows the place of the entity that its goal is about in one way: it sees the entity, holds it,
    or believes it in a room. Changes for fewer than 4 steps are left out. Behind a room stands the
    share of the agent's belief particles that have the entity there at the start of the stretch.

    Args:
        event: an event from :func:`phase_ppl.simulate`.
        path: file for a film, ending in .mp4; None: no film. The film shows what each agent sees,
            where it believes unseen entities to be (dots in their colours), and its subgoal.

    Raises:
        InvalidEventError: the event does not record what its agents saw, believed and intended:
            only events straight from :func:`phase_ppl.simulate` do.
        OutputError: the film cannot be written there.
    """
    thoughts = event.thoughts
    if thoughts is None or event.truth is None:
        raise InvalidEventError(
            f"the thoughts of the agents of event {event.id!r} are unknown: only events of "
            "ppl.simulate have them, until they are written to a file"
        )
    if len(thoughts.subgoals) != event.observation.n_frames - 1:
        raise InvalidEventError(
            f"event {event.id!r} has {event.observation.n_frames} frames and thoughts at "
            f"{len(thoughts.subgoals)} steps, expected one at each frame but the last"
        )
    agents = range(len(event.scene.world.agents))
    episodes = [one for agent in agents for one in _episodes(event, thoughts, agent)]
    episodes.sort(key=lambda one: (one.begin, one.agent))
    if path is not None:
        _film(event, thoughts, path)
    lines = []
    for one in episodes:
        begin, end = one.begin / SIMULATED_PER_SECOND, one.end / SIMULATED_PER_SECOND
        words = f"{begin:4.1f} to {end:4.1f} s  {_sentence(event, thoughts, one.agent, one.begin)}"
        lines.append(textwrap.fill(words, 88, subsequent_indent=" " * 16))
    return "\n".join(lines)


def _episodes(event: Event, thoughts: Thoughts, agent: int) -> list[Episode]:
    """Return the stretches of an agent's subgoals; brief ones join the stretch before."""
    found: list[Episode] = []
    steps = [
        (pair[agent], _knows(event, thoughts, agent, step))
        for step, pair in enumerate(thoughts.subgoals)
    ]
    begin = 0
    for step in range(1, len(steps) + 1):
        if step < len(steps) and steps[step] == steps[begin]:
            continue
        if found and (step - begin < _BRIEF or found[-1][3:] == steps[begin]):
            found[-1] = found[-1]._replace(end=step)
        else:
            found.append(Episode(agent, begin, step, *steps[begin]))
        begin = step
    return found


def _sentence(event: Event, thoughts: Thoughts, agent: int, step: int) -> str:
    """Return an agent's action at a step, and the reason."""
    world, subgoal = event.scene.world, thoughts.subgoals[step][agent]
    words = f"the {world.agents[agent]} {doing(subgoal, agent, event.scene)}"
    knows, about = _knows(event, thoughts, agent, step), _about(event, agent)
    if subgoal.predicate is PredicateKind.STOP:
        goal = _goal(event, agent)
        reached = is_true(goal, event.observation.trajectory[step], event.scene)
        reason = "it has what it wants" if reached else "it sees nothing to do"
        return f"{words}, as {reason}"
    if subgoal.predicate is PredicateKind.ATTACH or not knows:
        return words
    if knows != "believes":
        return f"{words}, as it {knows} the {world.entities[about]}"
    rooms = event.scene.rooms.room_of(thoughts.particles[step, agent, :, about, :2])
    shares = np.bincount(rooms) / len(rooms)
    room = int(shares.argmax())
    there = subgoal[:3] == (PredicateKind.CLOSE, agent, room)
    where = "there" if there else f"in the {room_name(event.scene, room)}"
    return (
        f"{words}, as it does not see the {world.entities[about]} and believes it {where} "
        f"({shares[room]:.0%})"
    )


def _goal(event: Event, agent: int) -> Literal:
    truth, world = event.truth, event.scene.world
    if isinstance(truth, Hypothesis):
        return goal_literal(truth.effective_goals[agent], agent, world)
    return goal_literal((truth.goal_red, truth.goal_green)[agent], agent)


def _about(event: Event, agent: int) -> int:
    """Return the entity that an agent's goal is about: the one to hold or to get to."""
    goal = planned_as(_goal(event, agent), agent, event.scene)
    return goal.target if goal.predicate is PredicateKind.TOUCH else goal.subject


def _knows(event: Event, thoughts: Thoughts, agent: int, step: int) -> str:
    """Return how an agent knows that entity's place: "holds", "sees", "believes"; "" for itself."""
    about = _about(event, agent)
    if about == agent or thoughts.subgoals[step][agent] == STOP:
        return ""
    if thoughts.held[step, agent] == about:
        return "holds"
    return "sees" if thoughts.seen[step, agent, about] else "believes"


def room_name(scene: Scene, room: int) -> str:
    """Return a room in words, such as "top right room", or "room of the home"."""
    if scene.world.quadrants:
        return ROOMS[room]
    inside = np.flatnonzero(scene.rooms.room_of(scene.landmark_centres) == room)
    if not len(inside):
        x0, x1, y0, y1 = scene.rooms.borders(room)
        return f"room at ({(x0 + x1) / 2:g}, {(y0 + y1) / 2:g})"
    return f"room of the {scene.world.landmark_names[inside[0]]}"


def _place(scene: Scene, place: int) -> str:
    """Return a room or a door in words."""
    door = place - len(scene.rooms)
    if door < 0:
        return room_name(scene, place)
    if scene.world.quadrants:
        return DOORS[door]
    one, other = (room_name(scene, room) for room in scene.rooms.doors[door].rooms)
    return f"door between the {one} and the {other}"


def doing(subgoal: Literal, agent: int, scene: Scene) -> str:
    """Return an agent's action for a subgoal in words, such as "goes to the top right room"."""
    world = scene.world
    predicate, subject, target, positive = subgoal
    own = subject == agent
    if predicate is PredicateKind.STOP:
        return "does nothing"
    if predicate is PredicateKind.ATTACH:
        return f"{'takes hold of' if positive else 'lets go of'} the {world.entities[target]}"
    if predicate is PredicateKind.TOUCH and own:
        return f"{'goes up to' if positive else 'gets away from'} the {world.entities[target]}"
    if predicate is PredicateKind.ON:
        place = f"the {_ABBREVIATED.sub('landmark', world.landmark_names[target])}"
    elif predicate is PredicateKind.TOUCH:
        if subject >= len(world.agents):  # the target is the one of two items that is moved
            subject, target = target, subject
        place = f"the {world.entities[target]}"
    else:
        place = f"the {_place(scene, target)}"
    if own:
        return f"{'goes to' if positive else 'leaves'} {place}"
    return f"{'brings' if positive else 'keeps'} the {world.entities[subject]} " + (
        f"to {place}" if positive else f"away from {place}"
    )


# --- the film ------------------------------------------------------------------------------------


def _film(event: Event, thoughts: Thoughts, path: str | os.PathLike[str]) -> None:
    n_agents = len(event.scene.world.agents)
    painters = [Painter(event.scene, (agent,), pale=0.45) for agent in range(n_agents)]
    poses = between_frames(event.observation.trajectory, FRAMES_PER_STEP)
    font = ImageFont.load_default(_TEXT_SIZE)

    def draw(index: int) -> Image.Image:
        step = min(index // FRAMES_PER_STEP, len(thoughts.subgoals) - 1)
        panels = [
            _mind(event, painter, thoughts, step, agent, poses[index])
            for agent, painter in enumerate(painters)
        ]
        picture = side_by_side(panels, _BELOW)
        canvas, width = ImageDraw.Draw(picture), picture.width // n_agents
        for agent in range(n_agents):
            words = _sentence(event, thoughts, agent, step)
            lines = textwrap.wrap(f"{words[0].upper()}{words[1:]}.", round(width * _LETTERS))
            for row, line in enumerate(lines):
                top = picture.height - _BELOW + 4 + row * (_TEXT_SIZE + 6)
                canvas.text((agent * width + _MARGIN, top), line, fill=_INK, font=font)
        return picture

    film(draw, len(poses), path)


def _mind(
    event: Event, painter: Painter, thoughts: Thoughts, step: int, agent: int, poses: FloatArray
) -> Image.Image:
    """Return the world with an agent's field of view, and dots for its beliefs of the unseen."""
    picture = painter.draw(poses)
    draw = ImageDraw.Draw(picture)
    for entity in np.flatnonzero(~thoughts.seen[step, agent]):
        if entity == agent:
            continue
        for x, y in painter.pixel(thoughts.particles[step, agent, :, entity, :2]):
            box = (x - _DOT, y - _DOT, x + _DOT, y + _DOT)
            draw.ellipse(box, fill=event.scene.world.entity_colours[entity], outline=_INK)
    return panel(picture)
