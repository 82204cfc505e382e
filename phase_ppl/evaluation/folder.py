"""The folder that keeps a model's predictions of many events; the events that are asked about.

::

    DIR/
      settings.json          what determines the result: model, options, seed, events, versions
      events.json            the events, in the package's own format
      events/0007-ID/        one folder per finished event, made whole or not at all
        prediction.json      what the model answered
        posterior.nc         where the model has one
      failures.json          event id -> what went wrong, of the events without a prediction
      metrics.json           written last

An event's folder exists only if its prediction is complete. So an interrupted evaluation continues
with the missing events.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.posterior import Posterior, load_posterior
from phase_ppl.data.documents import check_schema, naming, read_document, read_json
from phase_ppl.data.generated import MANIFEST, PLAN, GeneratedEvents
from phase_ppl.data.load import load_events, save_events
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    PhasePPLError,
    instance_of,
    shown,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import refusing, writable_folder, write_json
from phase_ppl.world.identity import differences

SCHEMA: Final = "phase-ppl-evaluation-1"  # value of ``schema`` in settings.json
SETTINGS: Final = "settings.json"
EVENTS: Final = "events.json"
PREDICTION: Final = "prediction.json"
POSTERIOR: Final = "posterior.nc"
METRICS: Final = "metrics.json"
FAILURES: Final = "failures.json"

COMPARISON: Final = "comparison.json"
"""The file that marks the folder of a comparison of models."""

_DETERMINE: Final = ("model", "options", "model_settings", "function", "function_source", "seed")
"""The settings that must be the same to continue an evaluation, beside events and versions."""


# --- the events that are asked about --------------------------------------------------------------

GENERATED: Final = (MANIFEST, PLAN)  # files that mark the folder of a generated data set
EVENT_FILES: Final = (".json",)  # endings of the files that are read from a folder of events


def all_events(
    events: str | os.PathLike[str] | Event | Sequence[Event], split: str | None = None
) -> list[Event]:
    """Return the events of a file or folder, or the given events, checked.

    Args:
        events: an event file, a folder of event files, a generated data set, an event, or several.
        split: a split of a generated data set, such as "train": only its events are returned.

    Raises:
        InvalidEventError: a file cannot be read, there are no events, two events have one id, or
            ``split`` is given for events that have no splits.
        InvalidSettingError: ``events`` is none of these.
    """
    if split is not None:
        given = load_events(events) if isinstance(events, str | os.PathLike) else events
        if not isinstance(given, GeneratedEvents):
            raise InvalidEventError(f"split {split!r}: only generated data sets have splits")
        return list(given.split(split))
    sources: list[tuple[str, Sequence[Event]]]
    if isinstance(events, str | os.PathLike):
        sources = [(f" in {file}", load_events(file)) for file in _files(events)]
    else:
        events = [events] if isinstance(events, Event) else events
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


# --- kept -----------------------------------------------------------------------------------------


class ResultsFolder:
    """The folder of an evaluation: the content of settings.json, and all events in order."""

    def __init__(self, path: Path, settings: Mapping[str, Any], events: Sequence[Event]) -> None:
        self.path = path
        self.settings = dict(settings)
        self.events = list(events)
        self._place = {event.id: index for index, event in enumerate(self.events)}

    @classmethod
    def create(
        cls, path: str | os.PathLike[str], settings: Mapping[str, Any], events: Sequence[Event]
    ) -> ResultsFolder:
        """Make a folder for a new evaluation."""
        folder = Path(path)
        if holds_predictions(folder):
            raise OutputError(f"{folder} already holds an evaluation; resume it or name another")
        writable_folder(folder / "events")
        made = cls(folder, settings, events)
        made.update(settings, events)
        return made

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> ResultsFolder:
        """Open the folder of an evaluation, finished or not."""
        folder = Path(path)
        if not (folder / SETTINGS).is_file():
            raise InvalidEventError(f"{folder} holds no evaluation: it has no {SETTINGS}")
        settings = read_json(folder / SETTINGS)
        check_schema(settings, SCHEMA, folder / SETTINGS)
        return cls(folder, settings, load_events(folder / EVENTS))

    @classmethod
    def begin(
        cls,
        path: str | os.PathLike[str],
        settings: Mapping[str, Any],
        events: Sequence[Event],
        resume: bool,
    ) -> tuple[ResultsFolder, dict[str, Prediction], list[str]]:
        """Begin an evaluation's folder or, with ``resume``, continue it.

        Returned are the folder, its predictions, and notes about damaged ones.
        """
        if not resume or not holds_predictions(Path(path)):
            return cls.create(path, settings, events), {}, []
        folder = cls.open(path)
        folder.check_same(settings)
        notes: list[str] = []
        done = folder.predictions(notes)
        before = folder.settings.get("versions") or {}
        other = differences(before, settings["versions"])
        if other and len(done) < len(events):
            raise InvalidSettingError(f"{path} was made with other versions: {'; '.join(other)}")
        folder.update({**settings, "versions": before}, events)
        return folder, done, notes

    def check_same(self, settings: Mapping[str, Any]) -> None:
        """Raise the errors of :meth:`begin` for other settings or events; change nothing."""
        before, now = (
            {name: given.get(name) for name in _DETERMINE} for given in (self.settings, settings)
        )
        found = differences(before, now)
        if before["model"] != now["model"]:  # the other differences follow from this one
            found = found[:1]
        holds = f"{self.path} holds an evaluation"
        if found:
            raise InvalidSettingError(f"{holds} with other settings: {'; '.join(found)}")
        old, new = self.settings.get("events"), settings["events"]
        ids = [event.id for event in self.events]
        if not isinstance(old, dict) or list(old) != ids[: len(old)]:
            raise InvalidEventError(
                f"{self.path}: settings.json and events.json do not fit together"
            )
        if len(old) > len(new):
            raise InvalidSettingError(f"{holds} of {len(old)} events, but {len(new)} are given")
        for place, (was, given) in enumerate(zip(old.items(), new.items(), strict=False), start=1):
            if was != given:
                how = "" if was[0] != given[0] else ", whose scene or observation differ"
                raise InvalidSettingError(
                    f"{holds} of other events: number {place} is {given[0]!r}, was {was[0]!r}{how}"
                )

    def update(self, settings: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Replace settings and events; new events may follow the old ones.

        The old metrics are deleted, and so are unfinished files of a killed evaluation.
        """
        with refusing(f"into {self.path}"):
            for name in (METRICS, FAILURES):
                (self.path / name).unlink(missing_ok=True)
            for part in self.path.glob("events/.part-*"):
                shutil.rmtree(part, ignore_errors=True)
        save_events(events, self.path / EVENTS)
        self.settings = {"schema": SCHEMA, **settings}
        self.events = list(events)
        self._place = {event.id: index for index, event in enumerate(self.events)}
        write_json(self.path / SETTINGS, self.settings)

    def folder_of(self, event_id: str) -> Path:
        """Return the folder of an event; it need not exist."""
        return self.path / "events" / entry_name(self._place[event_id], event_id)

    def add(self, prediction: Prediction, artefacts: Callable[[Path], None] | None = None) -> None:
        """Keep the prediction of an event; ``artefacts(folder)`` writes its other files."""
        target = self.folder_of(prediction.event_id)
        part = target.with_name(f".part-{secrets.token_hex(4)}")
        try:
            with refusing(str(target)):
                part.mkdir()
                if artefacts is not None:
                    artefacts(part)
                write_json(part / PREDICTION, prediction.to_dict())
                if target.exists():
                    shutil.rmtree(target)
                os.replace(part, target)
        finally:
            shutil.rmtree(part, ignore_errors=True)

    def predictions(self, damaged: list[str] | None = None) -> dict[str, Prediction]:
        """Return event id -> prediction of the finished events, in the order of the events.

        Errors of damaged ones are appended to the list ``damaged``; without it they are raised.
        """
        done = {}
        for event in self.events:
            try:
                prediction = self.prediction(event.id)
            except PhasePPLError as error:
                if damaged is None:
                    raise
                damaged.append(f"{error}; the event is predicted again")
                continue
            if prediction is not None:
                done[event.id] = prediction
        return done

    def prediction(self, event_id: str) -> Prediction | None:
        """Return the prediction of an event; None: it is not finished."""
        source = self.folder_of(event_id) / PREDICTION
        if not source.is_file():
            return None
        with naming(source):
            world = self.events[self._place[event_id]].scene.world
            found = Prediction.from_dict(read_document(source), world)
            if found.event_id != event_id:
                raise InvalidEventError(f"is of the event {found.event_id!r}, not {event_id!r}")
        return found

    def posterior(self, event_id: str) -> Posterior | ClosedLoopPosterior | None:
        """Return the posterior of an event; None if none was kept."""
        file = self.folder_of(event_id) / POSTERIOR
        return load_posterior(file) if file.is_file() else None

    def write_failures(self, failures: Mapping[str, str]) -> None:
        """Keep what went wrong, by event."""
        write_json(self.path / FAILURES, failures)

    def failures(self) -> dict[str, Any]:
        """Return event id -> what went wrong."""
        source = self.path / FAILURES
        return read_json(source) if source.is_file() else {}


def entry_name(place: int, event_id: str) -> str:
    """Return the name of an event's folder, from its place among the events and its id."""
    return f"{place:04d}-{re.sub(r'[^A-Za-z0-9._-]+', '_', event_id)[:80]}"


def holds_predictions(folder: Path) -> bool:
    """Whether an evaluation in ``folder`` has finished any event."""
    return any(folder.glob(f"events/*/{PREDICTION}"))
