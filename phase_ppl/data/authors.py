"""Events in the files of PHASE's authors: pickles of videos, in their processed form.

A file is a list of videos, such as ``Videos_Test_humanratings`` of the public repository
Isik-lab/SocialGNN. A video has ``name`` (of its film), ``trajectories`` (per body rows of x, y, vx,
vy, angle; one per frame), ``entity_sizes``, ``entity_color_code``, ``wall_segs``,
``landmark_centers`` and ``social_goals`` (the relation that most raters saw). Reading changes them
as follows:

* Bodies are put into the order of their colours (:func:`bodies_by_colour`).
* Goals and strengths come from the film's name, which has them in that order. The field
  ``physical_goals`` mixes two numberings and is not read. A name is such as
  ``D082020_1817530_0_F8_E8.1_G['LMO', 0, 2, 1]_['LMO', 0, 2, 1]_ST3_1_..._R0.0_0.0_....mp4``:
  a time stamp of 7 digits (8 in some training videos); its last digit and the next number are two
  observation switches (0_0); then the layout (8) and its reflection (.1). A goal [type, entity,
  target, sign] and a strength per agent follow, red first, then parts that are not used here.
  Entities have the numbers of their colours: agents 0 red, 1 green; items 0 blue, 1 pink; in "TE"
  both are agents; landmarks 0 blue, 1 green, 2 red, 3 yellow.
* Items' tracks are cut to the length of the agents', after which nothing moves.
* Angles of agents in copies about a diagonal are unwrapped, and repaired where averaging spoiled
  them (:func:`repaired`). Angles of items are 0 in all copies.
* Velocities are left out. In copies, those of agents were reflected like points, and those of items
  were not reflected.
* The scene starts as in the first frame; ``turning`` is inferred from the angles.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import math
import os
import pickle
import re
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from phase_ppl.data.documents import converted, event_id, reading_bytes, too_large
from phase_ppl.data.events_json import Entries
from phase_ppl.data.motion import full_turn, observed_turning
from phase_ppl.physics.constants import SUBSTEPS
from phase_ppl.world.arrays import FloatArray, finite_array
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.goals import GOALS, literal_goal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES, LANDMARKS, PredicateKind
from phase_ppl.world.names import Literal as GoalLiteral
from phase_ppl.world.scene import Scene

Goal = tuple[str, int, int, int]
"""Type "LMO" (item, landmark), "LMA" (agent, landmark) or "TE" (agent, agent); entity; target;
sign 1 (to) or -1 (away from)."""

_LONGEST: Final = 1000
_PLACE: Final = re.compile(
    r"(?P<stamp>.*?)(?P<between>_?)(?P<switch>\d)_\d_[FI]\d_E(?P<layout>\d+)(?:\.(?P<copy>[0-3]))?(?=_|$)"
)
_PARAMETERS: Final = re.compile(
    r"_G(?P<goals>.*)_ST(?P<red>[0-3]|None)_(?P<green>[0-3]|None)(?=_|$)"
)
_BETWEEN: Final = "[^A-Za-z0-9-]+"
_GOAL: Final = re.compile(rf"([A-Z]+){_BETWEEN}(\d+){_BETWEEN}(\d+){_BETWEEN}(-?1)(?!\d)")
_STAMP: Final = re.compile(r"D\d{6}_\d{6,7}")
_SUFFIXES: Final = re.compile(r"\.(mp4|pik|pkl|pickle)$")


class Place(NamedTuple):
    """The layout and reflection of a recording."""

    layout: int  # number of the layout before any reflection
    # number of the reflection, 0 up-down, 1 left-right, 2 about y = x, 3 about y = -x; None for an
    # original
    copy: int | None

    @property
    def is_diagonal(self) -> bool:
        """Whether it was reflected about a diagonal; angles of such copies were wrapped."""
        return self.copy in (2, 3)

    def __str__(self) -> str:
        return f"E{self.layout}" + ("" if self.copy is None else f".{self.copy}")


class Recorded(NamedTuple):
    """The contents of a file name."""

    id: str  # time stamp and place, or the first part of a name that is not the authors'
    place: Place | None  # None: not in the name
    truth: Truth | None  # goals and strengths; None: not in the name


def parse_name(name: str) -> Recorded:
    """Return the contents of a file name (InvalidEventError: too long, or invalid goals)."""
    if len(name) > _LONGEST:
        raise InvalidEventError(f"name is {shown(name)}, of more than {_LONGEST} characters")
    stem = _SUFFIXES.sub("", name)
    matches = list(_PLACE.finditer(stem))
    if not matches:
        return Recorded(stem, None, None)
    found = matches[-1]  # an id may look like part of a name
    stamp = stem[: found.start()] + found["stamp"]
    place = Place(int(found["layout"]), None if found["copy"] is None else int(found["copy"]))
    if _STAMP.fullmatch(stamp) and not found["between"]:
        stamp += f"{found['switch']}_{place}"
    return Recorded(stamp or stem, place, _truth(stem[found.end() :]))


def _truth(rest: str) -> Truth | None:
    found = _PARAMETERS.match(rest)
    if found is None:
        return None
    goals = _GOAL.findall(found["goals"])
    if len(goals) != len(AGENTS):
        raise InvalidEventError(
            f"name gives the goals {shown(found['goals'])}, expected one per agent such as "
            "['LMO', 0, 2, 1]"
        )
    red, green = (
        goal_string((kind, int(entity), int(target), int(sign)), holder)
        for holder, (kind, entity, target, sign) in enumerate(goals)
    )
    of_red, of_green = (
        None if level == "None" else STRENGTH_LEVELS[int(level)]
        for level in found.group("red", "green")
    )
    return Truth(red, green, strength_red=of_red, strength_green=of_green)


def goal_string(goal: Goal, holder: int) -> str:
    """Return the paper's string of a goal that the agent ``holder`` has, if there is one."""
    kind, entity, target, sign = goal
    positive = sign > 0
    on_landmark = entity < len(AGENTS) and target < len(LANDMARKS)
    if kind == "LMO" and on_landmark:
        literal = GoalLiteral(PredicateKind.ON, BLUE_ITEM + entity, target, positive)
    elif kind == "LMA" and on_landmark:
        literal = GoalLiteral(PredicateKind.ON, entity, target, positive)
    elif kind == "TE" and {entity, target} == {0, 1}:  # chaser and chased, in either agent's goal
        literal = GoalLiteral(PredicateKind.TOUCH, holder, 1 - holder, positive)
    else:
        raise InvalidEventError(f"goal {list(goal)} is none of the paper's {len(GOALS)} goals")
    return GOALS[literal_goal(literal)]


