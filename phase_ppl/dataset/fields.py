"""Checked access to the parts of a parsed event file; errors name the part and its value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from phase_ppl.world.errors import InvalidEventError, shown, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.names import ENTITIES
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import finite_array

T = TypeVar("T")
Entries = list[tuple[str, Callable[[], Event]]]
"""What a file holds: per event its id and the function that reads it."""

_WORDS = {dict: "an object", list: "a list", str: "a string", int: "a whole number"}


def require(record: Mapping[str, Any], name: str, kind: type[T], where: str = "") -> T:
    """Return ``record[name]``, which must be there and of JSON type ``kind``.

    Args:
        record: the JSON object.
        name: the wanted field.
        kind: dict, list, str or int.
        where: path of ``record`` in the file, for the error message.

    Raises:
        InvalidEventError: the field is missing or of another type.
    """
    path = f"{where}.{name}" if where else name
    if name not in record:
        raise InvalidEventError(f"has no {path}")
    value = record[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidEventError(f"{path} is {shown(value)}, expected {_WORDS[kind]}")
    return value


def optional(record: Mapping[str, Any], name: str, kind: type[T], where: str = "") -> T | None:
    """Return ``record[name]`` as :func:`require` does, or None where it is missing or null."""
    return None if record.get(name) is None else require(record, name, kind, where)


def only(record: Mapping[str, Any], allowed: Sequence[str], where: str) -> None:
    """Raise UnknownNameError if ``record`` has a field that is none of ``allowed``."""
    for name in record:
        if name not in allowed:
            raise unknown_name(f"field of {where}", name, allowed)


def per_name(record: Mapping[str, Any], names: Sequence[str], where: str) -> list[Any]:
    """Return the values of an object whose fields are exactly ``names``, in that order.

    Raises:
        InvalidEventError: a name is missing.
        UnknownNameError: another name is there.
    """
    only(record, names, where)
    missing = [name for name in names if name not in record]
    if missing:
        raise InvalidEventError(f"{where} has no {' and no '.join(missing)}")
    return [record[name] for name in names]


def event_id(record: Mapping[str, Any], where: str = "") -> str:
    """Return the field ``id``: a string that can be printed."""
    name = require(record, "id", str, where)
    if not name.strip() or not name.isprintable():
        raise InvalidEventError(f"id is {shown(name)}, expected printable text")
    return name


def read_observation(record: Mapping[str, Any], where: str) -> Observation:
    """Return the observation in an object that maps entity names to rows of [x, y, angle].

    Raises:
        InvalidEventError: entities are missing, rows are not three finite numbers, lengths
            differ, or there are fewer than 2 frames.
    """
    tracks: list[NDArray[np.float64]] = [
        finite_array(f"{where}[{name!r}]", rows, (None, 3))
        for name, rows in zip(ENTITIES, per_name(record, ENTITIES, where), strict=True)
    ]
    lengths = [len(track) for track in tracks]
    if len(set(lengths)) > 1:
        listed = ", ".join(f"{n} {name}" for n, name in zip(lengths, ENTITIES, strict=True))
        raise InvalidEventError(f"{where} differ in length: {listed}")
    return Observation(np.stack(tracks, axis=1))
