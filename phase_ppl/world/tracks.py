"""Tracks of other programs: tables of points, and time stamps, as observations of a world.

Tables may be long, a row for each track and frame, as of TrackMate (``TRACK_ID``, ``FRAME``,
``POSITION_X``), or wide, a row for each frame, as of idtracker.ai (``x1``, ``y1``, ...) and
DeepLabCut (columns of individuals, bodyparts and coords), or both, as of SLEAP (``track``,
``frame_idx``, ``nose.x``, ...).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from phase_ppl.world.arrays import FloatArray, finite_array
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    check_memory,
    check_name,
    instance_of,
    shown,
)
from phase_ppl.world.geometry import unwrapped

if TYPE_CHECKING:
    import pandas as pd

_COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "track": ("track", "track_id", "id", "name", "entity", "individual", "individuals"),
    "frame": ("frame", "frame_idx", "frame_number"),
    "time": ("time", "t", "seconds", "position_t"),
    "x": ("x", "position_x", "pos_x"),
    "y": ("y", "position_y", "pos_y"),
    "angle": ("angle", "theta"),
    "sure": ("likelihood", "score", "confidence"),
}
"""What a column is -> its names, in small letters."""

_KINDS: Final = ("x", "y", "angle", "sure")  # what a table has of a point
_OF_A_POINT: Final = {name: kind for kind in _KINDS for name in _COLUMNS[kind]}
_NAMED: Final = "|".join(_OF_A_POINT)
_WIDE: Final = (rf"(?P<name>.+?)[ _.]?(?P<kind>{_NAMED})", rf"(?P<kind>{_NAMED})_?(?P<name>\d+)")

_BODY: Final = "body"  # the part that has a track's point, where there are no parts
MOVES: Final = 0.05  # units from frame to frame that show which way a body heads


class Tracks(NamedTuple):
    """Tracks of some bodies along time."""

    names: tuple[str, ...]
    poses: FloatArray  # (time, track, 3) x, y in the table's lengths, angle [rad]; NaN where unseen
    seconds: FloatArray | None  # (time,) time stamps; None: every frame is there
    n_doubted: int  # points that the program was not sure of


def read_table(
    table: pd.DataFrame, by_frame: bool, least_sure: float, ahead: Sequence[str] | None, up: float
) -> Tracks:
    """Return the tracks in a table, see :meth:`phase_ppl.Observation.from_tracks`.

    ``up`` is -1 where y points down, as of pixels, else 1.
    """
    import pandas as pd  # slow to import

    instance_of("tracks", table, pd.DataFrame, "a pandas table, or an array")
    if (twice := table.columns.duplicated()).any():
        raise InvalidEventError(f"the table has column {table.columns[twice][0]!r} twice")
    points, is_frame = _points(table, by_frame)
    numbers = ["at", "x", "y", "angle", "sure"]
    points[numbers] = points[numbers].apply(pd.to_numeric, errors="coerce")
    points = points[np.isfinite(points["at"])].copy()  # without rows of headings, as of TrackMate
    if points.empty:
        raise InvalidEventError("the table has no row with a number as its frame or time")
    if is_frame:
        points["at"] = points["at"].round().astype(int)
    keys = ["track", "part", "at"]
    if (again := points.duplicated(keys)).any():
        track, _, at = points.loc[again, keys].iloc[0]
        raise InvalidEventError(f"track {track!r} has two points at {at}, expected one")
    points["y"] *= up
    doubted = points["sure"] < least_sure
    points.loc[doubted | points[["x", "y"]].isna().any(axis=1), ["x", "y", "angle"]] = np.nan
    wide = points.pivot(index="at", columns=["track", "part"], values=["x", "y", "angle"])
    wide = wide.sort_index()
    if is_frame:
        first, last = int(wide.index.min()), int(wide.index.max())
        check_memory(f"tracks of frames {first} to {last}", 8.0 * wide.shape[1] * (last - first))
        wide = wide.reindex(range(first, last + 1))
    names = tuple(dict.fromkeys(points["track"]))
    poses = np.stack([_pose(wide, name, ahead) for name in names], axis=1)
    seconds = None if is_frame else wide.index.to_numpy(np.float64)
    return Tracks(names, poses, seconds, int(doubted.sum()))


def _pose(wide: pd.DataFrame, track: str, ahead: Sequence[str] | None) -> FloatArray:
    """Return (time, 3): the middle of a track's points, and where they point."""
    of_track = {kind: wide[kind][track] for kind in ("x", "y", "angle")}
    found = np.column_stack([of_track[kind].mean(axis=1) for kind in of_track]).astype(np.float64)
    if ahead is not None:
        if len(ahead) != 2:
            raise InvalidSettingError(f"ahead={shown(ahead)}, expected two parts of a body")
        for part in ahead:
            check_name(f"part of track {track!r}", part, list(of_track["x"].columns))
        dx, dy = (of_track[kind][ahead[1]] - of_track[kind][ahead[0]] for kind in ("x", "y"))
        found[:, 2] = np.arctan2(-dx, dy)
    return found


