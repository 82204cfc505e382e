"""Making one event of a plan and its copies: simulate, measure, accept, reflect and recolour."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.data.events_json import event_record
from phase_ppl.data.generation.families import Drawn, pairs_showing
from phase_ppl.data.generation.plan import MOST_TRIES, UNCHANGED, Look, Plan, Slot, is_as_before
from phase_ppl.data.generation.situation import tables_of
from phase_ppl.data.motion import last_motion
from phase_ppl.physics.actions import DIRECTIONS
from phase_ppl.simulator.contract import random_generator
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import InvalidSettingError, instance_of
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.geometry import touches
from phase_ppl.world.goals import goal_literal, is_true, literal_goal, possible_goals
from phase_ppl.world.hypothesis import SOCIAL, STRENGTH_RANGE, Hypothesis, all_ways
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS, NOTHING, PredicateKind
from phase_ppl.world.scene import Scene, Turning, World

AFTER_MOTION: Final = 8
"""Frames kept after the last motion, as in the original recordings: 2 s of video."""

SHORTEST: Final = 33  # frames that are always kept: the shortest original recording


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A simulated situation."""

    scene: Scene  # the start
    hypothesis: Hypothesis
    layout: int  # number of the layout, before any reflection
    trajectory: FloatArray  # (time, entity, coord) x, y [units], angle [rad]
    # (time, agent) whether the action that led to the frame pushes; whether the agent held an item
    # when it chose that action. False at the start
    pushes: BoolArray
    holds: BoolArray


def record(
    situation: Drawn, simulator: JointSimulator, frames: int, rng: np.random.Generator
) -> Recording:
    """Simulate a situation for ``frames``, 12 per simulated second."""
    scene, hypothesis = situation.scene, situation.roles
    steps = simulator.steps(scene, hypothesis, rng)
    taken = list(itertools.islice(steps, frames))
    trajectory = np.array([frame for frame, _ in taken], np.float64)
    at_start = [(False, False)] * len(scene.world.agents)
    doing = [
        [(one.action in PUSHES, one.held != NOTHING) for one in each] or at_start
        for _, each in taken
    ]
    length = after_motion(trajectory) if tables_of(scene.world).is_cut else len(trajectory)
    pushes, holds = np.moveaxis(np.array(doing[:length]), 2, 0)
    return Recording(scene, hypothesis, situation.layout, trajectory[:length], pushes, holds)


def after_motion(trajectory: FloatArray) -> int:
    """Return how many frames of a (time, entity, coord) trajectory to keep."""
    return min(len(trajectory), max(SHORTEST, last_motion(trajectory) + 1 + AFTER_MOTION))


# Landmarks keep their places and colours. So a reflection changes the landmark of a goal. Agents
# that turn one way only turn the other way.


class Reflection(NamedTuple):
    """A reflection of the arena about a line through its centre."""

    matrix: FloatArray  # (2, 2) of offsets from the centre
    offset: float  # angle a becomes ``offset`` - a, rad


REFLECTIONS: Final = {
    "up-down": Reflection(np.array([[1.0, 0.0], [0.0, -1.0]]), np.pi),
    "left-right": Reflection(np.array([[-1.0, 0.0], [0.0, 1.0]]), 0.0),
    "about y=x": Reflection(np.array([[0.0, 1.0], [1.0, 0.0]]), -np.pi / 2),
    "about y=-x": Reflection(np.array([[0.0, -1.0], [-1.0, 0.0]]), np.pi / 2),
}
"""Name -> reflection; the names are those of the authors' files."""

_OTHER_WAY: Final[dict[str, Turning]] = {"both": "both", "ccw": "cw", "cw": "ccw"}


