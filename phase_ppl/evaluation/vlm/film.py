"""What a vision-language model gets to see of an event: its animation, as video or pictures."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import tempfile
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from phase_ppl.render.frames import HEIGHT, WIDTH, Painter
from phase_ppl.render.video import FRAMES_PER_SECOND, FRAMES_PER_STEP, video
from phase_ppl.world.event import Event
from phase_ppl.world.identity import event_digest
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

VIDEO_TYPE: Final = "video/mp4"
PICTURE_TYPE: Final = "image/png"

RENDERING: Final = {
    "size": [WIDTH, HEIGHT],
    "fps": FRAMES_PER_SECOND,
    "frames_per_step": FRAMES_PER_STEP,
}
"""How videos are drawn: as people saw them, a step in 0.25 s."""

_SECONDS_PER_STEP: Final = FRAMES_PER_STEP / FRAMES_PER_SECOND


class Picture(NamedTuple):
    """A frame of the animation.

    Attributes:
        seconds: when the video shows it.
        png: 640 x 480 pixels.
    """

    seconds: float
    png: bytes


class Film:
    """The animation of an event, drawn when it is first asked for.

    Args:
        scene, observation: what is shown.
        n_pictures: how many frames :attr:`pictures` has, at most.
    """

    def __init__(self, scene: Scene, observation: Observation, n_pictures: int) -> None:
        self._scene, self._observation = scene, observation
        last = observation.n_frames - 1
        count = min(n_pictures, last + 1)
        self._chosen = np.linspace(0, last, count).round().astype(int).tolist()

    @functools.cached_property
    def video(self) -> bytes:
        """The animation as MP4, 20 frames a second."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "event.mp4"
            video(self._observation, path, self._scene)
            return path.read_bytes()

    @functools.cached_property
    def pictures(self) -> tuple[Picture, ...]:
        """Frames from the first to the last, evenly spaced."""
        painter = Painter(self._scene)
        found = []
        for index, seconds in zip(self._chosen, self.seconds, strict=True):
            content = io.BytesIO()
            painter.draw(self._observation.trajectory[index]).save(content, "PNG")
            found.append(Picture(seconds, content.getvalue()))
        return tuple(found)

    @property
    def seconds(self) -> tuple[float, ...]:
        """When the video shows each of the pictures."""
        return tuple(index * _SECONDS_PER_STEP for index in self._chosen)

    @property
    def digest(self) -> str:
        """A hash of what is drawn and how.

        Not of the files: other versions of an encoder write other bytes of the same animation.
        """
        seen = event_digest(Event(self._scene, self._observation))
        record = json.dumps([seen, RENDERING, self._chosen])
        return hashlib.sha256(record.encode()).hexdigest()

    def drawn(self) -> dict[str, object]:
        """Return what has been asked for until now: its size in bytes and a hash of its bytes."""
        found: dict[str, object] = {}
        for name in ("video", "pictures"):
            if name in vars(self):
                parts = [self.video] if name == "video" else [each.png for each in self.pictures]
                content = b"".join(parts)
                found[name] = {
                    "files": len(parts),
                    "bytes": len(content),
                    "sha256": hashlib.sha256(content).hexdigest(),
                }
        return found