def _points(table: pd.DataFrame, by_frame: bool) -> tuple[pd.DataFrame, bool]:
    """Return points with track, part, at, x, y, angle and sure, and whether ``at`` is a frame."""
    import pandas as pd

    if isinstance(table.columns, pd.MultiIndex):
        return _of_levels(table), True
    known = {str(name).lower(): name for name in table.columns}
    columns = {
        kind: known[found]
        for kind, names in _COLUMNS.items()
        if (found := next((name for name in names if name in known), None)) is not None
    }
    is_frame = "time" not in columns or (by_frame and "frame" in columns)
    at: Any = table.index
    if (kind := "frame" if is_frame else "time") in columns:
        at = table[columns[kind]].to_numpy()
    elif "track" in columns:
        raise InvalidEventError(f"the table has a row for each track and no column {kind!r}")
    whose = table[columns["track"]].astype(str).to_numpy() if "track" in columns else None
    if whose is not None and {"x", "y"} <= set(columns):
        given = {kind: table[columns[kind]].to_numpy() for kind in columns if kind in _KINDS}
        return _piece(whose, _BODY, at, given), is_frame
    parts: dict[str, dict[str, Any]] = {}
    for name in table.columns:
        fits = (re.fullmatch(one, str(name), re.IGNORECASE) for one in _WIDE)
        if match := next((one for one in fits if one), None):
            kind = _OF_A_POINT[match["kind"].lower()]
            parts.setdefault(match["name"], {})[kind] = table[name].to_numpy()
    pieces = [
        _piece(name, _BODY, at, given) if whose is None else _piece(whose, name, at, given)
        for name, given in parts.items()
        if {"x", "y"} <= set(given)
    ]
    if not pieces:
        raise InvalidEventError(
            f"the table has columns {shown(list(map(str, table.columns)))}, expected track, frame, "
            "x and y, or x and y of each track, such as red_x and red_y"
        )
    return pd.concat(pieces, ignore_index=True), is_frame


def _of_levels(table: pd.DataFrame) -> pd.DataFrame:
    """Return the points of columns with levels: individuals, perhaps bodyparts, and coords."""
    import pandas as pd

    levels = [str(name).lower() for name in table.columns.names]
    grouped: dict[tuple[str, str], dict[str, Any]] = {}
    for place, key in enumerate(table.columns):
        kind = _OF_A_POINT.get(str(key[-1]).lower())
        if kind is not None:
            many = "individuals" in levels and len(key) > 2
            track = key[levels.index("individuals")] if many else key[-2]
            part = str(key[-2]) if many else _BODY
            grouped.setdefault((str(track), part), {})[kind] = table.iloc[:, place].to_numpy()
    pieces = [
        _piece(track, part, table.index, given)
        for (track, part), given in grouped.items()
        if {"x", "y"} <= set(given)
    ]
    if not pieces:
        raise InvalidEventError("the columns' last level has no x and y")
    return pd.concat(pieces, ignore_index=True)


