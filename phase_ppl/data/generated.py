"""The folder of a generated data set.

::

    DIR/
      plan.json           what was asked for
      parts/00007.json    one file per finished slot, until all are done
      events.nc           all events, ragged in time
      manifest.json       per event what is known about it beside the event itself
      rejected.nc         rejected draws as events, where they were kept
      rejected.json       why each of them was not kept, and its measures
      cost.json           what the last call took, and what it made anew

A part is written whole or not at all, so interrupted generation goes on with the slots that are
missing, or whose part was damaged since; the finished set is the same.

A set of more than 1000 slots has a folder for each thousand, ``blocks/00000`` and so on, with
events.nc, rejected.nc and rejected.json of these, and entries.json in place of the manifest's
``entries``; of it nothing is in memory but the ids and what is asked for.
"""

from __future__ import annotations

import functools
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self, overload

from phase_ppl.data.documents import check_schema, read_json
from phase_ppl.data.events_netcdf import StoredEvents, checksum
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.event import Event
from phase_ppl.world.identity import differences
from phase_ppl.world.picture import Printed
from phase_ppl.world.scene import Turning

MANIFEST_SCHEMA: Final = "phase-ppl-manifest-1"

EVENTS: Final = "events.nc"
MANIFEST: Final = "manifest.json"
PLAN: Final = "plan.json"
REJECTED: Final = "rejected"
COST: Final = "cost.json"
BLOCKS: Final = "blocks"
ENTRIES: Final = "entries.json"


class GeneratedEvents(Printed, StoredEvents):
    """The events of a generated data set, with its manifest; each is read when it is asked for.

    Slices and splits are of the same kind, and read nothing; see :class:`StoredEvents`.

    Args:
        path: the folder.
        turning: "both", "ccw" or "cw" instead of what is stored.

    Attributes:
        manifest: of the whole set.

    Raises:
        InvalidEventError: it holds no finished data set, or a file of it is damaged; where a
            single event is, only when it is asked for.
    """

    def __init__(self, path: str | os.PathLike[str], turning: Turning | None = None) -> None:
        self.path = Path(path)
        self.manifest = read_manifest(self.path)
        sizes: list[int] = self.manifest.get("blocks", [])
        self._blocks = [self.path / BLOCKS / f"{i:05d}" for i in range(len(sizes))]
        # a block without events has no file of them
        filled = [block for block, n in zip(self._blocks, sizes, strict=True) if n]
        super().__init__([folder / EVENTS for folder in filled or [self.path]], turning)
        told = [entry["id"] for entry in self.manifest.get("entries", [])]
        if len(self) != sum(sizes) if sizes else self.ids != told:
            raise InvalidEventError(
                f"{self.path}: {EVENTS} and {MANIFEST} are not of the same events"
            )

    def __repr__(self) -> str:
        splits = Counter(entry["split"] for entry in self.entries)
        told = ", ".join(f"{n} {name}" for name, n in splits.items())
        return f"<{len(self)} generated events of {self.path}: {told}>"

    @property
    def entries(self) -> Sequence[dict[str, Any]]:
        """What is known about how each of these events was made, in their order.

        Made anew at each access: keep it for a loop.
        """
        if self._blocks:
            return _Entries(self)
        return [self.manifest["entries"][one.place] for one in self._stored]

    def _entry(self, index: int) -> dict[str, Any]:
        """Return what is known about one of the events of a set in blocks."""
        id, number, within = self._stored[index]
        folder = self._files[number].parent
        entries = _entries_of(folder / ENTRIES)
        if within >= len(entries) or entries[within]["id"] != id:
            raise InvalidEventError(f"{folder}: {EVENTS} and {ENTRIES} are not of the same events")
        return entries[within]

    @property
    def cost(self) -> dict[str, Any]:
        """What the call that finished it took, ``seconds`` and ``workers``; {}: it is not kept."""
        source = self.path / COST
        return read_json(source) if source.is_file() else {}

    def split(self, name: str) -> Self:
        """Return the events of a split, such as "train".

        Raises:
            InvalidEventError: there is none in it.
        """
        found = [index for index, entry in enumerate(self.entries) if entry["split"] == name]
        if not found:
            known = sorted({entry["split"] for entry in self.entries})
            raise InvalidEventError(f"no events in split {name!r}; there are {known}")
        return self.chosen(found)

    def rejected(self) -> list[tuple[Event, str]]:
        """Return the draws that were not kept, each with the reason; none unless they were stored.

        Raises:
            InvalidEventError: their files are damaged, or not of the same draws.
        """
        folders = self._blocks or [self.path]
        return [draw for folder in folders for draw in _rejected(folder)]


