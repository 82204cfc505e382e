"""Event files in NetCDF 4, for xarray and other readers of HDF5.

A file of one event is the Dataset of :func:`event_dataset` with the attribute
``format`` = "phase-ppl-event-1".

A file of several, ``format`` = "phase-ppl-events-1", is ragged in time. The frames of all events
follow each other along ``time``, and their inner walls along ``wall``; ``n_frames`` and ``n_walls``
(event) are the numbers for each event. All else has a first dimension ``event``, whose coordinate
holds the ids, so that ``xarray.open_dataset("all.nc").goal_red`` is a column.

Events of another world than PHASE have the world as JSON in the text ``world``, and their truth in
the text ``truth``. All events of a file are of one world.

Each array carries a checksum of its bytes, and each event one of all its contents, ``sha256``.
Reading compares them.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import xarray as xr

from phase_ppl.data.documents import check_once, event_id, in_front, parse_document, per_name
from phase_ppl.data.events_json import (
    ARRAYS,
    DOCUMENTS,
    EVENT_FORMAT,
    EVENTS_FORMAT,
    Entries,
    event_from_record,
    event_record,
    scene_record,
    to_text,
)
from phase_ppl.data.hdf5 import check_hdf5, content_of, netcdf_bytes, reading, root_attribute
from phase_ppl.world.arrays import finite_array
from phase_ppl.world.errors import InvalidEventError, instance_of, shown
from phase_ppl.world.event import FRAMES_PER_SECOND, Event
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.scene import PHASE, World, one_or_all, world_in_files

LABELS: Final[Mapping[str, Sequence[str]]] = {
    "entity": ENTITIES,
    "coord": ("x", "y", "angle"),
    "xy": ("x", "y"),
    "landmark": LANDMARKS,
    "bound": ("x_min", "x_max", "y_min", "y_max"),
}
"""Dimension of an array -> names along it."""

_LENGTH: Final = "units of length"
_POSE: Final = "units of length (x, y), radians (angle)"
_ARRAYS: Final[Mapping[str, tuple[tuple[str, ...], str]]] = {
    "trajectory": (("time", "entity", "coord"), _POSE),
    "start": (("entity", "coord"), _POSE),
    "radius": (("entity",), _LENGTH),
    "walls": (("wall", "end", "xy"), _LENGTH),
    "landmark_centres": (("landmark", "xy"), _LENGTH),
    "landmark_half_width": ((), _LENGTH),
    "arena": (("bound",), _LENGTH),
}
"""Array of an event -> its dimensions, and its units in words."""

_GOALS: Final = ("goal_red", "goal_green")
_STRENGTHS: Final = ("strength_red", "strength_green")
_RESETS: Final = "resets_velocity"
"""1 or 0, if agents of any of a file's events stand still after each step; else left out."""

_TIME_TOLERANCE: Final = 1e-3
"""Largest relative deviation of a time step from 1/12 s that counts as rounding."""


def labels_of(world: World) -> Mapping[str, Sequence[str]]:
    """Return :data:`LABELS` with the names of a world."""
    return {**LABELS, "entity": world.entities, "landmark": world.landmark_names}


def _arrays_of(kept: Mapping[str, Any] | None) -> Mapping[str, tuple[tuple[str, ...], str]]:
    """Return :data:`_ARRAYS`; in files with a world, each landmark's square has its own size."""
    each = {"landmark_half_width": (("landmark",), _LENGTH)}
    return _ARRAYS if kept is None else {**_ARRAYS, **each}


