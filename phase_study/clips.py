"""The short films of the introduction: PHASE's, and those for any world."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import phase_ppl as ppl

_WAIT, _GO, _BACK = ppl.Action.NO_FORCE, ppl.Action.UP, ppl.Action.DOWN
_LEFT, _RIGHT, _STOP = ppl.Action.TURN_LEFT, ppl.Action.TURN_RIGHT, ppl.Action.STOP
_WALL: Final = [[[16.0, 12.0], [16.0, 22.0]]]
_FAR: Final = ((9.0, 4.5, 0.0), (23.0, 4.5, 0.0))
"""Place of items that have no part in a clip."""

Track = Sequence[tuple[ppl.Action, int]]
"""An agent's actions, each with its number of planner steps."""


@dataclasses.dataclass(frozen=True)
class Clip:
    """A film: start poses, and the actions of red and green; further agents repeat them in turn."""

    start: Sequence[tuple[float, float, float]]
    red: Track
    green: Track
    radius: Sequence[float] = (1.2, 1.2, 1.2, 1.2)
    strength: float = 450.0
    walls: Sequence[Sequence[Sequence[float]]] = ()
    sight: bool = False

    def scene(self, world: ppl.World = ppl.worlds.PHASE) -> ppl.Scene:
        """Return the scene of the clip; in another world than PHASE, a random one."""
        if world != ppl.worlds.PHASE:
            return world.random_scene(0)
        return ppl.Scene(np.array(self.start), np.array(self.radius), np.array(self.walls))

    def trajectory(self, scene: ppl.Scene) -> NDArray[np.float64]:
        """Return the (time, entity, coord) trajectory of the agents' actions."""
        n_agents = len(scene.world.agents)
        tracks = ((self.red, self.green)[agent % 2] for agent in range(n_agents))
        actions = ([action for action, n in track for _ in range(n)] for track in tracks)
        stage = ppl.Stage(scene, [self.strength] * n_agents)
        return np.array([scene.start, *map(stage.step, zip(*actions, strict=True))])


_SIDEWAYS: Final = -np.pi / 2  # angle of an agent that looks to the right

CLIPS: Final[Mapping[str, Clip]] = {
    "moving": Clip(
        [(11.0, 9.0, 0.0), (20.0, 16.0, np.pi), *_FAR],
        [(_GO, 5), (_STOP, 1), (_WAIT, 4), (_RIGHT, 2), (_GO, 5), (_STOP, 1), (_WAIT, 6)],
        [(_WAIT, 8), (_GO, 4), (_STOP, 1), (_LEFT, 2), (_GO, 5), (_STOP, 1), (_WAIT, 3)],
        strength=300.0,
    ),
    "walls": Clip(
        [(10.0, 17.0, _SIDEWAYS), (22.0, 15.0, np.pi), *_FAR],
        [(_GO, 12), (_BACK, 4), (_WAIT, 8)],
        [(_WAIT, 8), (_GO, 6), (_WAIT, 10)],
        walls=_WALL,
    ),
    "carrying": Clip(
        [(11.0, 12.0, _SIDEWAYS), (22.0, 18.0, np.pi), (15.0, 12.0, 0.0), _FAR[1]],
        [(_GO, 3), (_WAIT, 2), (ppl.Action.ATTACH, 1), (_GO, 7), (_STOP, 2), (ppl.Action.DETACH, 1),
         (_BACK, 6), (_WAIT, 3)],
        [(_WAIT, 25)],
    ),
    "weight": Clip(
        [(9.0, 16.0, _SIDEWAYS), (9.0, 8.0, _SIDEWAYS), (12.5, 16.0, 0.0), (12.5, 8.0, 0.0)],
        [(_GO, 10), (_WAIT, 12)],
        [(_GO, 10), (_WAIT, 12)],
        strength=300.0,
        radius=(1.2, 1.2, 0.8, 1.6),
    ),
    "sight": Clip(
        [(11.0, 16.0, 0.0), (21.0, 16.0, np.pi), *_FAR],
        [(_RIGHT, 6), (_WAIT, 4), (_RIGHT, 6), (_WAIT, 6)],
        [(_WAIT, 6), (_LEFT, 6), (_GO, 4), (_WAIT, 6)],
        walls=_WALL,
        sight=True,
    ),
}  # fmt: skip
"""Name, as ``study.toml`` uses it -> film."""


def clips_of(world: ppl.World) -> Mapping[str, Clip]:
    """Return the films for a world; for others than PHASE, its agents moving about."""
    moving = CLIPS["moving"]
    about = {"moving": moving, "sight": dataclasses.replace(moving, strength=450.0, sight=True)}
    return CLIPS if world == ppl.worlds.PHASE else about


def make_clips(folder: Path, world: ppl.World = ppl.worlds.PHASE) -> None:
    """Write the missing films into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, clip in clips_of(world).items():
        if not (path := folder / f"{name}.mp4").is_file():
            scene = clip.scene(world)
            track = ppl.Observation(clip.trajectory(scene))
            ppl.render.video(track, path, scene, fields_of_view=clip.sight)
