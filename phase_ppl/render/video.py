"""Animations: an event, or what was observed beside what was predicted, as MP4 or GIF."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from PIL import Image

from phase_ppl.render.encoder import MAX_GIF_FPS, encode_gif, encode_mp4
from phase_ppl.render.frames import Painter
from phase_ppl.render.panels import PANEL, panel, side_by_side, write_centred
from phase_ppl.render.tracks import Drawable, between_frames, scene_and_trajectory
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import positive_number, whole_number
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, atomic_output
from phase_ppl.world.scene import Scene

FRAMES_PER_SECOND: Final = 20
FRAMES_PER_STEP: Final = 5
"""At 20 frames per second a planner step is shown for 0.25 s, three times its simulated time."""

_SAMPLES: Final = 24
"""Frames, evenly spaced, whose colours a GIF has."""

SUFFIXES: Final = (".mp4", ".gif")
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
    fields_of_view: bool = False,
    compare: Drawable | None = None,
    captions: tuple[str, str] = CAPTIONS,
    progress: bool = False,
) -> None:
    """Write an animation in the look of the PHASE videos as MP4 (H.264) or GIF.

    Frames of a trajectory are means over a step; between them, bodies are drawn on straight lines.

    Args:
        what: an event, an observation, or an array (time, entity, coord) of x, y, angle.
        path: the file, ending in ".mp4" or ".gif"; it appears only once it is complete.
        scene: walls, landmarks and sizes; needed unless ``what`` is an event.
        fps: frames per second, of a GIF at most 50.
        frames_per_step: drawn frames per frame of the trajectory.
        fields_of_view: whether to show what each agent can see from where it is drawn, by the
            rule of the simulator (:mod:`phase_ppl.render.sight`).
        compare: a second trajectory, drawn beside the first in the same scene, or an event, in
            its own. The shorter of the two stands still at its end.
        captions: what is written above the two.
        progress: whether to show a progress bar.

    Raises:
        OutputError: another file ending, or the file cannot be written.
        InvalidSettingError: no scene, or ``fps`` or ``frames_per_step`` is out of range.
        InvalidEventError: a trajectory of another shape, or not finite.
    """
    positive_number("fps", fps)
    as_gif = as_path(path).suffix.lower() == ".gif"
    if as_gif and fps > MAX_GIF_FPS:
        raise InvalidSettingError(f"fps={fps!r}, but a GIF has at most {MAX_GIF_FPS} a second")
    whole_number("frames_per_step", frames_per_step)
    shown = [scene_and_trajectory(what, scene)]
    if compare is not None:
        beside = None if isinstance(compare, Event) else shown[0][0]
        shown.append(scene_and_trajectory(compare, beside))
    painters = [Painter(of, fields_of_view) for of, _ in shown]
    poses = _equally_long([between_frames(track, frames_per_step) for _, track in shown])
    n_frames = len(poses[0])

    def draw(index: int) -> Image.Image:
        drawn = [painter.draw(track[index]) for painter, track in zip(painters, poses, strict=True)]
        return drawn[0] if compare is None else _beside(drawn, captions)

    with atomic_output(path, SUFFIXES) as part:
        frames = _with_progress(map(draw, range(n_frames)), n_frames, progress)
        if as_gif:
            chosen = np.linspace(0, n_frames - 1, min(_SAMPLES, n_frames)).round().astype(int)
            encode_gif(frames, part, fps, samples=map(draw, chosen))
        else:
            encode_mp4(frames, part, fps)


def _equally_long(tracks: list[FloatArray]) -> list[FloatArray]:
    longest = max(len(track) for track in tracks)
    still = [np.repeat(track[-1:], longest - len(track), axis=0) for track in tracks]
    return [np.concatenate(parts) for parts in zip(tracks, still, strict=True)]


def _beside(drawn: list[Image.Image], captions: tuple[str, str]) -> Image.Image:
    picture = side_by_side([panel(frame) for frame in drawn])
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