def event_dataset(event: Event) -> xr.Dataset:
    """Return ``event`` as a Dataset; :func:`event_from_dataset` gives the same event back.

    Raises:
        InvalidEventError: judgments or predictions have no form in JSON, or the id is no
            printable text.
    """
    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, world, truth = event.scene, event.scene.world, event.truth
    values: dict[str, Any] = {"trajectory": event.observation.trajectory}
    values |= {name: getattr(scene, name) for name in (*ARRAYS, "turning")}
    if scene.resets_velocity:
        values[_RESETS] = np.int8(1)
    documents: dict[str, Any] = {}
    kept = world_in_files(world)
    if kept is None:
        for name in (*_GOALS, "relation", "scenario"):
            values[name] = getattr(truth, name, "")
        for name in _STRENGTHS:
            values[name] = np.array(getattr(truth, name, None), float)  # NaN: unknown
    else:
        values["landmark_half_width"] = scene.half_widths
        documents = {"world": kept, "truth": truth and truth.to_dict()}
    documents |= {name: getattr(event, name) for name in DOCUMENTS}
    for name, content in documents.items():
        values[name] = "" if content is None else to_text(dict(content), compact=True)
    described = {**_arrays_of(kept), **dict.fromkeys(_STRENGTHS, ((), "N"))}
    variables: dict[str, Any] = {}
    for name, value in values.items():
        dims, units = described.get(name, ((), ""))
        # copies: an event's own arrays are read-only
        variables[name] = dims, np.array(value), {"units": units} if units else {}
    seconds = np.arange(event.observation.n_frames) / FRAMES_PER_SECOND
    time = "time", seconds, {"units": "s", "long_name": "simulated time"}
    labels = {dim: list(names) for dim, names in labels_of(world).items()}
    coords = {"time": time, **labels, "event": event_id(event.id)}
    return xr.Dataset(variables, coords, {"format": EVENT_FORMAT})


def event_from_dataset(dataset: xr.Dataset) -> Event:
    """Return the event in a Dataset as from :func:`event_dataset`.

    Dimensions and labels may come in any order; further variables are ignored. Variables of the
    truth, judgments and predictions may be missing.

    Raises:
        InvalidEventError: something is missing, of the wrong type or shape, or impossible, or
            frames are not 1/12 s apart.
        UnknownNameError: an entity, coordinate, goal, relation or scenario is unknown.
        InvalidSettingError: a strength is no positive force.
    """
    if not isinstance(dataset, xr.Dataset):
        raise InvalidEventError(f"{shown(dataset)} is no xarray Dataset")
    _check_time(dataset)
    given = _document(dataset, "world")
    world = PHASE if given is None else World.from_dict(given)
    labels, arrays = labels_of(world), _arrays_of(given)
    found = {name: _values(dataset, name, dims, labels) for name, (dims, _) in arrays.items()}
    tracks = found.pop("trajectory").swapaxes(0, 1).tolist()
    found = {name: values.tolist() for name, values in found.items()}
    if given is not None:
        found["landmark_half_width"] = one_or_all(found["landmark_half_width"])
    resets = _value(dataset, _RESETS, 0)
    if resets not in (0, 1):
        raise InvalidEventError(f"{_RESETS} is {shown(resets)}, expected 0 or 1")
    record: dict[str, Any] = {
        "world": given,
        "truth": None if given is None else _document(dataset, "truth"),
        **{name: _document(dataset, name) for name in DOCUMENTS},
        "id": _text(dataset, "event"),
        "scene": scene_record(found, _text(dataset, "turning"), bool(resets), world),
        "trajectories": dict(zip(world.entities, tracks, strict=True)),
    }
    goals = [_text(dataset, name, "") for name in _GOALS]
    if any(goals):
        forces = [_value(dataset, name, None) for name in _STRENGTHS]
        record["truth"] = {
            "goals": dict(zip(AGENTS, goals, strict=True)),
            **{name: _text(dataset, name, "") for name in ("relation", "scenario")},
            "strengths": dict(zip(AGENTS, forces, strict=True)),
        }
    return event_from_record(record)


def _check_time(dataset: xr.Dataset) -> None:
    if "time" not in dataset.coords:
        return
    steps = np.diff(finite_array("time", dataset.variables["time"].values, (None,)))
    odd = np.abs(steps * FRAMES_PER_SECOND - 1) > _TIME_TOLERANCE
    if odd.any():
        raise InvalidEventError(
            f"time goes on by {steps[odd][0]:g} s, expected 1/{FRAMES_PER_SECOND:g} s per frame"
        )


