"""Making one event of a plan, with its copies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phase_ppl.dataset.generation.copies import recoloured, reflected
from phase_ppl.dataset.generation.filters import reason_against
from phase_ppl.dataset.generation.measures import measures
from phase_ppl.dataset.generation.plan import REFLECTION_SHARES, UNCHANGED, Look, Plan, Slot
from phase_ppl.dataset.generation.recording import Recording, record
from phase_ppl.dataset.generation.registry import family_and_variant
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS
from phase_ppl.world.observation import Observation


class Rejected(NamedTuple):
    """A draw that did not show what it should.

    Attributes:
        attempt: number of the draw.
        reason: why it was not kept.
        recording: of it.
    """

    attempt: int
    reason: str
    recording: Recording


class Made(NamedTuple):
    """What became of a slot.

    Attributes:
        slot: what was wanted.
        name: id of the event; copies get a dot and a number.
        events: the event and its copies; empty where every draw was rejected.
        entries: per event what the manifest says about it.
        rejected: draws before the one that was kept.
    """

    slot: Slot
    name: str
    events: list[Event]
    entries: list[dict[str, Any]]
    rejected: list[Rejected]


def make(plan: Plan, slot: Slot) -> Made:
    """Draw and simulate situations of a slot until one shows what it should.

    Args:
        plan: of the whole set.
        slot: what is to be made.
    """
    name = f"{slot.cell.replace(':', '-')}-{slot.number:05d}"
    family, variant = family_and_variant(slot.cell)
    simulator = JointSimulator(plan.planner)
    rejected: list[Rejected] = []
    for attempt in range(plan.max_tries):
        rng = np.random.default_rng([plan.seed, 0, slot.number, attempt])
        situation = family.draw(rng, variant, plan.turning)
        recording = record(situation, simulator, plan.frames, int(rng.integers(2**31)))
        found = measures(recording)
        reason = reason_against(family.scenario, recording.hypothesis, found)
        if reason is not None:
            rejected.append(Rejected(attempt, reason, recording))
            continue
        events, entries = [], []
        for copy, look in enumerate(_looks(plan, rng)):
            id = name if copy == 0 else f"{name}.{copy}"
            events.append(event_of(_with_look(recording, look), id))
            entries.append(_entry(slot, id, name, attempt, look, recording, found))
        return Made(slot, name, events, entries, rejected)
    return Made(slot, name, [], [], rejected)


def _looks(plan: Plan, rng: np.random.Generator) -> list[Look]:
    """Return how the event and its copies look, all different."""
    shares = np.array([REFLECTION_SHARES[look.reflection] for look in plan.looks])
    chosen = rng.choice(len(shares), 1 + plan.copies, replace=False, p=shares / shares.sum())
    return [plan.looks[index] for index in chosen]


def _with_look(recording: Recording, look: Look) -> Recording:
    if look.reflection != UNCHANGED:
        recording = reflected(recording, look.reflection)
    return recoloured(recording, agents=look.agents, items=look.items)


def event_of(recording: Recording, id: str) -> Event:
    """Return a recording as an event with its truth."""
    red, green = recording.hypothesis.effective_goals
    strengths = recording.hypothesis.strengths
    truth = Truth(GOALS[red], GOALS[green], strength_red=strengths[0], strength_green=strengths[1])
    return Event(recording.scene, Observation(recording.trajectory), id=id, truth=truth)


def _entry(
    slot: Slot,
    id: str,
    group: str,
    attempt: int,
    look: Look,
    recording: Recording,
    found: dict[str, Any],
) -> dict[str, Any]:
    family, variant = family_and_variant(slot.cell)
    stated = _with_look(recording, look).hypothesis
    return {
        "id": id,
        "group": group,
        "split": slot.split,
        "family": family.name,
        "variant": variant,
        "layout": recording.layout,
        "attempt": attempt,
        "reflection": look.reflection,
        "agents_exchanged": look.agents,
        "items_exchanged": look.items,
        "hypothesis": stated.to_dict(),
        "scenario": stated.scenario,
        "relation": stated.relation,
        "measures": found,
    }