class _Entries(Sequence[dict[str, Any]]):
    """What is known about the events of a set in blocks: read when asked for, a block at a time."""

    def __init__(self, events: GeneratedEvents) -> None:
        self._events = events

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[dict[str, Any]]: ...

    def __getitem__(self, index: int | slice) -> dict[str, Any] | Sequence[dict[str, Any]]:
        if isinstance(index, slice):
            return self._events[index].entries
        return self._events._entry(index)

    def __len__(self) -> int:
        return len(self._events)


@functools.lru_cache(maxsize=2)
def _entries_of(source: Path) -> list[dict[str, Any]]:
    return _checked_entries(read_json(source), source)


def _rejected(folder: Path) -> list[tuple[Event, str]]:
    events, reasons = folder / f"{REJECTED}.nc", folder / f"{REJECTED}.json"
    if not events.is_file():
        return []
    told = read_json(reasons).get("rejected")
    if not isinstance(told, list) or not all(
        isinstance(draw, dict) and isinstance(draw.get("reason"), str) for draw in told
    ):
        raise InvalidEventError(f"{reasons}: expected a list of draws with their reasons")
    found = StoredEvents(events)
    if found.ids != [draw.get("id") for draw in told]:
        raise InvalidEventError(f"{events} and {reasons.name} are not of the same draws")
    return [(event, draw["reason"]) for event, draw in zip(found, told, strict=True)]


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a finished data set."""
    source = folder / MANIFEST
    if not source.is_file():
        unfinished = " yet: its generation can be resumed" if (folder / PLAN).is_file() else ""
        raise InvalidEventError(f"{folder} holds no generated data set{unfinished}")
    manifest = read_json(source)
    check_schema(manifest, MANIFEST_SCHEMA, source)
    sizes = manifest.get("blocks")
    if sizes is None:
        _checked_entries(manifest, source)
    elif not isinstance(sizes, list) or not all(isinstance(n, int) and n >= 0 for n in sizes):
        raise InvalidEventError(f"{source}: expected numbers of events as blocks")
    return manifest


def _checked_entries(record: Mapping[str, Any], source: Path) -> list[dict[str, Any]]:
    entries = record.get("entries")
    wanted = ("id", "split", "checksum")
    if not isinstance(entries, list) or not all(
        isinstance(entry, dict) and all(isinstance(entry.get(name), str) for name in wanted)
        for entry in entries
    ):
        raise InvalidEventError(f"{source}: expected entries with {', '.join(wanted)}")
    return entries


def verify(folder: str | os.PathLike[str]) -> list[str]:
    """Return what is wrong with a finished data set; nothing if all is well."""
    found = GeneratedEvents(folder)
    wrong = []
    if found.manifest.get("earlier_versions"):
        before, now = found.manifest["earlier_versions"][-1], found.manifest["versions"]
        apart = "; ".join(differences(before, now))
        wrong.append(f"not all were made by the same versions: {apart}")
    for index, entry in enumerate(found.entries):
        try:
            same = checksum(found[index]) == entry["checksum"]
        except PhasePPLError as error:
            wrong.append(str(error))
            continue
        if not same:
            wrong.append(f"{entry['id']}: its content is not what the manifest says")
    return wrong
