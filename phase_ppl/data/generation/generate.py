"""The call that generates a data set: it makes a part for each slot, then assembles them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.data.documents import read_json
from phase_ppl.data.events_json import checksum, event_from_record, events_bytes
from phase_ppl.data.generated import EVENTS, MANIFEST, MANIFEST_SCHEMA, PLAN, GeneratedEvents
from phase_ppl.data.generation.making import DrawRoles, Part, Plan, Slot, cell_of, make, scaled
from phase_ppl.data.generation.situation import tables_of
from phase_ppl.simulator.processes import Failure, results, slots_of
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    PhasePPLError,
    SimulationError,
)
from phase_ppl.world.files import locked, writable_folder, write_bytes, write_json
from phase_ppl.world.identity import differences, versions_so_far
from phase_ppl.world.progress import Bar
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.worlds import named

PLAN_SCHEMA: Final = "phase-ppl-plan-1"
PARTS: Final = "parts"

# --- results of the slots, one file each ---------------------------------------------------------


def part_file(folder: Path, slot: Slot) -> Path:
    """Return the path of a slot's file, whether it exists or not."""
    return folder / PARTS / f"{slot.number:05d}.json"


def read_part(folder: Path, slot: Slot) -> Part:
    """Return the stored part of a slot, with events in place of their records.

    InvalidEventError: it is damaged.
    """
    source = part_file(folder, slot)
    part = read_json(source)
    try:
        if part.pop("sha256") != _digest(part) or part["name"] != slot.name:
            raise InvalidEventError("its content is not what sha256 says, or of another slot")
        part["events"] = [event_from_record(record) for record in part["events"]]
        return part
    except (KeyError, TypeError, PhasePPLError) as error:
        raise InvalidEventError(f"{source}: is damaged ({error})") from None


def _is_made(folder: Path, slot: Slot) -> bool:
    """Return whether a slot has a part; a damaged one counts as none, with a warning."""
    try:
        return part_file(folder, slot).is_file() and bool(read_part(folder, slot))
    except InvalidEventError as error:
        warnings.warn(f"{error}; it is made anew", RuntimeWarning, 3)
        return False


