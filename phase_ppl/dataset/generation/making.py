"""Making one event of a plan, with its copies."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.dataset.generation.copies import Recording, recoloured, record, reflected
from phase_ppl.dataset.generation.families import changed, family_and_variant, pairs_showing
from phase_ppl.dataset.generation.plan import (
    MOST_TRIES,
    REFLECTION_SHARES,
    UNCHANGED,
    Look,
    Plan,
    Slot,
)
from phase_ppl.dataset.generation.situation import Situation
from phase_ppl.physics.actions import DIRECTIONS
from phase_ppl.simulator.joint import JointSimulator, simulate
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.geometry import touches
from phase_ppl.world.goals import goal_literal, is_true, possible_goals
from phase_ppl.world.hypothesis import SOCIAL, STRENGTH_RANGE, Hypothesis, Roles, all_ways
from phase_ppl.world.scene import PHASE, Scene, World

NEAR: Final = 1.5  # agents this near, in units of the sum of their sizes, are said to have met
MAX_STUCK: Final = 36  # frames (3 s simulated) for which an agent may push without any effect
Measures = Mapping[str, Any]


def reason_against(scenario: str, wanted: Hypothesis | Roles, found: Measures) -> str | None:
    """Return why an event does not show its scenario; None where it does.

    Of three agents and more, two are enough that want what makes the scenario, and show it;
    independent are all.
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
        # whoever wants an item somewhere has to touch it
        both_touch = all(
            literals[agent].subject < n_agents
            or world.entities[literals[agent].subject] in found["touched"][agent]
            for agent in pair
        )
        if scenario in ("collaborative", "competing") and not both_touch:
            return "not both touch the item"
        if scenario == "collaborative" and not all(found["at_end"][agent] for agent in pair):
            return "a goal is not reached"
        closest = found["closest"] if world == PHASE else found["closest"][_named(world, pair)]
        if scenario == "opposing" and closest >= NEAR:
            return "the agents never come near each other"
        return None

    pairs = pairs_showing(scenario, wanted) if n_agents > 2 else [(0, 1)]
    reasons = [against(pair) for pair in pairs]
    return None if None in reasons else reasons[0]


# --- what can be seen in a recording ---------------------------------------------------------

STILL: Final = 0.02
"""Units per frame that an agent must move by for its push to count as having an effect."""

PUSHES: Final = tuple(int(action) for action in np.flatnonzero(DIRECTIONS.any(axis=1)))
"""Actions that push."""


def measures(recording: Recording) -> dict[str, Any]:
    """Return facts about a recording, as plain numbers and lists.

    Keys; those in brackets are lists over agents, red first:

    * ``frames``.
    * ``at_start``, ``ever``, ``at_end`` [agent]: whether its effective goal is true then.
    * ``closest``: least distance between the agents, in units of the sum of their sizes.
    * ``met``: frames in which the agents touch.
    * ``touched`` [agent]: items that it touched.
    * ``held`` [agent]: share of frames in which it holds something.
    * ``moved`` [entity]: length of its way, units.
    * ``stuck`` [agent]: longest run of frames in which it pushes and nothing moves.
    """
    track, scene = recording.trajectory, recording.scene
    closest, met = _of_pair(track, scene, (0, 1))
    of_bodies = _of_bodies(track, scene, recording.actions[1:])
    return {
        **_of_goals(track, scene, recording.hypothesis),
        "closest": closest,
        "met": met,
        "touched": of_bodies["touched"],
        "held": (recording.held >= 0).mean(axis=0).tolist(),
        "moved": of_bodies["moved"],
        "stuck": of_bodies["stuck"],
    }


def _of_goals(track: FloatArray, scene: Scene, wanted: Hypothesis | Roles) -> dict[str, Any]:
    """Return how long it took, and per agent whether its effective goal is true, and when."""
    literals = [
        goal_literal(goal, agent, scene.world) for agent, goal in enumerate(wanted.effective_goals)
    ]
    truth = np.array([[is_true(one, frame, scene) for one in literals] for frame in track])
    return {
        "frames": len(track),
        "at_start": truth[0].tolist(),
        "ever": truth.any(axis=0).tolist(),
        "at_end": truth[-1].tolist(),
    }


def _of_pair(track: FloatArray, scene: Scene, pair: tuple[int, int]) -> tuple[float, int]:
    """Return how near two agents come, in units of the sum of their sizes, and how often touch."""
    n_agents, (one, other) = len(scene.world.agents), pair
    apart = np.linalg.norm(track[:, one, :2] - track[:, other, :2], axis=1)
    met = sum(touches(one, other, frame, scene.radius, n_agents) for frame in track)
    return float((apart / scene.radius[[one, other]].sum()).min()), met


