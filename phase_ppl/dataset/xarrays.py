"""An event as an xarray Dataset, and back.

Dimensions ``time``, ``entity``, ``coord`` (x, y, angle), and those of the scene::

    trajectory           (time, entity, coord)   units and radians; time in simulated seconds
    start                (entity, coord)
    radius               (entity)
    walls                (wall, end, xy)         inner walls
    landmark_centres     (landmark, xy)
    landmark_half_width  ()
    arena                (bound)                 x_min, x_max, y_min, y_max
    turning              ()                      both, ccw or cw
    goal_red, goal_green, relation, scenario     ()  truth: effective goals; "" where unknown
    strength_red, strength_green                 ()  truth: newtons; NaN where unknown
    judgments, predictions                       ()  JSON; "" where there are none

The scalar coordinate ``event`` is the event's id. All that is said of these values in
:mod:`phase_ppl.dataset.events_json` holds here too; no number changes on the way there and back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.dataset.documents import parse_document
from phase_ppl.dataset.events_json import EVENT_FORMAT, event_from_record, to_text
from phase_ppl.dataset.fields import event_id, per_name
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS
from phase_ppl.world.observation import FRAMES_PER_SECOND
from phase_ppl.world.scene import finite_array

LABELS: Final[Mapping[str, Sequence[str]]] = {
    "entity": ENTITIES,
    "coord": ("x", "y", "angle"),
    "xy": ("x", "y"),
    "landmark": LANDMARKS,
    "bound": ("x_min", "x_max", "y_min", "y_max"),
}
"""Coordinates that say which is which along a dimension; in a file in any order."""

_DIMS: Final[Mapping[str, tuple[str, ...]]] = {
    "trajectory": ("time", "entity", "coord"),
    "start": ("entity", "coord"),
    "radius": ("entity",),
    "walls": ("wall", "end", "xy"),
    "landmark_centres": ("landmark", "xy"),
    "landmark_half_width": (),
    "arena": ("bound",),
}
_UNITS: Final = {
    "trajectory": "units of length (x, y), radians (angle)",
    "start": "units of length (x, y), radians (angle)",
    **dict.fromkeys(
        ("radius", "walls", "landmark_centres", "landmark_half_width", "arena"), "units of length"
    ),
    "strength_red": "N",
    "strength_green": "N",
}
_GOALS: Final = ("goal_red", "goal_green")
_STRENGTHS: Final = ("strength_red", "strength_green")
_DOCUMENTS: Final = ("judgments", "predictions")

_TIME_TOLERANCE: Final = 1e-3
"""Relative deviation of a time step from 1/12 s that is put down to rounding."""


def event_dataset(event: Event) -> xr.Dataset:
    """Return ``event`` as a Dataset; :func:`event_from_dataset` gives the same event back.

    Raises:
        InvalidEventError: judgments or predictions hold something that JSON has no form for, or
            the id is no printable text.
    """
    instance_of("event", event, Event, "a phase_ppl.Event")
    scene, truth = event.scene, event.truth
    values: dict[str, Any] = {
        "trajectory": event.observation.trajectory,
        **{name: getattr(scene, name) for name in _DIMS if name != "trajectory"},
        "turning": scene.turning,
    }
    for name in (*_GOALS, "relation", "scenario"):
        values[name] = "" if truth is None else getattr(truth, name)
    for name in _STRENGTHS:
        force = getattr(truth, name, None)
        values[name] = np.nan if force is None else force
    for name in _DOCUMENTS:
        content = getattr(event, name)
        values[name] = "" if content is None else to_text(dict(content), compact=True)

    def units(name: str) -> dict[str, str]:
        return {"units": _UNITS[name]} if name in _UNITS else {}

    seconds = np.arange(event.observation.n_frames) / FRAMES_PER_SECOND
    return xr.Dataset(
        {
            # copies: an event's own arrays are read-only
            name: (_DIMS.get(name, ()), np.array(value), units(name))
            for name, value in values.items()
        },
        {
            "time": ("time", seconds, {"units": "s", "long_name": "simulated time"}),
            **{dim: list(labels) for dim, labels in LABELS.items()},
            "event": event_id({"id": event.id}),
        },
        {"format": EVENT_FORMAT},
    )


def event_from_dataset(dataset: xr.Dataset) -> Event:
    """Return the event that a Dataset as of :func:`event_dataset` describes.

    Dimensions and labels may come in any order, further variables do no harm; what belongs to the
    truth, judgments and predictions may be missing.

    Raises:
        InvalidEventError: something is missing, of the wrong type or shape, or impossible, or the
            frames are not 1/12 s apart.
        UnknownNameError: an entity, coordinate, goal, relation or scenario is unknown.
        InvalidSettingError: a strength is no positive force.
    """
    if not isinstance(dataset, xr.Dataset):
        raise InvalidEventError(f"{shown(dataset)} is no xarray Dataset")
    _check_time(dataset)
    found = {name: _values(dataset, name, dims) for name, dims in _DIMS.items()}
    x0, x1, y0, y1 = found["arena"]
    record: dict[str, Any] = {
        "id": _text(dataset, "event", required=True),
        "scene": {
            "arena": {"x": [x0, x1], "y": [y0, y1]},
            "walls": found["walls"],
            "landmarks": dict(zip(LANDMARKS, found["landmark_centres"], strict=True)),
            "landmark_half_width": found["landmark_half_width"],
            "turning": _text(dataset, "turning", required=True),
            "radius": dict(zip(ENTITIES, found["radius"].tolist(), strict=True)),
            "start": dict(zip(ENTITIES, found["start"], strict=True)),
        },
        "trajectories": dict(zip(ENTITIES, np.moveaxis(found["trajectory"], 1, 0), strict=True)),
    }
    goals = [_text(dataset, name) for name in _GOALS]
    if any(goals):
        record["truth"] = {
            "goals": dict(zip(AGENTS, goals, strict=True)),
            "relation": _text(dataset, "relation"),
            "scenario": _text(dataset, "scenario"),
            "strengths": {
                agent: _force(dataset, name) for agent, name in zip(AGENTS, _STRENGTHS, strict=True)
            },
        }
    for name in _DOCUMENTS:
        text = _text(dataset, name)
        if text:
            record[name] = _document(name, text)
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


def _values(dataset: xr.Dataset, name: str, dims: tuple[str, ...]) -> NDArray[Any]:
    """Return the values of a variable along ``dims``, everything in the package's order."""
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
        if dim in LABELS:
            values = values.take(_order(dataset, dim), axis)
    return values


