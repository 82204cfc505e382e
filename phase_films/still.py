"""The parts of a film that stand still: floor, walls and landmarks, told by their colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import ndimage

import phase_ppl as ppl
from phase_films.view import BLACK, WALL, FloatArray, Mask, Pixels

NOBODY: Final = 255  # label of a pixel whose colour belongs to nobody
_APART: Final = 20.0  # least distance of colours, of 255, that a film can distinguish
_FAR: Final = 70.0  # distance from a colour beyond which a pixel belongs to nobody
_BITS: Final = 5  # bits of a channel that decide the label
_SNAP: Final = 0.15  # units within which measured places take the world's values
_LEAST: Final = 0.5  # share of walls and landmarks of a scene that a film must show


class Colours:
    """The colours of a world, by which pixels are labelled.

    Labels number entities, then landmarks, background and walls. InvalidSettingError: an entity
    has the colour of something else.
    """

    def __init__(self, world: ppl.World) -> None:
        self.names = (*world.entities, *world.landmark_names, "background", "walls")
        marks = (one.colour for one in world.landmarks)
        self.values = np.array(
            [
                *world.entity_colours,
                *marks,
                ppl.render.Painter.background,
                ppl.render.Painter.wall_colour,
            ],
            float,
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

    def __init__(
        self, samples: Sequence[Pixels], colours: Colours, painter: ppl.render.Painter
    ) -> None:
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
            length = np.ones((2 * WALL, 1) if axis == 0 else (1, 2 * WALL), bool)
            marks, _ = ndimage.label(ndimage.binary_opening(black, length))
            for number, place in enumerate(ndimage.find_objects(marks), 1):
                along, across = place if axis == 0 else place[::-1]
                thick = (marks[place] == number).sum() / (along.stop - along.start)
                if thick > 2 * WALL or self._is_eye(place):
                    continue
                middle = (across.start + across.stop) / 2
                ends = along.start + WALL / 2, along.stop - WALL / 2
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
