"""A film's frames as the package would draw them, found by the arena's border."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import phase_ppl as ppl
from phase_films.film import FilmFile

Mask = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

WALL: Final = ppl.render.Painter.wall_pixels
BLACK: Final = 110  # largest channel of a wall's pixel
_ASPECT: Final = 0.1  # relative deviation of an arena's proportions that is allowed
_SIDE: Final = 0.9  # share of each side of the border that must be black
_WHITE: Final = 225


class View:
    """Maps a film's frames to frames as the painter would draw them.

    The arena's border, black lines all around, is sought where every sample is black. The film may
    be larger, smaller, cut or have bars beside it. A pixel of the painter's picture is ``scale``
    pixels of the film wide.
    """

    def __init__(self, film: FilmFile, scene: ppl.Scene) -> None:
        painter = ppl.render.Painter(scene)
        self._size = painter.size
        x0, x1, y0, y1 = scene.arena
        corners = painter.pixel([[x0, y1], [x1, y0]])
        lightest = np.max([np.asarray(frame).max(axis=2) for frame in film.samples], axis=0)
        box = _border(lightest < BLACK, corners[1] - corners[0] + WALL, film, scene)
        lines = [_lines(lightest.T, box[2:], box[:2]), _lines(lightest, box[:2], box[2:])]
        ends = np.array(lines).T  # (first and last line, x and y)
        factor = (ends[1] - ends[0]) / (corners[1] - corners[0])
        shift = ends[0] - factor * corners[0]
        self.scale = float(factor.mean())
        self._affine = (factor[0], 0.0, shift[0], 0.0, factor[1], shift[1])
        off = np.abs(ends - corners).max()
        self._is_own = bool(film.samples[0].size == self._size and off < 0.1)

    def __call__(self, frame: Image.Image) -> Pixels:
        """Return (height, width, 3) a frame as the painter would have drawn it."""
        if not self._is_own:
            frame = frame.transform(
                self._size,
                Image.Transform.AFFINE,
                self._affine,
                Image.Resampling.BICUBIC,
                fillcolor=ppl.render.Painter.background,
            )
        return np.asarray(frame, np.uint8)


def _border(
    black: Mask, size: FloatArray, film: FilmFile, scene: ppl.Scene
) -> tuple[int, int, int, int]:
    """Return first and last row and column of the arena's border, the last ones excluded."""
    marks, _ = ndimage.label(black, np.ones((3, 3)))
    found = []
    for number, place in enumerate(ndimage.find_objects(marks), 1):
        part = marks[place] == number
        height, width = part.shape
        if min(height, width) < 20 or abs(width / height * size[1] / size[0] - 1) > _ASPECT:
            continue
        thick = max(1, round(width / size[0] * WALL))
        sides = part[:thick], part[-thick:], part[:, :thick].T, part[:, -thick:].T
        if min(side.any(axis=0).mean() for side in sides) >= _SIDE and part.mean() < 0.5:
            rows, columns = place
            found.append((height * width, (rows.start, rows.stop, columns.start, columns.stop)))
    found.sort(reverse=True)
    if not found:
        x0, x1, y0, y1 = scene.arena
        raise ppl.errors.InvalidEventError(
            f"{film.said}: no arena is found in the picture: expected a black border, "
            f"{x1 - x0:g} to {y1 - y0:g} in its proportions, as the world {scene.world.name} has it"
        )
    if len(found) > 1 and found[1][0] > 0.8 * found[0][0]:
        raise ppl.errors.InvalidEventError(
            f"{film.said}: {len(found)} arenas beside each other are in the picture; "
            "cut out the one that is to be read"
        )
    return found[0][1]


def _lines(
    lightest: Pixels, across: tuple[int, int], along: tuple[int, int]
) -> tuple[float, float]:
    """Return the positions, across the rows of a picture, of the middles of two border lines.

    A middle is the darkness' centre of mass, in columns where both sides of the line are white.
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
