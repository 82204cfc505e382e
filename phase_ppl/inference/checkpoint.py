"""Checkpoints: files from which a run continues, bit for bit.

A checkpoint holds a JSON document and arrays of plain numbers, no code. It therefore does not hold
a user's own prior, simulator or kernel, only a record that tells it from others.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import random
from numpy.typing import NDArray

from phase_ppl.data.events_json import event_from_record, event_record
from phase_ppl.inference.draws import PARTICLE_COLUMNS, SITE, Columns, numbers_of
from phase_ppl.inference.settings import frames, seconds, simulations
from phase_ppl.models.bridge import Record
from phase_ppl.models.density import on_cpu
from phase_ppl.simulator.contract import SimulationResult, Statistics
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, existing_file, write_bytes
from phase_ppl.world.identity import event_digest
from phase_ppl.world.space import space_of

SCHEMA: Final = "phase-ppl-checkpoint-5"
SUFFIXES: Final = (".ckpt",)

_DOCUMENT: Final = "run.json"
_LIST: Final = "arrays"
_KINDS: Final = "biuf"


def write_archive(
    path: str | os.PathLike[str], document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write a document and arrays of numbers to ``path``, whole or not at all."""
    memory = io.BytesIO()
    by_row: dict[str, Any] = {name: np.asarray(a, order="C") for name, a in arrays.items()}
    np.savez(memory, allow_pickle=False, **by_row)
    with zipfile.ZipFile(memory, "a") as archive:
        # with the list of names a file that lost arrays is recognised
        archive.writestr(_DOCUMENT, json.dumps({**document, _LIST: list(arrays)}))
    write_bytes(path, SUFFIXES, memory.getvalue())


def read_archive(path: str | os.PathLike[str]) -> tuple[dict[str, Any], Columns]:
    """Return the document and the arrays that :func:`write_archive` wrote."""
    source = existing_file(path)
    try:
        # from memory: NumPy leaves a damaged file open
        with np.load(io.BytesIO(source.read_bytes()), allow_pickle=False) as kept:
            # compressed arrays could be far larger than the file
            if any(one.file_size != one.compress_size for one in kept.zip.infolist()):
                raise ValueError("it is compressed")
            arrays = {name: kept[name] for name in kept.files}
        document = json.loads(arrays.pop(_DOCUMENT))
        if not isinstance(document, dict):
            raise ValueError(f"{_DOCUMENT} is no object")
        if document.pop(_LIST) != list(arrays):
            raise ValueError("it has not the arrays that were written")
        for name, values in arrays.items():
            if values.dtype.kind not in _KINDS:
                raise ValueError(f"{name} is an array of {values.dtype}, expected numbers")
    except Exception as error:  # a damaged file can make the readers raise anything
        raise damaged(source, error) from None
    return document, arrays


def damaged(path: str | os.PathLike[str], error: Exception) -> InvalidEventError:
    """Return the error for a file that is no checkpoint or an incomplete one."""
    reason = " ".join(str(error).split())[:200]
    if isinstance(error, KeyError):
        reason = f"it lacks {reason}"
    return InvalidEventError(
        f"{path} is no checkpoint, or a damaged one: {reason or type(error).__name__}"
    )


# --- what a run has done, as arrays of numbers ----------------------------------------------------


def _below(arrays: Columns, prefix: str) -> Columns:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _unpacked_particles(arrays: Columns, n: int) -> list[Columns]:
    columns = _below(arrays, "particles/")
    if missing := {*PARTICLE_COLUMNS} - columns.keys():
        raise KeyError(f"particles/{min(missing)}")
    for name, values in columns.items():
        if len(values) != n:
            raise ValueError(f"particles/{name} has {len(values)} entries, expected {n}")
    return [{name: values[i] for name, values in columns.items()} for i in range(n)]


def _packed_records(records: Sequence[Record]) -> Columns:
    """Return arrays (record, ...); errors and trajectories are those of all frames, end to end."""
    results = [record.result for record in records]
    columns = numbers_of(records)
    columns["error"] = np.concatenate([r.errors[: r.frames_simulated] for r in results])
    shown_frames = [r.trajectory[: r.frames_simulated] for r in results]
    columns["trajectory"] = np.concatenate(shown_frames).astype(np.float32)
    for site in records[0].sites:
        columns[f"{SITE}{site}"] = np.stack([record.sites[site] for record in records])
    return columns


def _unpacked_records(columns: Columns, failed: Mapping[str, str], event: Event) -> list[Record]:
    """Return the records from which :func:`_packed_records` made ``columns``.

    ``failed`` is number of the record -> what went wrong.
    """
    space, (n_frames, *shape) = space_of(event.scene.world), event.observation.trajectory.shape
    errors, trajectory = columns.pop("error"), columns.pop("trajectory")
    sites = _below(columns, SITE)
    simulated = columns["frames_simulated"]
    ends = np.cumsum(simulated)
    lengths = {len(values) for values in columns.values()}
    if len(lengths) != 1 or not ends.size or ends[-1] != len(errors) or ends[-1] != len(trajectory):
        raise ValueError("the records differ in length")
    if simulated.min() < 0 or simulated.max() > n_frames:
        raise ValueError(f"a record has more than {n_frames} frames")
    records = []
    densities = ("log_prior", "log_proposal", "log_bound", "log_again")
    for row, (end, n) in enumerate(zip(ends, simulated, strict=True)):
        here = {name: values[row] for name, values in sites.items()}
        frames_shown = np.full((n_frames, *shape), np.nan)
        frames_shown[:n] = trajectory[end - n : end]
        by_frame = np.full(n_frames, np.inf)
        by_frame[:n] = errors[end - n : end]
        result = SimulationResult(
            space.hypothesis(here),
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
                here,
                chain=int(columns["chain"][row]),
                iteration=int(columns["iteration"][row]),
                n_again=int(columns["n_again"][row]),
                **{name: float(columns[name][row]) for name in densities},
            )
        )
    return records


