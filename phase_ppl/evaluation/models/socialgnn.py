"""SocialGNN, a network that answers from a glance at the motion (paper, Appendix "SocialGNN").

Training on a generated data set, from several seeds, writes a folder::

    DIR/
      extended.npz            all networks, called by their variant, and the report
      extended.json           the report

Each network depends on its own seed only.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from phase_ppl.data.generated import MANIFEST, GeneratedEvents
from phase_ppl.evaluation.metrics import evaluate_predictions
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import register_model
from phase_ppl.models.socialgnn import store
from phase_ppl.models.socialgnn.graphs import example, frame_graphs
from phase_ppl.models.socialgnn.store import Arrays, Trained, TrainingSettings, needs_torch
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.files import locked, writable_folder, write_json
from phase_ppl.world.identity import versions
from phase_ppl.world.progress import Bar, counted
from phase_ppl.world.scene import Scene, check_is_phase

if TYPE_CHECKING:
    from phase_ppl.models.socialgnn.network import Ensemble


@dataclasses.dataclass(frozen=True, eq=False)
class SocialGNNModel:
    """Trained networks, ready to be asked."""

    trained: Trained  # the networks whose probabilities are averaged
    n_threads: int = 1  # of PyTorch

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Prediction:
        """Return what the networks say; nothing in it is random."""
        return Prediction("", probabilities=self._ensemble(scene, observation))

    @functools.cached_property
    def _ensemble(self) -> Ensemble:
        from phase_ppl.models.socialgnn.network import Ensemble

        return Ensemble(self.trained, self.n_threads)

    def warm_up(self) -> None:
        """Import PyTorch and make the networks, so that the first event does not pay for it."""
        _ = self._ensemble

    def settings(self) -> dict[str, Any]:
        """Return what determines the answers."""
        return {
            "variant": self.trained.variant,
            "networks": len(self.trained.members),
            "weights": self.trained.digest(),
            "threads": self.n_threads,
        }


# a prediction takes less than a process does to start
@register_model("socialgnn", parallel=False, needs=("torch",), extra="neural")
def socialgnn(
    *,
    variant: str | None = None,
    weights: str | Path | None = None,
    threads: int = 1,
) -> SocialGNNModel:
    """SocialGNN: a graph neural network that says goals and relation from the motion alone.

    The package's own networks were trained on events that it generated, not on PHASE. They saw the
    splits train and validation of the set named in ``report.json`` in their files; only its split
    test is new to them. ``phase-ppl train socialgnn`` trains others.

    Args:
        variant: "extended", the paper's and the default; "original", the authors', which says the
            relation only; not with ``weights``, which are of one.
        weights: an npz file, or the folder that training wrote, instead of those of the package.
        threads: of PyTorch.
    """
    if weights is None:
        trained = store.shipped(variant or "extended")
    elif variant is None:
        trained = store.load(weights)
    else:
        raise InvalidSettingError(f"give either weights or variant={variant!r}, not both")
    return SocialGNNModel(trained, whole_number("threads", threads))


# --- training ------------------------------------------------------------------------------------

TRAINING, VALIDATION, TEST = "train", "validation", "test"
"""Splits of the set: networks learn from the first, the second is looked at in every epoch; where
there is the third, the report scores it too."""

Shares: TypeAlias = dict[str, FloatArray]  # question -> probabilities of its answers
_MOST_SEEDS: Final = 1000
_DIGITS: Final = 4


def train_socialgnn(
    data: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    seeds: int = 5,
    seed: int = 0,
    settings: TrainingSettings | None = None,
    progress: bool | None = None,
) -> dict[str, Any]:
    """Train networks on a generated data set; return the report, which is written too.

    ``evaluate(events, "socialgnn", weights=out)`` asks them.

    Args:
        data: folder of the data set (:func:`phase_ppl.generate`), with the splits "train" and
            "validation".
        out: folder for the networks and the report (``extended.npz``, ``extended.json``).
        seeds: number of networks.
        seed: seed of the first network; the other networks have the seeds that follow.
        settings: how each network is trained; None: the default ``TrainingSettings``.
        progress: whether to show a bar on stderr; None: if stderr is a terminal.

    Returns:
        For each network, and for all together, the accuracies by split and scenario, with 95 %
        intervals; the curves, losses and accuracies per epoch; seconds of CPU.

    Raises:
        InvalidSettingError: PyTorch is not installed, or a number is not allowed.
        InvalidEventError: ``data`` holds no generated set, or no event of a split.
        OutputError: ``out`` cannot be written, holds networks already, or another process is at
            work in it.
    """
    settings = settings or TrainingSettings()
    n_seeds = whole_number("seeds", seeds, maximum=_MOST_SEEDS)
    wanted = range(whole_number("seed", seed, 0), seed + n_seeds)
    found = GeneratedEvents(data)
    for event in itertools.islice(found, 1):
        check_is_phase(event.scene.world, "SocialGNN")
    needs_torch()
    splits = {name: list(found.split(name)) for name in (TRAINING, VALIDATION)}
    if any(entry["split"] == TEST for entry in found.entries):
        splits[TEST] = list(found.split(TEST))
    asked = {
        "settings": dataclasses.asdict(settings),
        "data": _identity(found, splits),
        "versions": versions(),
    }
    folder = writable_folder(out)
    with locked(folder):
        if (folder / f"{settings.variant}.npz").exists():
            raise OutputError(f"{folder} holds networks already: name another")
        arrays, records = _train(wanted, splits, settings, progress)
        return _finish(folder, arrays, records, splits, settings, asked, progress)


def _identity(found: GeneratedEvents, splits: dict[str, list[Event]]) -> dict[str, Any]:
    """Return which set it is, as plain data."""
    plan = found.manifest.get("plan")
    if not isinstance(plan, Mapping):
        raise InvalidEventError(f"{found.path / MANIFEST}: plan is {shown(plan)}, not an object")
    sums = "".join(entry["checksum"] for entry in found.entries)
    return {
        "events": {name: len(events) for name, events in splits.items()},
        "checksum": hashlib.sha256(sums.encode()).hexdigest()[:16],
        **{name: plan.get(name) for name in ("seed", "cells", "copies", "turning", "planner")},
    }


def _train(
    seeds: Sequence[int],
    splits: dict[str, list[Event]],
    settings: TrainingSettings,
    progress: bool | None,
) -> tuple[list[Arrays], list[dict[str, Any]]]:
    """Return the networks, and how the training of each went."""
    from phase_ppl.models.socialgnn.network import fit

    training, validation = (
        [example(event, settings.variant) for event in splits[name]]
        for name in (TRAINING, VALIDATION)
    )
    arrays: list[Arrays] = []
    records: list[dict[str, Any]] = []
    with Bar(len(seeds) * settings.epochs, 0, progress, "epoch", "training") as bar:
        for seed in seeds:
            clock = time.process_time()
            fitted = fit(training, validation, settings, seed, bar.update)
            seconds = time.process_time() - clock
            curves = {
                name: [round(value, _DIGITS) for value in values]
                for name, values in fitted.curves.items()
            }
            arrays.append(fitted.arrays)
            records.append(
                {
                    "seed": seed,
                    "epochs": len(curves["training"]),
                    "cpu_seconds": round(seconds, 1),
                    "curves": curves,
                }
            )
    return arrays, records


def _finish(
    folder: Path,
    arrays: Sequence[Arrays],
    records: Sequence[dict[str, Any]],
    splits: dict[str, list[Event]],
    settings: TrainingSettings,
    asked: dict[str, Any],
    progress: bool | None,
) -> dict[str, Any]:
    """Write the networks, score them as they are read again, and write the report."""
    from phase_ppl.models.socialgnn.network import Ensemble

    variant, threads = settings.variant, settings.threads
    file = folder / f"{variant}.npz"
    store.save(arrays, file)
    members = store.load(file).members
    networks = [Ensemble(Trained(variant, (member,)), threads) for member in members]
    said: list[dict[str, Shares]] = [{} for _ in networks]  # what each says of each event
    events = [event for of_split in splits.values() for event in of_split]
    for event in counted(events, progress, "event", "scoring"):
        graphs = frame_graphs(event.scene, event.observation, variant)
        for answers, network in zip(said, networks, strict=True):
            answers[event.id] = network.of(graphs)
    together = {
        name: {q: np.mean([one[name][q] for one in said], axis=0) for q in shares}
        for name, shares in said[0].items()
    }
    report = {
        "note": "trained on generated events, not on PHASE; accuracies are on generated events too",
        "torch": str(needs_torch().__version__),
        **asked,
        "together": _accuracy(splits, together),
        "members": [
            {**record, "accuracy": _accuracy(splits, answers)}
            for record, answers in zip(records, said, strict=True)
        ],
    }
    write_json(folder / f"{variant}.json", report)
    written = (folder / f"{variant}.json").read_bytes()
    store.save(members, file, written)
    return report


def _accuracy(splits: dict[str, list[Event]], said: Mapping[str, Shares]) -> dict[str, Any]:
    """Return split -> accuracies over all its events and by scenario, with intervals."""
    result: dict[str, Any] = {}
    for split, events in splits.items():
        predictions = {event.id: Prediction(event.id, said[event.id]) for event in events}
        metrics = evaluate_predictions(events, predictions)
        names = ("goal_accuracy", "relation_accuracy")
        by_scenario = {
            scenario: {name: of[name] for name in ("n", *names)}
            for scenario, of in metrics["by_scenario"].items()
        }
        result[split] = {**{name: metrics[name] for name in names}, "by_scenario": by_scenario}
    return result
