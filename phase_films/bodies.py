"""Poses of the bodies in a frame: shapes are fitted to the pixels.

A frame is drawn again as the painter draws it: items below agents below walls, edges as soft as the
film's. Position, angle and perhaps size of one body after another are moved to the least squared
difference. So pixels covered by another body or a wall are no evidence.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

import phase_ppl as ppl
from phase_films.still import Colours, Still
from phase_films.view import FloatArray, Pixels

_CORNERS: Final = ppl.render.Painter.corners

REACH: Final = float(np.hypot(*_CORNERS.T).max())
"""Largest distance of an agent of size 1 from its origin."""

SEEN: Final = 0.3
"""Confidence below which a body counts as lost."""

_ANGLES: Final = 16  # of an agent, tried before the best is improved
_OTHERS: Final = 6  # best ones of those that are improved if the likely one fails
_SURE: Final = 0.9  # confidence from which on nothing else is tried
_BLOB: Final = 0.06  # share of a body's area that must be seen in one piece
_SWEEPS: Final = 3  # over bodies that cover others, or are covered
_MOVED: Final = 0.02  # units by which a body moves for its neighbours to be fitted again
_ROOM: Final = 1.15  # reach of a window, in reaches of its body
_MARGIN: Final = 0.3  # further reach, units
_FINE: Final = 44  # pixels of a window's side up to which all pixels are used
_DELTA: Final = 0.25  # pixels by which slopes are measured
_MOST_TRIES: Final = 30

_SIDES: Final = np.roll(_CORNERS, -1, axis=0) - _CORNERS
_NORMALS: Final = np.column_stack([-_SIDES[:, 1], _SIDES[:, 0]]) / np.hypot(*_SIDES.T)[:, None]
_OFFSETS: Final = (_NORMALS * _CORNERS).sum(axis=1)


class Bodies:
    """Finds bodies in frames that match the painter's picture, edges ``softness`` pixels wide."""

    def __init__(
        self, painter: ppl.render.Painter, still: Still, colours: Colours, softness: float
    ) -> None:
        self.painter, self.still, self.softness = painter, still, max(1.0, softness)
        self._colours = colours
        self._n_agents = len(painter.scene.world.agents)
        self._n = len(painter.scene.world.entities)
        self.order = (*range(self._n_agents, self._n), *range(self._n_agents))
        self.walls = np.asarray(painter.walls, float) / 255

    def is_agent(self, entity: int) -> bool:
        return entity < self._n_agents

    def find(self, frame: Pixels, before: FloatArray | None, radius: FloatArray) -> FloatArray:
        """Return (entity, 4) x, y [units], angle [rad] and confidence; NaN if not seen.

        The confidence is how far body and pixels of its colour agree (the intersection of the two
        over their union), lower if most of the body is covered. A body is sought near its place
        ``before``, (entity, 3), NaN if unknown.
        """
        labels = self._colours.labels(frame)
        found = np.full((self._n, 4), np.nan)
        firsts = [self._firsts(labels, e, before, float(radius[e])) for e in range(self._n)]
        left = [entity for entity in range(self._n) if firsts[entity]]
        for entity in left:
            found[entity, :3] = firsts[entity][0]
        for _ in range(_SWEEPS):
            was = found.copy()
            for entity in left:
                self._improve(frame, labels, entity, found, firsts[entity], radius)
            moved = (np.abs(found - was)[:, :2].max(axis=1) > _MOVED) | (found[:, 3] < SEEN)
            others = np.flatnonzero(moved).tolist()
            left = [e for e in left if any(self._meet(e, m, found, radius) for m in others)]
        return found

    def size(self, frame: Pixels, poses: FloatArray, radius: FloatArray, entity: int) -> float:
        """Return the size with which a body explains a frame best, units."""
        labels, pose = self._colours.labels(frame), poses[entity]
        window = _Window(self, frame, labels, entity, poses, radius, pose)
        return float(window.fit(pose, sized=True)[3])

    def _meet(self, one: int, other: int, found: FloatArray, radius: FloatArray) -> bool:
        reach = REACH * (radius[one] + radius[other])
        return one != other and bool(np.linalg.norm((found[one] - found[other])[:2]) < reach)

    def _firsts(
        self, labels: Pixels, entity: int, before: FloatArray | None, radius: float
    ) -> list[FloatArray]:
        """Return initial poses: at the pixels of its colour; the last ones at its earlier place."""
        blob = self.blob(labels, entity, radius)
        if blob is None:
            return []
        known = before is not None and bool(np.isfinite(before[entity, 0]))
        was = [before[entity]] if known and before is not None else []
        turn = was[0][2] if was else 0.0
        if not self.is_agent(entity):
            return [np.array([*blob, turn]), *was]
        # the mean of its coloured part, not its origin
        shift = 1 / 6 * radius
        angles = turn + 2 * np.pi * np.arange(_ANGLES) / _ANGLES
        by_colour = [
            np.array([*(blob + shift * np.array([-math.sin(a), math.cos(a)])), a]) for a in angles
        ]
        return by_colour + [np.array([*one[:2], a]) for one in was for a in angles[::-1]]

    def blob(self, labels: Pixels, entity: int, radius: float) -> FloatArray | None:
        """Return the middle of the pixels of a body's colour, units; None: too few pixels."""
        rows, columns = np.nonzero(labels == entity)
        if not len(rows):
            return None
        top, left = rows.min(), columns.min()
        part = labels[top : rows.max() + 1, left : columns.max() + 1] == entity
        marks, n = ndimage.label(ndimage.binary_opening(part, np.ones((3, 3))))
        if not n:
            return None
        areas = np.bincount(marks.ravel())
        areas[0] = 0
        full = self.area(entity) * (radius * self.painter.scale) ** 2
        if areas.max() < _BLOB * full:
            return None
        own = np.isin(marks, np.flatnonzero(areas >= 0.25 * areas.max()))
        row, column = (indices.mean() + 0.5 for indices in np.nonzero(own))
        return self.painter.units([column + left, row + top])

    def area(self, entity: int) -> float:
        """Return the area of a body of size 1 that has its own colour."""
        return 4.0 - 2 * np.pi * self.painter.eye_radius**2 if self.is_agent(entity) else np.pi

    def _improve(
        self,
        frame: Pixels,
        labels: Pixels,
        entity: int,
        found: FloatArray,
        firsts: list[FloatArray],
        radius: FloatArray,
    ) -> None:
        """Put into ``found`` the pose of a body that explains the frame best, given the others."""
        best = np.append(found[entity, :3], -1.0)

        def attempt(start: FloatArray) -> bool:
            window = _Window(self, frame, labels, entity, found, radius, start)
            pose = window.fit(start)
            sure = window.confidence(pose)
            if sure > best[3]:
                best[:] = *pose[:3], sure
            return bool(best[3] >= _SURE)

        window = _Window(self, frame, labels, entity, found, radius, firsts[0], coarse=2)
        improved = np.isfinite(found[entity, 3])
        likely = [found[entity, :3].copy()] if improved else [firsts[0], firsts[-1]]
        if not attempt(min(likely, key=window.cost)):
            costs = [window.cost(first) for first in firsts]
            any(attempt(firsts[start]) for start in np.argsort(costs)[:_OTHERS])
        found[entity] = best