def reflected(recording: Recording, name: str) -> Recording:
    """Return the recording's mirror image."""
    matrix, offset = REFLECTIONS[name]
    scene = recording.scene

    def mirrored(points: FloatArray) -> FloatArray:
        return np.asarray(scene.centre + (points - scene.centre) @ matrix.T)

    def turned(poses: FloatArray) -> FloatArray:
        result = -np.array(poses)
        result[..., :2] = mirrored(poses[..., :2])
        result[..., : len(AGENTS), 2] += offset
        return result

    apart = mirrored(scene.landmark_centres)[:, None] - scene.landmark_centres
    landmark = np.linalg.norm(apart, axis=2).argmin(axis=1).tolist()
    return dataclasses.replace(
        recording,
        scene=dataclasses.replace(
            scene,
            start=turned(scene.start),
            walls=mirrored(scene.walls),
            turning=_OTHER_WAY[scene.turning],
        ),
        hypothesis=_renamed(recording.hypothesis, list(range(len(ENTITIES))), landmark),
        trajectory=turned(recording.trajectory),
    )


def recoloured(recording: Recording, *, agents: bool, items: bool) -> Recording:
    """Return the recording with the colours of the agents, of the items or of both exchanged."""
    order = [*((1, 0) if agents else (0, 1)), *((3, 2) if items else (2, 3))]
    agent_order, scene = order[: len(AGENTS)], recording.scene
    return dataclasses.replace(
        recording,
        scene=dataclasses.replace(scene, start=scene.start[order], radius=scene.radius[order]),
        hypothesis=_renamed(recording.hypothesis, order, list(range(len(LANDMARKS)))),
        trajectory=recording.trajectory[:, order],
        pushes=recording.pushes[:, agent_order],
        holds=recording.holds[:, agent_order],
    )


def _renamed(hypothesis: Any, entity: list[int], landmark: list[int]) -> Hypothesis:
    """Return PHASE's hypothesis with other entities (entity -> entity, in pairs) and landmarks."""
    goals, alpha, strengths = [0, 0], [0, 0], [0.0, 0.0]
    for agent, goal in enumerate((hypothesis.goal_red, hypothesis.goal_green)):
        literal = goal_literal(goal, agent)
        targets = entity if literal.predicate is PredicateKind.TOUCH else landmark
        goals[entity[agent]] = literal_goal(
            literal._replace(subject=entity[literal.subject], target=targets[literal.target])
        )
        alpha[entity[agent]] = hypothesis.alpha[agent]
        strengths[entity[agent]] = hypothesis.strengths[agent]
    return Hypothesis(goals[0], goals[1], (alpha[0], alpha[1]), *strengths)


# --- measures of a recording, and whether it shows its scenario -----------------------------------

STILL: Final = 0.02
"""Units per frame that an agent must move by if its push has an effect."""

PUSHES: Final = tuple(int(action) for action in np.flatnonzero(DIRECTIONS.any(axis=1)))
"""Actions that push."""

NEAR: Final = 1.5  # distance at which agents have met, in units of the sum of their sizes
MAX_STUCK: Final = 36  # frames (3 s simulated) for which an agent may push without any effect
Measures = Mapping[str, Any]


def measures(recording: Recording) -> dict[str, Any]:
    """Return facts about a recording, as plain numbers and lists.

    Keys; those in brackets are lists over agents, or over agents, then items:

    * ``frames``.
    * ``at_start``, ``ever``, ``at_end`` [agent]: whether its effective goal is true then.
    * ``closest``: least distance between two agents, in units of the sum of their sizes; by pair,
      such as "red & green"; in PHASE a single value.
    * ``met``: frames in which they touch, likewise.
    * ``touched`` [agent]: items that it touched.
    * ``moved`` [entity]: length of its path, units.
    * ``stuck`` [agent]: longest run of frames in which it pushes and nothing moves.
    * ``held`` [agent], in PHASE: share of frames in which it holds something.
    * ``reached`` [agent], elsewhere: whether it has a goal of its own that became true.
    """
    track, scene, wanted = recording.trajectory, recording.scene, recording.hypothesis
    world, agents = scene.world, range(len(scene.world.agents))
    literals = list(map(goal_literal, wanted.effective_goals, agents, itertools.repeat(world)))
    truth = np.array([[is_true(one, frame, scene) for one in literals] for frame in track])
    steps = np.linalg.norm(np.diff(track[..., :2], axis=0), axis=2)
    in_vain = recording.pushes[1:] & (steps[:, : len(agents)] < STILL)

    def touching(one: int, other: int) -> list[bool]:
        return [touches(one, other, frame, scene.radius, len(agents)) for frame in track]

    def closest(one: int, other: int) -> float:
        apart = np.linalg.norm(track[:, one, :2] - track[:, other, :2], axis=1)
        return float((apart / scene.radius[[one, other]].sum()).min())

    pairs = {_named(world, pair): pair for pair in itertools.combinations(agents, 2)}
    items = list(enumerate(world.items, len(agents)))
    runs = [[len(list(run)) for vain, run in itertools.groupby(one) if vain] for one in in_vain.T]
    found: dict[str, Any] = {
        "frames": len(track),
        "at_start": truth[0].tolist(),
        "ever": truth.any(axis=0).tolist(),
        "at_end": truth[-1].tolist(),
        "closest": {name: closest(*pair) for name, pair in pairs.items()},
        "met": {name: sum(touching(*pair)) for name, pair in pairs.items()},
        "touched": [[name for item, name in items if any(touching(a, item))] for a in agents],
        "moved": steps.sum(axis=0).tolist(),
        "stuck": [max(lengths, default=0) for lengths in runs],
    }
    if not is_as_before(world):
        return {**found, "reached": _reached(wanted, found)}
    (found["closest"],), (found["met"],) = found["closest"].values(), found["met"].values()
    return {**found, "held": recording.holds.mean(axis=0).tolist()}