def _of_bodies(track: FloatArray, scene: Scene, actions: IntArray) -> dict[str, Any]:
    """Return ``touched``, ``moved`` and ``stuck``, of (step, agent) actions."""
    world = scene.world
    n_agents = len(world.agents)
    steps = np.linalg.norm(np.diff(track[..., :2], axis=0), axis=2)
    pushes = np.isin(actions, PUSHES) & (steps[:, :n_agents] < STILL)
    return {
        "touched": [
            [world.entities[item] for item in range(n_agents, len(world.entities))
             if any(touches(agent, item, frame, scene.radius, n_agents) for frame in track)]
            for agent in range(n_agents)
        ],
        "moved": steps.sum(axis=0).tolist(),
        "stuck": [
            max((len(list(run)) for vain, run in itertools.groupby(of_agent) if vain), default=0)
            for of_agent in pushes.T.tolist()
        ],
    }  # fmt: skip


def measures_elsewhere(event: Event) -> dict[str, Any]:
    """Return facts about a simulated event of another world than PHASE, as :func:`measures`.

    ``closest`` and ``met`` are by pair, such as "red & green"; ``held`` is missing; and there is
    ``reached`` [agent]: whether it has a goal of its own that became true.
    """
    track, world, wanted = event.observation.trajectory, event.scene.world, event.truth
    found = _of_goals(track, event.scene, wanted)
    own = zip(wanted.stated, found["at_start"], found["at_end"], strict=True)
    reached = [goal is not None and end and not start for goal, start, end in own]
    pairs = {
        _named(world, pair): _of_pair(track, event.scene, pair)
        for pair in itertools.combinations(range(len(world.agents)), 2)
    }
    assert event.thoughts is not None
    return {
        **found,
        "reached": reached,
        "closest": {name: closest for name, (closest, _) in pairs.items()},
        "met": {name: met for name, (_, met) in pairs.items()},
        **_of_bodies(track, event.scene, event.thoughts.actions),
    }


def _named(world: World, pair: tuple[int, int]) -> str:
    """Return what measures call two agents, such as "red & green"."""
    return " & ".join(world.keys[agent] for agent in pair)


# --- making ----------------------------------------------------------------------------------

REPLAN_TRIES: Final = 3  # simulations of a changed situation after which it is given up
_SLOTS: Final = 10**5


class Rejected(NamedTuple):
    """A simulation that did not show what it should."""

    id: str  # of it as an event
    reason: str  # why it was not kept
    event: Event | None  # it; None: there was nothing to simulate
    found: dict[str, Any]  # its measures
    replanned: bool  # whether it was to be a re-planned copy


class Made(NamedTuple):
    """What became of a slot."""

    slot: Slot  # what was wanted
    events: list[Event]  # the event and its copies; empty where every draw was rejected
    entries: list[dict[str, Any]]  # per event what the manifest says about it
    # draws before the one that was kept, and failed attempts at re-planned copies
    rejected: list[Rejected]


def make(plan: Plan, slot: Slot) -> Made:
    """Draw and simulate situations of a slot until one shows what it should.

    In PHASE a situation is one of a family, and its event has copies; in another world it is one of
    a family, or a random scene with roles.
    """
    made = Made(slot, [], [], [])
    tried = _tried_in_phase if plan.world == PHASE else _tried_elsewhere
    for attempt in range(plan.max_tries):
        tried(plan, made, attempt)
        if made.events:
            break
    return made


def _tried_in_phase(plan: Plan, made: Made, attempt: int) -> None:
    """Draw a situation of a family; keep its recording, and copies of it, if it is good."""
    slot = made.slot
    family, variant = family_and_variant(slot.cell)
    rng = np.random.default_rng([plan.seed, 0, slot.number, attempt])
    situation = family.draw(rng, variant, plan.turning)
    recording = _simulated(plan, made, situation, rng, f"{slot.name}-{attempt}")
    if recording is None:
        return
    shares = np.array([REFLECTION_SHARES[look.reflection] for look in plan.looks])
    shares /= shares.sum()
    for index in rng.choice(len(shares), 1 + plan.copies, replace=False, p=shares):
        _keep(made, recording, attempt, plan.looks[index])
    if not plan.replans:
        return
    # numbers of their own: the event and its other copies are the same without them
    rng = np.random.default_rng([plan.seed, 2, slot.number])
    changes = changed(family, variant, situation)
    wanted = len(made.events) + plan.replans
    for place in rng.permutation(len(changes)):
        if len(made.events) == wanted:
            break
        change, other = changes[place]
        for again in range(REPLAN_TRIES):
            id = f"{slot.name}-{change.name}-{again}"
            recording = _simulated(plan, made, other, rng, id, replanned=True)
            if recording is not None:
                look = plan.looks[int(rng.choice(len(shares), p=shares))]
                _keep(made, recording, again, look, change.described(situation))
                break


