"""The folder of a generated data set.

::

    DIR/
      plan.json           the settings
      parts/00007.json    one file per finished slot, until all are done
      events.json         all events
      manifest.json       how each event was made

A part is written whole or not at all. So interrupted generation goes on with the slots that have
none, or a damaged one, and the finished set is the same.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any, Final, Self, overload

import msgspec

from phase_ppl.data import events_json
from phase_ppl.data.documents import (
    check_schema,
    converted,
    in_front,
    naming,
    read_document,
    read_json,
)
from phase_ppl.data.events_json import checksum, turned
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event
from phase_ppl.world.picture import Printed
from phase_ppl.world.scene import Turning

MANIFEST_SCHEMA: Final = "phase-ppl-manifest-1"

EVENTS: Final = "events.json"
MANIFEST: Final = "manifest.json"
PLAN: Final = "plan.json"


class _Entry(msgspec.Struct):
    id: str
    split: str
    checksum: str


class _Manifest(msgspec.Struct):
    entries: list[_Entry]


class GeneratedEvents(Printed, Sequence[Event]):
    """The events of a generated data set: a sequence that reads an event when it is asked for.

    A slice or split of it is a ``GeneratedEvents`` too.

    Args:
        path: the folder of the data set.
        turning: which way agents can turn by themselves, "both", "ccw" (counter-clockwise) or "cw",
            in place of the stored values.

    Attributes:
        path: the folder of the data set.
        manifest: how the whole set was made: ``plan`` (the settings), ``versions``, and by kind of
            event the draws ``kept`` and ``rejected``.
        entries: (event,) how each event was made: its ``id``, ``split``, ``checksum`` and more.

    Raises:
        InvalidEventError: the folder holds no finished data set, or a file is damaged. A damaged
            single event is found only when it is asked for.
    """

    def __init__(self, path: str | os.PathLike[str], turning: Turning | None = None) -> None:
        self.path, self._turning = Path(path), turning
        self.manifest = read_manifest(self.path)
        self.entries: list[dict[str, Any]] = self.manifest["entries"]
        with naming(self.path / EVENTS):
            self._stored = events_json.read(read_document(self.path / EVENTS))
        if [id for id, _ in self._stored] != [entry["id"] for entry in self.entries]:
            raise InvalidEventError(
                f"{self.path}: {EVENTS} and {MANIFEST} are not of the same events"
            )

    def __str__(self) -> str:
        """How many draws of each kind of event were kept, and why other draws were rejected."""
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

    def __len__(self) -> int:
        return len(self._stored)

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> Self: ...

    def __getitem__(self, index: int | slice) -> Event | Self:
        if isinstance(index, slice):
            return self._chosen(range(len(self))[index])
        id, read = self._stored[index]
        with naming(self.path / EVENTS, id):
            event = read()
            if checksum(event) != self.entries[index]["checksum"]:
                raise InvalidEventError("its content is not what the manifest says: damaged")
        return event if self._turning is None else turned(event, self._turning)

    def _chosen(self, indices: Sequence[int]) -> Self:
        """Return some of the events, in the order of the indices."""
        found = copy(self)
        found._stored = [self._stored[index] for index in indices]
        found.entries = [self.entries[index] for index in indices]
        return found

    def split(self, name: str) -> Self:
        """Return the events of a split, such as "train" (InvalidEventError: it has no events)."""
        splits = [entry["split"] for entry in self.entries]
        if name not in splits:
            raise InvalidEventError(f"no events in split {name!r}; there are {sorted({*splits})}")
        return self._chosen([index for index, split in enumerate(splits) if split == name])


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a finished data set."""
    source = folder / MANIFEST
    if not source.is_file():
        unfinished = " yet: its generation can be resumed" if (folder / PLAN).is_file() else ""
        raise InvalidEventError(f"{folder} holds no generated data set{unfinished}")
    manifest = read_json(source)
    with in_front(f"{source}: "):
        converted(manifest, _Manifest)
    check_schema(manifest, MANIFEST_SCHEMA, source)
    return manifest
