"""Plans of data sets, and making one event of a plan and its copies.

An event is simulated, measured, accepted, reflected and recoloured. A *slot* is one event to be
made. It depends on the plan and its number only. So it is the same whichever events are made before
it or beside it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.data.events_json import event_record
from phase_ppl.data.generation.families import Drawn, Family, cells_of, family_of, pairs_showing
from phase_ppl.data.generation.situation import PHASE500, tables_of
from phase_ppl.data.motion import last_motion
from phase_ppl.physics.actions import DIRECTIONS
from phase_ppl.simulator.contract import random_generator
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_memory,
    check_name,
    instance_of,
    nonnegative_number,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.geometry import touches
from phase_ppl.world.goals import goal_literal, is_true, literal_goal, possible_goals
from phase_ppl.world.hypothesis import SOCIAL, STRENGTH_RANGE, Hypothesis, all_ways
from phase_ppl.world.identity import qualified_name, source_hash, stable
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS, PredicateKind
from phase_ppl.world.scene import PHASE, TURNINGS, Scene, Turning, World, world_in_files

# --- plans of data sets ---------------------------------------------------------------------------

SPLITS: Final[Mapping[str, int]] = {"train": 320, "validation": 80, "test": 100}
"""Shares of the splits, as in the paper."""

UNCHANGED: Final = "none"

REFLECTION_SHARES: Final[Mapping[str, float]] = {
    UNCHANGED: 0.25, "up-down": 0.12, "left-right": 0.18, "about y=x": 0.21, "about y=-x": 0.24,
}  # fmt: skip
"""How often the original test videos are reflected, and how."""

_EVENT_BYTES: Final = 20_000
_FRAME_BYTES: Final = 600
"""Bytes of memory for an event that is assembled, and for each of its frames."""

MOST_TRIES: Final = 1000  # in worlds other than PHASE, where each try has its own number

DrawRoles = Callable[[World, int], Hypothesis | None]
"""``(world, seed)`` -> hypothesis, as :func:`phase_ppl.roles.draw`; None: draw anew."""


def is_as_before(world: World) -> bool:
    """Whether numbers and files must equal those of versions that knew PHASE only."""
    return world_in_files(world) is None


class Look(NamedTuple):
    """The reflection and colours of a recording."""

    reflection: str  # a name of ``REFLECTION_SHARES``
    agents: bool  # whether the colours of the agents are exchanged; ``items``: of the items
    items: bool


class Slot(NamedTuple):
    """An event to be made, with its copies."""

    number: int  # from 0
    # FAMILY or FAMILY:VARIANT, or ``cell_of`` the world for random scenes
    cell: str
    split: str  # name of the split that it and its copies belong to

    @property
    def name(self) -> str:
        """The id of its event; those of copies have a dot and a number after it."""
        return f"{self.cell.replace(':', '-')}-{self.number:05d}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """The settings of :func:`phase_ppl.generate`."""

    cells: Mapping[str, int] = dataclasses.field(default_factory=lambda: dict(PHASE500))
    splits: Mapping[str, float] = dataclasses.field(default_factory=lambda: dict(SPLITS))
    copies: int = 0
    turning: Turning = "both"  # the original events have only "ccw", before any reflection
    frames: int = 101
    planner: str | PlannerConfig = "fast"
    seed: int = 0
    max_tries: int = 200
    world: World = PHASE
    roles: DrawRoles | None = None

    def __post_init__(self) -> None:
        for given in ("cells", "splits"):
            instance_of(given, getattr(self, given), Mapping, "a mapping from names to numbers")
        spread = Counter[str]()
        for cell, n in self.cells.items():
            of_each = dict.fromkeys(cells_of(cell, self.world), 1.0)
            spread.update(apportioned(whole_number(cell, n, 0), of_each))
        object.__setattr__(self, "cells", dict(spread))
        if self.roles is not None and not callable(self.roles):
            raise InvalidSettingError(
                f"roles={shown(self.roles)}, expected a function (world, seed) such as "
                "phase_ppl.roles.draw"
            )
        if not sum(self.cells.values()):
            raise InvalidSettingError("the plan holds no events")
        for name, share in self.splits.items():
            nonnegative_number(f"split {name}", share)
        if not sum(self.splits.values()) > 0:
            raise InvalidSettingError("the splits have no shares")
        check_name("turning", self.turning, TURNINGS)
        least = {"copies": 0, "frames": 2, "seed": 0, "max_tries": 1}
        for name, minimum in least.items():
            whole_number(name, getattr(self, name), minimum)
        if not is_as_before(self.world):
            whole_number("max_tries", self.max_tries, 1, MOST_TRIES)
        for family in self.families.values():  # errors of users' functions show now
            family.draw(self.world, np.random.default_rng(self.seed))
        n, each = sum(self.cells.values()), 1 + self.copies
        what = f"a plan of {n * each} events of {self.frames} frames"
        check_memory(what, n * each * (_EVENT_BYTES + _FRAME_BYTES * self.frames))
        object.__setattr__(self, "planner", PlannerConfig.named(self.planner))
        most = len(self.looks) - 1
        if self.copies > most:
            raise InvalidSettingError(
                f"copies={self.copies}, but an event of {self.world.name!r} has only {most} other "
                "looks"
            )

    @functools.cached_property
    def families(self) -> Mapping[str, Family]:
        """Cell -> family, with its variant; stored, as worker processes know no users' families."""
        own = cell_of(self.world)
        return {cell: family_of(cell, self.world) for cell in self.cells if cell != own}

    @functools.cached_property
    def looks(self) -> list[Look]:
        """The possible looks of events."""
        if not tables_of(self.world).has_looks:
            return [Look(UNCHANGED, agents=False, items=False)]
        swaps = (False, True)
        return [Look(*look) for look in itertools.product(REFLECTION_SHARES, swaps, swaps)]

    @functools.cached_property
    def shares(self) -> FloatArray:
        """The frequency of each look."""
        shares = np.array([REFLECTION_SHARES[look.reflection] for look in self.looks])
        return np.asarray(shares / shares.sum())

    def slots(self) -> list[Slot]:
        """Return the events to be made; each split has about the same shares of every cell."""
        rng = np.random.default_rng([self.seed, 1])
        row = [cell for cell, n in self.cells.items() for _ in range(n)]
        # neighbours are of one kind, so that dealing out the splits along the row stratifies them
        names = list(self.splits)
        counts = apportioned(len(row), self.splits)
        place = np.concatenate(
            [(np.arange(counts[name]) + rng.random()) / max(counts[name], 1) for name in names]
        )
        split_of_row = np.repeat(names, [counts[name] for name in names])[np.argsort(place)]
        order = rng.permutation(len(row))  # so that numbers do not reveal kinds
        return [Slot(number, row[one], str(split_of_row[one])) for number, one in enumerate(order)]

    def warm_up(self) -> None:
        """Compile the kernels that its simulations use."""
        JointSimulator(self.planner).warm_up()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, fit for JSON."""
        record = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        record["planner"] = self.planner.to_dict()  # type: ignore[union-attr]
        del record["world"], record["roles"]
        if self.roles is not None:
            record["roles"] = _function_record(self.roles)
        if not is_as_before(self.world):
            record["world"] = self.world.to_dict()
            if self.families:
                record["families"] = {
                    family.name: _function_record(family.function)
                    for family in self.families.values()
                }
        return dict(json.loads(json.dumps(record, default=dict)))


def _function_record(function: Callable[..., Any]) -> dict[str, Any]:
    """Return what identifies a function, and the functions inside a partial."""
    held = [function]
    if isinstance(function, functools.partial):
        held += [one for one in (*function.args, *function.keywords.values()) if callable(one)]
    found = {"function": qualified_name(function), "sources": [source_hash(one) for one in held]}
    return dict(stable(found))


def cell_of(world: World) -> str:
    """Return the cell of a world's random scenes."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", world.name).strip("-") or "world"


