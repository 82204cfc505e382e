"""Making one event of a plan in a world of any cast: a random scene, and roles that are drawn."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.generation.making import Made, Rejected
from phase_ppl.dataset.generation.plan import MOST_TRIES, Plan, Slot
from phase_ppl.simulator.joint import simulate
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.goals import goal_literal, is_true, possible_goals
from phase_ppl.world.hypothesis import SOCIAL, STRENGTH_RANGE, Roles, company
from phase_ppl.world.scene import World

_SLOTS: Final = 10**5


def draw_seed(plan: Plan, slot: Slot, attempt: int) -> int:
    """Return the number that an attempt at an event is made of."""
    return (plan.seed * _SLOTS + slot.number) * MOST_TRIES + attempt


def uniform_roles(world: World, seed: int) -> Roles:
    """Return roles of which all goals are alike, and all ways to help or hinder (Appendix 4B)."""
    rng = np.random.default_rng([seed, 1])  # not the numbers of the random scene of that seed
    ways = company(len(world.agents))
    social = len(ways) > 1 and rng.random() < SOCIAL
    towards = ways[int(rng.integers(1, len(ways))) if social else 0]
    own = [int(rng.choice(possible_goals(agent, world))) for agent in range(len(towards))]
    stated = tuple(None if one else goal for goal, one in zip(own, towards, strict=True))
    return Roles(world, stated, towards, tuple(rng.uniform(*STRENGTH_RANGE, len(own)).tolist()))


def make_in_any_world(plan: Plan, slot: Slot) -> Made:
    """Draw and simulate scenes with roles until an agent reaches a goal of its own."""
    made = Made(slot, [], [], [])
    for attempt in range(plan.max_tries):
        seed, id = draw_seed(plan, slot, attempt), f"{slot.name}-{attempt}"
        roles = (plan.roles or uniform_roles)(plan.world, seed)
        if roles is None:
            made.rejected.append(Rejected(id, "roles that are not wanted", None, {}, False))
            continue
        instance_of("what roles returned", roles, Roles, "phase_ppl's Roles, or None")
        if roles.world != plan.world:
            raise InvalidSettingError(
                f"roles returned those of the world {roles.world.name!r}, not {plan.world.name!r}"
            )
        if not roles.is_possible:
            made.rejected.append(Rejected(id, "nobody can act on such roles", None, {}, False))
            continue
        scene = dataclasses.replace(plan.world.random_scene(seed), turning=plan.turning)
        event = simulate(
            scene, roles, frames=plan.frames, seed=seed, planner=plan.planner, id=slot.name
        )
        event = dataclasses.replace(event, thoughts=None)
        found = measures(event)
        if any(found["reached"]):
            made.events.append(event)
            made.entries.append(
                {
                    "id": slot.name,
                    "group": slot.name,
                    "split": slot.split,
                    "world": plan.world.name,
                    "attempt": attempt,
                    "seed": seed,
                    "roles": roles.to_dict(),
                    "measures": found,
                }
            )
            break
        rejected = dataclasses.replace(event, id=id)
        made.rejected.append(Rejected(id, "no goal is reached", rejected, found, False))
    return made


def measures(event: Event) -> dict[str, Any]:
    """Return facts about an event of any world, as plain numbers and lists.

    ``frames``; ``moved`` [entity], the length of its way in units; and of each agent ``at_start``,
    ``ever`` and ``at_end``, whether its effective goal is true then, and ``reached``, whether it
    has a goal of its own that became so.
    """
    scene, roles, frames = event.scene, event.truth, event.observation.trajectory
    world = scene.world
    literals = [
        goal_literal(goal, agent, world) for agent, goal in enumerate(roles.effective_goals)
    ]
    truth = np.array([[is_true(one, frame, scene) for one in literals] for frame in frames])
    own = np.array([goal is not None for goal in roles.stated])
    steps = np.linalg.norm(np.diff(frames[..., :2], axis=0), axis=2)
    return {
        "frames": len(frames),
        "at_start": truth[0].tolist(),
        "ever": truth.any(axis=0).tolist(),
        "at_end": truth[-1].tolist(),
        "reached": (own & truth[-1] & ~truth[0]).tolist(),
        "moved": steps.sum(axis=0).tolist(),
    }