def _reached(wanted: Hypothesis, found: Measures) -> list[bool]:
    """Return (agent,) whether it pursues a goal of its own that became true."""
    each = zip(wanted.towards, found["at_start"], found["at_end"], strict=True)
    return [other is None and end and not start for other, start, end in each]


def _named(world: World, pair: tuple[int, int]) -> str:
    """Return the name of two agents in measures, such as "red & green"."""
    return " & ".join(world.keys[agent] for agent in pair)


def reason_against(scenario: str, wanted: Hypothesis, found: Measures) -> str | None:
    """Return why an event does not show its scenario; None: it does.

    With three or more agents, one pair must want what makes the scenario, and show it. For
    "independent" all must.
    """
    world, n_agents = wanted.world, len(wanted.world.agents)
    literals = [goal_literal(goal, a, world) for a, goal in enumerate(wanted.effective_goals)]
    if any(start and one.positive for start, one in zip(found["at_start"], literals, strict=True)):
        return "a goal is true at the start"
    if max(found["stuck"]) > MAX_STUCK:
        return "an agent is stuck"
    if scenario == "independent":
        return None if all(found["at_end"]) else "a goal is not reached"

    def against(pair: tuple[int, int]) -> str | None:
        # an agent that wants an item somewhere must touch it
        both_touch = all(
            literals[agent].subject < n_agents
            or world.entities[literals[agent].subject] in found["touched"][agent]
            for agent in pair
        )
        if scenario in ("collaborative", "competing") and not both_touch:
            return "not both touch the item"
        if scenario == "collaborative" and not all(found["at_end"][agent] for agent in pair):
            return "a goal is not reached"
        near = found["closest"]
        closest = near[_named(world, pair)] if isinstance(near, Mapping) else near
        if scenario == "opposing" and closest >= NEAR:
            return "the agents never come near each other"
        return None

    pairs = pairs_showing(scenario, wanted) if n_agents > 2 else [(0, 1)]
    reasons = [against(pair) for pair in pairs]
    return None if None in reasons else reasons[0]


# --- making ----------------------------------------------------------------------------------

_SLOTS: Final = 10**5

Part = dict[str, Any]
"""The result of a slot, as plain data.

``name`` and ``cell`` are the slot's. ``events`` are the event and its copies; empty if every draw
was rejected. ``entries`` are their entries in the manifest. ``rejected`` are the reasons against
the draws before the accepted one.
"""