def _piece(track: Any, part: str, at: Any, given: Mapping[str, Any]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame(
        {"track": track, "part": part, "at": at, "angle": np.nan, "sure": 1.0, **given}
    )


def read_array(tracks: ArrayLike, names: Sequence[str], up: float) -> Tracks:
    """Return the tracks of an array (time, entity, 2 or 3), the entities by name."""
    try:
        shape = np.shape(tracks)
    except ValueError:
        shape = ()  # ragged, as is said below
    if len(shape) == 3 and shape[-1] == 2:
        # what is masked stays so, and is refused
        tracks = np.ma.concatenate([tracks, np.full((*shape[:2], 1), np.nan)], axis=2)
    poses = finite_array("tracks", tracks, (None, len(names), 3), unseen=True)
    return Tracks(tuple(names), poses * [1.0, up, 1.0], None, 0)


def in_order(tracks: Tracks, entities: Sequence[str], names: Mapping[Any, str] | None) -> Tracks:
    """Return the tracks of all entities, in their order; ``names`` are of tracks, -> entity.

    Raises:
        InvalidSettingError: an entity has no track or two, or there is no such track.
        UnknownNameError: there is no such entity.
    """
    given = {str(name): entity for name, entity in (names or {}).items()}
    if names is None:
        given = {name: name for name in tracks.names if name in entities}
    for name, entity in given.items():
        check_name("track", name, tracks.names)
        check_name("entity", entity, entities)
    track_of = {entity: name for name, entity in given.items()}
    if set(track_of) != set(entities) or len(given) > len(track_of):
        raise InvalidSettingError(
            f"names={shown(names)}, expected one track for each of {', '.join(entities)}; the "
            f"tracks are {shown(list(tracks.names))}: names={{{tracks.names[0]!r}: "
            f"{entities[0]!r}, ...}}"
        )
    places = [tracks.names.index(track_of[entity]) for entity in entities]
    return tracks._replace(names=tuple(entities), poses=tracks.poses[:, places])


def bridged(poses: FloatArray, seconds: FloatArray, longest: float) -> tuple[FloatArray, int]:
    """Return poses with gaps of up to so many seconds put on straight lines, and their number."""
    filled, n = poses.copy(), 0
    filled[..., 2] = unwrapped(poses[..., 2])
    for place in np.ndindex(filled.shape[1:]):
        track = filled[:, *place]
        seen = np.flatnonzero(~np.isnan(track))
        before, after = seen[:-1], seen[1:]
        short = (after > before + 1) & (seconds[after] - seconds[before] <= longest + 1e-9)
        n += int(short.sum()) if place[1] == 0 else 0
        for first, last in zip(before[short], after[short], strict=True):
            inside = slice(first + 1, last)
            track[inside] = np.interp(seconds[inside], seconds[[first, last]], track[[first, last]])
    return filled, n


def headings(positions: FloatArray) -> FloatArray:
    """Return (time,) angles that look where a body (time, 2) heads; 0 if it never moves.

    Where it is at rest, the angle is between those before and after. NaN where it was not seen.
    """
    steps = np.diff(positions, axis=0)
    moves = np.flatnonzero(np.hypot(*steps.T) > MOVES)
    if not len(moves):
        return np.where(np.isnan(positions[:, 0]), np.nan, 0.0)
    angles = np.unwrap(np.arctan2(-steps[moves, 0], steps[moves, 1]))
    found = np.interp(np.arange(len(positions)), moves + 0.5, angles)
    return np.where(np.isnan(positions[:, 0]), np.nan, found)


# --- frames with time stamps, put on the grid of frames that worlds have --------------------------

FRAMES_PER_SECOND: Final = 12.0  # frames per second of simulated time

PARTS: Final = 5  # of a planner step, over which a frame is the mean
GAP: Final = 0.25
"""Seconds between two time stamps, at most, over which bodies are taken to move straight."""

LONGEST: Final = 3600.0
"""Seconds between two time stamps, at most: more are no seconds, or belong to another video."""

_ROUNDING: Final = 1e-7  # seconds


class Clock:
    """Turns poses with time stamps into frames, one by one.

    The first pose is the start. Frame k is the mean over the five parts of the twelfth of a second
    that ends k twelfths later. In between, bodies move straight and turn the shorter way. A body is
    NaN in a frame if it was not seen before and after one of the parts, or these are too far apart.

    Args:
        gap: longest time between two poses, seconds.
    """

    def __init__(self, gap: float = GAP) -> None:
        self._gap = gap
        self._first = self._last = math.nan
        self._pose = self._turned = np.empty(0)
        self._parts: list[FloatArray] = []
        self._n = 0  # parts so far

    def put(self, seconds: float, pose: FloatArray) -> list[FloatArray]:
        """Return the frames that are complete with a pose, (entity, 3), NaN where unseen.

        Raises:
            InvalidEventError: the time stamp is not later than the last one, or later by more than
                an hour. What was put before stays.
        """
        if not math.isfinite(seconds) or seconds <= self._last:
            raise InvalidEventError(
                f"time stamp {seconds:g} after {self._last:g}: expected seconds, each later than "
                "the one before"
            )
        if seconds - self._last > max(LONGEST, self._gap):
            raise InvalidEventError(
                f"time stamp {seconds:g} after {self._last:g}: expected seconds, at most "
                f"{LONGEST:g} after the one before"
            )
        pose = np.array(pose)
        if math.isnan(self._last):
            self._first = self._last = seconds
            self._pose, self._turned = pose, np.nan_to_num(pose[:, 2])
            return [pose]
        turns = np.round((pose[:, 2] - self._turned) / (2 * np.pi))
        pose[:, 2] -= 2 * np.pi * turns
        self._turned = np.where(np.isnan(pose[:, 2]), self._turned, pose[:, 2])
        found, before, unseen = [], self._pose, np.full(pose.shape, np.nan)
        while (at := self._first + (self._n + 1) / (PARTS * FRAMES_PER_SECOND)) < (
            seconds + _ROUNDING
        ):
            share = min(1.0, (at - self._last) / (seconds - self._last))
            if share == 1.0:
                part = pose
            elif seconds - self._last > self._gap + _ROUNDING:
                part = unseen
            else:
                part = (1 - share) * before + share * pose
            self._parts.append(part)
            self._n += 1
            if len(self._parts) == PARTS:
                found.append(np.mean(self._parts, axis=0))
                self._parts = []
        self._last, self._pose = seconds, pose
        return found
