"""Kernels against each other: the same event, the same budget, several seeds."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from phase_ppl.analysis.comparison import (
    CURVE_COLUMNS,
    RUN_COLUMNS,
    Comparison,
    accuracy,
    curve,
    efficiency,
    of_truth,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.summary import plain
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.inference.entries import Entry, Spec, entries
from phase_ppl.inference.infer import CHAINS
from phase_ppl.inference.reference import Reference, reference_of
from phase_ppl.inference.runs.run import check_event
from phase_ppl.inference.settings import BUDGETS, Budget, SimpleSettings, simulations
from phase_ppl.models.model import Model
from phase_ppl.models.program import event_salt
from phase_ppl.simulator.processes import slots_of
from phase_ppl.world.checks import instance_of, whole_number
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked
from phase_ppl.world.identity import versions, versions_so_far
from phase_ppl.world.progress import is_shown
from phase_ppl.world.shards import SHARD, Shard

BUDGET: Final = simulations(500)
REPEATS: Final = 8

_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")

_MOST_REPEATS: Final = 10**6
_MAY_DIFFER: Final = ("kernels", "repeats", "reference", "event", "versions")


class ComparisonInterrupted(KeyboardInterrupt):
    """The comparison was interrupted; the runs that were finished are kept.

    Attributes:
        comparison: of the finished runs; None where there are none.
    """

    def __init__(self, comparison: Comparison | None) -> None:
        kept = "no run was finished yet" if comparison is None else "see .comparison"
        super().__init__(f"the comparison was interrupted; {kept}")
        self.comparison = comparison


def compare(
    event: Event,
    model: Model | None = None,
    *,
    kernels: Iterable[Spec] | Mapping[str, Spec] = ("local_mh", "prior_mh"),
    budget: Budget = BUDGET,
    repeats: int = REPEATS,
    chains: int = CHAINS,
    seed: int = 0,
    reference: Posterior | Spec | None = None,
    weights: str = "count",
    settings: SimpleSettings | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    shard: str | None = None,
    progress: bool | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Return how kernels do on one event under the same budget.

    Repeat r of every kernel runs with the same seed, so that the first repeats of two
    comparisons of equal settings are equal. Everything is refused before the first simulation
    if one of the kernels cannot run.

    Args:
        event: what to explain. Its truth, where it has one, is used to judge the results.
        model: prior, simulator and likelihood; by default the paper's.
        kernels: names, or label -> name; instead of a name also ``(name, options)``, a kernel
            class, or a function that makes a kernel; or a preset of SIMPLE such as "as_printed",
            whose planner and weights are the comparison's here. Options are the kernel's own, and
            ``chains`` and ``settings``, as in
            ``{"as printed": ("local_mh", {"rule": "paper"})}``.
        budget: of every single run; ``phase_ppl.simulations(n)`` or ``phase_ppl.frames(n)``,
            the initial ones included, or ``phase_ppl.seconds(t)``, compiling included. A run ends
            with the iteration that spends it, whatever its kernel declares that one may cost.
        repeats: runs of every kernel.
        chains: particles M.
        seed: a whole number >= 0.
        reference: what the results are compared with: a posterior of the same event and model,
            "enumeration" in PHASE (:mod:`phase_ppl.inference.reference`), with more than 4
            simulations of each pair of goals as ``("enumeration", {"per_pair": 16})``, or a
            kernel as in ``kernels``, whose options may have a ``budget`` or ``iterations``;
            without, it has ten times the budget. By default enumeration, if ten times the budget
            suffices for it, else ``local_mh``. A reference has an error of its own, which is
            measured and printed; kernels are not ranked within it.
        weights: of the draws; "count" is the only valid one for judging kernels.
        settings: of SIMPLE; by default the paper's numbers, with learned proposals.
        workers: processes; by default one per usable core. With an ``executor``, how many
            simulations to give it at a time; by default all.
        executor: any PEP 3148 executor to simulate in, as for :func:`phase_ppl.infer`.
        shard: "2/8" does only the second of eight shares of the runs, of which
            :func:`phase_ppl.merge` makes the whole; each makes the reference for itself.
        progress: whether to show a bar on stderr; by default where that is a terminal.
        checkpoint: a .json file that is rewritten after every run. If it exists, the runs in it
            are not repeated; more kernels and more repeats may be asked for. It is a comparison
            in itself.

    Raises:
        InvalidSettingError, UnknownNameError: a setting or kernel that cannot be used, or a
            checkpoint of other settings.
        InvalidEventError: ``event`` is no event, or the checkpoint is damaged.
        SimulationError: all initial simulations of a run failed, or the executor takes no more
            work.
        ComparisonInterrupted: Ctrl-C; it carries what was finished.
    """
    check_event(event)
    model = Model() if model is None else model
    settings = SimpleSettings.of(event.scene.world) if settings is None else settings
    repeats = whole_number("repeats", repeats, maximum=_MOST_REPEATS)
    seed = whole_number("seed", seed, minimum=0)
    slots_of(workers, executor)
    if weights not in WEIGHTINGS:
        raise unknown_name("weights", weights, WEIGHTINGS)
    instance_of("budget", budget, Budget, BUDGETS)
    chosen = entries(kernels, chains, settings)
    wanted = Reference.asked_for(reference, event, budget, chains, settings, weights)
    for entry in chosen if wanted.kernel is None else (*chosen, wanted.kernel):
        entry.check(event, model, budget)
    share = None if shard is None else Shard.named(shard)
    runs = [(repeat, entry) for repeat in range(repeats) for entry in chosen]
    runs = runs if share is None else share.of_all(runs)
    with locked(checkpoint):
        record = _Record(
            {
                "versions": versions(),
                "event": event.id,
                "observed": event_salt(event.scene, event.observation),
                "model": model.fingerprint(),
                "kernels": {entry.label: entry.record() for entry in chosen},
                "budget": str(budget),
                "chains": chains,
                "repeats": repeats,
                "seed": seed,
                "weights": weights,
                "reference": {"asked": wanted.record()},
                **({} if share is None else {SHARD: str(share)}),
            },
            checkpoint,
        )
        waiting = [(r, c) for r, c in runs if not record.has(c, r)]
        if waiting and checkpoint is not None:
            versions_so_far([record.settings["versions"]], checkpoint)
        shown_bar = is_shown(progress)
        try:
            with tqdm(total=len(waiting) + 1, disable=not shown_bar, unit="run") as bar:
                bar.set_description("reference")
                if record.reference is None:
                    found = reference_of(wanted, event, model, seed, workers, executor)
                    found["truth"] = of_truth(found["marginals"], event.truth)
                    record.keep_reference(found)
                bar.update()
                marginals = {name: np.array(p) for name, p in record.reference["marginals"].items()}
                for repeat, entry in waiting:
                    bar.set_description(f"{entry.label}, repeat {repeat + 1}")
                    run_seed = int(np.random.SeedSequence([seed, repeat]).generate_state(1)[0])
                    post = entry.run(event, model, budget, run_seed, workers, executor)
                    post = Posterior(post.tree, weights)
                    columns = {
                        "kernel": entry.label,
                        "repeat": repeat,
                        "seed": run_seed,
                        "validity": str(post.tree.attrs["validity"]),
                        **accuracy(post, marginals, event.truth),
                        **efficiency(post),
                    }
                    rows = curve(post, marginals, event.truth)
                    record.keep(columns, rows.assign(kernel=entry.label, repeat=repeat))
                    bar.update()
        except KeyboardInterrupt as stopped:
            done = record.comparison() if record.runs else None
            raise ComparisonInterrupted(done) from stopped
        return record.comparison()