CHANNELS: Final = ("x", "y", "vx", "vy", "angle")


class _Video(msgspec.Struct):
    trajectories: Any
    wall_segs: Any
    landmark_centers: Any
    entity_color_code: dict[Any, int]
    entity_sizes: Any
    name: str = ""
    social_goals: Literal["friendly", "neutral", "adversarial"] | None = None


class _Named(msgspec.Struct):
    name: str


def read(path: str | os.PathLike[str]) -> Entries:
    """Return the videos of the pickle ``path``, in memory; each is checked when it is used.

    Two videos with the same stamp and place have their whole names as ids.
    """
    content = read_pickle(path)
    names = [event_id(one.name) for one in converted(content, list[_Named], "videos")]
    ids = []
    for name in names:
        try:
            ids.append(parse_name(name).id)
        except InvalidEventError:  # reported when the video is read
            ids.append(name)
    given = Counter(ids)
    unique = [id if given[id] == 1 else name for id, name in zip(ids, names, strict=True)]
    return [
        (id, functools.partial(_event, video, id))
        for video, id in zip(content, unique, strict=True)
    ]


def _event(given: Mapping[str, Any], id: str) -> Event:
    said, video = parse_name(given["name"]), converted(given, _Video)
    bodies = list(bodies_by_colour(video.entity_color_code))
    radius = finite_array("sizes", video.entity_sizes, (len(ENTITIES),))[bodies]
    if not isinstance(video.trajectories, list | tuple | np.ndarray):
        raise InvalidEventError("trajectories is no list of tracks")
    if len(video.trajectories) != len(ENTITIES):
        raise InvalidEventError(
            f"trajectories has {len(video.trajectories)} tracks, expected {len(ENTITIES)}"
        )
    shape = (None, len(CHANNELS))
    tracks = [
        finite_array(f"trajectories[{body}]", video.trajectories[body], shape) for body in bodies
    ]
    length = len(tracks[0])
    lengths = list(map(len, tracks))
    if length != lengths[1] or length > min(lengths):
        raise InvalidEventError(
            f"trajectories have {lengths} rows, expected equally many of both agents and no fewer "
            "of items"
        )
    columns = [0, 1, CHANNELS.index("angle")]
    rows = np.stack([track[:length, columns] for track in tracks], axis=1)
    trajectory = np.array(Observation(rows).trajectory)  # refuses a track that is too short
    scene = Scene(  # refuses impossible sizes, before they are used
        trajectory[0], radius, video.wall_segs, landmark_centres=video.landmark_centers
    )
    if said.place is not None and said.place.is_diagonal:
        for agent in range(len(AGENTS)):
            trajectory[:, agent, 2] = repaired(trajectory[:, agent, 2], float(radius[agent]))
    turning = observed_turning(trajectory, radius)
    relation = video.social_goals
    return Event(
        scene=dataclasses.replace(scene, start=trajectory[0], turning=turning),
        observation=Observation(trajectory),
        id=id,
        truth=said.truth,
        judgments=None if relation is None else {"majority": relation},
    )


