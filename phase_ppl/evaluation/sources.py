"""The events of an evaluation, and people's judgments of them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from phase_ppl.dataset.generation.store import MANIFEST, PLAN, GeneratedEvents
from phase_ppl.dataset.load import load_events
from phase_ppl.evaluation.folder import EVENTS, SETTINGS
from phase_ppl.evaluation.references import reference_predictions
from phase_ppl.evaluation.votes import event_judgments
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from phase_ppl.evaluation.judgments import Study

GENERATED: Final = (MANIFEST, PLAN)
"""Files by which the folder of a generated data set is known."""

EVENT_FILES: Final = (".json", ".nc")
"""Endings of the files that are read from a folder of events."""


def all_events(
    events: str | os.PathLike[str] | Event | Sequence[Event], split: str | None = None
) -> list[Event]:
    """Return the events of a file or folder, or those given; or a split of a generated data set.

    Raises:
        InvalidEventError: there are none, or two with the same id; or no such split.
    """
    if split is not None:
        path = events if isinstance(events, str | os.PathLike) else None
        generated = events if path is None else load_events(path)
        if not isinstance(generated, GeneratedEvents):
            raise InvalidEventError(f"split {split!r}: only generated data sets have splits")
        return list(generated.split(split))
    if isinstance(events, Event):
        sources: list[tuple[str, Sequence[Event]]] = [("", [events])]
    elif isinstance(events, str | os.PathLike):
        sources = [(f" in {file}", load_events(file)) for file in _files(events)]
    else:
        instance_of("events", events, Iterable, "a file, a folder or events")
        sources = [("", list(events))]
    seen: dict[str, str] = {}
    for where, found in sources:
        for event in found:
            if not isinstance(event, Event):
                raise InvalidEventError(f"{shown(event)} is no event; phase_ppl.load_events reads")
            if event.id in seen:
                both = f"{seen[event.id]} and{where}" if where else ""
                raise InvalidEventError(f"there are two events with the id {event.id!r}{both}")
            seen[event.id] = where
    if not seen:
        raise InvalidEventError("there are no events to evaluate")
    return [event for _, found in sources for event in found]


def _files(path: str | os.PathLike[str]) -> list[Path]:
    source = Path(path)
    if not source.is_dir() or any((source / name).is_file() for name in GENERATED):
        return [source]
    if (source / SETTINGS).is_file() and (source / EVENTS).is_file():
        raise InvalidEventError(
            f"{source} holds an evaluation; its events are in {source / EVENTS}"
        )
    files = sorted(file for file in source.iterdir() if file.suffix.lower() in EVENT_FILES)
    if not files:
        endings = ", ".join(EVENT_FILES)
        raise InvalidEventError(f"{source}: the folder holds no event files ({endings})")
    return files


def judged(
    events: list[Event], judgments: str | os.PathLike[str] | Study | None
) -> Sequence[Event]:
    """Return the events with people's judgments; what cannot be scored is found out now.

    Raises:
        InvalidEventError, UnknownNameError: judgments or stored predictions cannot be read.
    """
    if judgments is not None:
        from phase_ppl.evaluation.judgments import Study, load_judgments, with_judgments

        study = judgments if isinstance(judgments, Study) else load_judgments(judgments, events)
        events = with_judgments(events, study)
    reference_predictions(events)
    for event in events:
        event_judgments(event)
    return events
