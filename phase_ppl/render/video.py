"""Animations: an event, or what was observed beside what was predicted, as MP4."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from PIL import Image

from phase_ppl.render.encoder import encode
from phase_ppl.render.frames import Painter
from phase_ppl.render.panels import PANEL, panel, side_by_side, write_centred
from phase_ppl.render.tracks import Drawable, FloatArray, between_frames, scene_and_trajectory
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.files import atomic_output
from phase_ppl.world.scene import Scene

FRAMES_PER_SECOND: Final = 20
FRAMES_PER_STEP: Final = 5
"""At 20 frames per second a planner step is shown for 0.25 s, three times its simulated time."""

CAPTIONS: Final = ("observed", "predicted")
_CAPTION_SIZE: Final = 20
_CAPTION_Y: Final = 19


def video(
    what: Drawable,
    path: str | os.PathLike[str],
    scene: Scene | None = None,
    *,
    fps: float = FRAMES_PER_SECOND,
    frames_per_step: int = FRAMES_PER_STEP,
    compare: Drawable | None = None,
    captions: tuple[str, str] = CAPTIONS,
    progress: bool = False,
) -> None:
    """Write an animation in the look of the PHASE videos as MP4 (H.264).

    Frames of a trajectory are means over a step; between them, bodies are drawn on straight lines.

    Args:
        what: an event, an observation, or an array (time, entity, coord) of x, y, angle.
        path: the file, ending in ".mp4"; it appears only once it is complete.
        scene: walls, landmarks and sizes; needed unless ``what`` is an event.
        fps: frames per second.
        frames_per_step: drawn frames per frame of the trajectory.
        compare: a second trajectory, drawn beside the first in the same scene, or an event, in
            its own. The shorter of the two stands still at its end.
        captions: what is written above the two.
        progress: whether to show a progress bar.

    Raises:
        OutputError: another file ending, or the file cannot be written.
        InvalidSettingError: no scene, or ``fps`` or ``frames_per_step`` is not positive.
        InvalidEventError: a trajectory of another shape, or not finite.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise InvalidSettingError(f"fps={fps!r}, expected a positive number")
    if not isinstance(frames_per_step, int) or frames_per_step < 1:
        raise InvalidSettingError(f"frames_per_step={frames_per_step!r}, expected 1, 2, ...")
    shown = [scene_and_trajectory(what, scene)]
    if compare is not None:
        beside = None if isinstance(compare, Event) else shown[0][0]
        shown.append(scene_and_trajectory(compare, beside))
    painters = [Painter(of) for of, _ in shown]
    poses = _equally_long([between_frames(track, frames_per_step) for _, track in shown])
    if compare is None:
        frames = (painters[0].draw(pose) for pose in poses[0])
    else:
        frames = (
            _beside(painters[0].draw(first), painters[1].draw(second), captions)
            for first, second in zip(*poses, strict=True)
        )
    with atomic_output(path, (".mp4",)) as part:
        encode(_with_progress(frames, len(poses[0]), progress), part, fps)


def _equally_long(tracks: list[FloatArray]) -> list[FloatArray]:
    longest = max(len(track) for track in tracks)
    still = [np.repeat(track[-1:], longest - len(track), axis=0) for track in tracks]
    return [np.concatenate(parts) for parts in zip(tracks, still, strict=True)]


def _beside(first: Image.Image, second: Image.Image, captions: tuple[str, str]) -> Image.Image:
    picture = side_by_side([panel(first), panel(second)])
    for index, text in enumerate(captions):
        write_centred(picture, text, (index + 0.5) * PANEL, _CAPTION_Y, _CAPTION_SIZE)
    return picture


def _with_progress(
    frames: Iterator[Image.Image], total: int, progress: bool
) -> Iterable[Image.Image]:
    if not progress:
        return frames
    from tqdm import tqdm

    bar: Iterable[Image.Image] = tqdm(frames, total=total, unit="frame")
    return bar
