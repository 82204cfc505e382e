"""Making one event of a plan, with its copies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phase_ppl.dataset.generation.copies import Recording, recoloured, record, reflected
from phase_ppl.dataset.generation.families import changed, described, family_and_variant
from phase_ppl.dataset.generation.plan import REFLECTION_SHARES, UNCHANGED, Look, Plan, Slot
from phase_ppl.dataset.generation.situation import Situation
from phase_ppl.physics.actions import DIRECTIONS
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.geometry import touches
from phase_ppl.world.goals import goal_literal, is_true
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES, ITEMS
from phase_ppl.world.observation import Observation

NEAR: Final = 1.5  # agents this near, in units of the sum of their sizes, are said to have met
MAX_STUCK: Final = 36  # frames (3 s simulated) for which an agent may push without any effect
Measures = Mapping[str, Any]


def reason_against(scenario: str, hypothesis: Hypothesis, found: Measures) -> str | None:
    """Return why a recording does not show its scenario; None where it does."""
    positive = [
        goal_literal(goal, agent).positive for agent, goal in enumerate(hypothesis.effective_goals)
    ]
    if any(start and wanted for start, wanted in zip(found["at_start"], positive, strict=True)):
        return "a goal is true at the start"
    if max(found["stuck"]) > MAX_STUCK:
        return "an agent is stuck"
    if scenario in ("collaborative", "competing") and not _both_touch(hypothesis, found):
        return "not both touch the item"
    if scenario in ("collaborative", "independent") and not all(found["at_end"]):
        return "a goal is not reached"
    if scenario == "opposing" and found["closest"] >= NEAR:
        return "the agents never come near each other"
    return None


def _both_touch(hypothesis: Hypothesis, found: Measures) -> bool:
    """Whether each agent touches the item that its goal is about, if it is about one."""
    wanted = [
        goal_literal(goal, agent).subject for agent, goal in enumerate(hypothesis.effective_goals)
    ]
    return all(
        item < len(AGENTS) or ENTITIES[item] in items
        for item, items in zip(wanted, found["touched"], strict=True)
    )


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
    goals = recording.hypothesis.effective_goals
    literals = [goal_literal(goal, agent) for agent, goal in enumerate(goals)]
    truth = np.array([[is_true(lit, frame, scene) for lit in literals] for frame in track])
    apart = np.linalg.norm(track[:, 0, :2] - track[:, 1, :2], axis=1) / scene.radius[:2].sum()
    items = range(BLUE_ITEM, BLUE_ITEM + len(ITEMS))
    touched = [
        [ENTITIES[item] for item in items
         if any(touches(agent, item, frame, scene.radius) for frame in track)]
        for agent in range(len(AGENTS))
    ]  # fmt: skip
    steps = np.linalg.norm(np.diff(track[..., :2], axis=0), axis=2)
    return {
        "frames": len(track),
        "at_start": truth[0].tolist(),
        "ever": truth.any(axis=0).tolist(),
        "at_end": truth[-1].tolist(),
        "closest": float(apart.min()),
        "met": sum(touches(0, 1, frame, scene.radius) for frame in track),
        "touched": touched,
        "held": (recording.held >= 0).mean(axis=0).tolist(),
        "moved": steps.sum(axis=0).tolist(),
        "stuck": [
            longest_run(np.isin(recording.actions[1:, agent], PUSHES) & (steps[:, agent] < STILL))
            for agent in range(len(AGENTS))
        ],
    }


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of true values."""
    padded = np.concatenate([[False], flags, [False]]).astype(np.int8)
    edges = np.flatnonzero(np.diff(padded))
    return int((edges[1::2] - edges[::2]).max(initial=0))


# --- making ----------------------------------------------------------------------------------

REPLAN_TRIES: Final = 3  # simulations of a changed situation after which it is given up


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
    """Draw and simulate situations of a slot until one shows what it should."""
    family, variant = family_and_variant(slot.cell)
    simulator = JointSimulator(plan.planner)
    made = Made(slot, [], [], [])

    def simulated(
        situation: Situation, rng: np.random.Generator, id: str, *, replanned: bool = False
    ) -> Recording | None:
        """Return the recording of a situation if it is to be kept, and note it if not."""
        recording = record(situation, simulator, plan.frames, int(rng.integers(2**31)))
        found = measures(recording)
        reason = reason_against(family.scenario, recording.hypothesis, found)
        if reason is None:
            return recording
        made.rejected.append(Rejected(id, reason, event_of(recording, id), found, replanned))
        return None

    for attempt in range(plan.max_tries):
        rng = np.random.default_rng([plan.seed, 0, slot.number, attempt])
        situation = family.draw(rng, variant, plan.turning)
        recording = simulated(situation, rng, f"{slot.name}-{attempt}")
        if recording is not None:
            for look in _looks(plan, rng):
                _keep(made, recording, attempt, look)
            break
    if not (made.events and plan.replans):
        return made
    # numbers of their own: the event and its other copies are the same without them
    rng = np.random.default_rng([plan.seed, 2, slot.number])
    changes = changed(family, variant, situation)
    wanted = len(made.events) + plan.replans
    for place in rng.permutation(len(changes)):
        if len(made.events) == wanted:
            break
        change, other = changes[place]
        for attempt in range(REPLAN_TRIES):
            id = f"{slot.name}-{change.name}-{attempt}"
            recording = simulated(other, rng, id, replanned=True)
            if recording is not None:
                look = plan.looks[int(rng.choice(len(plan.looks), p=_shares(plan)))]
                _keep(made, recording, attempt, look, described(change, situation))
                break
    return made


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
    shown = _with_look(recording, look)
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


def _looks(plan: Plan, rng: np.random.Generator) -> list[Look]:
    """Return how the event and its copies look, all different."""
    chosen = rng.choice(len(plan.looks), 1 + plan.copies, replace=False, p=_shares(plan))
    return [plan.looks[index] for index in chosen]


def _shares(plan: Plan) -> FloatArray:
    shares = np.array([REFLECTION_SHARES[look.reflection] for look in plan.looks])
    return np.asarray(shares / shares.sum())


def _with_look(recording: Recording, look: Look) -> Recording:
    if look.reflection != UNCHANGED:
        recording = reflected(recording, look.reflection)
    return recoloured(recording, agents=look.agents, items=look.items)


def event_of(recording: Recording, id: str) -> Event:
    """Return a recording as an event with its truth."""
    truth = Truth.of(recording.hypothesis)
    return Event(recording.scene, Observation(recording.trajectory), id=id, truth=truth)
