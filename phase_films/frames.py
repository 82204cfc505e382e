"""A film's frames as the package would draw them, and the parts that stand still."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import tempfile
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import IO, Final

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import phase_ppl as ppl

Mask = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]
Painter = ppl.render.Painter

MOST_SAMPLES: Final = 16
_WALL: Final = Painter.wall_pixels
BLACK: Final = 110  # largest channel of a wall's pixel
_WIDEST: Final = 1280  # pixels; wider films are made smaller
_ASPECT: Final = 0.1  # relative deviation of an arena's proportions that is allowed
_SIDE: Final = 0.9  # share of each side of the border that must be black
_WHITE: Final = 225

NOBODY: Final = 255  # label of a pixel whose colour belongs to nobody
_APART: Final = 20.0  # least distance of colours, of 255, that a film can distinguish
_FAR: Final = 70.0  # distance from a colour beyond which a pixel belongs to nobody
_BITS: Final = 5  # bits of a channel that decide the label
_SNAP: Final = 0.15  # units within which measured places take the world's values
_LEAST: Final = 0.5  # share of walls and landmarks of a scene that a film must show


class Film:
    """A video file, decoded by ffmpeg (InvalidEventError: it is missing, or no video)."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = ppl.files.existing_file(path)
        self.said = ppl.errors.shown_path(self.path)  # its name in messages
        self.fps = 0.0  # frames per second, 0 if the file does not say
        self.samples: list[Image.Image] = []  # evenly spaced, the first frame among them
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
        """Yield all frames, and note the frame rate."""
        options = ["-hide_banner", "-nostats", "-i", str(self.path)]
        options += ["-f", "image2pipe", "-c:v", "ppm", "-"]
        some = False
        with tempfile.TemporaryFile() as said, self._started(options, said) as process:
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
            raise ppl.errors.InvalidEventError(
                f"{self.said}: not a video that can be read ({last.strip()[:200]})"
            )
        rate = re.search(r"Video:.* ([\d.]+) fps", words)
        self.fps = float(rate[1]) if rate else 0.0

    def _started(self, options: Sequence[str], said: IO[bytes]) -> subprocess.Popen[bytes]:
        program = "ffmpeg"
        try:
            program = imageio_ffmpeg.get_ffmpeg_exe()
            # Ctrl-C reaches Python only, which then ends it
            return subprocess.Popen(
                [program, *options], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said,
                start_new_session=True,
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            reason = (isinstance(error, OSError) and error.strerror) or "there is none"
            raise ppl.errors.InvalidEventError(
                f"{self.said}: ffmpeg cannot be started ({program}: {reason}): install "
                "it, or let the environment variable IMAGEIO_FFMPEG_EXE name it"
            ) from error


class View:
    """Maps a film's frames to frames as the painter would draw them.

    The arena's border, black lines all around, is sought where every sample is black. The film may
    be larger, smaller, cut or have bars beside it. A pixel of the painter's picture is ``scale``
    pixels of the film wide.
    """

    def __init__(self, film: Film, scene: ppl.Scene) -> None:
        painter = Painter(scene)
        self._size = painter.size
        x0, x1, y0, y1 = scene.arena
        corners = painter.pixel([[x0, y1], [x1, y0]])
        lightest = np.max([np.asarray(frame).max(axis=2) for frame in film.samples], axis=0)
        box = _border(lightest < BLACK, corners[1] - corners[0] + _WALL, film, scene)
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
                fillcolor=Painter.background,
            )
        return np.asarray(frame, np.uint8)


def _border(
    black: Mask, size: FloatArray, film: Film, scene: ppl.Scene
) -> tuple[int, int, int, int]:
    """Return first and last row and column of the arena's border, the last ones excluded."""
    marks, _ = ndimage.label(black, np.ones((3, 3)))
    found = []
    for number, place in enumerate(ndimage.find_objects(marks), 1):
        part = marks[place] == number
        height, width = part.shape
        if min(height, width) < 20 or abs(width / height * size[1] / size[0] - 1) > _ASPECT:
            continue
        thick = max(1, round(width / size[0] * _WALL))
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


# --- parts that stand still ----------------------------------------------------------------------


