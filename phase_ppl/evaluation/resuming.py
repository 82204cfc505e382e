"""The folder of an evaluation that begins, or goes on where it was left."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from phase_ppl.evaluation.folder import ResultsFolder, holds_predictions
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import ReadyModel
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.identity import differences, event_digest, stable, versions

_DETERMINE: Final = ("model", "options", "model_settings", "function", "function_source", "seed")


def settings_of(model: ReadyModel, seed: int, events: Sequence[Event]) -> dict[str, Any]:
    """Return what determines the predictions, in JSON's types."""
    digests = {event.id: event_digest(event) for event in events}
    return {
        **model.record,
        "seed": seed,
        "versions": stable(versions()),
        "events": digests,
    }


def open_folder(
    path: str | os.PathLike[str],
    settings: Mapping[str, Any],
    events: Sequence[Event],
    resume: bool,
) -> tuple[ResultsFolder, dict[str, Prediction], list[str]]:
    """Return the folder of results, the predictions that are in it, and notes.

    Raises:
        OutputError: it holds an evaluation that is not to be resumed, or cannot be written.
        InvalidSettingError: the evaluation has other settings or events.
        InvalidEventError: it is damaged.
    """
    if not resume or not holds_predictions(Path(path)):
        return ResultsFolder.create(path, settings, events), {}, []
    folder = ResultsFolder.open(path)
    _check_same(folder, settings)
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


def check_resumable(path: str | os.PathLike[str], settings: Mapping[str, Any]) -> None:
    """Raise what :func:`open_folder` would for other settings or events; change nothing.

    Raises:
        InvalidSettingError: the evaluation has other settings or events.
        InvalidEventError: it is damaged.
    """
    if holds_predictions(Path(path)):
        _check_same(ResultsFolder.open(path), settings)


def _check_same(folder: ResultsFolder, settings: Mapping[str, Any]) -> None:
    before, now = (
        {name: given.get(name) for name in _DETERMINE} for given in (folder.settings, settings)
    )
    found = differences(before, now)
    if before["model"] != now["model"]:  # of which the rest follows
        found = found[:1]
    if found:
        raise InvalidSettingError(
            f"{folder.path} holds an evaluation with other settings: {'; '.join(found)}"
        )
    old, new = folder.settings.get("events"), settings["events"]
    if not isinstance(old, dict) or list(old) != [event.id for event in folder.events][: len(old)]:
        raise InvalidEventError(f"{folder.path}: settings.json and events.json do not fit together")
    if len(old) > len(new):
        raise InvalidSettingError(
            f"{folder.path} holds an evaluation of {len(old)} events, but {len(new)} are given"
        )
    for place, (was, given) in enumerate(zip(old, new, strict=False), start=1):
        if was != given:
            raise InvalidSettingError(
                f"{folder.path} holds an evaluation of other events: number {place} is "
                f"{given!r}, was {was!r}"
            )
        if old[was] != new[given]:
            raise InvalidSettingError(
                f"{folder.path} holds an evaluation of another event {was!r}: its scene or "
                "observation differ"
            )