class _Record:
    """What is finished, and the file that keeps it, if there is one."""

    def __init__(self, settings: Mapping[str, Any], path: str | os.PathLike[str] | None) -> None:
        self.settings: dict[str, Any] = _stable(settings)
        self.runs: list[dict[str, Any]] = []
        self.curves: list[pd.DataFrame] = []
        self._path = None if path is None else Path(path)
        if self._path is not None and self._path.exists():
            self._take_up(Comparison.load(self._path))
        elif self._path is not None:
            self.comparison().save(self._path)  # where it cannot be written is said now

    @property
    def reference(self) -> Any:
        """The reference with its marginals; None where it is still to be made."""
        entry = self.settings["reference"]
        return entry if "marginals" in entry else None

    def has(self, entry: Entry, repeat: int) -> bool:
        return any(r["kernel"] == entry.label and r["repeat"] == repeat for r in self.runs)

    def keep_reference(self, found: Mapping[str, Any]) -> None:
        self.settings["reference"] |= _stable(found)
        self._save()

    def keep(self, run: dict[str, Any], rows: pd.DataFrame) -> None:
        self.runs.append(run)
        self.curves.append(rows[list(CURVE_COLUMNS)])
        self._save()

    def comparison(self) -> Comparison:
        runs = pd.DataFrame(self.runs, columns=list(RUN_COLUMNS))
        empty = pd.DataFrame(columns=list(CURVE_COLUMNS))
        curves = pd.concat(self.curves, ignore_index=True) if self.curves else empty
        return _in_order(runs, curves, self.settings)

    def _save(self) -> None:
        if self._path is not None:
            self.comparison().save(self._path)

    def _take_up(self, stored: Comparison) -> None:
        """Go on from a checkpoint."""
        old, new = dict(stored.settings), self.settings
        pairs = [(name, old.get(name), new[name]) for name in new
                 if name not in _MAY_DIFFER]  # fmt: skip
        pairs.append((SHARD, old.get(SHARD), new.get(SHARD)))
        if SHARD in new:  # of which kernels and repeats a share is decides what is in it
            pairs += [(name, old[name], new[name]) for name in ("kernels", "repeats")]
        pairs.append(("reference", old["reference"].get("asked"), new["reference"]["asked"]))
        shared = old["kernels"].keys() & new["kernels"].keys()
        pairs += [(f"kernel {k!r}", old["kernels"][k], new["kernels"][k]) for k in sorted(shared)]
        for name, was, given in pairs:
            if was != given:
                raise InvalidSettingError(
                    f"checkpoint {self._path} was made with another {name}: {shown(was)}, not "
                    f"{shown(given)}; name another file, or delete this one"
                )
        new["versions"] = old.get("versions", {})
        new["kernels"] = {**old["kernels"], **new["kernels"]}
        new["repeats"] = max(old["repeats"], new["repeats"])
        new["reference"] = old["reference"]
        self.runs = stored.runs.to_dict("records")
        self.curves = [stored.curve] if len(stored.curve) else []