def _digest(part: Part) -> str:
    text = json.dumps(part, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def assemble(
    out: Path,
    plan: Mapping[str, Any],
    made_by: Sequence[Mapping[str, Any]],
    slots: Sequence[Slot],
) -> None:
    """Write the data set of a plan whose slots all have parts; the manifest comes last.

    ``made_by`` are the code versions that made it, oldest first.
    """
    parts = [read_part(out, slot) for slot in slots]
    kept = Counter(dict.fromkeys(plan["cells"], 0))
    refused = {cell: Counter[str]() for cell in plan["cells"]}
    for part in parts:
        kept[part["cell"]] += bool(part["events"])
        refused[part["cell"]].update(part["rejected"])
    events = [event for part in parts for event in part["events"]]
    entries = [entry for part in parts for entry in part["entries"]]
    if not events:
        raise OutputError(f"{out}: no draw of any kind was kept")
    for event, entry in zip(events, entries, strict=True):
        entry["checksum"] = checksum(event)
    write_bytes(out / EVENTS, (".json",), events_bytes(events))
    write_json(
        out / MANIFEST,
        {
            "schema": MANIFEST_SCHEMA,
            "plan": dict(plan),
            "versions": made_by[-1],
            "earlier_versions": made_by[:-1],
            "kept": kept,
            "rejected": refused,
            "given_up": [part["name"] for part in parts if not part["events"]],
            "entries": entries,
        },
    )


def _make_missing(
    folder: Path, plan: Plan, missing: Sequence[Slot], total: int, **how: Any
) -> None:
    """Make the missing parts; ``total`` is the number of all."""
    left, progress = len(missing), how.pop("progress")
    failures: list[str] = []
    made = results(make, plan, missing, what="the plan", **how)
    try:
        bar = Bar(total, total - left, progress, "event", "events")
        with contextlib.closing(made), bar:
            for slot, part in made:
                if isinstance(part, Failure):
                    failures.append(f"{slot.cell}, number {slot.number}: {part.reason}")
                else:
                    write_json(part_file(folder, slot), {"sha256": _digest(part), **part})
                    left -= 1
                bar.update()
    except KeyboardInterrupt:
        raise GenerationInterrupted(
            f"interrupted with {left} of {total} events to be made; resume goes on"
        ) from None
    except SimulationError as error:
        raise SimulationError(
            f"{error}: {left} of {total} events are still to be made; the others are kept in "
            f"{folder}, and resume goes on"
        ) from None
    if failures:
        raise SimulationError(
            f"{len(failures)} events could not be made, the first: {failures[0]}; the others "
            f"are kept in {folder}"
        )


# --- the call --------------------------------------------------------------------------------


class GenerationInterrupted(KeyboardInterrupt):
    """A ``KeyboardInterrupt`` in :func:`phase_ppl.generate`.

    Finished events are kept; ``generate(..., resume=True)`` goes on.
    """


def generate(
    out: str | os.PathLike[str],
    n: int | None = None,
    *,
    world: str | World = PHASE,
    roles: DrawRoles | None = None,
    cells: Mapping[str, int] | None = None,
    splits: Mapping[str, float] | None = None,
    copies: int = 0,
    planner: str | PlannerConfig = "fast",
    seed: int = 0,
    turning: Any = "both",
    frames: int | None = None,
    max_tries: int | None = None,
    resume: bool = False,
    other_versions: bool = False,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | None = None,
) -> GeneratedEvents:
    """Make a data set like PHASE: draw situations, simulate them, keep those that show something.

    Each event depends only on ``seed`` and its number in the plan. So the set is the same for any
    number of workers, and after any interruption.

    A situation comes from a family (:func:`phase_ppl.draw_situation`), or it is a random scene
    ``world.random_scene(seed)`` with a hypothesis ``roles(world, seed)``. An event of a family is
    kept if it shows the family's scenario. An event in a random scene is kept if an agent with a
    goal of its own reaches that goal. Except in PHASE, one number gives a whole event: the ``seed``
    of its entry, which ``phase_ppl.simulate`` takes too.

    Args:
        out: folder of the data set (:mod:`phase_ppl.data.generated`).
        n: number of events, in the proportions of ``cells``; None: the numbers of ``cells``.
            Required for random scenes without cells.
        world: the world, or the name of a ready-made one.
        roles: for random scenes, a function ``(world, seed)`` that returns a
            :class:`phase_ppl.Hypothesis`, or None to draw scene and hypothesis anew. Examples are
            :func:`phase_ppl.roles.draw` and, for a prior of your own,
            ``functools.partial(phase_ppl.roles.draw, prior=...)``. By default all goals, and all
            ways to help or hinder, are equally likely.
        cells: FAMILY or FAMILY:VARIANT -> number of events (``available_families`` lists the
            families). A family's number is spread evenly over its variants. By default PHASE has
            the paper's 500 events. In other worlds, or with ``roles``, scenes are random.
        splits: name of a split -> share of the events, in any unit; by default the paper's "train"
            320, "validation" 80 and "test" 100.
        copies: number of further copies of each event, with other reflections and colours, in the
            event's split. Only PHASE has copies. Reflection and colours of the event itself are
            drawn at random there too.
        planner: settings of the agents' planner: "fast", "paper", another name of
            :meth:`phase_ppl.PlannerConfig.named`, or a ``PlannerConfig``.
        seed: a whole number >= 0, the seed of everything random.
        turning: which way agents can turn before any reflection: "both", "ccw" (counter-clockwise)
            or "cw".
        frames: number of frames of an event; PHASE's are then cut after the last motion. Default:
            101.
        max_tries: number of draws after which an event is given up. Default: 200.
        resume: whether to go on with an unfinished set in ``out``. Its damaged events are made
            anew, with a warning.
        other_versions: whether to resume a set that other versions of this package or its libraries
            began. The manifest keeps all versions.
        workers: number of processes; by default one per usable core. With an ``executor``: how many
            events to give it at a time; by default up to 1000.
        executor: any PEP 3148 executor to make events in, such as that of a ``dask.distributed``
            client. It is not shut down.
        progress: whether to show a bar on stderr; None: if stderr is a terminal.

    Returns:
        The events; its attributes ``manifest`` and ``entries`` say how each was made.

    Raises:
        UnknownNameError, InvalidSettingError: a setting is not allowed.
        OutputError: the folder cannot be written, holds a data set of other settings, or holds one
            and ``resume`` is False.
        SimulationError: an event could not be made, or the executor takes no more work; finished
            events are kept.
        GenerationInterrupted: Ctrl-C; finished events are kept.
    """
    world = named(world)
    tables = tables_of(world)
    if cells is None:
        cells = {} if roles is not None else tables.cells
        if n is None and not cells:
            raise InvalidSettingError(
                f"n, the number of events, is needed in the world {world.name!r}"
            )
        cells = cells or {cell_of(world): 1}
    given = {"splits": splits, "frames": frames, "max_tries": max_tries}
    plan = Plan(
        world=world,
        roles=roles,
        cells=cells if n is None else scaled(cells, n),
        copies=copies,
        planner=planner,
        seed=seed,
        turning=turning,
        **{name: value for name, value in given.items() if value is not None},  # type: ignore[arg-type]
    )
    at_once = slots_of(workers, executor)
    folder, slots = Path(out), plan.slots()
    record = {"schema": PLAN_SCHEMA, **plan.to_dict()}
    with locked(writable_folder(out)):
        made_by: list[dict[str, Any]] = []
        if (folder / PLAN).exists():
            if not resume:
                raise OutputError(f"{folder} holds a data set already; resume it, or name another")
            stored = read_json(folder / PLAN)
            made_by = stored.pop("versions", [{}])
            apart = differences(stored, record)
            if apart:
                raise OutputError(f"{folder} holds a data set of another plan: {'; '.join(apart)}")
        parts = writable_folder(folder / PARTS)
        if not (folder / MANIFEST).is_file():
            missing = [slot for slot in slots if not _is_made(folder, slot)]
            if missing:
                made_by = versions_so_far(made_by, folder, other_versions)
                write_json(folder / PLAN, {**record, "versions": made_by})
            how = {"workers": at_once, "executor": executor, "progress": progress}
            _make_missing(folder, plan, missing, len(slots), **how)
            assemble(folder, plan.to_dict(), made_by, slots)
        for file in (*(part_file(folder, slot) for slot in slots), *parts.glob(".part-*")):
            file.unlink(missing_ok=True)  # also parts cut short when a process was killed
        with contextlib.suppress(OSError):  # other files there are not ours
            parts.rmdir()
        return GeneratedEvents(folder)
