"""A run on file: all that is needed to go on with it, bit for bit.

Nothing in the file can run (:mod:`~phase_ppl.inference.runs.archive`). A prior, a simulator or a
kernel of a user's own is therefore not in it, but what tells it from others.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import jax

from phase_ppl.dataset.events_json import event_from_record, event_record
from phase_ppl.inference.runs.archive import damaged, read_archive, write_archive
from phase_ppl.inference.runs.chains import Step, on_cpu
from phase_ppl.inference.runs.packing import (
    packed_leaf,
    packed_records,
    packed_steps,
    unpacked_leaf,
    unpacked_records,
    unpacked_steps,
)
from phase_ppl.inference.runs.plan import Plan, fields_of, stored_model, stored_options
from phase_ppl.models.bridge import Record
from phase_ppl.simulator.costs import Statistics
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path
from phase_ppl.world.identity import event_digest

_TARGET: Final = ("iterations", "seconds")
_FAILURES: Final = ("on_failure", "retries")

SCHEMA: Final = "phase-ppl-checkpoint-2"


@dataclasses.dataclass(frozen=True)
class Spent:
    """What a run has cost so far, in all calls.

    Attributes:
        statistics: of its simulations.
        seconds: of wall time.
        recent: seconds that the last iterations took.
        calls: of ``infer`` and ``resume``.
    """

    statistics: Statistics = dataclasses.field(default_factory=Statistics)
    seconds: float = 0.0
    recent: Sequence[float] = ()
    calls: int = 0


@dataclasses.dataclass(frozen=True)
class Progressed:
    """What a run has done.

    Attributes:
        state: of the kernel.
        start: the initial particles.
        steps: the particles after each iteration.
        records: all simulations.
        spent: what it cost.
        versions: of this package and what it builds on, of which it was made; the last last.
    """

    state: Any
    start: Step
    steps: list[Step]
    records: list[Record]
    spent: Spent
    versions: Sequence[Mapping[str, Any]]


class Checkpoint:
    """The file of a run, opened.

    Args:
        path: of the file.

    Attributes:
        path: of the file.
        identity: what the run is (:meth:`phase_ppl.inference.runs.plan.Plan.identity`).
        event: that it explains.
        target: ``iterations``, ``seconds``, ``simulations`` or ``frames``, when it was to be
            complete; the others are None, or absent.
        failures: ``on_failure`` and ``retries``.
        model: to make the model again; None where it has parts of a user's own.
        kernel: name of the kernel; None where it is a user's own object.
        options: of the kernel; None where they are not plain data.
        settings: of SIMPLE; likewise.
        start, steps, records, spent, versions: as in :class:`Progressed`.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = as_path(path)
        document, self._arrays = read_archive(path)
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"its schema is {shown(document['schema'])}, not {SCHEMA!r}")
            self._read(document)
        except Exception as error:  # it may hold anything
            raise damaged(path, error) from None

    def _read(self, document: Mapping[str, Any]) -> None:
        self.identity = dict(document["identity"])
        self.event = dataclasses.replace(
            event_from_record(document["event"]), id=str(document["event_id"])
        )
        if event_digest(self.event) != self.identity["event"]:
            raise ValueError("its event is not that of the run")
        self.target, self.failures = dict(document["target"]), dict(document["failures"])
        for known in (*_TARGET, *_FAILURES):
            (self.target if known in _TARGET else self.failures)[known]
        again = document["again"]
        self.model: dict[str, Any] | None = again["model"]
        self.kernel: str | None = again["kernel"]
        self.options: dict[str, Any] | None = again["options"]
        self.settings: dict[str, Any] | None = again["settings"]
        self.start = unpacked_steps(self._arrays, "start", 1)[0]
        self.steps = unpacked_steps(self._arrays, "steps", int(document["iterations"]))
        self.records = unpacked_records(
            self._arrays, document["failed"], self.event.observation.n_frames
        )
        self.versions = [
            dict(one) for one in document.get("versions", [{}])
        ]  # there were none once
        spent = dict(document["spent"])
        self.spent = Spent(**{**spent, "statistics": Statistics(**spent["statistics"])})
        with on_cpu():
            self._leaves = [
                (str(name), unpacked_leaf(self._arrays[f"state/{i}"], kind))
                for i, (name, kind) in enumerate(document["state"])
            ]

    def made(self, make: Callable[..., Any], given: Mapping[str, Any]) -> Any:
        """Return what is made of a part of the file; raise InvalidEventError if nothing can be."""
        try:
            return make(**given)
        except Exception as error:  # it may hold anything
            raise damaged(self.path, error) from None

    def state(self, blank: Any) -> Any:
        """Return the state of the kernel.

        Args:
            blank: its shapes and types.

        Raises:
            InvalidSettingError: the kernel's state had others.
        """
        expected, treedef = jax.tree_util.tree_flatten_with_path(blank)
        if [(name, leaf.shape, leaf.dtype) for name, leaf in self._leaves] != [
            (jax.tree_util.keystr(path), leaf.shape, leaf.dtype) for path, leaf in expected
        ]:
            raise InvalidSettingError(
                f"{self.path} does not fit the kernel: its state had other fields, shapes or types"
            )
        return jax.tree_util.tree_unflatten(treedef, [leaf for _, leaf in self._leaves])


def write_checkpoint(
    path: str | os.PathLike[str],
    plan: Plan,
    target: Mapping[str, Any],
    failures: Mapping[str, Any],
    done: Progressed,
) -> None:
    """Write a run to a file, whole or not at all.

    Args:
        path: ends in .ckpt.
        plan: what the run is.
        target, failures: as the attributes of :class:`Checkpoint`.
        done: what it has done; ``state`` as the kernel has it.

    Raises:
        OutputError: the file cannot be written there.
    """
    seen = Event(plan.event.scene, plan.event.observation)
    leaves = jax.tree_util.tree_flatten_with_path(done.state)[0]
    packed = [packed_leaf(leaf) for _, leaf in leaves]
    # those of an iteration that was interrupted will be run again
    records = [record for record in done.records if record.iteration <= len(done.steps)]
    document = {
        "schema": SCHEMA,
        "identity": plan.identity(),
        "again": {
            "model": stored_model(plan.model),
            "kernel": plan.kernel if isinstance(plan.kernel, str) else None,
            "options": stored_options(plan.options),
            "settings": stored_options(fields_of(plan.settings)),
        },
        "target": dict(target),
        "failures": dict(failures),
        "event": event_record(seen),
        "event_id": plan.event.id,
        "iterations": len(done.steps),
        "spent": dataclasses.asdict(done.spent),
        "versions": list(done.versions),
        "state": [
            [jax.tree_util.keystr(path), kind]
            for (path, _), (_, kind) in zip(leaves, packed, strict=True)
        ],
        "failed": {
            str(row): record.result.failure
            for row, record in enumerate(records)
            if record.result.failure is not None
        },
    }
    arrays = {f"state/{i}": values for i, (values, _) in enumerate(packed)}
    arrays |= packed_steps("start", [done.start])
    arrays |= packed_steps("steps", done.steps)
    arrays |= packed_records(records)
    write_archive(path, document, arrays)
