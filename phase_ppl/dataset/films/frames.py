"""The frames of a video file, and how its pixels lie over those of the package's own pictures."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from phase_ppl.render.frames import BACKGROUND, WALL_PIXELS, Painter
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, shown_path
from phase_ppl.world.files import existing_file
from phase_ppl.world.scene import Scene

Mask = NDArray[np.bool_]

MOST_SAMPLES: Final = 16
BLACK: Final = 110  # largest channel below which a pixel is taken for a wall's
_WIDEST: Final = 1280  # pixels; wider films are made smaller
_ASPECT: Final = 0.1  # relative deviation of an arena's proportions that is allowed
_SIDE: Final = 0.9  # share of each side of the border that must be black
_WHITE: Final = 225


class Film:
    """A video file, decoded by ffmpeg.

    Attributes:
        fps: frames per second, 0 where the file does not say.
        n_frames: how many there are.
        samples: up to 16 of them, evenly spaced, the first among them.

    Raises:
        InvalidEventError: there is no such file, or it is no video.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = existing_file(path)
        self.fps = 0.0
        self.samples: list[Image.Image] = []
        every, self.n_frames = 1, 0
        for frame in self._decoded():
            if self.n_frames % every == 0:
                self.samples.append(frame)
                if len(self.samples) > MOST_SAMPLES:
                    self.samples, every = self.samples[::2], 2 * every
            self.n_frames += 1

    def frames(self, wanted: set[int]) -> Iterator[tuple[int, Image.Image]]:
        """Yield (number, frame) of the wanted ones, in order."""
        with contextlib.closing(self._decoded()) as decoded:
            for number, frame in enumerate(decoded):
                if number in wanted:
                    yield number, frame
                if number >= max(wanted):
                    return

    def _decoded(self) -> Generator[Image.Image, None, None]:
        """Yield all frames, and note how fast they are."""
        import imageio_ffmpeg

        program = imageio_ffmpeg.get_ffmpeg_exe()
        command = [program, "-hide_banner", "-nostats", "-i", str(self.path)]
        command += ["-f", "image2pipe", "-c:v", "ppm", "-"]
        some = False
        with (
            tempfile.TemporaryFile() as said,
            subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said
            ) as process,
        ):
            assert process.stdout is not None
            try:
                while process.stdout.readline():  # of each picture: its kind, size, depth
                    width, height = map(int, process.stdout.readline().split())
                    process.stdout.readline()
                    data = process.stdout.read(3 * width * height)
                    if len(data) < 3 * width * height:
                        break
                    some, frame = True, Image.frombytes("RGB", (width, height), data)
                    smaller = _WIDEST, max(1, round(height * _WIDEST / width))
                    yield frame if width <= _WIDEST else frame.resize(smaller)
                process.wait()
            finally:
                process.kill()
            said.seek(0)
            words = said.read().decode(errors="replace")
        if not some:
            last = (words.split("\n\n")[0].strip().splitlines() or ["it is empty"])[-1]
            raise InvalidEventError(
                f"{shown_path(self.path)}: not a video that can be read ({last.strip()[:200]})"
            )
        rate = re.search(r"Video:.* ([\d.]+) fps", words)
        self.fps = float(rate[1]) if rate else 0.0


