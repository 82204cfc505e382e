"""Shards, each made on a machine of its own, put together to what one machine would have made."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from phase_ppl.analysis.comparison import Comparison
from phase_ppl.dataset.documents import read_json
from phase_ppl.dataset.generated import PLAN, GeneratedEvents
from phase_ppl.dataset.generation.generate import assemble, part_file
from phase_ppl.dataset.generation.plan import slots
from phase_ppl.evaluation.evaluate import whole_digest
from phase_ppl.evaluation.evaluation import (
    COMPARISON,
    METRICS,
    SETTINGS,
    Evaluation,
    ResultsFolder,
    cost_of,
)
from phase_ppl.inference.compare import runs_left, together
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, OutputError
from phase_ppl.world.files import as_path, locked, writable_folder, write_json
from phase_ppl.world.identity import differences
from phase_ppl.world.shards import SHARD, Shard


class _Found(NamedTuple):
    """A shard in its folder, and what it says of the whole."""

    folder: Path
    shard: Shard
    request: dict[str, Any]


def merge(
    folders: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]
) -> GeneratedEvents | Evaluation | Comparison:
    """Put shards together, of ``generate``, ``evaluate`` or ``compare``.

    The result is that of one call without ``shard``: a data set byte for byte, an evaluation or a
    comparison but for the seconds that it took.

    Args:
        folders: of all shards, in any order; they stay as they are. That of a comparison has it as
            comparison.json.
        out: folder for the whole.

    Raises:
        InvalidSettingError: a shard is missing, or there twice, or they are of different requests.
        InvalidEventError: a folder holds no shard, or one that is not finished, or is damaged.
        OutputError: ``out`` cannot be written, or holds results already.
    """
    paths = [as_path(folder) for folder in folders]
    if not paths:
        raise InvalidSettingError("no shards were given")
    kind = next((name for name in _KINDS if (paths[0] / name).is_file()), None)
    if kind is None:
        raise InvalidEventError(f"{paths[0]} is no shard: it has no {' or '.join(_KINDS)}")
    found = _complete([_found(path, kind) for path in paths])
    with locked(writable_folder(out)):
        for name, there in _KINDS.items():
            if (Path(out) / name).exists():
                raise OutputError(f"{out} holds {there.what} already: name another folder")
        return _KINDS[kind].put_together(found, Path(out))


def _found(folder: Path, kind: str) -> _Found:
    source = folder / kind
    request = read_json(source) if source.is_file() else {}
    if kind == COMPARISON and request:
        request = dict(Comparison.load(source).settings)
    shard = request.pop(SHARD, None)
    if shard is None:
        raise InvalidEventError(f"{folder} is no shard of {_KINDS[kind].what}")
    return _Found(folder, Shard.named(shard), request)


def _complete(found: Sequence[_Found]) -> list[_Found]:
    """Return all shards of a whole in their order."""
    first = found[0]
    places: dict[Shard, _Found] = {}
    for one in found:
        apart = differences(_of_whole(first), _of_whole(one))
        if one.shard.of != first.shard.of:
            apart = [f"{one.shard} and {first.shard}"]
        if apart:
            raise InvalidSettingError(
                f"{one.folder} and {first.folder} are of different requests: {'; '.join(apart)}"
            )
        other = places.setdefault(one.shard, one)
        if other is not one:
            raise InvalidSettingError(
                f"the shard {one.shard} is there twice: {other.folder} and {one.folder}"
            )
    wanted = [Shard(i, first.shard.of) for i in range(1, first.shard.of + 1)]
    missing = [str(shard) for shard in wanted if shard not in places]
    if missing:
        raise InvalidSettingError(f"the shard {', '.join(missing)} is missing")
    return [places[shard] for shard in wanted]


def _of_whole(one: _Found) -> Mapping[str, Any]:
    """Return what is the same for all shards: of an evaluation all but its own events."""
    return {name: value for name, value in one.request.items() if name != "events"}


def _check_finished(one: _Found, done: int, n: int, what: str = "events") -> None:
    if done < n:
        raise InvalidEventError(
            f"{one.folder} is not finished: {done} of {n} {what}; resume it as shard {one.shard}"
        )


def _merged_set(found: Sequence[_Found], out: Path) -> GeneratedEvents:
    record = dict(found[0].request)
    plan = {name: value for name, value in record.items()
            if name not in ("schema", "keep_rejected", "versions")}  # fmt: skip
    wanted = slots(plan["cells"], plan["splits"], plan["seed"])
    for one in found:
        mine = one.shard.of_all(wanted)
        _check_finished(one, sum(part_file(one.folder, slot).is_file() for slot in mine), len(mine))
    assemble(
        out, plan, record["versions"], wanted,
        lambda slot: found[slot.number % len(found)].folder,
    )  # fmt: skip
    write_json(out / PLAN, record)  # last, so that a merge that was killed can be begun again
    return GeneratedEvents(out)


def _merged_evaluation(found: Sequence[_Found], out: Path) -> Evaluation:
    given = [Evaluation.load(one.folder) for one in found]
    for one, evaluation in zip(found, given, strict=True):
        n = len(evaluation.predictions) + len(evaluation.failures)
        _check_finished(one, n, len(evaluation.events))
    n = sum(len(one.events) for one in given)
    events = [given[place % len(given)].events[place // len(given)] for place in range(n)]
    digests = {name: digest for one in given for name, digest in one.settings["events"].items()}
    settings = {**found[0].request, "events": {event.id: digests[event.id] for event in events}}
    if whole_digest(settings["events"]) != settings.pop("whole"):
        raise InvalidEventError(
            f"{found[0].folder} and the others hold other events than asked for"
        )
    folder = ResultsFolder.create(out, settings, events)
    failures = {}
    for place, event in enumerate(events):
        mine = given[place % len(given)]
        assert mine.folder is not None, "it was loaded"
        if event.id in mine.predictions:
            shutil.copytree(mine.folder.folder_of(event.id), folder.folder_of(event.id))
        else:
            failures[event.id] = mine.failures[event.id]
    if failures:
        folder.write_failures(failures)
    predictions = folder.predictions()
    merged = Evaluation(
        events, predictions, failures, folder.settings, cost_of(predictions, None, None), folder
    )
    write_json(out / METRICS, merged.metrics)
    return merged


def _merged_comparison(found: Sequence[_Found], out: Path) -> Comparison:
    given = [Comparison.load(one.folder / COMPARISON) for one in found]
    for one, comparison in zip(found, given, strict=True):
        done = len(comparison.runs)
        _check_finished(one, done, done + runs_left(comparison), "runs")
    merged = together(given)
    merged.save(out / COMPARISON)
    return merged


class _Kind(NamedTuple):
    """What shards can be of, in words, and how they are put together."""

    what: str
    put_together: Callable[[Sequence[_Found], Path], GeneratedEvents | Evaluation | Comparison]


_KINDS: Final = {
    PLAN: _Kind("a data set", _merged_set),
    SETTINGS: _Kind("an evaluation", _merged_evaluation),
    COMPARISON: _Kind("a comparison", _merged_comparison),
}
"""The file that tells a kind of results -> the kind."""
