"""A run on file: all that is needed to go on with it, bit for bit.

Nothing in the file can run (:mod:`~phase_ppl.inference.runs.checkpoint`). A prior, a simulator or a
kernel of a user's own is therefore not in it, but what tells it from others.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.dataset.events_json import event_from_record, event_record
from phase_ppl.inference.runs.chains import Step, on_cpu
from phase_ppl.inference.runs.plan import Plan, fields_of, stored_model, stored_options
from phase_ppl.models.bridge import Record, hypothesis_of_row
from phase_ppl.simulator.contract import FRAME_SHAPE, SimulationResult, Statistics
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, existing_file, write_bytes
from phase_ppl.world.identity import event_digest

SUFFIXES: Final = (".ckpt",)

Arrays = dict[str, NDArray[Any]]

_DOCUMENT: Final = "run.json"
_ARRAY: Final = ".npy"
_LIST: Final = "arrays"
_KINDS: Final = "biuf"
_VERSION: Final = (1, 0)


def write_archive(
    path: str | os.PathLike[str], document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write a document and arrays of numbers to ``path``, whole or not at all.

    Raises:
        OutputError: the file cannot be written there, or its name does not end in .ckpt.
    """
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_STORED) as archive:
        # the list tells a file that lost some of them without a trace
        archive.writestr(_DOCUMENT, json.dumps({**document, _LIST: list(arrays)}))
        for name, values in arrays.items():
            with archive.open(name + _ARRAY, "w", force_zip64=True) as member:
                np.lib.format.write_array(
                    member, np.asarray(values, order="C"), _VERSION, allow_pickle=False
                )
    write_bytes(path, SUFFIXES, memory.getvalue())


def read_archive(path: str | os.PathLike[str]) -> tuple[dict[str, Any], Arrays]:
    """Return the document and the arrays that :func:`write_archive` wrote.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
    """
    source = existing_file(path)
    try:
        with zipfile.ZipFile(source) as archive:
            members = {info.filename: _member(archive, info) for info in archive.infolist()}
        document = json.loads(members.pop(_DOCUMENT))
        if not isinstance(document, dict):
            raise ValueError(f"{_DOCUMENT} is no object")
        arrays = {name.removesuffix(_ARRAY): _array(data) for name, data in members.items()}
        if document.pop(_LIST) != list(arrays):
            raise ValueError("it has not the arrays that were written")
    except Exception as error:  # whatever a damaged file makes the readers stumble over
        raise damaged(source, error) from None
    return document, arrays


def damaged(path: str | os.PathLike[str], error: Exception) -> InvalidEventError:
    """Return the error for a file that cannot be a checkpoint, or not a whole one."""
    reason = " ".join(str(error).split())[:200]
    if isinstance(error, KeyError):
        reason = f"it lacks {reason}"
    return InvalidEventError(
        f"{path} is no checkpoint, or a damaged one: {reason or type(error).__name__}"
    )


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    # compressed ones could be far larger than the file
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise ValueError(f"{info.filename!r} is compressed")
    return archive.read(info)


def _array(data: bytes) -> NDArray[Any]:
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != _VERSION:
        raise ValueError("an array has another version")
    shape, by_column, dtype = np.lib.format.read_array_header_1_0(file)
    if dtype.kind not in _KINDS or by_column:
        raise ValueError(f"an array of {dtype}, expected numbers, row by row")
    content = data[file.tell() :]
    if len(content) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"an array is {len(content)} bytes long, which does not fit {shape}")
    return np.frombuffer(content, dtype).reshape(shape) if content else np.empty(shape, dtype)


# --- turning what a run has done into arrays of numbers, and back, to the last bit ----------------

# --- state -----------------------------------------------------------------------------------