def _values(
    dataset: xr.Dataset, name: str, dims: tuple[str, ...], labels: Mapping[str, Sequence[str]]
) -> Any:
    """Return the values of a variable along ``dims``, in the package's order."""
    if name not in dataset.variables:
        raise InvalidEventError(f"has no variable {name}")
    variable = dataset.variables[name]
    if sorted(map(str, variable.dims)) != sorted(dims):
        raise InvalidEventError(
            f"{name} has dimensions ({', '.join(map(str, variable.dims))}), "
            f"expected ({', '.join(dims)})"
        )
    values = np.asarray(variable.values)
    if variable.dims != dims:
        values = values.transpose([variable.dims.index(dim) for dim in dims])
    for axis, dim in enumerate(dims):
        if dim in labels:
            values = values.take(_order(dataset, dim, labels[dim]), axis)
    return values


def _order(dataset: xr.Dataset, dim: str, names: Sequence[str]) -> list[int]:
    """Return the positions of the labels of ``dim``, in the package's order."""
    if dim not in dataset.coords:
        raise InvalidEventError(f"has no coordinate {dim}, which says what is where along it")
    labels = [_plain(label) for label in dataset.variables[dim].values.tolist()]
    check_once(labels, f"coordinate {dim} has twice the label")
    return per_name(
        {label: place for place, label in enumerate(labels)}, names, f"coordinate {dim}"
    )


def _value(dataset: xr.Dataset, name: str, *default: Any) -> Any:
    """Return the value of a variable without dimensions, None for NaN; or the default."""
    if name not in dataset.variables:
        if not default:
            raise InvalidEventError(f"has no {name}")
        return default[0]
    value = _plain(dataset.variables[name].values.tolist())
    return None if isinstance(value, float) and np.isnan(value) else value


def _text(dataset: xr.Dataset, name: str, *default: str) -> str:
    value = _value(dataset, name, *default)
    if not isinstance(value, str):
        raise InvalidEventError(f"{name} is {shown(value)}, expected a string")
    return value


def _plain(value: object) -> Any:
    """Return text that a file holds as bytes as a string, other values unchanged."""
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def _document(dataset: xr.Dataset, name: str) -> dict[str, Any] | None:
    text = _text(dataset, name, "")
    with in_front(f"{name}: "):
        return parse_document(text) if text else None


# --- files -----------------------------------------------------------------------------------

_RAGGED: Final = {"time": "n_frames", "wall": "n_walls"}
"""Dimension along which events follow each other -> the variable with their lengths."""

_CHECKSUM: Final = "sha256"

Place = dict[str, int | slice]
"""Place of an event in a file of several: dimension -> index or slice."""


def read(path: str | os.PathLike[str]) -> Entries:
    """Return the events of the file ``path``, in memory; each is checked when it is used."""
    check_hdf5(path)
    with reading():
        dataset = content_of(path)["/"]
    tag = root_attribute(path, "format")
    if tag == EVENT_FORMAT:
        ids, places = [event_id(_text(dataset, "event"))], [Place()]
    elif tag == EVENTS_FORMAT:
        ids, places = _listed(dataset)
    else:
        what = f"format {shown(tag)}" if tag else "no format"
        raise InvalidEventError(f"has {what}, expected {EVENT_FORMAT!r} or {EVENTS_FORMAT!r}")
    return [
        (id, functools.partial(_checked_event, dataset, place))
        for id, place in zip(ids, places, strict=True)
    ]


def event_bytes(event: Event) -> bytes:
    """Return the content of a file of one event. Errors as for :func:`event_dataset`."""
    return _to_bytes(_sealed(event))