def _simulated(
    plan: Plan,
    made: Made,
    situation: Situation,
    rng: np.random.Generator,
    id: str,
    *,
    replanned: bool = False,
) -> Recording | None:
    """Return the recording of a situation if it is to be kept, and note it if not."""
    simulator = JointSimulator(plan.planner)
    recording = record(situation, simulator, plan.frames, int(rng.integers(2**31)))
    found = measures(recording)
    family, _ = family_and_variant(made.slot.cell)
    reason = reason_against(family.scenario, recording.hypothesis, found)
    if reason is None:
        return recording
    made.rejected.append(Rejected(id, reason, event_of(recording, id), found, replanned))
    return None


def _keep(
    made: Made,
    recording: Recording,
    attempt: int,
    look: Look,
    replanned: dict[str, Any] | None = None,
) -> None:
    """Add an event, or a copy of it, to what was made."""
    slot = made.slot
    id = f"{slot.name}.{len(made.events)}" if made.events else slot.name
    if look.reflection != UNCHANGED:
        recording = reflected(recording, look.reflection)
    shown = recoloured(recording, agents=look.agents, items=look.items)
    made.events.append(event_of(shown, id))
    family, variant = family_and_variant(slot.cell)
    made.entries.append(
        {
            "id": id,
            "group": slot.name,
            "split": slot.split,
            "family": family.name,
            "variant": variant,
            "layout": shown.layout,
            "attempt": attempt,
            "replanned": replanned,
            "reflection": look.reflection,
            "agents_exchanged": look.agents,
            "items_exchanged": look.items,
            "hypothesis": shown.hypothesis.to_dict(),
            "scenario": shown.hypothesis.scenario,
            "relation": shown.hypothesis.relation,
            "measures": measures(shown),
        }
    )


def event_of(recording: Recording, id: str) -> Event:
    """Return a recording as an event with its truth."""
    truth = Truth.of(recording.hypothesis)
    return Event(recording.scene, Observation(recording.trajectory), id=id, truth=truth)


def _tried_elsewhere(plan: Plan, made: Made, attempt: int) -> None:
    """Draw a situation; keep its event if it is good.

    Of a family it is one that shows its scenario, of random scenes with roles one in which an agent
    reaches a goal of its own.
    """
    slot, world = made.slot, plan.world
    seed, id = (plan.seed * _SLOTS + slot.number) * MOST_TRIES + attempt, f"{slot.name}-{attempt}"
    family, variant = plan.families.get(slot.cell, (None, None))
    if family is not None:
        scene, roles = family.draw(world, seed, variant)
    else:
        drawn = _drawn_roles(plan, seed)
        if isinstance(drawn, str):
            made.rejected.append(Rejected(id, drawn, None, {}, False))
            return
        scene, roles = world.random_scene(seed), drawn
    scene = dataclasses.replace(scene, turning=plan.turning)
    event = simulate(scene, roles, frames=plan.frames, seed=seed, planner=plan.planner, id=id)
    found = measures_elsewhere(event)
    event = dataclasses.replace(event, thoughts=None)
    reason = None if any(found["reached"]) else "no goal is reached"
    if family is not None:
        reason = reason_against(family.scenario, roles, found)
    if reason is not None:
        made.rejected.append(Rejected(id, reason, event, found, False))
        return
    of_family = {} if family is None else {"family": family.name, "variant": variant}
    made.events.append(dataclasses.replace(event, id=slot.name))
    made.entries.append(
        {
            "id": slot.name,
            "group": slot.name,
            "split": slot.split,
            "world": world.name,
            **of_family,
            "attempt": attempt,
            "seed": seed,
            "roles": roles.to_dict(),
            "measures": found,
        }
    )


def _drawn_roles(plan: Plan, seed: int) -> Roles | str:
    """Return the roles of a random scene, or why there are none."""
    roles = (plan.roles or uniform_roles)(plan.world, seed)
    if roles is None:
        return "roles that are not wanted"
    instance_of("what roles returned", roles, Roles, "phase_ppl's Roles, or None")
    if roles.world != plan.world:
        raise InvalidSettingError(
            f"roles returned those of the world {roles.world.name!r}, not {plan.world.name!r}"
        )
    return roles if roles.is_possible else "nobody can act on such roles"


def uniform_roles(world: World, seed: int) -> Roles:
    """Return roles of which all goals are alike, and all ways to help or hinder (Appendix 4B)."""
    rng = np.random.default_rng([seed, 1])  # not the numbers of the random scene of that seed
    ways = all_ways(len(world.agents))
    social = len(ways) > 1 and rng.random() < SOCIAL
    towards = ways[int(rng.integers(1, len(ways))) if social else 0]
    own = [int(rng.choice(possible_goals(agent, world))) for agent in range(len(towards))]
    stated = tuple(None if one else goal for goal, one in zip(own, towards, strict=True))
    return Roles(world, stated, towards, tuple(rng.uniform(*STRENGTH_RANGE, len(own)).tolist()))