def apportioned(total: int, shares: Mapping[str, float]) -> dict[str, int]:
    """Return whole numbers of sum ``total`` in proportion to shares (largest remainders)."""
    exact = {name: total * share / sum(shares.values()) for name, share in shares.items()}
    counts = {name: int(value) for name, value in exact.items()}
    left = sorted(exact, key=lambda name: counts[name] - exact[name])
    for name in left[: total - sum(counts.values())]:
        counts[name] += 1
    return counts


def scaled(cells: Mapping[str, int], n: int) -> dict[str, int]:
    """Return numbers of events in the proportions of ``cells``, ``n`` in all."""
    instance_of("cells", cells, Mapping, "a mapping from names to numbers")
    return apportioned(whole_number("n", n, 1), cells)


# --- recordings ------------------------------------------------------------------------------

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
    # (time, agent) whether the action that led to the frame pushes; False at the start
    pushes: BoolArray


def record(
    situation: Drawn, simulator: JointSimulator, frames: int, rng: np.random.Generator
) -> Recording:
    """Simulate a situation for ``frames``, 12 per simulated second."""
    scene, hypothesis = situation.scene, situation.roles
    steps = simulator.steps(scene, hypothesis, rng)
    taken = list(itertools.islice(steps, frames))
    trajectory = np.array([frame for frame, _ in taken], np.float64)
    at_start = [False] * len(scene.world.agents)
    pushes = np.array([[one.action in PUSHES for one in each] or at_start for _, each in taken])
    length = after_motion(trajectory) if tables_of(scene.world).is_cut else len(trajectory)
    return Recording(scene, hypothesis, situation.layout, trajectory[:length], pushes[:length])


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