def _order(dataset: xr.Dataset, dim: str) -> list[int]:
    """Return where the labels of ``dim`` stand, in the package's order."""
    if dim not in dataset.coords:
        raise InvalidEventError(f"has no coordinate {dim}, which says what is where along it")
    labels = [_plain(label) for label in dataset.variables[dim].values.tolist()]
    if len(set(labels)) < len(labels):
        raise InvalidEventError(f"coordinate {dim} has a label twice: {shown(labels)}")
    places = {label: place for place, label in enumerate(labels)}
    return per_name(places, LABELS[dim], f"coordinate {dim}")


def _text(dataset: xr.Dataset, name: str, required: bool = False) -> str:
    """Return the text of a variable without dimensions; "" where there is none."""
    if name not in dataset.variables:
        if required:
            raise InvalidEventError(f"has no {name}")
        return ""
    value = _plain(dataset.variables[name].values.tolist())
    if not isinstance(value, str):
        raise InvalidEventError(f"{name} is {shown(value)}, expected a string")
    return value


def _plain(value: object) -> Any:
    """Return text that a file holds as bytes as a string, anything else as it is."""
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def _force(dataset: xr.Dataset, name: str) -> float | None:
    if name not in dataset.variables:
        return None
    value = dataset.variables[name].values.tolist()
    return None if isinstance(value, float) and np.isnan(value) else value


def _document(name: str, text: str) -> dict[str, Any]:
    try:
        return parse_document(text.encode(errors="surrogatepass"))
    except InvalidEventError as error:
        raise InvalidEventError(f"{name}: {error}") from None