# --- which body has which colour ------------------------------------------------------------------

COLOUR_CODE: Final = {0: 0, 1: 1, 3: 2, 4: 3}
"""The code of bodies that are ordered by colour."""

_KEYS: Final = ((0, 1, 3, 4), (0, None, 1, 2), (0, 1, 2, 3))
"""Possible keys of ``entity_color_code`` for the bodies; the last are those without shuffling."""


def bodies_by_colour(code: Mapping[Any, Any]) -> tuple[int, ...]:
    """Return the numbers of the red, green, blue and pink body.

    Recordings number their bodies: agents 0 and 1, items 2 and 3. ``entity_color_code`` maps bodies
    to colours (0 red, 1 green, 2 blue, 3 pink), but counts items from 3 on. If the colours of the
    agents were not shuffled, it lacks agent 1, since an item took that number.
    """
    for keys in _KEYS:
        if {*keys} - {None} == {*code}:
            # a missing body has the remaining colour
            colours = [1 - code[0] if key is None else code[key] for key in keys]
            if sorted(colours[:2]) == [0, 1] and sorted(colours[2:]) == [2, 3]:
                return tuple(map(colours.index, range(len(ENTITIES))))
    raise InvalidEventError(
        f"entity_color_code is {shown(dict(code))}, expected a code such as {COLOUR_CODE}"
    )


# --- angles of reflected copies -------------------------------------------------------------------

_TURN: Final = 2 * np.pi
_ROUNDING: Final = 1e-6
_MISFIT: Final = 4.0
"""Cost of being a radian off the cut, in costs of turning by a radian."""

_PASS: Final = 0.1  # cost of passing the cut, rad^2
_BACK: Final = 3.0  # cost of passing it forth and back within two frames, rad^2

_JUMPS: Final = np.array([0, -1, 1])
"""Cuts that may be passed between two frames; earlier ones win ties."""

_PASSING: Final = np.array(
    [(0, 0)] + [(way, after) for way in (1, -1) for after in range(1, SUBSTEPS)]
)
"""(state, 2): direction in which a frame passes the cut (1 as the angle grows, 0: it does not), and
the number of substeps after that."""


def repaired(angles: FloatArray, radius: float) -> FloatArray:
    """Return an agent's angles as if they had been averaged before they were wrapped.

    In copies about a diagonal, angles were wrapped into (-2 pi, 0] in every substep, and then
    averaged over the five substeps of a frame. So a frame in which the angle passes the cut is off
    by a multiple of 2 pi / 5, and later frames by 2 pi. ``angles`` (time,) [rad] are these means.

    Of all ways in which the angle may have passed the cut, the one with the least turning is taken.
    A frame that passes the cut must lie near it, within what an agent of this radius can turn. If
    the angle passed the cut forth and back within one frame, only that frame is off. Angles beyond
    the cut were never wrapped and stay as they are.
    """
    if (angles > _ROUNDING).any() or (angles < -_TURN - _ROUNDING).any():
        return angles
    way, after = _PASSING.T
    passes = np.stack(np.broadcast_arrays(way[:, None, None], way[None, :, None], _JUMPS))
    back = (passes > 0).any(axis=0) & (passes < 0).any(axis=0)
    # (state, former state, jump) of passing the cut
    price = _PASS * np.abs(passes[[0, 2]]).sum(axis=0) + _BACK * back
    share = _TURN * way * after / SUBSTEPS
    # relative to the turns before the frame, and after it
    before, later = angles[:, None] + share, angles[:, None] + share - _TURN * way
    misfit = _misfit(before, radius)
    misfit[0, 1:] = np.inf  # the first frame is no mean
    cost = misfit[0]
    choices = []
    for frame in range(1, len(angles)):
        step = before[frame][:, None, None] + _TURN * _JUMPS - later[frame - 1][:, None]
        # (state, former state, jump)
        total = cost[:, None] + step**2 + price
        flat = total.reshape(len(share), -1)
        best = flat.argmin(axis=1)
        choices.append(best)
        cost = flat[np.arange(len(share)), best] + misfit[frame]
    return _without_spikes(_followed(before, way, choices, int(cost.argmin())), radius)


