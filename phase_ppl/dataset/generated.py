"""The folder of a generated data set.

::

    DIR/
      plan.json           what was asked for
      parts/00007.json    one file per finished slot, until all are done
      events.nc           all events, ragged in time
      manifest.json       per event what is known about it beside the event itself
      rejected.nc         rejected draws as events, where they were kept
      rejected.json       why each of them was not kept, and its measures

A part is written whole or not at all, so interrupted generation goes on with the slots that are
missing, or whose part was damaged since; the finished set is the same.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Self

from phase_ppl.dataset.documents import check_schema, read_json
from phase_ppl.dataset.events_netcdf import StoredEvents, checksum
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.event import Event
from phase_ppl.world.identity import differences
from phase_ppl.world.picture import preformatted
from phase_ppl.world.scene import Turning

MANIFEST_SCHEMA: Final = "phase-ppl-manifest-1"

EVENTS: Final = "events.nc"
MANIFEST: Final = "manifest.json"
PLAN: Final = "plan.json"
REJECTED: Final = "rejected"


class GeneratedEvents(StoredEvents):
    """The events of a generated data set, with its manifest; each is read when it is asked for.

    Slices and splits are of the same kind, and read nothing. The files are open only while
    something is read, so that any number of processes can have the same events.

    Args:
        path: the folder.
        turning: "both", "ccw" or "cw" instead of what is stored.

    Attributes:
        path: the folder.
        manifest: of the whole set.

    Raises:
        InvalidEventError: it holds no finished data set, or a file of it is damaged; where a
            single event is, only when it is asked for.
    """

    def __init__(self, path: str | os.PathLike[str], turning: Turning | None = None) -> None:
        self.path = Path(path)
        self.manifest = read_manifest(self.path)
        self._entries: list[dict[str, Any]] = self.manifest["entries"]
        super().__init__(self.path / EVENTS, turning)
        if self.ids != [entry["id"] for entry in self._entries]:
            raise InvalidEventError(
                f"{self.path}: {EVENTS} and {MANIFEST} are not of the same events"
            )

    def __repr__(self) -> str:
        splits = Counter(entry["split"] for entry in self._entries)
        told = ", ".join(f"{n} {name}" for name, n in splits.items())
        return f"<{len(self)} generated events of {self.path}: {told}>"

    def _repr_html_(self) -> str:
        return preformatted(self)

    @property
    def entries(self) -> list[dict[str, Any]]:
        """What the manifest says about each of these events, in their order."""
        return list(self._entries)

    def split(self, name: str) -> Self:
        """Return the events of a split, such as "train".

        Raises:
            InvalidEventError: there is none in it.
        """
        found = [index for index, entry in enumerate(self._entries) if entry["split"] == name]
        if not found:
            known = sorted({entry["split"] for entry in self._entries})
            raise InvalidEventError(f"no events in split {name!r}; there are {known}")
        return self.chosen(found)

    def rejected(self) -> list[tuple[Event, str]]:
        """Return the draws that were not kept, each with the reason; none unless they were stored.

        Raises:
            InvalidEventError: their files are damaged, or not of the same draws.
        """
        events, reasons = self.path / f"{REJECTED}.nc", self.path / f"{REJECTED}.json"
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

    def chosen(self, indices: Sequence[int]) -> Self:
        """Return some of the events, in the order of the indices."""
        found = super().chosen(indices)
        found._entries = [self._entries[index] for index in indices]
        return found


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a finished data set."""
    source = folder / MANIFEST
    if not source.is_file():
        unfinished = " yet: its generation can be resumed" if (folder / PLAN).is_file() else ""
        raise InvalidEventError(f"{folder} holds no generated data set{unfinished}")
    manifest = read_json(source)
    check_schema(manifest, MANIFEST_SCHEMA, source)
    entries = manifest.get("entries")
    wanted = ("id", "split", "checksum")
    if not isinstance(entries, list) or not all(
        isinstance(entry, dict) and all(isinstance(entry.get(name), str) for name in wanted)
        for entry in entries
    ):
        raise InvalidEventError(f"{source}: expected entries with {', '.join(wanted)}")
    return manifest


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