def events_bytes(events: Sequence[Event]) -> bytes:
    """Return the content of a file of several events. Errors as for :func:`event_dataset`."""
    other = next((e for e in events if e.scene.world != events[0].scene.world), None)
    if other is not None:
        raise InvalidEventError(
            f"event {other.id!r} is of the world {other.scene.world.name}, the first one of "
            f"{events[0].scene.world.name}: a file holds events of one world"
        )
    datasets = [_sealed(event) for event in events]
    if any(_RESETS in dataset for dataset in datasets):
        no = {_RESETS: ((), np.int8(0))}
        datasets = [one if _RESETS in one else one.assign(no) for one in datasets]
    return _to_bytes(_packed(datasets))


def _sealed(event: Event) -> xr.Dataset:
    return event_dataset(event).assign({_CHECKSUM: ((), checksum(event))})


def _to_bytes(dataset: xr.Dataset) -> bytes:
    """Return the bytes of a file (InvalidEventError: it would be too large to read)."""
    # only strengths can be missing
    content = netcdf_bytes({"/": dataset}, {"_FillValue": None, "fletcher32": True})
    check_hdf5(io.BytesIO(content))
    return content


def checksum(event: Event) -> str:
    """Return the SHA-256 of all contents of an event, as hexadecimal digits."""
    # names of judgments may be numbers; JSON has strings
    record = json.loads(to_text(event_record(event), compact=True))
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def _checked_event(dataset: xr.Dataset, place: Mapping[str, Any]) -> Event:
    dataset = dataset.isel(place)
    event = event_from_dataset(dataset)
    if _CHECKSUM in dataset and dataset.variables[_CHECKSUM].values.tolist() != checksum(event):
        raise InvalidEventError(
            f"its content is not what {_CHECKSUM} says: damaged, or edited; an edited dataset is "
            f"written by save_event(event_from_dataset(dataset), path) or without {_CHECKSUM}"
        )
    return event


def _packed(datasets: Sequence[xr.Dataset]) -> xr.Dataset:
    """Return one dataset of several events, which have the same variables."""
    packed: dict[str, xr.Variable] = {}
    for name, variable in datasets[0].variables.items():
        parts = [dataset.variables[name].values for dataset in datasets]
        if name in LABELS:
            packed[str(name)] = variable
            continue
        if variable.dtype.kind == "U":
            # texts as objects: arrays of strings are as wide as the longest
            parts = [part.astype(object) for part in parts]
        ragged = variable.dims and variable.dims[0] in _RAGGED
        dims = variable.dims if ragged else ("event", *variable.dims)
        joined = np.concatenate(parts) if ragged else np.stack(parts)
        packed[str(name)] = xr.Variable(dims, joined, variable.attrs)
    for dim, counter in _RAGGED.items():
        lengths = np.array([dataset.sizes[dim] for dataset in datasets])
        packed[counter] = xr.Variable("event", lengths, {"sample_dimension": dim})
    coords = {name: packed.pop(name) for name in ("time", "event", *LABELS)}
    return xr.Dataset(packed, coords, {"format": EVENTS_FORMAT})


def _listed(dataset: xr.Dataset) -> tuple[list[str], list[Place]]:
    """Return the ids of the events of a packed dataset, and their places."""
    if "event" not in dataset.dims or "event" not in dataset.coords:
        raise InvalidEventError("has no coordinate event, which holds the ids")
    places: list[Place] = [{"event": index} for index in range(dataset.sizes["event"])]
    for dim, counter in _RAGGED.items():
        if counter not in dataset.variables or dataset[counter].dims != ("event",):
            raise InvalidEventError(f"has no {counter} (event)")
        lengths, size = dataset[counter].values, dataset.sizes.get(dim, 0)
        # no length above the total, so that no sum can overflow
        whole = lengths.dtype.kind in "iu" and not ((lengths < 0) | (lengths > size)).any()
        if not whole or int(lengths.sum()) != size:
            raise InvalidEventError(f"{counter} does not add up to the {size} along {dim}")
        stops = np.cumsum(lengths, dtype=np.int64).tolist()
        for place, start, stop in zip(places, [0, *stops], stops, strict=False):
            place[dim] = slice(start, stop)
    return [event_id(name) for name in dataset.variables["event"].values.tolist()], places
