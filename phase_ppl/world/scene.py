"""The part of the world that everybody knows: arena, walls, landmarks, sizes, start state."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Final, Literal

import numpy as np

from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import number_or_nan
from phase_ppl.world.errors import InvalidEventError, shown, unknown_name
from phase_ppl.world.names import ENTITIES, LANDMARKS
from phase_ppl.world.picture import drawn
from phase_ppl.world.rooms import Rooms

Turning = Literal["both", "ccw", "cw"]
TURNINGS: Final = ("both", "ccw", "cw")

ARENA: Final = (6.0, 26.0, 2.0, 22.0)
"""x_min, x_max, y_min, y_max of the original world, units."""

LANDMARK_CENTRES: Final = np.array([[8.5, 19.5], [23.5, 19.5], [23.5, 4.5], [8.5, 4.5]])
LANDMARK_HALF_WIDTH: Final = 2.5
MIN_RADIUS: Final = 0.01
"""Smallest size of an entity, units: masses and inertias of smaller ones are next to nothing."""

OUTSIDE_TOLERANCE: Final = 0.25
"""How far beyond the border a body's origin may lie before it counts as outside, units."""


def finite_array(name: str, value: object, shape: tuple[int | None, ...]) -> FloatArray:
    """Return ``value`` as a read-only float array of ``shape`` (None: any length).

    Raises:
        InvalidEventError: not numbers, not finite or of another shape; the message says which
            value of ``name`` it is.
    """
    if np.ma.is_masked(value):
        raise InvalidEventError(f"{name} is masked in places, expected numbers everywhere")
    try:
        given = np.asarray(value)
    except ValueError:
        raise InvalidEventError(f"{name} is ragged: its rows differ in length") from None
    if given.dtype.kind not in "iuf":
        values = np.array(value, dtype=object).ravel().tolist()
        odd = next((v for v in values if not math.isfinite(number_or_nan(v))), value)
        raise InvalidEventError(f"{name} holds {shown(odd)}, expected numbers")
    array = np.array(given, dtype=np.float64)
    if array.size == 0 and None in shape:
        array = array.reshape([0 if n is None else n for n in shape])
    fits = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = tuple("n" if n is None else n for n in shape)
        raise InvalidEventError(f"{name} has shape {array.shape}, expected {wanted}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InvalidEventError(f"{name}{list(where)} is {array[where]}, expected a finite number")
    array.setflags(write=False)
    return array


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Everything about an event that is known before anybody moves.

    Attributes:
        start: (4, 3) x, y [units], angle [rad] of each entity at rest, holding nothing.
        radius: (4,) size R of each entity, units.
        walls: (n, 2, 2) end points of the inner walls; the arena's border is a wall too.
        turning: which way agents can turn by themselves: "both", "ccw" or "cw".
        arena: x_min, x_max, y_min, y_max, units.
        landmark_centres: (4, 2) centres of the landmarks' squares, units.
        landmark_half_width: half the side of the squares, units.
        resets_velocity: whether agents stand still after each planner step, as where people steer
            them (paper, Appendix A.2); items go on.

    Raises:
        InvalidEventError: a value that is not finite, has the wrong shape or lies outside.
    """

    start: FloatArray
    radius: FloatArray
    walls: FloatArray = dataclasses.field(default_factory=lambda: np.empty((0, 2, 2)))
    turning: Turning = "both"
    arena: tuple[float, float, float, float] = ARENA
    landmark_centres: FloatArray = dataclasses.field(default_factory=lambda: LANDMARK_CENTRES)
    landmark_half_width: float = LANDMARK_HALF_WIDTH
    resets_velocity: bool = False

    def __post_init__(self) -> None:
        n = len(ENTITIES)
        set_field = functools.partial(object.__setattr__, self)
        set_field("start", finite_array("scene.start", self.start, (n, 3)))
        set_field("radius", finite_array("scene.radius", self.radius, (n,)))
        set_field("walls", finite_array("scene.walls", self.walls, (None, 2, 2)))
        set_field(
            "landmark_centres",
            finite_array("scene.landmark_centres", self.landmark_centres, (len(LANDMARKS), 2)),
        )
        arena = finite_array("scene.arena", self.arena, (4,))
        set_field("arena", tuple(float(v) for v in arena))
        if self.turning not in TURNINGS:
            raise unknown_name("turning", self.turning, TURNINGS)
        if not isinstance(self.resets_velocity, bool):
            raise InvalidEventError(
                f"scene.resets_velocity is {shown(self.resets_velocity)}, expected true or false"
            )
        width, height = arena[1] - arena[0], arena[3] - arena[2]
        if width <= 0 or abs(width - height) > 1e-6:
            raise InvalidEventError(f"scene.arena {self.arena} is not a square x0, x1, y0, y1")
        if (self.radius < MIN_RADIUS).any() or (self.radius > width / 4).any():
            raise InvalidEventError(
                f"scene.radius {self.radius.tolist()}: sizes must lie in [{MIN_RADIUS:g}, "
                f"{width / 4:g}]"
            )
        check_inside(self.start[None], self, "scene.start")
        rooms = self.rooms  # refuses impossible walls now, not during a run
        if list(rooms.room_of(self.landmark_centres)) != list(range(len(LANDMARKS))):
            raise InvalidEventError(
                f"scene.landmark_centres {self.landmark_centres.tolist()}: expected "
                f"{', '.join(LANDMARKS)} top left, top right, bottom right, bottom left"
            )
        half_width = float(finite_array("scene.landmark_half_width", self.landmark_half_width, ()))
        if not 0 < half_width <= width / 4:
            raise InvalidEventError(
                f"scene.landmark_half_width is {half_width:g}, expected one in (0, {width / 4:g}]"
            )
        set_field("landmark_half_width", half_width)

    def _repr_html_(self) -> str:
        return drawn(self)

    @property
    def centre(self) -> FloatArray:
        x0, x1, y0, y1 = self.arena
        return np.array([(x0 + x1) / 2, (y0 + y1) / 2])

    @functools.cached_property
    def rooms(self) -> Rooms:
        return Rooms.from_walls(self.walls, self.centre, (self.arena[1] - self.arena[0]) / 2)

    @functools.cached_property
    def border(self) -> FloatArray:
        """(4, 2, 2) end points of the arena's outer walls."""
        x0, x1, y0, y1 = self.arena
        corners = np.array([[x0, y1], [x1, y1], [x1, y0], [x0, y0]])
        return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def check_inside(trajectory: FloatArray, scene: Scene, name: str) -> None:
    """Raise InvalidEventError if a body of a (time, entity, coord) trajectory is outside."""
    x0, x1, y0, y1 = scene.arena
    x, y = trajectory[..., 0], trajectory[..., 1]
    slack = OUTSIDE_TOLERANCE
    outside = (x < x0 - slack) | (x > x1 + slack) | (y < y0 - slack) | (y > y1 + slack)
    if outside.any():
        frame, entity = (int(i) for i in np.argwhere(outside)[0])
        raise InvalidEventError(
            f"{name}: the {ENTITIES[entity]} is at ({x[frame, entity]:g}, {y[frame, entity]:g}) "
            f"in frame {frame}, outside the arena x {x0:g}..{x1:g}, y {y0:g}..{y1:g}"
        )
