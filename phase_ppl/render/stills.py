"""Pictures of an event: one frame, or a film strip."""

from __future__ import annotations

import os
from typing import Final

import numpy as np
from PIL import Image

from phase_ppl.render.frames import Painter
from phase_ppl.render.panels import panel, side_by_side, write_centred
from phase_ppl.render.tracks import Drawable, scene_and_trajectory
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.files import atomic_output
from phase_ppl.world.observation import FRAMES_PER_SECOND
from phase_ppl.world.scene import Scene

_STRIP_PANEL: Final = 300
_STRIP_CAPTION: Final = 36
_STRIP_TEXT_SIZE: Final = 22


def image(
    what: Drawable,
    frame: int,
    path: str | os.PathLike[str],
    scene: Scene | None = None,
    *,
    fields_of_view: bool = False,
) -> None:
    """Write one frame as a 640 x 480 PNG.

    Args:
        what: an event, an observation, or an array (time, entity, coord) of x, y, angle.
        frame: index of the frame; -1 is the last one.
        path: the file, ending in ".png".
        scene: walls, landmarks and sizes; needed unless ``what`` is an event.
        fields_of_view: whether to show what each agent can see, by the rule of the simulator.

    Raises:
        OutputError: another file ending, or the file cannot be written.
        InvalidSettingError: no such frame, or no scene.
        InvalidEventError: a trajectory of another shape, or not finite.
    """
    scene, trajectory = scene_and_trajectory(what, scene)
    n_frames = len(trajectory)
    if not -n_frames <= frame < n_frames:
        raise InvalidSettingError(f"frame={frame}, expected one of 0..{n_frames - 1}")
    picture = Painter(scene, fields_of_view).draw(trajectory[frame])
    with atomic_output(path, (".png",)) as part:
        picture.save(part, "PNG")


def strip(
    what: Drawable,
    path: str | os.PathLike[str],
    n: int = 6,
    scene: Scene | None = None,
    *,
    fields_of_view: bool = False,
) -> None:
    """Write a film strip as PNG: ``n`` frames from first to last, evenly spaced.

    Lines show the ways since the picture before; the time below is simulated seconds.

    Args:
        what: an event, an observation, or an array (time, entity, coord) of x, y, angle.
        path: the file, ending in ".png".
        n: how many frames, at most all.
        scene: walls, landmarks and sizes; needed unless ``what`` is an event.
        fields_of_view: whether to show what each agent can see, by the rule of the simulator.

    Raises:
        OutputError: another file ending, or the file cannot be written.
        InvalidSettingError: ``n`` is not in 1..T, or no scene.
        InvalidEventError: a trajectory of another shape, or not finite.
    """
    picture = draw_strip(what, n, scene, fields_of_view)
    with atomic_output(path, (".png",)) as part:
        picture.save(part, "PNG")


def draw_strip(
    what: Drawable, n: int = 6, scene: Scene | None = None, fields_of_view: bool = False
) -> Image.Image:
    """Return the picture that :func:`strip` writes: panels 300 pixels wide, 36 rows below.

    Raises:
        InvalidSettingError, InvalidEventError: as :func:`strip`.
    """
    scene, trajectory = scene_and_trajectory(what, scene)
    if not 1 <= n <= len(trajectory):
        raise InvalidSettingError(f"n={n}, expected one of 1..{len(trajectory)}")
    painter = Painter(scene, fields_of_view)
    chosen = np.linspace(0, len(trajectory) - 1, n).round().astype(int)
    panels: list[Image.Image] = []
    for before, frame in zip([0, *chosen[:-1]], chosen, strict=True):
        drawn = painter.draw(trajectory[frame], trail=trajectory[before : frame + 1])
        size = (_STRIP_PANEL, _STRIP_PANEL)
        panels.append(panel(drawn).resize(size, Image.Resampling.LANCZOS))
    picture = side_by_side(panels, below=_STRIP_CAPTION)
    for index, frame in enumerate(chosen):
        x, y = (index + 0.5) * _STRIP_PANEL, _STRIP_PANEL + _STRIP_CAPTION / 3
        write_centred(picture, f"{frame / FRAMES_PER_SECOND:.1f} s", x, y, _STRIP_TEXT_SIZE)
    return picture
