"""Event files in NetCDF 4, for xarray and whatever else reads HDF5.

A file of one event is the Dataset of :mod:`phase_ppl.dataset.xarrays` with the attribute
``format`` = "phase-ppl-event-1".

A file of several, ``format`` = "phase-ppl-events-1", is ragged in time: the frames of all events
follow each other along ``time`` and their inner walls along ``wall``; ``n_frames`` and ``n_walls``
(event) say how many are whose. All else has a first dimension ``event``, whose coordinate holds
the ids, so that ``xarray.open_dataset("all.nc").goal_red`` is a column.

Arrays carry a checksum of their bytes, and each event one of all it holds, ``sha256``, which is
compared when the file is read.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import json
import os
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.dataset.events_json import EVENT_FORMAT, EVENTS_FORMAT, event_record, to_text
from phase_ppl.dataset.fields import Entries, event_id
from phase_ppl.dataset.hdf5 import check_hdf5, netcdf_bytes, reading
from phase_ppl.dataset.xarrays import LABELS, event_dataset, event_from_dataset
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Event

_RAGGED: Final = {"time": "n_frames", "wall": "n_walls"}
"""Per dimension along which events follow each other the variable with their lengths."""

_CHECKSUM: Final = "sha256"


def read(path: str | os.PathLike[str]) -> Entries:
    """Return the events of the file ``path``, in memory, each still to be checked.

    Raises:
        InvalidEventError: damaged, too large, or no file of events.
    """
    check_hdf5(path)
    with reading(), xr.open_dataset(path, engine="h5netcdf", decode_times=False) as stored:
        dataset = stored.load()
    tag = _format(dataset)
    if tag == EVENT_FORMAT:
        return [(_id(dataset), functools.partial(_checked_event, dataset))]
    if tag == EVENTS_FORMAT:
        ids, places = _listed(dataset)
        return [
            (name, functools.partial(_taken, dataset, place))
            for name, place in zip(ids, places, strict=True)
        ]
    what = "has no format" if tag is None else f"has format {shown(tag)}"
    raise InvalidEventError(f"{what}, expected {EVENT_FORMAT!r} or {EVENTS_FORMAT!r}")


def _format(dataset: xr.Dataset) -> str | None:
    tag = dataset.attrs.get("format")
    return tag if isinstance(tag, str) else None  # an array would compare element by element


def one(event: Event) -> xr.Dataset:
    """Return the content of a file of one event.

    Raises:
        InvalidEventError: as for :func:`phase_ppl.dataset.xarrays.event_dataset`.
    """
    return event_dataset(event).assign({_CHECKSUM: ((), checksum(event))})


def many(events: Sequence[Event]) -> xr.Dataset:
    """Return the content of a file of several events.

    Raises:
        InvalidEventError: as for :func:`phase_ppl.dataset.xarrays.event_dataset`.
    """
    return _packed([one(event) for event in events])


def to_bytes(dataset: xr.Dataset) -> bytes:
    """Return the content of a file.

    Raises:
        InvalidEventError: it is larger than what can be read again.
    """
    # nothing but a strength is ever missing
    content = netcdf_bytes({"/": dataset}, {"_FillValue": None, "fletcher32": True})
    check_hdf5(io.BytesIO(content))
    return content


# --- checksums -------------------------------------------------------------------------------


def checksum(event: Event) -> str:
    """Return the SHA-256 of all that an event holds, as hexadecimal digits."""
    # names of judgments may be numbers; JSON has strings
    record = json.loads(to_text(event_record(event), compact=True))
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def _checked_event(dataset: xr.Dataset) -> Event:
    event = event_from_dataset(dataset)
    if _CHECKSUM in dataset and dataset.variables[_CHECKSUM].values.tolist() != checksum(event):
        raise InvalidEventError(
            f"its content is not what {_CHECKSUM} says: damaged, or edited; an edited dataset is "
            f"written by save_event(event_from_dataset(dataset), path) or without {_CHECKSUM}"
        )
    return event


# --- one at a time ---------------------------------------------------------------------------


Place = dict[str, int | slice]
"""Where an event is in a file of several: dimension -> index or slice."""


class Listing(NamedTuple):
    """What a file of several events holds.

    Attributes:
        ids: of the events.
        places: of the events.
        dims: variable -> its dimensions.
    """

    ids: list[str]
    places: list[Place]
    dims: dict[str, tuple[str, ...]]


def listing(path: str | os.PathLike[str]) -> Listing:
    """Return what a file of several events holds, without reading the events.

    Raises:
        InvalidEventError: damaged, too large, or no file of several events.
    """
    check_hdf5(path)
    with reading(), xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        tag = _format(dataset)
        if tag != EVENTS_FORMAT:
            raise InvalidEventError(f"has format {shown(tag)}, expected {EVENTS_FORMAT!r}")
        for name, variable in dataset.variables.items():
            if {"scale_factor", "add_offset"} & set(variable.encoding):
                raise InvalidEventError(f"array {name} is packed, expected plain numbers")
        ids, places = _listed(dataset)
        dims = {str(k): tuple(map(str, array.dims)) for k, array in dataset.variables.items()}
        return Listing(ids, places, dims)


@contextlib.contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """Open a file that :func:`listing` found in order, for :func:`event_at`; then close it.

    Raises:
        InvalidEventError: it cannot be opened.
    """
    import h5py

    with reading():
        file = h5py.File(path, "r")
    with file:
        yield file


def event_at(file: Any, listed: Listing, index: int) -> Event:
    """Return one event of an open file of several; of the others nothing is read.

    Straight from HDF5, since xarray takes several times as long to open a file and find its way.

    Raises:
        InvalidEventError: it is damaged.
    """
    place, variables = listed.places[index], {}
    with reading():
        for name, dims in listed.dims.items():
            array = file[name].asstr() if file[name].dtype.kind == "O" else file[name]
            value = array[tuple(place.get(dim, slice(None)) for dim in dims)]
            left = [dim for dim in dims if not isinstance(place.get(dim), int)]
            variables[name] = xr.Variable(left, value)
        taken = xr.Dataset(variables)
    return _checked_event(taken)


# --- ragged in time --------------------------------------------------------------------------


def _packed(datasets: Sequence[xr.Dataset]) -> xr.Dataset:
    """Return one dataset of several events; each has the same variables."""
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
    stops = {dim: _stops(dataset, dim) for dim in _RAGGED}
    places: list[Place] = []
    for index in range(dataset.sizes["event"]):
        place: Place = {"event": index}
        for dim, ends in stops.items():
            place[dim] = slice(int(ends[index - 1]) if index else 0, int(ends[index]))
        places.append(place)
    ids = dataset.variables["event"].values.tolist()
    return [event_id({"id": name}) for name in ids], places


def _stops(dataset: xr.Dataset, dim: str) -> NDArray[np.int64]:
    """Return per event where along ``dim`` it ends."""
    counter = _RAGGED[dim]
    if counter not in dataset.variables or dataset[counter].dims != ("event",):
        raise InvalidEventError(f"has no {counter} (event)")
    lengths, size = dataset[counter].values, dataset.sizes.get(dim, 0)
    # no length beyond the whole, so that no sum can overflow
    whole = lengths.dtype.kind in "iu" and not ((lengths < 0) | (lengths > size)).any()
    if not whole or int(lengths.sum()) != size:
        raise InvalidEventError(f"{counter} does not add up to the {size} along {dim}")
    return np.cumsum(lengths, dtype=np.int64)


def _taken(dataset: xr.Dataset, place: Place) -> Event:
    return _checked_event(dataset.isel(place))


def _id(dataset: xr.Dataset) -> str:
    """Return the id of the only event of a dataset."""
    if "event" not in dataset.variables:
        raise InvalidEventError("has no event, which is its id")
    return event_id({"id": dataset.variables["event"].values.tolist()})
