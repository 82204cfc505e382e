"""The folder that an evaluation writes, and from which everything about it is read again.

::

    DIR/
      settings.json          what determines the result: model, options, seed, events, versions
      events.json            the events, in the package's own format
      events/0007-ID/        one folder per finished event, made whole or not at all
        prediction.json      what the model answered
        posterior.nc         where the model has one
        page.html            the page of the event
      failures.json          event id -> what went wrong, of the events without a prediction
      metrics.json           written last
      figures/*.png

A folder of an event is there only when its prediction is complete, so an interrupted evaluation
goes on with the events that are missing.
"""

from __future__ import annotations

import math
import os
import re
import secrets
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from phase_ppl.dataset.documents import check_schema, read_json
from phase_ppl.dataset.load import load_events, save_events
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.checks import number_or_nan
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    PhasePPLError,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import refusing, writable_folder, write_json
from phase_ppl.world.identity import differences

SCHEMA: Final = "phase-ppl-evaluation-1"  # value of ``schema`` in settings.json
SETTINGS: Final = "settings.json"
EVENTS: Final = "events.json"
PREDICTION: Final = "prediction.json"
POSTERIOR: Final = "posterior.nc"
PAGE: Final = "page.html"
METRICS: Final = "metrics.json"
FAILURES: Final = "failures.json"

COMPARISON: Final = "comparison.json"
"""The file by which the folder of a comparison of models is known."""

_DETERMINE: Final = (
    "model",
    "options",
    "model_settings",
    "function",
    "function_source",
    "seed",
    "shard",
)
"""The settings that must be the same for an evaluation to go on, beside events and versions."""


class ResultsFolder:
    """A folder of results: what settings.json holds, and all events in order."""

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
        """Return the folder of an evaluation that begins or, with ``resume``, goes on.

        And the predictions that are in it, and notes about those that are damaged.
        """
        if not resume or not holds_predictions(Path(path)):
            return cls.create(path, settings, events), {}, []
        folder = cls.open(path)
        folder.check_same(settings)
        done: dict[str, Prediction] = {}
        notes = []
        for event in folder.events:
            try:
                prediction = folder.prediction(event.id)
            except InvalidEventError as error:
                notes.append(f"{error}; the event is predicted again")
                continue
            if prediction is not None:
                done[event.id] = prediction
        before = folder.settings.get("versions") or {}
        other = differences(before, settings["versions"])
        if other and len(done) < len(events):
            raise InvalidSettingError(f"{path} was made with other versions: {'; '.join(other)}")
        folder.update({**settings, "versions": before}, events)
        return folder, done, notes

    def check_same(self, settings: Mapping[str, Any]) -> None:
        """Raise what :meth:`begin` would for other settings or events; change nothing."""
        before, now = (
            {name: given.get(name) for name in _DETERMINE} for given in (self.settings, settings)
        )
        found = differences(before, now)
        if before["model"] != now["model"]:  # of which the rest follows
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
        for place, (was, given) in enumerate(zip(old, new, strict=False), start=1):
            if was != given:
                raise InvalidSettingError(
                    f"{holds} of other events: number {place} is {given!r}, was {was!r}"
                )
            if old[was] != new[given]:
                raise InvalidSettingError(
                    f"{holds} of another event {was!r}: its scene or observation differ"
                )

    def update(self, settings: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Replace settings and events, of which more may come after those that are there.

        The metrics, which belong to those before, are deleted, and so is what an evaluation
        that was killed has left half done.
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
        """Return the folder of an event, whether it is there or not."""
        return self.path / "events" / entry_name(self._place[event_id], event_id)

    def add(self, prediction: Prediction, artefacts: Callable[[Path], None] | None = None) -> None:
        """Keep the prediction of an event; ``artefacts(folder)`` writes what else belongs to it."""
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

    def predictions(self) -> dict[str, Prediction]:
        """Return event id -> prediction of the finished events, in the order of the events."""
        found = {event.id: self.prediction(event.id) for event in self.events}
        return {name: given for name, given in found.items() if given is not None}

    def prediction(self, event_id: str) -> Prediction | None:
        """Return the prediction of an event; None where it is not finished."""
        source = self.folder_of(event_id) / PREDICTION
        if not source.is_file():
            return None
        record = read_json(source)
        world = self.events[self._place[event_id]].scene.world
        try:
            prediction = Prediction.from_dict(record, world)
        except PhasePPLError as error:
            raise InvalidEventError(f"{source}: {error}") from None
        if prediction.event_id != event_id:
            raise InvalidEventError(
                f"{source}: is of the event {prediction.event_id!r}, not {event_id!r}"
            )
        return prediction

    def write_failures(self, failures: Mapping[str, str]) -> None:
        """Keep what went wrong, by event."""
        write_json(self.path / FAILURES, failures)

    def failures(self) -> dict[str, Any]:
        """Return event id -> what went wrong."""
        source = self.path / FAILURES
        return read_json(source) if source.is_file() else {}

    def last_call(self) -> tuple[int | None, float | None]:
        """Return workers and wall seconds of the call that finished it, by metrics.json."""
        source = self.path / METRICS
        cost = read_json(source).get("cost") if source.is_file() else None
        given = cost if isinstance(cost, Mapping) else {}
        workers, seconds = (number_or_nan(given.get(n)) for n in ("workers", "wall_seconds"))
        known = math.isfinite(workers) and math.isfinite(seconds)
        return (int(workers), seconds) if known else (None, None)


def entry_name(place: int, event_id: str) -> str:
    """Return the name of what belongs to an event, by its place among the events."""
    return f"{place:04d}-{re.sub(r'[^A-Za-z0-9._-]+', '_', event_id)[:80]}"


def holds_predictions(folder: Path) -> bool:
    """Whether an evaluation in ``folder`` has finished any event."""
    return any(folder.glob(f"events/*/{PREDICTION}"))
