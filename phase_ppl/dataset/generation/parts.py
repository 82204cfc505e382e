"""What became of the slots of a plan, one file each, and the data set that is made of them."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from phase_ppl.dataset.documents import read_json
from phase_ppl.dataset.events_json import event_from_record, event_record
from phase_ppl.dataset.events_netcdf import checksum, events_bytes
from phase_ppl.dataset.generated import (
    BLOCKS,
    ENTRIES,
    EVENTS,
    MANIFEST,
    MANIFEST_SCHEMA,
    REJECTED,
)
from phase_ppl.dataset.generation.making import Made, Rejected
from phase_ppl.dataset.generation.plan import BLOCK, Slot
from phase_ppl.world.errors import InvalidEventError, OutputError, PhasePPLError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import writable_folder, write_bytes, write_json

PARTS: Final = "parts"


def part_file(folder: Path, slot: Slot) -> Path:
    """Return the file of a slot, whether it is there or not."""
    return folder / PARTS / f"{slot.number:05d}.json"


def write_part(folder: Path, made: Made, keep_rejected: bool) -> None:
    """Keep what became of a slot."""
    rejected: list[dict[str, Any]] = []
    for id, reason, event, measures, replanned in made.rejected:
        rejected.append({"id": id, "reason": reason, "replanned": replanned, "measures": measures})
        if keep_rejected and event is not None:
            rejected[-1]["event"] = event_record(event)
    content = {
        "name": made.slot.name,
        "cell": made.slot.cell,
        "events": [event_record(event) for event in made.events],
        "entries": made.entries,
        "rejected": rejected,
    }
    write_json(part_file(folder, made.slot), {"sha256": _digest(content), **content})


def read_part(folder: Path, slot: Slot) -> Made:
    """Return what is kept of a slot (InvalidEventError: it is damaged)."""
    source = part_file(folder, slot)
    content = read_json(source)
    digest = content.pop("sha256", None)
    try:
        if digest != _digest(content):
            raise InvalidEventError("its content is not what sha256 says")
        if content["name"] != slot.name:
            raise InvalidEventError(f"it holds {shown(content['name'])}")
        events = [event_from_record(record) for record in content["events"]]
        made = Made(slot, events, list(content["entries"]), [])
        for draw in content["rejected"]:
            event = event_from_record(draw["event"]) if "event" in draw else None
            told = draw["id"], draw["reason"], event, draw["measures"], draw["replanned"]
            made.rejected.append(Rejected(*told))
        if [event.id for event in events] != [entry["id"] for entry in made.entries]:
            raise InvalidEventError("its events and entries are not the same")
        return made
    except (KeyError, TypeError, PhasePPLError) as error:
        raise InvalidEventError(f"{source}: is damaged ({error}); resume makes it anew") from None


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


# --- the data set ------------------------------------------------------------------------------


def assemble(
    out: Path,
    plan: Mapping[str, Any],
    made_by: Sequence[Mapping[str, Any]],
    slots: Sequence[Slot],
    folder_of: Callable[[Slot], Path],
) -> None:
    """Write the data set of a plan, of which each slot has a part; the manifest comes last.

    A block of slots is in memory at a time. A set of one block has its events in one file, and its
    entries in the manifest.

    Args:
        out: folder of the data set.
        plan: as plain data.
        made_by: versions that made it, the last ones last.
        slots: all of the plan.
        folder_of: slot -> the folder that has its part.
    """
    cells = plan["cells"]
    # of simulations, and of those of re-planned copies
    kept = {replanned: dict.fromkeys(cells, 0) for replanned in (False, True)}
    reasons: dict[bool, dict[str, Counter[str]]] = {
        replanned: {cell: Counter() for cell in cells} for replanned in (False, True)
    }
    given_up: list[str] = []
    sizes: list[int] = []
    single = len(slots) <= BLOCK
    entries: list[dict[str, Any]] = []
    for start in range(0, len(slots), BLOCK):
        events: list[Event] = []
        entries = []
        refused: list[Event] = []
        told: list[dict[str, Any]] = []
        for slot in slots[start : start + BLOCK]:
            part = read_part(folder_of(slot), slot)
            events += part.events
            entries += part.entries
            kept[False][slot.cell] += bool(part.events)
            kept[True][slot.cell] += sum(bool(entry.get("replanned")) for entry in part.entries)
            given_up += [] if part.events else [slot.name]
            for id, reason, event, measures, replanned in part.rejected:
                reasons[replanned][slot.cell][reason] += 1
                if event is not None:
                    refused.append(event)
                    draw = {"reason": reason, "replanned": replanned, "measures": measures}
                    told.append({"id": id, "cell": slot.cell, **draw})
        for event, entry in zip(events, entries, strict=True):
            entry["checksum"] = checksum(event)
        place = out if single else writable_folder(out / BLOCKS / f"{len(sizes):05d}")
        if events:
            write_bytes(place / EVENTS, (".nc",), events_bytes(events))
        if refused:
            write_bytes(place / f"{REJECTED}.nc", (".nc",), events_bytes(refused))
            write_json(place / f"{REJECTED}.json", {"rejected": told})
        if not single:
            write_json(place / ENTRIES, {"entries": entries})
        sizes.append(len(events))
    if not sum(sizes):
        raise OutputError(f"{out}: no draw of any kind was kept")
    replans = {cell: {"kept": n, "rejected": reasons[True][cell]} for cell, n in kept[True].items()}
    write_json(
        out / MANIFEST,
        {
            "schema": MANIFEST_SCHEMA,
            "plan": dict(plan),
            "versions": made_by[-1],
            "earlier_versions": made_by[:-1],
            "kept": kept[False],
            "rejected": reasons[False],
            "replans": replans if plan["replans"] else {},
            "given_up": given_up,
            **({"entries": entries} if single else {"blocks": sizes}),
        },
    )
