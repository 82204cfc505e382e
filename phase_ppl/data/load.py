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
    """Return the names of the bundled events, sorted."""
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
    """Read one event.

    Args:
        path: an event file, or the name of a bundled event. The file is recognised by its content:
            JSON (:mod:`phase_ppl.data.events_json`) or a pickle of PHASE's authors
            (:mod:`phase_ppl.data.authors`). Only plain data are read from a pickle; its code is not
            run. The name may have ".json" at its end. A file of that name comes first.
        video: id of the wanted event; required if the file holds several.
        turning: which way agents can turn, in place of the file's value: "both", "ccw"
            (counter-clockwise) or "cw".

    Raises:
        InvalidEventError: the file cannot be read as an event; the message names file and value.
        UnknownNameError: the file holds no event ``video``; the message names close matches.
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
    """Read all events of a file, in the order of the file, or of a generated data set.

    Args:
        path: as for :func:`load_event`, or the folder of a generated data set. That gives
            :class:`~phase_ppl.data.generated.GeneratedEvents`, which reads an event when it is
            asked for.
        turning: as for :func:`load_event`.

    Raises:
        InvalidEventError, InvalidSettingError: as for :func:`load_event`.
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
            f"{path}: no such file and no such bundled event ({', '.join(known)})"
        )
    return name


def _check_turning(turning: str | None) -> None:
    if turning is not None:
        check_name("turning", turning, TURNINGS)


# --- writing ---------------------------------------------------------------------------------


def save_event(event: Event, path: PathLike) -> None:
    """Write ``event`` to a ".json" file; :func:`load_event` gives the same event back.

    Judgments and predictions come back as JSON has them: tuples as lists, and keys as strings.

    Args:
        event: the event.
        path: of the file, which ends in ".json". An existing file is replaced.

    Raises:
        OutputError: the file cannot be written.
        InvalidEventError: judgments or predictions have no form in JSON, or the id is not
            printable text.
    """
    _write(path, lambda: events_json.event_bytes(event))


def save_events(events: Sequence[Event], path: PathLike) -> None:
    """Write several events to a ".json" file; :func:`load_events` gives them back.

    Raises:
        OutputError: the file cannot be written.
        InvalidEventError: no events, an id given twice, or as for :func:`save_event`.
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

    ``trajectory`` (time, entity, coord), ``radius`` (entity), ``walls`` (wall, end, xy),
    ``landmark_centres`` (landmark, xy) and ``landmark_half_width`` (landmark) are in units of
    length, angles in radians, ``time`` in seconds simulated. Attributes are ``event``, its id, and
    ``truth`` as JSON.
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
