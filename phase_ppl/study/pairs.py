"""What people played beside what was generated: the pairs of a study of likeness."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from phase_ppl.simulator.joint import simulate
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


def counterparts(played: Sequence[Event], generated: Sequence[Event] | None) -> list[Event]:
    """Return for each played event the generated one of the same scene, goals and strengths.

    Where none are given they are simulated, by the agents' planner, as long as the played ones, in
    a world whose agents keep their velocities.
    """
    if generated is None:
        return [_simulated(event, seed) for seed, event in enumerate(played)]
    left = list(generated)
    found = [_counterpart(event, left) for event in played]
    ids = {event.id for event in played}
    return [
        dataclasses.replace(event, id=f"{event.id}-generated") if event.id in ids else event
        for event in found
    ]


def _counterpart(event: Event, left: list[Event]) -> Event:
    """Take the counterpart of an event out of those that are left."""
    for place, other in enumerate(left):
        if _same_scene(event.scene, other.scene) and _same_truth(event.truth, other.truth):
            return left.pop(place)
    raise InvalidEventError(
        f"event {event.id!r} has no counterpart (any more) of the same scene, goals and strengths"
    )


def _same_scene(one: Scene, other: Scene) -> bool:
    return one.arena == other.arena and all(
        first.shape == second.shape and np.allclose(first, second)
        for first, second in (
            (one.start, other.start),
            (one.radius, other.radius),
            (one.walls, other.walls),
            (one.landmark_centres, other.landmark_centres),
        )
    )


def _same_truth(one: Truth | None, other: Truth | None) -> bool:
    if one is None or other is None or other.strength_red is None or other.strength_green is None:
        return False
    strengths = [(t.strength_red or 0, t.strength_green or 0) for t in (one, other)]
    goals = [(t.goal_red, t.goal_green) for t in (one, other)]
    return goals[0] == goals[1] and np.allclose(strengths[0], strengths[1])


def _simulated(event: Event, seed: int) -> Event:
    truth = event.truth
    assert truth is not None
    assert truth.strength_red is not None
    assert truth.strength_green is not None
    try:
        hypothesis = Hypothesis(
            truth.goal_red,  # type: ignore[arg-type]
            truth.goal_green,  # type: ignore[arg-type]
            strength_red=truth.strength_red,
            strength_green=truth.strength_green,
        )
    except InvalidSettingError as error:
        raise InvalidEventError(f"event {event.id!r}: {error}") from None
    return simulate(
        dataclasses.replace(event.scene, resets_velocity=False),
        hypothesis,
        frames=event.observation.n_frames,
        seed=seed,
        id=f"{event.id}-generated",
        overlapping=True,
    )
