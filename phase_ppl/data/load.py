"""Reading and writing events in all formats."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from typing import TYPE_CHECKING, Final

import numpy as np

from phase_ppl.data import events_json
from phase_ppl.data.documents import (
    check_ids,
    event_id,
    in_front,
    is_pickle,
    naming,
    parse_document,
    read_document,
)
from phase_ppl.data.events_json import Entries, event_from_record, turned
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    check_name,
    instance_of,
)
from phase_ppl.world.event import FRAMES_PER_SECOND, Event
from phase_ppl.world.files import as_path, check_output, write_bytes
from phase_ppl.world.scene import TURNINGS, Turning

if TYPE_CHECKING:
    import xarray as xr

PathLike = str | os.PathLike[str]

_JSON: Final = ".json"


def bundled_events() -> list[str]:
    """Return the names of the events that come with the package, sorted."""
    names = (file.name for file in _folder().iterdir())
    return sorted(name.removesuffix(_JSON) for name in names if name.endswith(_JSON))


def _folder() -> Traversable:
    return resources.files("phase_ppl.data") / "events"


# --- reading ---------------------------------------------------------------------------------


def load_event(
    path: PathLike,
    video: str | None = None,
    turning: Turning | None = None,
) -> Event:
    """Return an event, read from a file or bundled with the package.

    Args:
        path: an event file, or the name of a bundled event, with or without ".json". If there is a
            file of that name too, the file is read. A file is recognised by its content: JSON
            (:mod:`phase_ppl.data.events_json`) or a pickle of PHASE's authors
            (:mod:`phase_ppl.data.authors`). Only plain data are read from a pickle; its code is not
            run.
        video: id of the wanted event; required if the file holds several.
        turning: which way agents can turn by themselves, in place of the file's value: "both",
            "ccw" (counter-clockwise) or "cw".

    Raises:
        InvalidEventError: the file cannot be read as an event; the message names file and value.
        UnknownNameError: the file holds no event ``video``, or ``turning`` is unknown.
        InvalidSettingError: the file holds several events and ``video`` is not given.
    """
    _check_turning(turning)
    entries = _entries(path)
    ids = [name for name, _ in entries]
    if video is None and len(ids) > 1:
        some = ", ".join(repr(name) for name in ids[:3]) + (", ..." if len(ids) > 3 else "")
        raise InvalidSettingError(f"{path} holds {len(ids)} videos; name one of them: {some}")
    if video is not None:
        with naming(path):
            check_name("video", video, ids)
    index = 0 if video is None else ids.index(video)
    return _read(path, entries[index], turning)


def load_events(path: PathLike, turning: Turning | None = None) -> Sequence[Event]:
    """Return all events of a file, in the file's order, or of a generated data set.

    Args:
        path: an event file or the name of a bundled event (:func:`load_event`), or the folder of a
            generated data set. A folder gives a :class:`phase_ppl.GeneratedEvents`, which reads an
            event when it is asked for.
        turning: which way agents can turn by themselves, in place of the files' values.

    Raises:
        InvalidEventError: the file or folder holds no readable events; the message says which part.
        UnknownNameError: ``turning`` is unknown.
    """
    _check_turning(turning)
    folder = as_path(path)
    if folder.is_dir() and any(
        (folder / name).is_file() for name in ("plan.json", "manifest.json")
    ):
        from phase_ppl.data.generated import GeneratedEvents

        return GeneratedEvents(folder, turning)
    return [_read(path, entry, turning) for entry in _entries(path)]


def _entries(path: PathLike) -> Entries:
    bundled = _bundled_name(path)
    if bundled is None and as_path(path).is_dir():
        with naming(path):
            raise InvalidEventError("is a folder, expected an event file")
    if bundled is not None:
        file = _folder() / f"{bundled}{_JSON}"
        return [(bundled, lambda: event_from_record(parse_document(file.read_bytes())))]
    with naming(path):
        if is_pickle(path):
            # imported only here, as it brings the simulator
            from phase_ppl.data import authors

            with in_front("is a pickle (only pickles of PHASE's authors can be read): "):
                entries = authors.read(path)
        elif as_path(path).is_file() and as_path(path).suffix.lower() == ".nc":
            raise InvalidEventError(
                "is NetCDF, the form of posteriors, which phase_ppl.load_posterior reads; events "
                "are JSON"
            )
        else:
            entries = events_json.read(read_document(path))
        check_ids([name for name, _ in entries])
    return entries


def _read(path: PathLike, entry: tuple[str, Callable[[], Event]], turning: Turning | None) -> Event:
    name, read = entry
    with naming(path, name):
        event = read()
    return event if turning is None else turned(event, turning)


def _bundled_name(path: PathLike) -> str | None:
    """Return the bundled event of that name, unless a file has that name."""
    plain = as_path(path)
    if os.fspath(path) != plain.name or (plain.exists() and not plain.is_dir()):
        return None
    name, known = plain.name.removesuffix(".json"), bundled_events()
    if name not in known:
        if plain.exists():
            return None
        raise InvalidEventError(
            f"{path}: no such file, nor a bundled event: those are {', '.join(known)}"
        )
    return name


def _check_turning(turning: str | None) -> None:
    if turning is not None:
        check_name("turning", turning, TURNINGS)


# --- writing ---------------------------------------------------------------------------------


def save_event(event: Event, path: PathLike) -> None:
    """Write ``event`` to a ".json" file, from which :func:`load_event` reads it.

    Judgments and predictions come back as JSON has them: tuples as lists, and keys as strings.
    Thoughts of simulated agents are not written.

    Args:
        event: the event.
        path: the file, ending in ".json". An existing file is replaced.

    Raises:
        OutputError: the file cannot be written.
        InvalidEventError: judgments or predictions have no form in JSON, or the id is not
            printable text.
    """
    _write(path, lambda: events_json.event_bytes(event))


def save_events(events: Sequence[Event], path: PathLike) -> None:
    """Write several events to the ".json" file ``path``, from which :func:`load_events` reads them.

    Raises:
        OutputError: the file cannot be written.
        InvalidEventError: there are no events, two have the same id, or :func:`save_event` refuses
            one.
    """
    instance_of("events", events, Sequence, "a list of events")
    events = list(events)
    for event in events:
        instance_of("event", event, Event, "a phase_ppl.Event")
    with naming(path):
        check_ids([event.id for event in events])
    _write(path, lambda: events_json.events_bytes(events))


def _write(path: PathLike, content: Callable[[], bytes]) -> None:
    check_output(path, (_JSON,))  # errors of the path come before errors of the content
    with naming(path):
        made = content()
    write_bytes(path, (_JSON,), made)


def event_dataset(event: Event) -> xr.Dataset:
    """Return an event's arrays as a Dataset, with names along its dimensions.

    Variables are ``trajectory`` (time, entity, coord), ``radius`` (entity,), ``walls`` (wall, end,
    xy), ``landmark_centres`` (landmark, xy) and ``landmark_half_width`` (landmark,). Lengths are in
    units, angles in rad, times in simulated seconds. The Dataset's attributes are ``event``, the
    event's id, and ``truth``, if known, as JSON.
    """
    import xarray as xr

    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, world, truth = event.scene, event.scene.world, event.truth
    arrays = {
        "trajectory": (("time", "entity", "coord"), event.observation.trajectory.copy()),
        "radius": ("entity", scene.radius.copy()),
        "walls": (("wall", "end", "xy"), np.array(scene.walls)),
        "landmark_centres": (("landmark", "xy"), scene.landmark_centres.copy()),
        "landmark_half_width": ("landmark", np.array(scene.half_widths)),
    }
    names = {
        "time": np.arange(event.observation.n_frames) / FRAMES_PER_SECOND,
        "entity": list(world.entities),
        "coord": ["x", "y", "angle"],
        "landmark": list(world.landmark_names),
        "xy": ["x", "y"],
    }
    known = {} if truth is None else {"truth": events_json.to_text(truth.to_dict(), compact=True)}
    return xr.Dataset(arrays, names, {"event": event_id(event.id), **known})
