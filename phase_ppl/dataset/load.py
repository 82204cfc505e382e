"""Reading and writing events, whatever the format of the file."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from phase_ppl.dataset import events_json, phase_test
from phase_ppl.dataset.documents import parse_document, read_document
from phase_ppl.dataset.events_json import Entries, event_from_record
from phase_ppl.dataset.hdf5 import is_hdf5
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    UnknownNameError,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, check_output, write_bytes
from phase_ppl.world.scene import TURNINGS, Turning

_SUFFIX = ".json"


def bundled_events() -> list[str]:
    """Return the names of the bundled events, sorted."""
    folder = _folder()
    if not folder.is_dir():
        return []
    names = (file.name for file in folder.iterdir())
    return sorted(name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX))


def load_bundled(name: str) -> Event:
    """Return the bundled event ``name``.

    Raises:
        UnknownNameError: there is no such event; the message names those that there are.
    """
    names = bundled_events()
    if name not in names:
        raise unknown_name("bundled event", name, names)
    return event_from_record(parse_document((_folder() / f"{name}{_SUFFIX}").read_bytes()))


def _folder() -> Traversable:
    return resources.files("phase_ppl.dataset") / "events"


# --- reading and writing events, whatever the format of the file ----------------------------------

_JSON: Final = ".json"
_NETCDF: Final = ".nc"
SUFFIXES: Final = (_JSON, _NETCDF)
"""Endings of the files that events are written to."""

PathLike = str | os.PathLike[str]

_READERS: Final[Mapping[str, Callable[[Mapping[str, Any]], Entries]]] = {
    events_json.EVENT_FORMAT: events_json.read_one,
    events_json.EVENTS_FORMAT: events_json.read_many,
    phase_test.FORMAT: phase_test.read,
}
"""Per format tag the function that lists the events of a document."""

PHASE_PICKLE: Final = "phase-pickle"
"""The format of the authors' pickles, which are read only where this is said."""


def load_event(
    path: PathLike,
    video: str | None = None,
    turning: Turning | None = None,
    *,
    format: str | None = None,
) -> Event:
    """Read one event.

    Args:
        path: an event file, JSON (:mod:`phase_ppl.dataset.events_json`) or NetCDF
            (:mod:`phase_ppl.dataset.events_netcdf`), the authors' videos
            (:mod:`phase_ppl.dataset.phase_test`), or the name of a bundled event, with or without
            ".json", where no file of that name exists.
        video: id of the wanted event; must be given if the file holds several.
        turning: "both", "ccw" or "cw" instead of what the file says or shows.
        format: "phase-pickle" for a pickle of PHASE's authors
            (:mod:`phase_ppl.dataset.authors.videos`), of which only plain data are read; no code
            in it is run. All other files say themselves what they are.

    Raises:
        InvalidEventError: the file cannot be read as an event; the message names file and value.
        UnknownNameError: the file holds no event ``video``; the message names close matches.
        InvalidSettingError: the file holds several events and none was named.
    """
    _check_turning(turning)
    entries = _entries(path, format)
    ids = [name for name, _ in entries]
    if video is None and len(ids) > 1:
        some = ", ".join(repr(name) for name in ids[:3]) + (", ..." if len(ids) > 3 else "")
        raise InvalidSettingError(f"{path} holds {len(ids)} videos; name one of them: {some}")
    if video is not None and video not in ids:
        with naming(path):
            raise unknown_name("video", video, ids)
    index = 0 if video is None else ids.index(video)
    return _read(path, entries[index], turning)


def load_events(
    path: PathLike, turning: Turning | None = None, *, format: str | None = None
) -> Sequence[Event]:
    """Read all events of a file, in the order of the file, or of a generated data set.

    Args:
        path: as for :func:`load_event`, or the folder of a generated data set, which comes as
            :class:`~phase_ppl.dataset.generation.store.GeneratedEvents`, whose events are read
            when they are asked for.
        turning, format: as for :func:`load_event`.

    Raises:
        InvalidEventError, InvalidSettingError: as for :func:`load_event`.
    """
    _check_turning(turning)
    folder = as_path(path)
    if folder.is_dir() and any(
        (folder / name).is_file() for name in ("plan.json", "manifest.json")
    ):
        from phase_ppl.dataset.generation.store import GeneratedEvents

        return GeneratedEvents(folder, turning)
    return [_read(path, entry, turning) for entry in _entries(path, format)]


def save_event(event: Event, path: PathLike) -> None:
    """Write ``event`` to a ".json" or ".nc" file; :func:`load_event` gives the same event back.

    Judgments and predictions come back as JSON has them: tuples as lists, names as strings.

    Raises:
        OutputError: the file cannot be written.
        InvalidEventError: judgments or predictions hold something that JSON has no form for, or
            the id is no printable text.
    """
    as_path(path)
    with naming(path):
        content = _netcdf().one(event) if _is_netcdf(path) else events_json.event_record(event)
    _write(content, path)