def make(plan: Plan, slot: Slot) -> Part:
    """Draw and simulate situations of a slot until one is accepted.

    A situation of a family is accepted if it shows its scenario. A random scene is
    accepted if an agent reaches a goal of its own. The event has copies if the plan wants them.
    """
    family, simulator = plan.families.get(slot.cell), JointSimulator(plan.planner)
    before = is_as_before(plan.world)
    part: Part = {"name": slot.name, "cell": slot.cell, "events": [], "entries": [], "rejected": []}
    for attempt in range(plan.max_tries):
        seed = (plan.seed * _SLOTS + slot.number) * MOST_TRIES + attempt
        rng = np.random.default_rng([plan.seed, 0, slot.number, attempt] if before else seed)
        if family is not None:
            drawn = family.draw(plan.world, rng)
        else:
            roles = _drawn_roles(plan, seed)
            if isinstance(roles, str):
                part["rejected"].append(roles)
                continue
            drawn = Drawn(plan.world.random_scene(seed), roles, 0)
        steps = np.random.default_rng(rng.integers(2**31)) if before else random_generator(seed)
        drawn = drawn._replace(scene=dataclasses.replace(drawn.scene, turning=plan.turning))
        recording = record(drawn, simulator, plan.frames, steps)
        found = measures(recording)
        if family is not None:
            reason = reason_against(family.scenario, recording.hypothesis, found)
        else:
            reason = None if any(_reached(drawn.roles, found)) else "no goal is reached"
        if reason is not None:
            part["rejected"].append(reason)
            continue
        for index in rng.choice(len(plan.looks), 1 + plan.copies, replace=False, p=plan.shares):
            look = plan.looks[index]
            shown = _shown(recording, look)
            id = f"{slot.name}.{len(part['events'])}" if part["events"] else slot.name
            entry = {"id": id, "group": slot.name, "split": slot.split, "attempt": attempt}
            if family is not None:
                entry |= {"family": family.name, "variant": family.variant}
            entry |= _told(shown, look) if before else {"world": plan.world.name, "seed": seed}
            if not before:
                entry["roles"] = shown.hypothesis.to_dict()
            part["events"].append(event_record(event_of(shown, id)))
            part["entries"].append({**entry, "measures": measures(shown)})
        break
    return part


def _shown(recording: Recording, look: Look) -> Recording:
    if look.reflection != UNCHANGED:
        recording = reflected(recording, look.reflection)
    if tables_of(recording.scene.world).has_looks:
        recording = recoloured(recording, agents=look.agents, items=look.items)
    return recording


def _told(shown: Recording, look: Look) -> dict[str, Any]:
    """Return an event's entry in the manifest, in PHASE."""
    return {
        "layout": shown.layout,
        "reflection": look.reflection,
        "agents_exchanged": look.agents,
        "items_exchanged": look.items,
        "hypothesis": shown.hypothesis.to_dict(),
        "scenario": shown.hypothesis.scenario,
        "relation": shown.hypothesis.relation,
    }


def event_of(recording: Recording, id: str) -> Event:
    """Return a recording as an event with its truth."""
    truth = Truth.of(recording.hypothesis)
    return Event(recording.scene, Observation(recording.trajectory), id=id, truth=truth)


def _drawn_roles(plan: Plan, seed: int) -> Hypothesis | str:
    """Return the hypothesis of a random scene, or why it has none."""
    roles = (plan.roles or uniform_roles)(plan.world, seed)
    if roles is None:
        return "roles that are not wanted"
    instance_of("what roles returned", roles, Hypothesis, "a phase_ppl.Hypothesis, or None")
    if roles.world != plan.world:
        raise InvalidSettingError(
            f"roles returned those of the world {roles.world.name!r}, not {plan.world.name!r}"
        )
    return roles if roles.is_possible else "nobody can act on such roles"


def uniform_roles(world: World, seed: int) -> Hypothesis:
    """Draw a hypothesis: all goals, and all ways to help or hinder, are alike (Appendix 4B)."""
    rng = np.random.default_rng([seed, 1])  # not the numbers of the random scene of that seed
    ways = all_ways(len(world.agents))
    social = len(ways) > 1 and rng.random() < SOCIAL
    towards = ways[int(rng.integers(1, len(ways))) if social else 0]
    own = [int(rng.choice(possible_goals(agent, world))) for agent in range(len(towards))]
    stated = tuple(None if one else goal for goal, one in zip(own, towards, strict=True))
    forces = tuple(rng.uniform(*STRENGTH_RANGE, len(own)).tolist())
    return Hypothesis.coded(world, stated, towards, forces)