class _Window:
    """The part of a frame about one body, and what else is drawn there.

    Its middle is ``about``, x and y in units. Poses of missing bodies are NaN.
    """

    def __init__(
        self,
        of: Bodies,
        frame: Pixels,
        labels: Pixels,
        entity: int,
        poses: FloatArray,
        radius: FloatArray,
        about: FloatArray,
        coarse: int = 1,
    ) -> None:
        self._painter, self._soft = of.painter, of.softness
        self._agent, self._size = of.is_agent(entity), float(radius[entity])
        reach = self._size * (REACH if self._agent else 1.0) * _ROOM + _MARGIN
        (width, height), half = of.painter.size, reach * of.painter.scale
        column, row = of.painter.pixel(about[:2])
        step = coarse * max(1, round(2 * half / _FINE))
        left, right = (int(v) for v in np.clip([column - half, column + half], 0, width))
        top, bottom = (int(v) for v in np.clip([row - half, row + half], 0, height))
        place = slice(top, bottom, step), slice(left, right, step)
        rows, columns = np.mgrid[place] + 0.5
        points = of.painter.units(np.stack([columns, rows], axis=-1))
        self._x, self._y = (np.ascontiguousarray(points[..., axis]) for axis in (0, 1))
        self._own_colour = of.still.body_colours[entity][:, None, None]
        self._frame, self._labelled = _layers(frame[place]), labels[place] == entity
        wall, floor = of.walls[place], _layers(of.still.floor[place])
        under, above, free = floor, np.zeros_like(floor), np.ones_like(wall)
        for other in of.order:
            lost = not np.isfinite(poses[other, 0]) or poses[other, 3] < SEEN
            if other == entity or lost:
                continue
            apart = float(np.linalg.norm(poses[other, :2] - about[:2]))
            if apart > 1.5 * reach + REACH * radius[other]:
                continue
            shape, own = self._cover(of.is_agent(other), poses[other], float(radius[other]))
            colour = own * of.still.body_colours[other][:, None, None]
            colour = (
                colour + (shape - own) * np.array(self._painter.eye_colour, float)[:, None, None]
            )
            if of.order.index(other) < of.order.index(entity):
                under = under * (1 - shape) + colour
            else:
                above, free = above * (1 - shape) + colour, free * (1 - shape)
        # walls are above all; the floor contains them
        self._under, self._above = under, floor * wall + above * (1 - wall)
        self._free = free * (1 - wall)

    def _cover(self, agent: bool, pose: FloatArray, size: float) -> tuple[FloatArray, FloatArray]:
        """Return how far a body covers each pixel, and how far in its own colour."""
        x, y = self._x - pose[0], self._y - pose[1]
        per_edge = self._painter.scale / self._soft

        def within(distance: FloatArray) -> FloatArray:
            return np.clip(0.5 - distance * per_edge, 0.0, 1.0)

        if not agent:
            shape = within(np.hypot(x, y) - size)
            return shape, shape
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        x, y = cos * x + sin * y, cos * y - sin * x
        beyond = np.full_like(x, -np.inf)
        for (across, along), offset in zip(_NORMALS, _OFFSETS, strict=True):
            np.maximum(beyond, across * x + along * y - size * offset, out=beyond)
        shape = within(beyond)
        eyes = [
            np.hypot(x - size * across, y - size * along) for across, along in self._painter.eyes
        ]
        return shape, shape * (1 - within(np.minimum(*eyes) - size * self._painter.eye_radius))

    def _residual(self, pose: FloatArray) -> FloatArray:
        """Return drawn minus seen, over all pixels and colours."""
        size = float(pose[3]) if len(pose) > 3 else self._size
        shape, own = self._cover(self._agent, pose, size)
        body = self._under * (1 - shape) + own * self._own_colour
        return np.asarray((self._above + self._free * body - self._frame).ravel() / 255)

    def cost(self, pose: FloatArray) -> float:
        """Return the summed squared difference."""
        residual = self._residual(pose)
        return float(residual @ residual)

    def fit(self, first: FloatArray, sized: bool = False) -> FloatArray:
        """Return x, y, angle and size with the least squared difference, from an initial pose."""
        free = [0, 1, *([2] if self._agent else []), *([3] if sized else [])]
        base = np.array([*first[:3], self._size])
        # in equal steps for all: a pixel at the body's rim
        unit = np.array([1.0, 1.0, 1 / self._size, 1.0])[free] / self._painter.scale

        def at(step: FloatArray) -> FloatArray:
            pose = base.copy()
            pose[free] += step * unit
            return pose

        def residual(step: FloatArray) -> FloatArray:
            return self._residual(at(step))

        def slopes(step: FloatArray) -> FloatArray:
            here = residual(step)
            parts = [residual(step + _DELTA * one) - here for one in np.eye(len(free))]
            return np.stack(parts, axis=1) / _DELTA

        start = np.zeros(len(free))
        if 3 * self._x.size < len(free):  # outside the picture
            return base
        found = optimize.least_squares(
            residual, start, slopes, method="lm", ftol=3e-3, xtol=1e-3, max_nfev=_MOST_TRIES
        )
        return at(found.x)

    def confidence(self, pose: FloatArray) -> float:
        """Return how far a pose and the pixels of the body's colour agree."""
        shape, own = self._cover(self._agent, pose, self._size)
        drawn = own * self._free > 0.5
        union = float((drawn | self._labelled).sum())
        if not union:
            return 0.0
        visible = float((shape * self._free).sum()) / max(float(shape.sum()), 1.0)
        return float((drawn & self._labelled).sum()) / union * min(1.0, 2 * visible)


def _layers(picture: NDArray[Any]) -> FloatArray:
    """Return (colour, height, width) of a picture."""
    return np.ascontiguousarray(np.moveaxis(picture, -1, 0), float)
