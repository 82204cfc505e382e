"""Making one event of a plan, with its copies."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.dataset.generation.changes import Change, changed, described
from phase_ppl.dataset.generation.copies import recoloured, reflected
from phase_ppl.dataset.generation.filters import reason_against
from phase_ppl.dataset.generation.measures import measures
from phase_ppl.dataset.generation.plan import REFLECTION_SHARES, UNCHANGED, Look, Plan, Slot
from phase_ppl.dataset.generation.recording import Recording, record
from phase_ppl.dataset.generation.registry import Family, family_and_variant
from phase_ppl.dataset.generation.situation import Situation
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS
from phase_ppl.world.observation import Observation

REPLAN_TRIES: Final = 3
"""Simulations of a changed situation after which it is given up."""


class Rejected(NamedTuple):
    """A simulation that did not show what it should.

    Attributes:
        id: of it as an event.
        reason: why it was not kept.
        recording: of it.
        found: its measures.
        change: what of the event it was to be a re-planned copy of was changed; None for a draw.
    """

    id: str
    reason: str
    recording: Recording
    found: dict[str, Any]
    change: Change | None = None


class Made(NamedTuple):
    """What became of a slot.

    Attributes:
        slot: what was wanted.
        name: id of the event; copies get a dot and a number.
        events: the event and its copies; empty where every draw was rejected.
        entries: per event what the manifest says about it.
        rejected: draws before the one that was kept, and failed attempts at re-planned copies.
    """

    slot: Slot
    name: str
    events: list[Event]
    entries: list[dict[str, Any]]
    rejected: list[Rejected]


class _Trial(NamedTuple):
    """A situation simulated once: its recording, what is seen in it, and why not to keep it."""

    recording: Recording
    found: dict[str, Any]
    reason: str | None


def name_of(slot: Slot) -> str:
    """Return the id of a slot's event."""
    return f"{slot.cell.replace(':', '-')}-{slot.number:05d}"


def make(plan: Plan, slot: Slot) -> Made:
    """Draw and simulate situations of a slot until one shows what it should.

    Args:
        plan: of the whole set.
        slot: what is to be made.
    """
    name = name_of(slot)
    family, variant = family_and_variant(slot.cell)
    simulator = JointSimulator(plan.planner)
    made = Made(slot, name, [], [], [])
    for attempt in range(plan.max_tries):
        rng = np.random.default_rng([plan.seed, 0, slot.number, attempt])
        situation = family.draw(rng, variant, plan.turning)
        trial = _tried(plan, family, situation, simulator, rng)
        if trial.reason is not None:
            made.rejected.append(
                Rejected(f"{name}-{attempt}", trial.reason, trial.recording, trial.found)
            )
            continue
        for look in _looks(plan, rng):
            _keep(made, trial, attempt, look)
        if plan.replans:
            _replan(made, plan, family, variant, situation, simulator)
        break
    return made


def _tried(
    plan: Plan,
    family: Family,
    situation: Situation,
    simulator: JointSimulator,
    rng: np.random.Generator,
) -> _Trial:
    recording = record(situation, simulator, plan.frames, int(rng.integers(2**31)))
    found = measures(recording)
    reason = reason_against(family.scenario, recording.hypothesis, found)
    return _Trial(recording, found, reason)


def _keep(
    made: Made, trial: _Trial, attempt: int, look: Look, replanned: dict[str, Any] | None = None
) -> None:
    """Add an event, or a copy of it, to what was made."""
    id = f"{made.name}.{len(made.events)}" if made.events else made.name
    shown = _with_look(trial.recording, look)
    made.events.append(event_of(shown, id))
    family, variant = family_and_variant(made.slot.cell)
    made.entries.append(
        {
            "id": id,
            "group": made.name,
            "split": made.slot.split,
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


def _replan(
    made: Made,
    plan: Plan,
    family: Family,
    variant: str | None,
    situation: Situation,
    simulator: JointSimulator,
) -> None:
    """Add re-planned copies of a slot's event, as many as are wanted and can be had."""
    # numbers of their own: the event and its other copies are the same without them
    rng = np.random.default_rng([plan.seed, 2, made.slot.number])
    changes = changed(family, variant, situation)
    wanted = len(made.events) + plan.replans
    for place in rng.permutation(len(changes)):
        if len(made.events) == wanted:
            return
        change, other = changes[place]
        for attempt in range(REPLAN_TRIES):
            trial = _tried(plan, family, other, simulator, rng)
            if trial.reason is None:
                _keep(made, trial, attempt, _any_look(plan, rng), described(change, situation))
                break
            id = f"{made.name}-{change.name}-{attempt}"
            made.rejected.append(Rejected(id, trial.reason, trial.recording, trial.found, change))


def _looks(plan: Plan, rng: np.random.Generator) -> list[Look]:
    """Return how the event and its copies look, all different."""
    chosen = rng.choice(len(plan.looks), 1 + plan.copies, replace=False, p=_shares(plan))
    return [plan.looks[index] for index in chosen]


def _any_look(plan: Plan, rng: np.random.Generator) -> Look:
    return plan.looks[int(rng.choice(len(plan.looks), p=_shares(plan)))]


def _shares(plan: Plan) -> FloatArray:
    shares = np.array([REFLECTION_SHARES[look.reflection] for look in plan.looks])
    return np.asarray(shares / shares.sum())


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
