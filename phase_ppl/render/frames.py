"""One frame in the look of the PHASE animations.

640 x 480 pixels, 20 per unit, white; landmarks are filled squares, walls black lines 5 pixels
wide, items discs, agents trapezoids with two eyes at the short side, their front. y points up.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from phase_ppl.render.sight import field_of_view
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import UNIT_TRAPEZOID, is_agent, rotation
from phase_ppl.world.names import AGENTS, ENTITIES, ITEMS
from phase_ppl.world.scene import Scene, finite_array

Colour = tuple[int, int, int]
Pixels = NDArray[np.uint8]
Points = list[tuple[float, float]]

WIDTH: Final = 640
HEIGHT: Final = 480
ARENA_PIXELS: Final = 400
"""Side of the arena: 20 pixels per unit in the original world of 20 units."""

WALL_PIXELS: Final = 5
BACKGROUND: Final[Colour] = (255, 255, 255)
WALL_COLOUR: Final[Colour] = (0, 0, 0)
EYE_COLOUR: Final[Colour] = (0, 0, 0)
LANDMARK_COLOURS: Final[tuple[Colour, ...]] = (
    (45, 45, 180),
    (50, 150, 50),
    (180, 45, 45),
    (180, 180, 45),
)
ENTITY_COLOURS: Final[tuple[Colour, ...]] = (
    (255, 0, 0),
    (0, 255, 0),
    (117, 216, 230),
    (255, 153, 153),
)

TRAIL_COLOURS: Final[tuple[Colour, ...]] = (
    (170, 0, 0),
    (0, 140, 0),
    (60, 150, 170),
    (215, 100, 110),
)
TRAIL_PIXELS: Final = 3

SIGHT_COLOURS: Final[tuple[Colour, ...]] = ((215, 0, 0), (0, 150, 0))
SIGHT_OPACITY: Final = 0.16
SIGHT_EDGE_OPACITY: Final = 0.45
"""The edge of a field of view shows it on a landmark of its colour too."""

SIGHT_EDGE_PIXELS: Final = 1.25

EYES: Final = np.array([[-0.24, 0.62], [0.24, 0.62]])
"""Centres of the eyes of an agent of size 1 in its body frame."""

EYE_RADIUS: Final = 0.14

FINE: Final = 8
"""Subpixels per pixel and axis."""

_FAINT: Final = 0.7
"""How much of the floor shows through what is drawn faintly."""

_SIGHT_FINE = 4
"""The same for fields of view, which are large."""

_DRAWING_ORDER = tuple(ENTITIES.index(name) for name in (*ITEMS, *AGENTS))


class Painter:
    """Draws frames of one scene; what does not move is drawn once.

    Args:
        scene: arena, walls, landmarks and sizes.
        fields_of_view: whether to show what each agent can see.
        fine: subpixels per pixel and axis in which shapes are drawn before they are averaged;
            fewer are faster, and enough for a picture that is made smaller.
        pale: how far the landmarks are mixed with white, so that more can be seen on them.
    """

    def __init__(
        self,
        scene: Scene,
        fields_of_view: bool = False,
        *,
        fine: int = FINE,
        pale: float = 0.0,
    ) -> None:
        self._scene = scene
        self._fields_of_view = fields_of_view
        self._fine = fine
        self._pale = pale
        x0, x1, _, _ = scene.arena
        self._scale = ARENA_PIXELS / (x1 - x0)

    def draw(
        self, poses: ArrayLike, trail: FloatArray | None = None, faint: FloatArray | None = None
    ) -> Image.Image:
        """Return the frame with the entities at ``poses``.

        Args:
            poses: (entity, coord) with coord = x, y [units], angle [rad].
            trail: (time, entity, coord) of the way there, drawn as thin lines.
            faint: (entity, coord) of other poses, drawn faintly below all that.

        Raises:
            InvalidEventError: ``poses`` has another shape or is not finite.
        """
        pose = finite_array("poses", poses, (len(ENTITIES), 3))
        picture = self._floor.copy()
        if self._fields_of_view:
            for agent, colour in enumerate(SIGHT_COLOURS):
                self._tint(picture, colour, self.pixel(field_of_view(self._scene, pose, agent)))
        if faint is not None:
            for entity in _DRAWING_ORDER:
                self._draw_entity(picture, entity, faint[entity])
            picture = Image.blend(picture, self._floor, _FAINT)
        if trail is not None and len(trail) > 1:
            for entity in _DRAWING_ORDER:
                points = self.pixel(trail[:, entity, :2])
                _paste_line(picture, TRAIL_COLOURS[entity], points, TRAIL_PIXELS, self._fine)
        for entity in _DRAWING_ORDER:
            self._draw_entity(picture, entity, pose[entity])
        picture.paste(WALL_COLOUR, mask=self._walls)
        return picture

    def pixel(self, points: ArrayLike) -> FloatArray:
        """Return the pixel coordinates (column, row from the top) of points of shape (..., 2)."""
        offset = (np.asarray(points, float) - self._scene.centre) * self._scale
        # pixel (i, j) covers [i, i + 1) x [j, j + 1): half a pixel on keeps odd lines sharp
        return np.array([WIDTH / 2, HEIGHT / 2]) + 0.5 + offset * np.array([1.0, -1.0])

    @functools.cached_property
    def _floor(self) -> Image.Image:
        """Background and landmarks."""
        picture = Image.new("RGB", (WIDTH, HEIGHT), BACKGROUND)
        half = self._scene.landmark_half_width
        for centre, colour in zip(self._scene.landmark_centres, LANDMARK_COLOURS, strict=True):
            corners = self.pixel(centre + half * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]))
            _paste_polygon(picture, colour, corners, self._fine)
        if self._pale:
            return Image.blend(picture, Image.new("RGB", picture.size, BACKGROUND), self._pale)
        return picture

    @functools.cached_property
    def _walls(self) -> Image.Image:
        """Mask of the outer and inner walls."""
        mask = Image.new("L", (WIDTH, HEIGHT), 0)
        half = WALL_PIXELS / 2
        for wall in (*self._scene.border, *self._scene.walls):
            ends = self.pixel(wall)
            # walls run along an axis; those that meet overlap in a square, so no corner is open
            low, high = ends.min(axis=0) - half, ends.max(axis=0) + half
            corners = np.array([low, (low[0], high[1]), high, (high[0], low[1])])
            _paste_polygon(mask, 255, corners, self._fine)
        return mask

    def _tint(self, picture: Image.Image, colour: Colour, corners: FloatArray) -> None:
        """Lay a translucent colour over the part of an area that lies in the arena."""
        first, last = self._arena_box
        low = np.floor(corners.min(axis=0) - 1).clip(first, last).astype(int)
        high = np.ceil(corners.max(axis=0) + 1).clip(first, last).astype(int)
        if (low >= high).any():
            return
        width, height = (int(n) for n in (high - low) * _SIGHT_FINE)
        mask = Image.new("L", (width, height), 0)
        fine = ((corners - low) * _SIGHT_FINE - 0.5).ravel().tolist()
        draw = ImageDraw.Draw(mask)
        draw.polygon(fine, fill=round(255 * SIGHT_OPACITY))
        edge = round(SIGHT_EDGE_PIXELS * _SIGHT_FINE)
        draw.line([*fine, *fine[:2]], fill=round(255 * SIGHT_EDGE_OPACITY), width=edge)
        picture.paste(colour, (int(low[0]), int(low[1])), mask.reduce(_SIGHT_FINE))

    @functools.cached_property
    def _arena_box(self) -> NDArray[np.int64]:
        """Top left and bottom right pixel of the arena; walls cover what this rounds off."""
        x0, x1, y0, y1 = self._scene.arena
        return self.pixel([[x0, y1], [x1, y0]]).astype(np.int64)

    def _draw_entity(self, picture: Image.Image, entity: int, pose: FloatArray) -> None:
        radius, colour = float(self._scene.radius[entity]), ENTITY_COLOURS[entity]
        if not is_agent(entity):
            _paste_disc(picture, colour, self.pixel(pose[:2]), radius * self._scale, self._fine)
            return
        turn = radius * rotation(pose[2]).T
        _paste_polygon(picture, colour, self.pixel(pose[:2] + UNIT_TRAPEZOID @ turn), self._fine)
        for eye in self.pixel(pose[:2] + EYES @ turn):
            eye_radius = EYE_RADIUS * radius * self._scale
            _paste_disc(picture, EYE_COLOUR, eye, eye_radius, self._fine)


def draw_frame(scene: Scene, poses: ArrayLike, fields_of_view: bool = False) -> Pixels:
    """Return one frame as (480, 640, 3) RGB values.

    Args:
        scene: arena, walls, landmarks and sizes.
        poses: (entity, coord) with coord = x, y [units], angle [rad].
        fields_of_view: whether to show what each agent can see.

    Raises:
        InvalidEventError: ``poses`` has another shape or is not finite.
    """
    return np.asarray(Painter(scene, fields_of_view).draw(poses), np.uint8)


def _paste_polygon(
    picture: Image.Image, colour: Colour | int, corners: FloatArray, fine: int
) -> None:
    _paste(picture, colour, corners, lambda draw, at: draw.polygon(at, fill=255), fine)


def _paste_disc(
    picture: Image.Image, colour: Colour, centre: FloatArray, radius: float, fine: int
) -> None:
    box = centre + radius * np.array([[-1.0, -1.0], [1.0, 1.0]])
    _paste(picture, colour, box, lambda draw, at: draw.ellipse(at, fill=255), fine)


def _paste_line(
    picture: Image.Image, colour: Colour, points: FloatArray, width: float, fine: int
) -> None:
    def paint(draw: ImageDraw.ImageDraw, at: Points) -> None:
        draw.line(at, fill=255, width=round(width * fine), joint="curve")

    _paste(picture, colour, points, paint, fine, margin=width)


def _paste(
    picture: Image.Image,
    colour: Colour | int,
    points: FloatArray,
    paint: Callable[[ImageDraw.ImageDraw, Points], None],
    fine: int,
    margin: float = 0.0,
) -> None:
    """Let ``paint`` draw a shape through ``points``, (n, 2) pixels, and paste it smoothly.

    Only the box around the points is drawn finely and averaged.
    """
    # of a shape that leaves the picture, only what can be seen
    low = np.floor(points.min(axis=0) - margin).clip(0, picture.size).astype(int)
    high = np.ceil(points.max(axis=0) + margin).clip(0, picture.size).astype(int)
    if (low >= high).any():
        return
    mask = Image.new("L", (int(high[0] - low[0]) * fine, int(high[1] - low[1]) * fine), 0)
    # a fine pixel is named by its index; its centre lies half a fine pixel further
    at = [(float(x), float(y)) for x, y in (points - low) * fine - 0.5]
    paint(ImageDraw.Draw(mask), at)
    picture.paste(colour, (int(low[0]), int(low[1])), mask.reduce(fine))