def packed_leaf(leaf: Any) -> tuple[NDArray[Any], str | None]:
    """Return the numbers of a leaf of a state, and of which kind it is if it is a key."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return np.asarray(random.key_data(leaf)), str(random.key_impl(leaf))
    return np.asarray(leaf), None


def unpacked_leaf(values: NDArray[Any], kind: str | None) -> jax.Array:
    """Return the leaf that :func:`packed_leaf` was given."""
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise ValueError("a value of its state is NaN")
    leaf = jnp.asarray(values)
    return leaf if kind is None else random.wrap_key_data(leaf, impl=kind)


# --- steps -----------------------------------------------------------------------------------


def packed_steps(prefix: str, steps: Sequence[Step]) -> Arrays:
    """Return arrays (step, ...), named ``prefix/field``."""
    if not steps:
        return {}
    arrays: Arrays = {}
    for field in Step._fields:
        values = [getattr(step, field) for step in steps]
        if field == "sites":
            for site in values[0]:
                arrays[f"{prefix}/sites/{site}"] = np.stack([sites[site] for sites in values])
        else:
            arrays[f"{prefix}/{field}"] = np.stack(values)
    return arrays


def unpacked_steps(arrays: Arrays, prefix: str, n: int) -> list[Step]:
    """Return the ``n`` steps that :func:`packed_steps` was given."""
    if not n:
        return []
    sites = _below(arrays, f"{prefix}/sites/")
    fields = {name: arrays[f"{prefix}/{name}"] for name in Step._fields if name != "sites"}
    for values in (*sites.values(), *fields.values()):
        if len(values) != n:
            raise ValueError(f"{prefix} has {len(values)} entries, expected {n}")
    return [
        Step(
            sites={name: values[i] for name, values in sites.items()},
            **{name: values[i] for name, values in fields.items()},
        )
        for i in range(n)
    ]


def _below(arrays: Arrays, prefix: str) -> Arrays:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


# --- records ---------------------------------------------------------------------------------

_RECORD: Final = (
    *("seed", "chain", "iteration", "log_prior", "log_proposal", "log_bound", "log_again"),
    *("frames", "completed"),
)


def packed_records(records: Sequence[Record]) -> Arrays:
    """Return arrays (record, ...); errors and trajectories of the simulated frames, in a row."""
    results = [record.result for record in records]
    frames = [result.frames_simulated for result in results]
    columns = {
        "seed": np.array([result.seed for result in results], np.int64),
        "chain": np.array([record.chain for record in records], np.int64),
        "iteration": np.array([record.iteration for record in records], np.int64),
        **{
            name: np.array([getattr(record, name) for record in records], np.float64)
            for name in ("log_prior", "log_proposal", "log_bound", "log_again")
        },
        "frames": np.array(frames, np.int64),
        "completed": np.array([result.completed for result in results], np.bool_),
        "error": np.concatenate([r.errors[:n] for r, n in zip(results, frames, strict=True)]),
        "trajectory": np.concatenate(
            [r.trajectory[:n] for r, n in zip(results, frames, strict=True)]
        ).astype(np.float32),
    }
    for site in records[0].sites:
        columns[f"sites/{site}"] = np.stack([record.sites[site] for record in records])
    return {f"records/{name}": values for name, values in columns.items()}


def unpacked_records(arrays: Arrays, failed: Mapping[str, str], n_frames: int) -> list[Record]:
    """Return the records that :func:`packed_records` was given.

    Args:
        arrays: that it returned.
        failed: number of the record -> what went wrong.
        n_frames: of a complete simulation.
    """
    sites = _below(arrays, "records/sites/")
    columns = {name: arrays[f"records/{name}"] for name in _RECORD}
    errors, trajectory = arrays["records/error"], arrays["records/trajectory"]
    frames = columns["frames"]
    ends = np.cumsum(frames)
    lengths = {len(values) for values in (*sites.values(), *columns.values())}
    if len(lengths) != 1 or not ends.size or ends[-1] != len(errors) or ends[-1] != len(trajectory):
        raise ValueError("the records differ in length")
    if frames.min() < 0 or frames.max() > n_frames:
        raise ValueError(f"a record has more than {n_frames} frames")
    records = []
    for row, (end, n) in enumerate(zip(ends, frames, strict=True)):
        frames_shown = np.full((n_frames, *FRAME_SHAPE), np.nan)
        frames_shown[:n] = trajectory[end - n : end]
        by_frame = np.full(n_frames, np.inf)
        by_frame[:n] = errors[end - n : end]
        result = SimulationResult(
            hypothesis_of_row(sites, row),
            int(columns["seed"][row]),
            frames_shown,
            by_frame,
            int(n),
            bool(columns["completed"][row]),
            failure=failed.get(str(row)),
        )
        records.append(
            Record(
                result,
                {name: values[row] for name, values in sites.items()},
                float(columns["log_prior"][row]),
                chain=int(columns["chain"][row]),
                iteration=int(columns["iteration"][row]),
                log_proposal=float(columns["log_proposal"][row]),
                log_bound=float(columns["log_bound"][row]),
                log_again=float(columns["log_again"][row]),
            )
        )
    return records


# --- A run on file: all that is needed to go on with it, bit for bit ------------------------------
# Nothing in the file can run (:mod:`~phase_ppl.inference.runs.checkpoint`). A prior, a simulator or
# a kernel of a user's own is therefore not in it, but what tells it from others.

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