def measures(recording: Recording) -> dict[str, Any]:
    """Return facts about a recording, as plain numbers and lists.

    * ``at_start``, ``at_end``: for each agent, whether its effective goal is true then.
    * ``closest``: least distance between two agents, in units of the sum of their sizes; by pair,
      such as "red & green".
    * ``touched``: for each agent, items that it touched.
    * ``stuck``: for each agent, the longest run of frames in which it pushes and does not move.
    """
    track, scene, wanted = recording.trajectory, recording.scene, recording.hypothesis
    world, agents = scene.world, range(len(scene.world.agents))
    literals = list(map(goal_literal, wanted.effective_goals, agents, itertools.repeat(world)))
    at_start, at_end = ([is_true(one, track[i], scene) for one in literals] for i in (0, -1))
    steps = np.linalg.norm(np.diff(track[:, : len(agents), :2], axis=0), axis=2)
    in_vain = recording.pushes[1:] & (steps < STILL)

    def touched(one: int, other: int) -> bool:
        return any(touches(one, other, frame, scene.radius, len(agents)) for frame in track)

    def closest(one: int, other: int) -> float:
        apart = np.linalg.norm(track[:, one, :2] - track[:, other, :2], axis=1)
        return float((apart / scene.radius[[one, other]].sum()).min())

    pairs = {_named(world, pair): pair for pair in itertools.combinations(agents, 2)}
    items = list(enumerate(world.items, len(agents)))
    runs = [[len(list(run)) for vain, run in itertools.groupby(one) if vain] for one in in_vain.T]
    return {
        "at_start": at_start,
        "at_end": at_end,
        "closest": {name: closest(*pair) for name, pair in pairs.items()},
        "touched": [[name for item, name in items if touched(a, item)] for a in agents],
        "stuck": [max(lengths, default=0) for lengths in runs],
    }


def reached(wanted: Hypothesis, found: Mapping[str, Any]) -> list[bool]:
    """Return (agent,) whether it pursues a goal of its own that became true."""
    each = zip(wanted.towards, found["at_start"], found["at_end"], strict=True)
    return [other is None and end and not start for other, start, end in each]


def _named(world: World, pair: tuple[int, int]) -> str:
    """Return the name of two agents in measures, such as "red & green"."""
    return " & ".join(world.keys[agent] for agent in pair)


def reason_against(scenario: str, wanted: Hypothesis, found: Mapping[str, Any]) -> str | None:
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
        if scenario == "opposing" and found["closest"][_named(world, pair)] >= NEAR:
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
            reason = None if any(reached(drawn.roles, found)) else "no goal is reached"
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
