"""The folder of a generated data set.

::

    DIR/
      plan.json           what was asked for
      parts/00007.json    one file per finished slot, until all are done
      events.nc           all events, ragged in time
      manifest.json       per event what is known about it beside the event itself
      rejected.nc         rejected draws as events, where they were kept
      rejected.json       why each of them was not kept

A part is written whole or not at all, so interrupted generation goes on with the slots that are
missing; the finished set is the same.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, overload

from phase_ppl.dataset.documents import read_json
from phase_ppl.dataset.events_json import event_from_record, event_record
from phase_ppl.dataset.events_netcdf import checksum
from phase_ppl.dataset.generation.making import Made, event_of
from phase_ppl.dataset.generation.plan import Plan, Slot
from phase_ppl.dataset.load import load_events, save_events
from phase_ppl.world.errors import InvalidEventError, OutputError, PhasePPLError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import write_json
from phase_ppl.world.identity import differences, versions

PLAN_SCHEMA: Final = "phase-ppl-plan-1"
MANIFEST_SCHEMA: Final = "phase-ppl-manifest-1"

EVENTS: Final = "events.nc"
MANIFEST: Final = "manifest.json"
PLAN: Final = "plan.json"
PARTS: Final = "parts"
REJECTED: Final = "rejected"


class GeneratedEvents(Sequence[Event]):
    """The events of a generated data set, with its manifest.

    Args:
        path: the folder.

    Raises:
        InvalidEventError: it holds no finished data set, or a file of it is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.manifest = read_manifest(self.path)
        self._events = list(load_events(self.path / EVENTS))
        ids, told = [event.id for event in self._events], [entry["id"] for entry in self.entries]
        if ids != told:
            raise InvalidEventError(
                f"{self.path}: {EVENTS} and {MANIFEST} are not of the same events"
            )

    @property
    def entries(self) -> list[dict[str, Any]]:
        """What the manifest says about each event, in their order."""
        return list(self.manifest["entries"])

    def split(self, name: str) -> list[Event]:
        """Return the events of a split, such as "train".

        Raises:
            InvalidEventError: there is none in it.
        """
        found = [
            event
            for event, entry in zip(self._events, self.entries, strict=True)
            if entry["split"] == name
        ]
        if not found:
            known = sorted({entry["split"] for entry in self.entries})
            raise InvalidEventError(f"no events in split {name!r}; there are {known}")
        return found

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> list[Event]: ...

    def __getitem__(self, index: int | slice) -> Event | list[Event]:
        return self._events[index]

    def __len__(self) -> int:
        return len(self._events)

    def __iter__(self) -> Iterator[Event]:
        return iter(self._events)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a finished data set.

    Raises:
        InvalidEventError: there is none, or it is damaged.
    """
    source = folder / MANIFEST
    if not source.is_file():
        unfinished = " yet: its generation can be resumed" if (folder / PLAN).is_file() else ""
        raise InvalidEventError(f"{folder} holds no generated data set{unfinished}")
    manifest = read_json(source)
    if manifest.get("schema") != MANIFEST_SCHEMA:
        raise InvalidEventError(
            f"{source}: its schema is {shown(manifest.get('schema'))}, not {MANIFEST_SCHEMA!r}"
        )
    entries = manifest.get("entries")
    wanted = ("id", "split", "checksum")
    if not isinstance(entries, list) or not all(
        isinstance(entry, dict) and all(isinstance(entry.get(name), str) for name in wanted)
        for entry in entries
    ):
        raise InvalidEventError(f"{source}: expected entries with {', '.join(wanted)}")
    return manifest


def verify(folder: str | os.PathLike[str]) -> list[str]:
    """Return what is wrong with a finished data set; nothing if all is well.

    Raises:
        InvalidEventError: it cannot be read at all.
    """
    found = GeneratedEvents(folder)
    return [
        f"{event.id}: its content is not what the manifest says"
        for event, entry in zip(found, found.entries, strict=True)
        if checksum(event) != entry["checksum"]
    ]


# --- unfinished ------------------------------------------------------------------------------


class Workshop:
    """The folder of a data set that is being made.

    Args:
        path: of the folder.
        plan: what is to be made.
        keep_rejected: whether rejected draws are kept.
        resume: whether to go on with what is there.

    Raises:
        OutputError: the folder cannot be written, holds a data set already, or one of another
            plan.
    """

    def __init__(
        self, path: str | os.PathLike[str], plan: Plan, *, keep_rejected: bool, resume: bool
    ) -> None:
        self.path, self.plan = Path(path), plan
        record = {"schema": PLAN_SCHEMA, "keep_rejected": keep_rejected, **plan.to_dict()}
        target = self.path / PLAN
        if target.exists():
            if not resume:
                raise OutputError(
                    f"{self.path} holds a data set already; resume it, or name another"
                )
            apart = differences(read_json(target), record)
            if apart:
                raise OutputError(
                    f"{self.path} holds a data set of another plan: {'; '.join(apart)}"
                )
        try:
            (self.path / PARTS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write into {self.path}: {error.strerror or error}") from None
        self._keep_rejected = keep_rejected
        if not target.exists():
            write_json(target, record)

    def part(self, slot: Slot) -> Path:
        """Return the file of a slot."""
        return self.path / PARTS / f"{slot.number:05d}.json"

    def missing(self) -> list[Slot]:
        """Return the slots that are not finished."""
        if (self.path / MANIFEST).is_file():
            return []
        return [slot for slot in self.plan.slots() if not self.part(slot).is_file()]

    def add(self, made: Made) -> None:
        """Keep what became of a slot."""
        rejected: list[dict[str, Any]] = []
        for draw in made.rejected:
            record: dict[str, Any] = {"attempt": draw.attempt, "reason": draw.reason}
            if self._keep_rejected:
                event = event_of(draw.recording, f"{made.name}-{draw.attempt}")
                record["event"] = event_record(event)
            rejected.append(record)
        write_json(
            self.part(made.slot),
            {
                "name": made.name,
                "cell": made.slot.cell,
                "events": [event_record(event) for event in made.events],
                "entries": made.entries,
                "rejected": rejected,
            },
        )

    def finish(self, cost: Mapping[str, Any]) -> GeneratedEvents:
        """Put the parts together and return the data set."""
        if not (self.path / MANIFEST).is_file():
            self._assemble(cost)
        for slot in self.plan.slots():
            self.part(slot).unlink(missing_ok=True)
        (self.path / PARTS).rmdir()
        return GeneratedEvents(self.path)

    def _assemble(self, cost: Mapping[str, Any]) -> None:
        events: list[Event] = []
        entries: list[dict[str, Any]] = []
        refused: list[Event] = []
        reasons: list[dict[str, Any]] = []
        counts: dict[str, dict[str, int]] = {cell: {} for cell in self.plan.cells}
        kept = dict.fromkeys(self.plan.cells, 0)
        given_up = []
        for slot in self.plan.slots():
            part = read_json(self.part(slot))
            try:
                events += [event_from_record(record) for record in part["events"]]
                entries += part["entries"]
                kept[part["cell"]] += bool(part["events"])
                given_up += [] if part["events"] else [part["name"]]
                for draw in part["rejected"]:
                    of_cell = counts[part["cell"]]
                    of_cell[draw["reason"]] = of_cell.get(draw["reason"], 0) + 1
                    if "event" in draw:
                        refused.append(event_from_record(draw["event"]))
                        reasons.append({"id": refused[-1].id, "cell": part["cell"],
                                        "reason": draw["reason"]})  # fmt: skip
            except (KeyError, TypeError, PhasePPLError) as error:
                raise InvalidEventError(f"{self.part(slot)}: is damaged ({error})") from None
        if not events:
            raise OutputError(f"{self.path}: no draw of any kind was kept")
        for event, entry in zip(events, entries, strict=True):
            entry["checksum"] = checksum(event)
        save_events(events, self.path / EVENTS)
        if refused:
            save_events(refused, self.path / f"{REJECTED}.nc")
            write_json(self.path / f"{REJECTED}.json", {"rejected": reasons})
        write_json(
            self.path / MANIFEST,
            {
                "schema": MANIFEST_SCHEMA,
                "plan": self.plan.to_dict(),
                "versions": versions(),
                "kept": kept,
                "rejected": counts,
                "given_up": given_up,
                "cost": dict(cost),
                "entries": entries,
            },
        )
