"""What is drawn: an event, an observation or bare trajectories, and the poses between frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene, finite_array

Drawable = Event | Observation | ArrayLike
"""Anything with trajectories; all but an event need a scene beside them."""


def scene_and_trajectory(what: Drawable, scene: Scene | None) -> tuple[Scene, FloatArray]:
    """Return the scene and the (time, entity, coord) trajectory to draw.

    Args:
        what: an event, an observation, or an array (time, entity, coord) with coord = x, y, angle.
        scene: drawn instead of the event's own; needed for anything but an event.

    Raises:
        InvalidSettingError: no scene.
        InvalidEventError: not such an array, not finite, or without frames.
    """
    if isinstance(what, Event):
        return scene or what.scene, what.observation.trajectory
    if scene is None:
        raise InvalidSettingError("a trajectory alone does not say what to draw: give its scene=")
    given = what.trajectory if isinstance(what, Observation) else what
    trajectory = finite_array("trajectory", given, (None, len(ENTITIES), 3))
    if len(trajectory) == 0:
        raise InvalidEventError("trajectory has no frames")
    return scene, trajectory


def between_frames(trajectory: FloatArray, frames_per_step: int) -> FloatArray:
    """Return the poses of every drawn frame, straight lines between the trajectory's frames.

    Angles turn the shorter way round. The result has (T - 1) * frames_per_step + 1 frames.
    """
    smooth = np.array(trajectory)
    smooth[..., 2] = np.unwrap(smooth[..., 2], axis=0)
    moments = np.arange((len(smooth) - 1) * frames_per_step + 1) / frames_per_step
    before = np.minimum(moments.astype(int), len(smooth) - 1)
    after = np.minimum(before + 1, len(smooth) - 1)
    weight = (moments - before)[:, None, None]
    return np.asarray((1 - weight) * smooth[before] + weight * smooth[after])
