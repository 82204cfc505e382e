"""User-defined predicates: goals of a world beyond those about landmarks and touching.

A predicate relates a body to another body, to a landmark or to a room. It is data, not code, so
that files hold no code. The compiled planner pursues it by touching, being on, or being in a room.
Only the predicate itself decides when it is true, and so when an agent is content. That is
computed from the bodies' positions once per step, never inside the compiled search.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_fields,
    check_name,
    instance_of,
    number_or_nan,
    positive_number,
    shown,
)
from phase_ppl.world.rooms import in_words

_MARGIN: Final = 0.5
_MARGIN_SHARE: Final = 0.2
_CLEAR_OF_DOORS: Final = 1.5  # in units of a body's size R


@dataclasses.dataclass(frozen=True)
class Predicate:
    """A user-defined goal: where a body shall be, and a name for that.

    It gives its world two more goals, ``name`` and "not ``name``". Distances are lengths of the
    path through the doors, units, between the origins of two bodies or to a landmark's centre.

    Example:
        ``ppl.Predicate("toys together", "ball", "doll", within=4)``,
        ``ppl.Predicate("agents apart", "red agent", "green agent", beyond=12)``,
        ``ppl.Predicate("ball in the attic", "ball", room=(30, 20))``

    Args:
        name: name of the goal, without the words "to" and "away from".
        subject: name of an agent or item. If subject and target are items, agents move the subject.
        target: name of another agent or item, or of a landmark; None with ``room``.
        within: the predicate is true where the distance is at most this, units.
        beyond: the predicate is true where the distance is at least this, units.
        room: the predicate is true where the subject is in the room of this point (x, y) or of the
            landmark of this name.

    Raises:
        InvalidSettingError: not exactly one of within, beyond and room, or an impossible value.
    """

    name: str
    subject: str
    target: str | None = None
    within: float | None = None
    beyond: float | None = None
    room: Any = None

    def __post_init__(self) -> None:
        instance_of("name", self.name, str, "a text")
        what = f"predicate {self.name!r}"
        instance_of(f"{what}: subject", self.subject, str, "the name of an agent or item")
        given = [way for way in ("within", "beyond", "room") if getattr(self, way) is not None]
        if len(given) != 1:
            raise InvalidSettingError(
                f"{what} has {' and '.join(given) or 'no limit'}, expected one of within, beyond "
                "and room"
            )
        set_field = functools.partial(object.__setattr__, self)
        if self.room is None:
            instance_of(f"{what}: target", self.target, str, "the name of a body or landmark")
            set_field(given[0], positive_number(f"{what}: {given[0]}", getattr(self, given[0])))
            return
        if self.target is not None:
            raise InvalidSettingError(
                f"{what} has a room and the target {shown(self.target)}, expected one of them"
            )
        if isinstance(self.room, str):
            return
        room = self.room if isinstance(self.room, Sequence) else ()
        point = tuple(map(number_or_nan, room))
        if len(point) != 2 or not np.isfinite(point).all():
            raise InvalidSettingError(
                f"{what}: room={shown(self.room)}, expected a point (x, y) or a landmark's name"
            )
        set_field("room", point)

    @property
    def brings_near(self) -> bool:
        """Whether the predicate becomes true by coming near (``within``, ``room``)."""
        return self.beyond is None

    @property
    def limit(self) -> float:
        """The distance at which the predicate becomes true or false, units; 0 for a room."""
        return self.within or self.beyond or 0.0

    @property
    def content(self) -> float:
        """Distance at which an agent that comes near stops, units: a little less than ``limit``."""
        return self.limit - min(_MARGIN, _MARGIN_SHARE * self.limit)

    def check(self, world: Any) -> None:
        """Raise a PhasePPLError if the predicate is impossible in a world.

        The world must have its subject, target and room. The limit must be less than the diagonal
        of the world's arena.
        """
        what, (x0, x1, y0, y1) = f"predicate {self.name!r}", world.arena
        check_name(f"subject of {what}", self.subject, world.entities)
        if self.target == self.subject:
            raise InvalidSettingError(f"{what} has {self.subject!r} as subject and target")
        if self.room is None:
            targets = (*world.entities, *world.landmark_names)
            check_name(f"target of {what}", self.target, targets)
            farthest = float(np.hypot(x1 - x0, y1 - y0))
            if not self.limit < farthest:
                way = "within" if self.beyond is None else "beyond"
                raise InvalidSettingError(
                    f"{what}: {way}={self.limit:g}, expected less than the arena's diagonal, "
                    f"{farthest:.4g}"
                )
        elif isinstance(self.room, str):
            check_name(f"room of {what}", self.room, world.landmark_names)
        else:
            x, y = self.room
            if not (x0 <= x <= x1 and y0 <= y <= y1):
                where = f"({x:g}, {y:g}) lies outside {in_words(world.arena)}"
                raise InvalidSettingError(f"{what}: room={where}")

    def check_scene(self, scene: Any) -> None:
        """Raise InvalidSettingError if the predicate is true (or false) everywhere in a scene."""
        what, world = f"predicate {self.name!r}", scene.world
        if self.room is not None and len(scene.rooms) == 1:
            raise InvalidSettingError(f"{what} is about a room, and the scene has one only")
        if self.target in world.entities:
            one, other = (world.entity(name) for name in (self.subject, self.target))
            touching = float(scene.radius[one] + scene.radius[other])
            if self.content < touching:
                raise InvalidSettingError(
                    f"{what}: {self.limit:g} units are too few for bodies that touch at "
                    f"{touching:g}; expected {touching / (1 - _MARGIN_SHARE):.3g} or more"
                )

    def apart(self, poses: FloatArray, scene: Any) -> FloatArray:
        """Return the path length from the subject to the target, or into the room.

        Args:
            poses: (..., entity, coord) x, y [units] of all entities; further coords are ignored.
            scene: a scene of a world that has this predicate.

        Returns:
            (...) units; one number for each set of poses.
        """
        world, places = scene.world, np.asarray(poses, float)[..., :2]
        start = places[..., world.entity(self.subject), :]
        if self.room is not None:
            return scene.rooms.distance_into(self.room_in(scene), start)  # type: ignore[no-any-return]
        if self.target in world.landmark_names:
            end = scene.landmark_centres[world.landmark_names.index(self.target)]
        else:
            end = places[..., world.entity(self.target), :]
        return scene.rooms.path_distance(start, end)  # type: ignore[no-any-return]

    def holds(self, poses: FloatArray, scene: Any) -> BoolArray:
        """Return (...) whether the predicate is true. For arguments see :meth:`apart`."""
        apart = self.apart(poses, scene)
        return apart <= self.limit if self.brings_near else apart >= self.limit

    def distance(self, poses: FloatArray, scene: Any) -> FloatArray:
        """Return (...) how far the predicate is from being true, units; 0: it is true.

        For arguments see :meth:`apart`.
        """
        apart = self.apart(poses, scene)
        left = apart - self.limit if self.brings_near else self.limit - apart
        return np.maximum(0.0, left)

    def is_content(self, poses: FloatArray, scene: Any) -> BoolArray:
        """Return (...) whether an agent that comes near may stop. For arguments see :meth:`apart`.

        An agent stops a little before the limit. In a room it stops only clear of the doors.
        """
        near = self.apart(poses, scene) <= self.content
        if self.room is None:
            return near
        subject, room = scene.world.entity(self.subject), self.room_in(scene)
        doors = scene.rooms.door_position[[door for door, _ in scene.rooms.exits(room)]]
        place = np.asarray(poses, float)[..., subject, :2]
        gaps = np.linalg.norm(place[..., None, :] - doors, axis=-1)
        clear = (gaps > _CLEAR_OF_DOORS * scene.radius[subject]).all(axis=-1)
        return np.asarray(near & clear)

    def room_in(self, scene: Any) -> int:
        """Return the number of the predicate's room in a scene."""
        where = self.room
        if isinstance(where, str):
            where = scene.landmark_centres[scene.world.landmark_names.index(where)]
        return int(scene.rooms.room_of(where))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, which :meth:`from_dict` reads: the arguments that are not None."""
        found = {name: value for name, value in vars(self).items() if value is not None}
        if isinstance(self.room, tuple):
            found["room"] = list(self.room)
        return found

    @classmethod
    def from_dict(cls, record: object) -> Predicate:
        """Return the predicate that :meth:`to_dict` wrote as ``record``.

        Raises:
            UnknownNameError: a predicate does not have such a field.
            InvalidSettingError: name or subject is missing, or the predicate is impossible.
        """
        if not isinstance(record, Mapping):
            raise InvalidSettingError(f"a predicate is {shown(record)}, expected a mapping")
        check_fields(record, cls, "a predicate", ("name", "subject"))
        return cls(**record)