def runs_left(shard: Comparison) -> int:
    """Return how many runs of a shard's comparison are not finished."""
    settings = shard.settings
    runs = [None] * (settings["repeats"] * len(settings["kernels"]))
    return len(Shard.named(settings[SHARD]).of_all(runs)) - len(shard.runs)


def together(shards: Sequence[Comparison]) -> Comparison:
    """Return the comparison whose shards are given, all of them."""
    settings = {name: value for name, value in shards[0].settings.items() if name != SHARD}
    frames = ([one.runs for one in shards], [one.curve for one in shards])
    runs, curves = (pd.concat(each, ignore_index=True) for each in frames)
    return _in_order(runs, curves, settings)


def _in_order(runs: pd.DataFrame, curves: pd.DataFrame, settings: Mapping[str, Any]) -> Comparison:
    """Return a comparison of runs in any order."""
    order = {label: place for place, label in enumerate(settings["kernels"])}
    runs, curves = (
        frame.sort_values(
            ["kernel", "repeat"],
            key=lambda c: c.map(order) if c.name == "kernel" else c,
            kind="stable",
            ignore_index=True,
        )
        for frame in (runs, curves)
    )
    return Comparison(runs, curves, settings)


def _stable(value: Any) -> Any:
    """Return ``value`` in JSON's types, without what differs from process to process."""
    return json.loads(_ADDRESS.sub("", json.dumps(plain(value), default=repr)))
