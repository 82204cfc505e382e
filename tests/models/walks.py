"""Events made by hand, in which the agents walk straight to landmarks, and sets of them."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phase_ppl.data.events_json import checksum
from phase_ppl.data.generated import EVENTS, MANIFEST, MANIFEST_SCHEMA, PLAN
from phase_ppl.data.generation.making import Plan
from phase_ppl.data.load import save_events
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.files import write_json
from phase_ppl.world.names import AGENTS, LANDMARKS
from phase_ppl.world.scene import LANDMARK_CENTRES, Scene
from tests.world.examples import walls

needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="PyTorch, the extra neural, is not installed"
)

START = np.array([[14.0, 11.0, 0.3], [18.0, 13.0, -2.0], [12.0, 12.5, 0.0], [20.0, 12.5, 0.0]])
RADIUS = np.array([0.8, 1.2, 1.01, 0.8])


def walk(red: int, green: int, n_frames: int = 6, with_item: bool = False) -> Event:
    """Return an event in which both agents go to a landmark, red perhaps with the blue item."""
    share = np.linspace(0, 1, n_frames)[:, None]
    trajectory = np.repeat(START[None], n_frames, axis=0)
    for entity, landmark in ((0, red), (1, green)):
        trajectory[:, entity, :2] += share * (LANDMARK_CENTRES[landmark] - START[entity, :2])
    what = AGENTS[0]
    if with_item:
        what = "blue item"
        trajectory[1:, 2, :2] = trajectory[1:, 0, :2] + [1.0, 0.5]
    return Event(
        Scene(START, RADIUS, walls(up=10, left=5)),
        Observation(trajectory),
        id=f"{red}-{green}-{n_frames}-{with_item}",
        truth=Truth(f"Get {what} to {LANDMARKS[red]}", f"Get green agent to {LANDMARKS[green]}"),
    )


def eight() -> list[Event]:
    """Return eight events of different lengths and goals; one relation differs from the others."""
    walks = [walk(i, (i + 1 + i // 4) % 4, 4 + i, i % 2 == 0) for i in range(4)]
    walks += [walk(i, (i + 2) % 4, 5 + i, i % 2 == 1) for i in range(3)]
    friendly = walk(0, 0, 7, with_item=True)
    goal = friendly.truth.goal_red
    truth = Truth(goal, goal)
    return [*walks, Event(friendly.scene, friendly.observation, "both", truth)]


def make_set(
    folder: Path,
    events: Sequence[Event],
    splits: Sequence[str],
    told: Sequence[dict[str, Any]] | None = None,
    **manifest: Any,
) -> Path:
    """Write a generated set, with what is told of each event beside its split."""
    folder.mkdir(exist_ok=True)
    save_events(events, folder / EVENTS)
    plan = Plan(cells={"collab": len(events)}).to_dict()
    entries = [
        {"id": event.id, "split": split, "checksum": checksum(event), **more}
        for event, split, more in zip(events, splits, told or [{}] * len(events), strict=True)
    ]
    write_json(folder / PLAN, plan)
    record = {"schema": MANIFEST_SCHEMA, "plan": plan, "entries": entries, **manifest}
    write_json(folder / MANIFEST, record)
    return folder