class Colours:
    """The colours of a world, by which pixels are labelled.

    Labels number entities, then landmarks, background and walls. InvalidSettingError: an entity
    has the colour of something else.
    """

    def __init__(self, world: ppl.World) -> None:
        self.names = (*world.entities, *world.landmark_names, "background", "walls")
        marks = (one.colour for one in world.landmarks)
        self.values = np.array(
            [*world.entity_colours, *marks, Painter.background, Painter.wall_colour], float
        )
        self._n = len(world.entities)
        for one in range(self._n):
            for other in range(one + 1, len(self.names)):
                if np.linalg.norm(self.values[one] - self.values[other]) < _APART:
                    raise ppl.errors.InvalidSettingError(
                        f"the colours of {self.names[one]} and {self.names[other]} are "
                        f"{tuple(self.values[one].astype(int).tolist())} and "
                        f"{tuple(self.values[other].astype(int).tolist())}: too near each other "
                        "to be told apart in a film"
                    )
        levels = (np.arange(2**_BITS) + 0.5) * 2 ** (8 - _BITS)
        grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
        off = np.linalg.norm(grid[..., None, :] - self.values, axis=-1)
        table = off.argmin(axis=-1).astype(np.uint8)
        table[off.min(axis=-1) > _FAR] = NOBODY
        self._table = table

    def labels(self, frame: Pixels) -> Pixels:
        """Return (height, width) labels of the pixels, or ``NOBODY``."""
        part = frame >> (8 - _BITS)
        return np.asarray(self._table[part[..., 0], part[..., 1], part[..., 2]])