# --- the file of a run ----------------------------------------------------------------------------

_ASKED: Final = ("iterations", "budget", "weights", "on_failure", "simulation_seconds")
_BUDGETS: Final = {"simulations": simulations, "frames": frames, "seconds": seconds}


class Checkpoint:
    """An opened checkpoint.

    Args:
        path: of the file.

    Attributes:
        path: of the file.
        identity: what determines the run (:meth:`phase_ppl.inference.run.Run.identity`).
        event: the event that the run explains.
        asked: arguments of ``infer`` by name: ``iterations`` and ``budget`` (one is None),
            ``weights`` (None: the default), ``on_failure`` and ``simulation_seconds``.
        again: ``model``, ``kernel``, ``options`` and ``settings`` to make the run again; each is
            None where it is not plain data, such as a user's own parts.
        particles: the initial particles, and those after every iteration.
        records: all simulations.
        statistics: of the simulations.
        seconds: wall time of the run, over all calls.
        recent: seconds that the last iterations took.
        calls: number of calls of ``infer`` and ``resume``.
        versions: versions of this package and its dependencies that made the run, oldest first.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = as_path(path)
        document, arrays = read_archive(path)
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"its schema is {shown(document['schema'])}, not {SCHEMA!r}")
            self._read(document, arrays)
        except Exception as error:  # it may hold anything
            raise damaged(path, error) from None

    def _read(self, document: Mapping[str, Any], arrays: Columns) -> None:
        self.identity = dict(document["identity"])
        event = event_from_record(document["event"])
        self.event = dataclasses.replace(event, id=str(document["event_id"]))
        if event_digest(self.event) != self.identity["event"]:
            raise ValueError("its event is not that of the run")
        self.asked = {name: document["target"][name] for name in _ASKED}
        if self.asked["budget"] is not None:
            amount, unit = self.asked["budget"]
            self.asked["budget"] = _BUDGETS[unit](amount)
        self.again = {
            name: document["again"][name] for name in ("model", "kernel", "options", "settings")
        }
        self.particles = _unpacked_particles(arrays, int(document["iterations"]) + 1)
        self.records = _unpacked_records(_below(arrays, "records/"), document["failed"], self.event)
        self.versions = [dict(one) for one in document["versions"]]
        spent = document["spent"]
        self.statistics = Statistics(**spent["statistics"])
        self.seconds, self.calls = float(spent["seconds"]), int(spent["calls"])
        self.recent = [float(one) for one in spent["recent"]]
        with on_cpu():
            self._leaves = [
                (str(name), _leaf(arrays[f"state/{i}"], kind))
                for i, (name, kind) in enumerate(document["state"])
            ]

    @property
    def done(self) -> int:
        """Number of finished iterations."""
        return len(self.particles) - 1

    def made(self, make: Callable[..., Any], given: Mapping[str, Any]) -> Any:
        """Return ``make`` of a part of the file; InvalidEventError: the part is damaged."""
        try:
            return make(**given)
        except Exception as error:  # it may hold anything
            raise damaged(self.path, error) from None

    def state(self, blank: Any) -> Any:
        """Return the kernel's state, with the shapes and types of ``blank``."""
        expected, treedef = jax.tree_util.tree_flatten_with_path(blank)
        if [(name, leaf.shape, leaf.dtype) for name, leaf in self._leaves] != [
            (jax.tree_util.keystr(path), leaf.shape, leaf.dtype) for path, leaf in expected
        ]:
            raise InvalidSettingError(
                f"{self.path} does not fit the kernel, as its state has other fields, shapes or "
                "types: continue with the kernel that wrote it, or give another file"
            )
        return jax.tree_util.tree_unflatten(treedef, [leaf for _, leaf in self._leaves])


def _leaf(values: NDArray[Any], kind: str | None) -> jax.Array:
    """Return a leaf of a state from its numbers; with a ``kind`` it is a random key."""
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise ValueError("a value of the kernel's state is NaN")
    leaf = jnp.asarray(values)
    return leaf if kind is None else random.wrap_key_data(leaf, impl=kind)


def write_checkpoint(
    path: str | os.PathLike[str],
    about: Mapping[str, Any],
    event: Event,
    state: Any,
    particles: Sequence[Columns],
    records: Sequence[Record],
) -> None:
    """Write a run to a file, whole or not at all; ``about`` as :class:`Checkpoint` reads it."""
    leaves: list[tuple[str, str | None]] = []
    arrays: Columns = {}
    for i, (place, leaf) in enumerate(jax.tree_util.tree_flatten_with_path(state)[0]):
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        arrays[f"state/{i}"] = np.asarray(random.key_data(leaf) if is_key else leaf)
        leaves.append((jax.tree_util.keystr(place), str(random.key_impl(leaf)) if is_key else None))
    document = {
        "schema": SCHEMA,
        **about,
        "event": event_record(Event(event.scene, event.observation)),
        "event_id": event.id,
        "iterations": len(particles) - 1,
        "state": leaves,
        "failed": {
            str(row): record.result.failure
            for row, record in enumerate(records)
            if record.result.failure is not None
        },
    }
    for name in particles[0]:
        arrays[f"particles/{name}"] = np.stack([step[name] for step in particles])
    arrays |= {f"records/{name}": values for name, values in _packed_records(records).items()}
    write_archive(path, document, arrays)