def _misfit(before: FloatArray, radius: float) -> FloatArray:
    """Return (time, state) by how much a frame misses the cut, if it passes the cut in that state.

    Let the turn be an even v a substep, with ``after`` substeps beyond the cut. Then the mean is
    between (after - 3) v and (after - 2) v beyond it. The fastest substep turns by a third of a
    full turn.
    """
    way, after = _PASSING.T
    beyond = way * (before - np.where(way > 0, 0.0, -_TURN))
    ends = np.stack([after - 3, after - 2, 0 * after]) * (full_turn(radius) / 3)
    off = np.maximum(np.maximum(ends.min(axis=0) - beyond, beyond - ends.max(axis=0)), 0.0)
    return np.where(way == 0, 0.0, (_MISFIT * off) ** 2)


def _without_spikes(angles: FloatArray, radius: float) -> FloatArray:
    """Return angles with single frames repaired that jump farther than an agent can turn, and back.

    They are moved near their neighbours if that is near the cut.
    """
    most, share = full_turn(radius), _TURN / SUBSTEPS
    mended = np.array(angles)
    for frame in range(1, len(mended) - 1):
        forth, back = angles[frame] - mended[frame - 1], angles[frame] - angles[frame + 1]
        if forth * back > 0 and min(abs(forth), abs(back)) > most:
            moved = angles[frame] - share * np.round((forth + back) / 2 / share)
            if abs(moved - _TURN * np.round(moved / _TURN)) < most / 3:
                mended[frame] = moved
    return mended


def _followed(
    before: FloatArray, way: NDArray[np.int64], choices: list[NDArray[np.int64]], last: int
) -> FloatArray:
    """Return the angles of the best path, which ends in state ``last``."""
    steps = [(last, 0)]  # from the last frame backwards: the state, and the jump before it
    for best in reversed(choices):
        state = steps[-1][0]
        former, jump = divmod(int(best[state]), len(_JUMPS))
        steps[-1] = state, int(_JUMPS[jump])
        steps.append((former, 0))
    states, jumps = np.array(steps[::-1]).T
    passed = np.cumsum(jumps) + np.concatenate([[0], np.cumsum(way[states])[:-1]])
    return np.asarray(before[np.arange(len(states)), states] + _TURN * passed)


# --- pickles of plain data ------------------------------------------------------------------------
# Python's unpickler calls any function that a file names. This one has the opcodes of plain data
# only, and a limited number of them. It knows the few names by which NumPy's arrays are described,
# and replaces them by functions that build arrays of plain numbers. Arrays of objects are refused,
# since they would hold a pickle of their own. At last, the result is measured as if written out.

MAX_BYTES: Final = 256 * 2**20  # largest file that is read
MAX_OPCODES: Final = 2_000_000  # most opcodes that are read, which takes some ten seconds
MAX_NESTING: Final = 64  # deepest nesting of lists, tuples and dicts

MAX_SIZE: Final = 20_000_000
"""Most values, numbers in arrays and characters together; shared parts count every time."""

MAX_COPIED: Final = 256 * 2**20
"""Most bytes that are copied into arrays; a shared part may be copied again and again."""

_LONGEST_KEY: Final = 9  # longest tuple allowed as the key of a dict
_NUMBERS: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1)")
_NO_NUMBERS: Final = "holds an array of something else than plain numbers"
_NDARRAY: Final = object()  # represents the class of arrays


def read_pickle(path: str | os.PathLike[str]) -> Any:
    """Return what the pickle in the file ``path`` describes."""
    with reading_bytes("a pickle"), open(path, "rb") as file:
        content = file.read(MAX_BYTES + 1)
    return unpickled(content)