class Still:
    """The parts of a film that stand still, mapped to the painter's picture.

    Its ``floor``, (height, width, 3), is the picture without bodies. These have the (entity, 3)
    ``body_colours`` in the film.
    """

    def __init__(self, samples: Sequence[Pixels], colours: Colours, painter: Painter) -> None:
        n = len(painter.scene.world.entities)
        self._painter, self._colours = painter, colours
        total = np.zeros(samples[0].shape)
        count = np.zeros(samples[0].shape[:2])
        self._seen = np.zeros((len(colours.names) - n, *samples[0].shape[:2]), bool)
        self._lightest = np.max([frame.max(axis=2) for frame in samples], axis=0)
        self._agents = np.ones(samples[0].shape[:2], bool)  # an agent is there in every sample
        own: list[list[FloatArray]] = [[] for _ in range(n)]  # away from edges, which are mixed
        for frame in samples:
            labels = colours.labels(frame)
            self._agents &= labels < len(painter.scene.world.agents)
            for part in range(n, len(colours.names)):
                self._seen[part - n] |= labels == part
            inner = ndimage.minimum_filter(labels, 5) == ndimage.maximum_filter(labels, 5)
            for entity in range(n):
                own[entity].append(frame[inner & (labels == entity)].astype(float))
            free = ndimage.minimum_filter(labels, 7) >= n
            total[free] += frame[free]
            count[free] += 1
        plain = np.asarray(painter.floor, float)
        self.floor = np.where(count[..., None] > 0, total / np.maximum(count, 1)[..., None], plain)
        self.body_colours = np.empty((n, 3))
        for entity, parts in enumerate(own):
            pixels = np.concatenate(parts)
            if len(pixels) < 20:
                raise ppl.errors.InvalidEventError(
                    f"nothing in the film has the colour of the {colours.names[entity]}, "
                    f"{tuple(colours.values[entity].astype(int).tolist())}"
                )
            self.body_colours[entity] = np.median(pixels, axis=0)

    def landmarks(self) -> tuple[FloatArray, FloatArray]:
        """Return (landmark, 2) centres and (landmark,) half-widths of the squares, units.

        They are the world's, unless the film shows them elsewhere.
        """
        world = self._painter.scene.world
        centres, halves = [], []
        for index, one in enumerate(world.landmarks):
            seen = self._mark(index)
            inside, area = self._square((one.x, one.y), one.half_width)
            shown = (seen & inside).sum()
            centre, half = np.array([one.x, one.y]), float(one.half_width)
            if shown < _LEAST * area or shown < 0.95 * seen.sum():
                rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
                if not len(rows):
                    raise ppl.errors.InvalidEventError(
                        f"nothing in the film has the colour of the {one.name}, {one.colour}"
                    )
                low = self._painter.units([columns[0], rows[-1] + 1])
                high = self._painter.units([columns[-1] + 1, rows[0]])
                centre = np.round((low + high) / 2, 1)
                half = round(float((high - low).max()) / 2, 1)
            centres.append(centre)
            halves.append(half)
        return np.array(centres), np.array(halves)

    def walls(self) -> FloatArray:
        """Return (n, 2, 2) end points of the inner walls, units: the black lines in the arena."""
        painter = self._painter
        black = self._lightest < BLACK
        found = []
        for axis in (0, 1):
            length = np.ones((2 * _WALL, 1) if axis == 0 else (1, 2 * _WALL), bool)
            marks, _ = ndimage.label(ndimage.binary_opening(black, length))
            for number, place in enumerate(ndimage.find_objects(marks), 1):
                along, across = place if axis == 0 else place[::-1]
                thick = (marks[place] == number).sum() / (along.stop - along.start)
                if thick > 2 * _WALL or self._is_eye(place):
                    continue
                middle = (across.start + across.stop) / 2
                ends = along.start + _WALL / 2, along.stop - _WALL / 2
                points = [(middle, end) if axis == 0 else (end, middle) for end in ends]
                found.append(self._snapped(painter.units(points)))
        return np.array(self._inner(found)).reshape(-1, 2, 2)

    def _is_eye(self, place: tuple[slice, slice]) -> bool:
        """Whether a black spot lies within a body: the eye of an agent that never moves."""
        rows, columns = (slice(max(0, part.start - 3), part.stop + 3) for part in place)
        return bool(self._agents[rows, columns].mean() > 0.4)

    def _snapped(self, wall: FloatArray) -> FloatArray:
        """Return end points with coordinates of the world if near, else rounded to tenths."""
        scene = self._painter.scene
        x0, x1, y0, y1 = scene.arena
        known = np.concatenate([[[x0, y0], [x1, y1], scene.centre], *np.array(scene.world.walls)])
        off = np.abs(wall[:, None] - known)
        nearest = np.take_along_axis(known, off.argmin(axis=1), axis=0)
        result = np.where(off.min(axis=1) < _SNAP, nearest, np.round(wall, 1))
        across = int(np.ptp(wall, axis=0).argmin())
        result[:, across] = result[0, across]
        return np.asarray(result)

    def _inner(self, walls: Sequence[FloatArray]) -> list[FloatArray]:
        """Return the walls without the border; if rooms are quadrants, cut at the centre."""
        scene = self._painter.scene
        x0, x1, y0, y1 = scene.arena
        low, high, centre = np.array([x0, y0]), np.array([x1, y1]), scene.centre
        inner: list[FloatArray] = []
        for wall in walls:
            along = int(np.ptp(wall, axis=0).argmax())
            across = 1 - along
            if np.ptp(wall, axis=0)[along] < 2 * _SNAP or (
                np.abs(wall[0, across] - np.array([low, high])[:, across]).min() < _SNAP
            ):
                continue
            ends = np.sort(wall[:, along])
            cut = scene.world.quadrants and ends[0] < centre[along] < ends[1]
            parts = [(centre[along], ends[1]), (centre[along], ends[0])] if cut else [tuple(ends)]
            for first, last in parts:
                one = np.array(wall)
                one[:, along] = first, last
                if scene.world.quadrants and abs(last - centre[along]) < _SNAP:
                    one = one[::-1]  # from the centre
                inner.append(one)
        return inner

    def check(self, scene: ppl.Scene) -> None:
        """Raise InvalidEventError unless the film shows the scene's walls and landmarks."""
        black = self._lightest < BLACK
        for wall in scene.walls:
            points = wall[0] + np.linspace(0, 1, 50)[:, None] * (wall[1] - wall[0])
            columns, rows = self._painter.pixel(points).astype(int).T
            if black[rows, columns].mean() < 1 - _LEAST / 5:
                raise ppl.errors.InvalidEventError(
                    f"the film does not show the scene's wall {wall.tolist()}: it is of another "
                    "scene; give a layout instead, and walls are found in the film"
                )
        extra = [wall for wall in self.walls() if not _covered(wall, scene.walls)]
        if extra:
            raise ppl.errors.InvalidEventError(
                f"the film shows a wall {extra[0].tolist()} that the scene does not have: it is "
                "of another scene; give a layout instead, and walls are found in the film"
            )
        for index, (name, centre, half) in enumerate(
            zip(scene.world.landmark_names, scene.landmark_centres, scene.half_widths, strict=True)
        ):
            inside, area = self._square(centre, half)
            if (self._mark(index) & inside).sum() < _LEAST * area:
                raise ppl.errors.InvalidEventError(
                    f"the film does not show the scene's {name} at {centre.tolist()}"
                )

    def _mark(self, landmark: int) -> Mask:
        """Return where a landmark's colour is seen at some time, without edges of other things."""
        return np.asarray(ndimage.binary_opening(self._seen[landmark], np.ones((5, 5))))

    def _square(self, centre: Sequence[float] | FloatArray, half: float) -> tuple[Mask, float]:
        """Return the pixels of a square and its surroundings, and how many of these lie within."""
        corners = self._painter.pixel(np.array(centre) + half * np.array([[-1, 1], [1, -1]]))
        (left, top), (right, bottom) = corners.round().astype(int)
        mask = np.zeros(self._lightest.shape, bool)
        mask[max(0, top - 2) : bottom + 2, max(0, left - 2) : right + 2] = True
        return mask, float((right - left) * (bottom - top))


def _covered(wall: FloatArray, by: FloatArray) -> bool:
    """Whether most points of a wall lie on some wall."""
    points = wall[0] + np.linspace(0, 1, 21)[:, None] * (wall[1] - wall[0])
    covered = np.zeros(len(points), bool)
    for one in by:
        low, high = one.min(axis=0) - 2 * _SNAP, one.max(axis=0) + 2 * _SNAP
        covered |= ((points >= low) & (points <= high)).all(axis=1)
    return bool(covered.mean() > 0.8)
