"""The folder of a generated data set.

::

    DIR/
      plan.json           the settings
      parts/00007.json    one file per finished slot, until all are done
      events.nc           all events, ragged in time
      manifest.json       how each event was made
      rejected.nc         rejected draws as events, if they were kept
      rejected.json       why each was rejected, and its measures
      cost.json           time and new events of the last call

A part is written whole or not at all. So interrupted generation goes on with the slots that have
none, or a damaged one, and the finished set is the same.

A set of more than 1000 slots has a folder for each thousand, ``blocks/00000`` and so on. It holds
events.nc, rejected.nc and rejected.json of these slots, and entries.json in place of the manifest's
``entries``. Only the ids of its events are in memory; an event is read when it is asked for.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Final, Self

import msgspec

from phase_ppl.data.documents import check_schema, converted, in_front, read_json
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


class _Entry(msgspec.Struct):
    id: str
    split: str
    checksum: str


class _Entries(msgspec.Struct):
    entries: list[_Entry]


class _Manifest(msgspec.Struct):
    entries: list[_Entry] = []
    blocks: list[Annotated[int, msgspec.Meta(ge=0)]] | None = None


class _Draw(msgspec.Struct):
    id: str
    reason: str


class _Rejected(msgspec.Struct):
    rejected: list[_Draw]


class GeneratedEvents(Printed, StoredEvents):
    """The events of a generated data set, with its manifest; each is read when asked for.

    Slices and splits are of the same kind, and read nothing; see :class:`StoredEvents`.

    Args:
        path: the folder.
        turning: "both", "ccw" or "cw" instead of what is stored.

    Attributes:
        manifest: of the whole set.

    Raises:
        InvalidEventError: the folder holds no finished data set, or a file is damaged. A damaged
            single event is found only when it is asked for.
    """

    def __init__(self, path: str | os.PathLike[str], turning: Turning | None = None) -> None:
        self.path = Path(path)
        self.manifest = read_manifest(self.path)
        sizes: list[int] | None = self.manifest.get("blocks")
        self._folders = [self.path]
        if sizes is not None:
            self._folders = [self.path / BLOCKS / f"{i:05d}" for i in range(len(sizes))]
        # a block without events has no file of them
        filled = [one for one, n in zip(self._folders, sizes or [1], strict=True) if n]
        super().__init__([folder / EVENTS for folder in filled], turning)
        if len(self) != sum(sizes or [len(self.manifest.get("entries", []))]):
            raise InvalidEventError(
                f"{self.path}: {EVENTS} and {MANIFEST} are not of the same events"
            )

    def __str__(self) -> str:
        """How many draws of each kind were kept, and why the others were rejected."""
        lines = []
        for cell, kept in self.manifest["kept"].items():
            refused = self.manifest["rejected"][cell]
            why = "; ".join(f"{reason}: {n}" for reason, n in refused.items())
            of = kept + sum(refused.values())
            line = f"{cell:<22}{kept:>4} of {of:>4} draws   {why and f'rejected: {why}'}"
            lines += [line.rstrip()] * (kept > 0)
        return "\n".join([*lines, f"{len(self)} events ({self._by_split()}) in {self.path}"])

    def __repr__(self) -> str:
        return f"<{len(self)} generated events of {self.path}: {self._by_split()}>"

    def _by_split(self) -> str:
        splits = Counter(entry["split"] for entry in self.entries)
        return ", ".join(f"{n} {name}" for name, n in splits.items())

    @property
    def entries(self) -> list[dict[str, Any]]:
        """How each of these events was made, in their order.

        The list is made anew at each access: keep it for a loop.
        """
        told: dict[int, dict[str, dict[str, Any]]] = {}
        for number in {one.file for one in self._stored}:
            source = self._files[number].parent / ENTRIES
            record = self.manifest if self._folders == [self.path] else _read(source, _Entries)
            told[number] = {entry["id"]: entry for entry in record["entries"]}
        try:
            return [told[one.file][one.id] for one in self._stored]
        except KeyError as error:
            raise InvalidEventError(
                f"{self.path}: {EVENTS} and {ENTRIES} are not of the same events: {error}"
            ) from None

    @property
    def cost(self) -> dict[str, Any]:
        """``seconds`` and ``workers`` of the call that finished the set; {}: not kept."""
        source = self.path / COST
        return read_json(source) if source.is_file() else {}

    def split(self, name: str) -> Self:
        """Return the events of a split, such as "train".

        Raises:
            InvalidEventError: the split has no events.
        """
        splits = [entry["split"] for entry in self.entries]
        if name not in splits:
            raise InvalidEventError(f"no events in split {name!r}; there are {sorted({*splits})}")
        return self.chosen([index for index, split in enumerate(splits) if split == name])

    def rejected(self) -> list[tuple[Event, str]]:
        """Return the rejected draws, each with the reason; none unless they were stored.

        Raises:
            InvalidEventError: their files are damaged, or not of the same draws.
        """
        found: list[tuple[Event, str]] = []
        for folder in self._folders:
            events, reasons = folder / f"{REJECTED}.nc", folder / f"{REJECTED}.json"
            if events.is_file():
                told, draws = _read(reasons, _Rejected)["rejected"], StoredEvents(events)
                if draws.ids != [draw["id"] for draw in told]:
                    raise InvalidEventError(
                        f"{events} and {reasons.name} are not of the same draws"
                    )
                found += zip(draws, (draw["reason"] for draw in told), strict=True)
        return found


def _read(source: Path, form: type[msgspec.Struct]) -> dict[str, Any]:
    """Return a checked JSON object of a file; further fields are kept."""
    record = read_json(source)
    with in_front(f"{source}: "):
        converted(record, form)
    return record


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a finished data set."""
    source = folder / MANIFEST
    if not source.is_file():
        unfinished = " yet: its generation can be resumed" if (folder / PLAN).is_file() else ""
        raise InvalidEventError(f"{folder} holds no generated data set{unfinished}")
    manifest = _read(source, _Manifest)
    check_schema(manifest, MANIFEST_SCHEMA, source)
    return manifest


def verify(folder: str | os.PathLike[str]) -> list[str]:
    """Return the faults of a finished data set, none if all is well."""
    found = GeneratedEvents(folder)
    wrong: list[str] = []
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
