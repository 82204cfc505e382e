"""Files as PHASE's authors have them, where a test must know what is in them.

What happens in them is made up: two agents that drive in circles and two items that drift.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from phase_ppl.data.generation.making import Recording, reflected
from phase_ppl.data.generation.situation import walls_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import LANDMARK_CENTRES, Scene

FRAMES = 40
LAYOUT = 8
RADIUS = [0.8, 1.2, 0.8, 1.01]
GOALS = ("Get blue item to red lm", "get to red agent")
STAMP = "D082020_1817530"
KINDS = (None, 0, 1, 2, 3)
"""An original, and the numbers of the reflections."""

NAMES = ("up-down", "left-right", "about y=x", "about y=-x")

SHUFFLED = {1: 0, 0: 1, 4: 2, 3: 3}
"""Body 0 is green, body 1 red, item 0 (key 3) pink, item 1 blue."""

SHORT = {0: 1, 1: 3, 2: 2}
"""The same, where item 0 has overwritten agent 1."""

BODY_OF_COLOUR = [1, 0, 3, 2]

# what a reflection does to positions, and did to the velocities of agents
POINT: dict[int | None, Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]] = {
    None: lambda x, y: (x, y),
    0: lambda x, y: (x, 24 - y),
    1: lambda x, y: (32 - x, y),
    2: lambda x, y: (y + 4, x - 4),
    3: lambda x, y: (28 - y, 28 - x),
}
ANGLE: dict[int | None, Callable[[FloatArray], FloatArray]] = {
    None: lambda a: a,
    0: lambda a: np.pi - a,
    1: lambda a: -a,
    2: lambda a: wrapped(-np.pi / 2 - a),
    3: lambda a: wrapped(np.pi / 2 - a),
}
LANDMARK = {None: 2, 0: 1, 1: 3, 2: 0, 3: 2}
"""The red landmark in a mirror."""


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles in (-2 pi, 0]."""
    return -np.mod(-angle, 2 * np.pi)


def substeps() -> FloatArray:
    """Return (time, entity, channel) x, y, vx, vy, angle per substep, the start first.

    Red drives in circles and turns with them, counter-clockwise; green turns now and then.
    """
    time = np.arange(1 + 5 * (FRAMES - 1)) / 60
    rows = np.zeros((len(time), 4, 5))
    centres = [(12.0, 8.0), (21.0, 17.0), (9.0, 17.0), (20.0, 6.0)]
    for entity, ((x, y), rate) in enumerate(zip(centres, (6.0, 2.0, 1.0, -1.5), strict=True)):
        rows[:, entity, 0] = x + 2 * np.cos(rate * time)
        rows[:, entity, 1] = y + 2 * np.sin(rate * time)
        rows[:, entity, 2] = -2 * rate * np.sin(rate * time)
        rows[:, entity, 3] = 2 * rate * np.cos(rate * time)
    rows[:, 0, 4] = 1.0 + 6 * time
    rows[:, 1, 4] = -2.0 + 5 * np.maximum(0, time - 1)
    rows[:, 3, 4] = 0.3 * time
    return rows


def averaged(rows: FloatArray, first: int) -> FloatArray:
    """Return one row per frame: the first, and means over five."""
    return np.concatenate([rows[:1], rows[first:].reshape(-1, 5, *rows.shape[1:]).mean(axis=1)])


def expected(copy: int | None) -> Recording:
    """Return what the files below show."""
    rows = substeps()
    rows = averaged(rows, 1) if copy is None else averaged(rows[1:], 0)
    if copy is not None:
        rows[:, 2:, 4] = 0.0
    trajectory = rows[..., [0, 1, 4]]
    scene = Scene(trajectory[0], np.array(RADIUS), walls_of(LAYOUT), "ccw")
    hypothesis = Hypothesis(*GOALS, (0, 0), 600.0, 150.0)  # type: ignore[arg-type]
    nobody = np.zeros((len(rows), 2), bool)
    made = Recording(scene, hypothesis, LAYOUT, trajectory, nobody)
    return made if copy is None else reflected(made, NAMES[copy])


def name_of(copy: int | None, stamp: str = STAMP) -> str:
    place = f"E{LAYOUT}" + ("" if copy is None else f".{copy}")
    return (
        f"{stamp}_0_F8_{place}_G['LMO', 0, {LANDMARK[copy]}, 1]_['TE', 1, 0, 1]_ST3_0_SZ0_1_0_3"
        "_P10_4_2_17_A0_0_C0_0_AN1.0_-2.0_MCTS_L39_R0.0_0.0_PL1_EL1_1_1_s1000_r10_cI1.25_cB1000_e0"
    )


def record(copy: int | None, code: dict[int, int] = SHUFFLED) -> dict[str, Any]:
    """Return a record of the generator, wrong as those of copies are."""
    rows = substeps()
    if copy is not None:
        point = POINT[copy]
        rows = rows[1:]
        rows[:, :, 0], rows[:, :, 1] = point(rows[:, :, 0], rows[:, :, 1])
        rows[:, :2, 2], rows[:, :2, 3] = point(rows[:, :2, 2], rows[:, :2, 3])
        rows[:, :2, 4] = ANGLE[copy](rows[:, :2, 4])
        rows[:, 2:, 4] = 0.0
    walls = [
        [tuple(float(v) for v in POINT[copy](*end)) for end in wall] for wall in walls_of(LAYOUT)
    ]
    body_of_entity = BODY_OF_COLOUR
    entity_of_body = [body_of_entity.index(body) for body in range(4)]
    return {
        "trajectories": [[tuple(row) for row in rows[:, e].tolist()] for e in entity_of_body],
        "actions": [["turnleft", "up"], ["up", None]],
        "wall_segs": walls,
        "landmark_centers": [tuple(centre) for centre in LANDMARK_CENTRES.tolist()],
        "sizes": [RADIUS[e] for e in entity_of_body],
        "strengths": [30, 120],
        "entity_color_code": dict(code),
        "goals": [["TE", 0, 1, 1], ["LMO", 1, 2, 1]],
        "modes": [["neutral"], ["neutral"]],
        "simulations": {("neutral", "neutral"): [np.float64(0.5), np.ones((2, 2), bool)]},
        "sampled_beliefs": None,
    }


def processed(
    copy: int | None, code: dict[int, int] = SHUFFLED, stamp: str = STAMP
) -> dict[str, Any]:
    """Return a video of the processed form; agents' tracks are cut, those of items are not."""
    made = record(copy, code)
    tracks = [averaged(np.array(rows), 1 if copy is None else 0) for rows in made["trajectories"]]
    longer = np.repeat(tracks[2][-1:], 7, axis=0)
    return {
        "name": name_of(copy, stamp) + ".mp4",
        "trajectories": [*tracks[:2], *(np.concatenate([track, longer]) for track in tracks[2:])],
        "entity_sizes": made["sizes"],
        "entity_color_code": made["entity_color_code"],
        "physical_goals": made["goals"],
        "wall_segs": made["wall_segs"],
        "landmark_centers": made["landmark_centers"],
        "social_goals": "neutral",
    }