def unpickled(content: bytes) -> Any:
    """Return what a pickle describes. Errors as for :func:`read_pickle`."""
    if len(content) > MAX_BYTES:
        raise too_large(MAX_BYTES)
    if not content:
        raise InvalidEventError("is empty")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for unknown escapes in texts of Python 2
            loaded = _Reader(content).load()
    except (InvalidEventError, MemoryError):
        raise
    except EOFError:
        raise InvalidEventError("is damaged: the pickle ends too early") from None
    except Exception:  # pickle can raise nearly any kind of error
        raise InvalidEventError("is damaged: its pickle makes no sense") from None
    if _size(loaded, {}) > MAX_SIZE:
        raise InvalidEventError(f"is larger than the {MAX_SIZE} values that are read, written out")
    return loaded


def _size(value: Any, known: dict[int, int], depth: int = 0) -> int:
    """Return the number of values, written out."""
    if isinstance(value, str | bytes | bytearray):
        return 1 + len(value)
    if isinstance(value, np.ndarray):
        return 1 + value.size
    if value is None or isinstance(value, bool | int | float):
        return 1
    if not isinstance(value, list | tuple | dict):
        raise InvalidEventError("holds a function or a class in place of data")
    if depth > MAX_NESTING:
        raise InvalidEventError(f"is nested more than {MAX_NESTING} deep, or in itself")
    if id(value) not in known:
        parts = [*value, *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_size(part, known, depth + 1) for part in parts)
    return known[id(value)]


_Base: Any = pickle._Unpickler  # type: ignore[attr-defined]  # the one whose opcodes can be chosen