def save_events(events: Sequence[Event], path: PathLike) -> None:
    """Write several events to a ".json" or ".nc" file; :func:`load_events` gives them back.

    Raises:
        OutputError: the file cannot be written.
        InvalidEventError: no events, an id given twice, or as for :func:`save_event`.
    """
    as_path(path)
    instance_of("events", events, Sequence, "a list of events")
    events = list(events)
    for event in events:
        instance_of("event", event, Event, "a phase_ppl.Event")
    with naming(path):
        check_ids([event.id for event in events])
        content = _netcdf().many(events) if _is_netcdf(path) else events_json.events_record(events)
    _write(content, path)


def _is_netcdf(path: PathLike) -> bool:
    return Path(path).suffix.lower() == _NETCDF


def _netcdf() -> ModuleType:
    """Return the module for NetCDF, which brings xarray: only where it is needed."""
    return importlib.import_module("phase_ppl.dataset.events_netcdf")


def _write(content: Any, path: PathLike) -> None:
    """Write a JSON object, or a Dataset for NetCDF."""
    check_output(path, SUFFIXES)  # what is wrong with the place is said before what is in it
    with naming(path):
        netcdf = _is_netcdf(path)
        text = _netcdf().to_bytes(content) if netcdf else events_json.to_text(content).encode()
    write_bytes(path, SUFFIXES, text)


def _entries(path: PathLike, format: str | None) -> Entries:
    if format is not None:
        return _authors_entries(path, format)
    bundled = _bundled_name(path)
    if bundled is not None:
        return [(bundled, functools.partial(load_bundled, bundled))]
    with naming(path):
        if is_hdf5(path) or (_is_netcdf(path) and Path(path).is_file()):
            entries: Entries = _netcdf().read(path)
        else:
            entries = _of_document(read_document(path))
        check_ids([name for name, _ in entries])
    return entries


def _authors_entries(path: PathLike, format: str) -> Entries:
    if format != PHASE_PICKLE:
        raise unknown_name("format", format, [PHASE_PICKLE])
    with naming(path):
        entries: Entries = importlib.import_module("phase_ppl.dataset.authors.videos").read(path)
        check_ids([name for name, _ in entries])
    return entries


def _of_document(document: Mapping[str, Any]) -> Entries:
    tag = document.get("format")
    if tag is None:
        raise InvalidEventError(f"is not an event file: it has no format, such as {_FORMATS}")
    if not isinstance(tag, str) or tag not in _READERS:
        raise InvalidEventError(f"has format {shown(tag)}, expected one of {_FORMATS}")
    return _READERS[tag](document)


_FORMATS = ", ".join(repr(tag) for tag in _READERS)


def check_ids(ids: Sequence[str]) -> None:
    """Raise InvalidEventError if there are no ids, or one is there twice."""
    if not ids:
        raise InvalidEventError("holds no videos: the list is empty")
    seen: set[str] = set()
    for name in ids:
        if name in seen:
            raise InvalidEventError(f"holds two videos with the id {shown(name)}")
        seen.add(name)


def _read(path: PathLike, entry: tuple[str, Callable[[], Event]], turning: Turning | None) -> Event:
    name, read = entry
    with naming(path, name):
        event = read()
    return event if turning is None else turned(event, turning)


def turned(event: Event, turning: Turning) -> Event:
    """Return the event with agents that can turn in other ways."""
    return dataclasses.replace(event, scene=dataclasses.replace(event.scene, turning=turning))


def _bundled_name(path: PathLike) -> str | None:
    """Return the bundled event that a bare name stands for, unless a file has that name."""
    plain = as_path(path)
    if os.fspath(path) != plain.name or (plain.exists() and not plain.is_dir()):
        return None
    name, known = plain.name.removesuffix(".json"), bundled_events()
    if name not in known:
        if plain.exists():
            return None
        bundled = f" and no such bundled event ({', '.join(known)})" if known else ""
        raise InvalidEventError(f"{path}: no such file{bundled}")
    return name


def _check_turning(turning: str | None) -> None:
    if turning is not None and turning not in TURNINGS:
        raise unknown_name("turning", turning, TURNINGS)


@contextlib.contextmanager
def naming(path: PathLike, video: str | None = None) -> Iterator[None]:
    """Put the file, and the video where there is one, in front of an error's message."""
    try:
        yield
    except (InvalidEventError, InvalidSettingError, UnknownNameError) as error:
        where = str(path) if video is None or video == Path(path).stem else f"{path}, video {video}"
        # a wrong value in a file is the file's fault, not that of a setting
        kind = UnknownNameError if isinstance(error, UnknownNameError) else InvalidEventError
        raise kind(f"{where}: {error}") from None