class Mapping:
    """Where a film shows the arena, and its frames as the package's painter would draw them.

    The arena's border, black lines all around, is looked for in what is black in every sample;
    the film may be larger, smaller, cut or have bars beside it.

    Args:
        film: the film.
        scene: its arena; nothing else of it matters.

    Attributes:
        scale: pixels of the film per pixel of the painter's picture.

    Raises:
        InvalidEventError: there is no border of the arena's proportions, or more than one.
    """

    def __init__(self, film: Film, scene: Scene) -> None:
        painter = Painter(scene)
        self._size = painter.size
        x0, x1, y0, y1 = scene.arena
        corners = painter.pixel([[x0, y1], [x1, y0]])
        lightest = np.max([np.asarray(frame).max(axis=2) for frame in film.samples], axis=0)
        box = _border(lightest < BLACK, corners[1] - corners[0] + WALL_PIXELS, film, scene)
        lines = [_lines(lightest.T, box[2:], box[:2]), _lines(lightest, box[:2], box[2:])]
        ends = np.array(lines).T  # (first and last line, x and y)
        factor = (ends[1] - ends[0]) / (corners[1] - corners[0])
        shift = ends[0] - factor * corners[0]
        self.scale = float(factor.mean())
        self._affine = (factor[0], 0.0, shift[0], 0.0, factor[1], shift[1])
        off = np.abs(ends - corners).max()
        self._is_own = bool(film.samples[0].size == self._size and off < 0.1)

    def __call__(self, frame: Image.Image) -> NDArray[np.uint8]:
        """Return (height, width, 3) a frame as it would be had the painter drawn it."""
        if not self._is_own:
            frame = frame.transform(
                self._size,
                Image.Transform.AFFINE,
                self._affine,
                Image.Resampling.BICUBIC,
                fillcolor=BACKGROUND,
            )
        return np.asarray(frame, np.uint8)


def _border(black: Mask, size: FloatArray, film: Film, scene: Scene) -> tuple[int, int, int, int]:
    """Return first and last row and column, the last ones not included, of the arena's border."""
    marks, _ = ndimage.label(black, np.ones((3, 3)))
    found = []
    for number, place in enumerate(ndimage.find_objects(marks), 1):
        part = marks[place] == number
        height, width = part.shape
        if min(height, width) < 20 or abs(width / height * size[1] / size[0] - 1) > _ASPECT:
            continue
        thick = max(1, round(width / size[0] * WALL_PIXELS))
        sides = part[:thick], part[-thick:], part[:, :thick].T, part[:, -thick:].T
        if min(side.any(axis=0).mean() for side in sides) >= _SIDE and part.mean() < 0.5:
            rows, columns = place
            found.append((height * width, (rows.start, rows.stop, columns.start, columns.stop)))
    found.sort(reverse=True)
    if not found:
        x0, x1, y0, y1 = scene.arena
        raise InvalidEventError(
            f"{shown_path(film.path)}: no arena is found in the picture: expected a black border, "
            f"{x1 - x0:g} to {y1 - y0:g} in its proportions, as the world {scene.world.name} has it"
        )
    if len(found) > 1 and found[1][0] > 0.8 * found[0][0]:
        raise InvalidEventError(
            f"{shown_path(film.path)}: {len(found)} arenas beside each other are in the picture; "
            "cut out the one that is to be read"
        )
    return found[0][1]


def _lines(
    lightest: NDArray[np.uint8], across: tuple[int, int], along: tuple[int, int]
) -> tuple[float, float]:
    """Return where, across the rows of a picture, the middles of two lines of the border lie.

    The darkness' centre of mass, in columns where both sides of the line are white.
    """
    low, high = across
    thick = max(1, round((high - low) / 80))  # wide enough to hold the line and its blur
    inside = slice(along[0] + 2 * thick, max(along[1] - 2 * thick, along[0] + 2 * thick + 1))
    padded = np.pad(lightest, ((3 * thick, 3 * thick), (0, 0)), constant_values=255)

    def middle(edge: int, inwards: int) -> float:
        first = edge + inwards * thick
        band = padded[max(first, 0) : first + 6 * thick, inside].astype(float)
        dark = np.maximum(255 - band, 0.0)
        plain = (band[0] > _WHITE) & (band[-1] > _WHITE)
        dark = np.maximum(BLACK - band, 0.0) if plain.mean() < 0.05 else dark[:, plain]
        profile = np.median(dark, axis=1)
        profile[profile < 0.03 * profile.max()] = 0.0
        places = np.arange(len(profile)) + max(first, 0) - 3 * thick + 0.5
        return float((profile * places).sum() / profile.sum())

    return middle(low, 1), middle(high, -1)