class _Reader(_Base):  # type: ignore[misc]
    """Python's unpickler, limited to opcodes of plain data, with its own functions for arrays."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content), fix_imports=False, encoding="latin-1")
        self.dispatch = _Opcodes()
        self._copied = 0
        self._known: dict[tuple[str, str], Any] = {
            ("numpy", "ndarray"): _NDARRAY,
            ("numpy", "dtype"): self._dtype,
            ("_codecs", "encode"): self._encode,
            **dict.fromkeys((("__builtin__", "bytes"), ("builtins", "bytes")), lambda: b""),
        }
        for core in ("numpy.core", "numpy._core"):  # before and since NumPy 2
            self._known[f"{core}.multiarray", "_reconstruct"] = self._reconstruct
            self._known[f"{core}.multiarray", "scalar"] = self._scalar
            self._known[f"{core}.numeric", "_frombuffer"] = self._from_buffer

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._known:
            raise InvalidEventError(
                f"asks for {shown(f'{module[:60]}.{name[:60]}')}, which is refused: only dicts, "
                "lists, tuples, texts, numbers and arrays of numbers are read"
            )
        return self._known[module, name]

    # --- opcodes that differ from Python's

    def load_build(self) -> None:
        """Set the content of an array, or the byte order of a data type."""
        state, made = self.stack.pop(), self.stack[-1]
        if isinstance(made, np.dtype):
            # the rest is about fields and nested arrays
            plain = isinstance(state, tuple) and len(state) in (8, 9)
            if not plain or state[1] not in tuple("<>|=") or state[2:5] != (None, None, None):
                raise InvalidEventError(_NO_NUMBERS)
            made.__setstate__((3, state[1], None, None, None, -1, -1, 0))  # type: ignore[attr-defined]
        elif isinstance(made, np.ndarray):
            shape, dtype, fortran, content = state[-4:]
            raw = self._raw(content)
            self._count(len(raw))
            _check_array(raw, dtype, shape)
            made.__setstate__((1, shape, dtype, fortran in (1, True), raw))  # type: ignore[arg-type]
        else:
            raise InvalidEventError("sets the state of what is no array")

    def load_bytearray8(self) -> None:
        (n,) = struct.unpack("<Q", self.read(8))
        self.append(bytearray(self.read(n)))  # takes no more memory than the file has bytes

    def load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._set([key], [value])

    def load_setitems(self) -> None:
        items = self.pop_mark()
        self._set(items[::2], items[1::2])

    def load_dict(self) -> None:
        items = self.pop_mark()
        self.append({})
        self._set(items[::2], items[1::2])

    def _set(self, keys: list[Any], values: list[Any]) -> None:
        """Put items into the dict on top of the stack; keys that take long to hash are refused."""
        for key, value in zip(keys, values, strict=True):
            parts = key if type(key) is tuple and len(key) <= _LONGEST_KEY else (key,)
            if any(
                type(part) is not str and (type(part) is not int or abs(part) >= 2**64)
                for part in parts
            ):
                raise InvalidEventError("has a dict whose keys are no texts or whole numbers")
            self.stack[-1][key] = value

    # --- functions that build arrays, called with anything that a file says

    def _raw(self, content: Any) -> bytes:
        """Return bytes; Python 2 and old protocols wrote them as a text."""
        if isinstance(content, bytes):
            return content
        if not isinstance(content, str | bytearray):
            raise InvalidEventError(_NO_NUMBERS)
        self._count(len(content))
        return content.encode("latin-1") if isinstance(content, str) else bytes(content)

    def _count(self, n: int) -> None:
        self._copied += n
        if self._copied > MAX_COPIED:
            raise InvalidEventError("becomes too large: it shares long texts or arrays")

    def _encode(self, text: str, codec: str) -> bytes:
        if codec not in ("latin1", "latin-1"):
            raise ValueError(codec)
        return self._raw(text)

    def _dtype(self, spelling: str, *_: Any) -> np.dtype[Any]:
        if not isinstance(spelling, str) or not _NUMBERS.fullmatch(spelling):
            raise InvalidEventError(_NO_NUMBERS)
        return np.dtype(spelling, copy=True)  # whose byte order may still be set

    def _reconstruct(self, kind: Any, shape: Any, letter: Any) -> NDArray[Any]:
        if kind is not _NDARRAY:
            raise ValueError(kind)
        return np.empty(0)

    def _scalar(self, dtype: Any, content: Any) -> Any:
        return self._from_buffer(content, dtype, (), "C").item()

    def _from_buffer(
        self, content: Any, dtype: Any, shape: Any, order: str, axes: Any = None
    ) -> NDArray[Any]:
        """Return an array in the order "C", "F" or "K"; "K" follows a given order of the axes."""
        raw = self._raw(content)
        _check_array(raw, dtype, shape)
        flat = np.frombuffer(raw, dtype) if raw else np.empty(0, dtype)
        array = flat.reshape(shape, order="F" if order == "F" else "C")
        return array if axes is None else array.transpose(axes)


def _check_array(raw: bytes, dtype: Any, shape: Any) -> None:
    if not isinstance(dtype, np.dtype):
        raise InvalidEventError(_NO_NUMBERS)
    if not isinstance(shape, tuple) or not all(type(n) is int and 0 <= n < 2**31 for n in shape):
        raise InvalidEventError("holds an array of an impossible shape")
    if math.prod(shape) * dtype.itemsize != len(raw):
        raise InvalidEventError(f"holds an array of shape {shape} in {len(raw)} bytes")


_PLAIN: Final = (
    *("PROTO", "FRAME", "MARK", "STOP", "POP", "POP_MARK", "DUP", "MEMOIZE"),
    *("GET", "BINGET", "LONG_BINGET", "PUT", "BINPUT", "LONG_BINPUT"),
    *("NONE", "NEWTRUE", "NEWFALSE", "FLOAT", "BINFLOAT"),
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"),
    *("STRING", "BINSTRING", "SHORT_BINSTRING"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8"),
    *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    *("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"),
    *("EMPTY_LIST", "LIST", "APPEND", "APPENDS"),
    *("EMPTY_DICT", "DICT", "SETITEM", "SETITEMS"),
    *("GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"),
)


class _Opcodes(dict[int, Callable[[_Reader], None]]):
    """The functions of the allowed opcodes, by code; counts how often they are asked for."""

    def __init__(self) -> None:
        super().__init__()
        for name in _PLAIN:
            code = getattr(pickle, name)[0]
            self[code] = getattr(_Reader, f"load_{name.lower()}", _Base.dispatch[code])
        self._left = MAX_OPCODES

    def __getitem__(self, code: int) -> Callable[[_Reader], None]:
        self._left -= 1
        if self._left < 0:
            raise InvalidEventError(f"has more than {MAX_OPCODES} opcodes")
        if code not in self:
            raise InvalidEventError(
                f"is damaged, or holds an object of a class, refused: opcode {bytes([code])!r}"
            )
        return super().__getitem__(code)
