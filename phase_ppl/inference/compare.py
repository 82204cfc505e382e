"""Comparison of kernels: same event, same budget, several seeds, and a reference."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import pandas as pd

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
from phase_ppl.inference.infer import CHAINS, infer
from phase_ppl.inference.reference import Asked, Reference, reference_of
from phase_ppl.inference.registry import KernelInfo, info_of
from phase_ppl.inference.run import Kernel, Run
from phase_ppl.inference.settings import (
    BUDGETS,
    PRESETS,
    Budget,
    SimpleSettings,
    check_event,
    check_settings,
    completed,
    simulations,
)
from phase_ppl.models.density import on_cpu
from phase_ppl.models.likelihood import is_closed_loop
from phase_ppl.models.model import Model
from phase_ppl.simulator.processes import slots_of
from phase_ppl.world.errors import (
    InvalidSettingError,
    PhasePPLError,
    instance_of,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked
from phase_ppl.world.identity import event_digest, stable, versions, versions_so_far
from phase_ppl.world.picture import plain
from phase_ppl.world.progress import Bar
from phase_ppl.world.scene import World

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

BUDGET: Final = simulations(500)
REPEATS: Final = 8

_MOST_REPEATS: Final = 10**6
_MAY_DIFFER: Final = ("kernels", "proposals", "repeats", "reference", "event", "versions")


Spec: TypeAlias = Kernel | tuple[Kernel, Mapping[str, Any]]  # A kernel, or a kernel and its options

_TAKEN: Final = (
    *("event", "model", "kernel", "seed", "workers", "executor", "progress", "planner"),
    *("budget", "iterations", "checkpoint", "weights"),
)
"""Arguments of ``infer`` that the comparison itself gives."""


@dataclasses.dataclass(frozen=True, eq=False)
class Entry:
    """A kernel that is compared."""

    label: str  # what it is called in tables and figures
    kernel: Kernel  # as ``infer`` takes it
    options: Mapping[str, Any]  # of the kernel
    chains: int  # particles M
    settings: SimpleSettings  # of SIMPLE
    own: Mapping[str, Any]  # ``iterations`` and ``planner`` of a preset
    info: KernelInfo  # what is known of the kernel

    def proposals(self, world: World) -> str | None:
        """Return how the kernel proposes goals; None: it asks for no proposals."""
        settings = self.settings.settled(world)
        return str(settings.proposal) if "guide" in self.info.needs else None

    def record(self) -> dict[str, Any]:
        """Return name and options as they are stored."""
        return {
            "name": self.info.name,
            "options": dict(self.options),
            "chains": self.chains,
            "settings": dataclasses.asdict(self.settings),
            **{name: str(value) for name, value in self.own.items()},
        }

    def check(self, event: Event, model: Model, budget: Any) -> None:
        """Make the kernel and trace one step; nothing is simulated."""
        try:
            if "planner" in self.own:
                model = dataclasses.replace(model, planner=self.own["planner"])
            run = Run(event, model, self.kernel, self.options, self.settings, self.chains, seed=0)
            iterations = self.own.get("iterations")
            run.check(iterations, budget if iterations is None else None)
        except PhasePPLError as error:
            raise type(error)(f"{self.label}: {error}") from None
        except Exception as error:  # a user's kernel can raise anything
            reason = " ".join(str(error).split())
            raise InvalidSettingError(
                f"{self.label}: the kernel cannot run with {self.chains} chains and these "
                f"settings: {type(error).__name__}: {reason}"
            ) from error

    def run(
        self,
        event: Event | ClosedLoopPosterior,
        model: Model | None,
        budget: Any,
        seed: int,
        workers: int | None,
        executor: Executor | None,
    ) -> Posterior:
        """Return the posterior of one run on an event or on a result of the closed loop."""
        simulates, iterations = isinstance(event, Event), self.own.get("iterations")
        post = infer(
            event,
            model,
            kernel=self.kernel,
            chains=self.chains,
            seed=seed,
            workers=workers,
            executor=executor,
            progress=False,
            settings=self.settings,
            iterations=iterations,
            budget=budget if iterations is None else None,
            planner=self.own.get("planner") if simulates else None,
            **self.options,
        )
        return Posterior(post.tree, "count")  # the only weights that judge a kernel


def entries(
    kernels: Iterable[Spec] | Mapping[str, Spec], chains: int, settings: SimpleSettings
) -> list[Entry]:
    """Return the kernels of a comparison."""
    if isinstance(kernels, str):
        kernels = [kernels]
    instance_of("kernels", kernels, Iterable, "names, or a mapping from labels to kernels")
    named: Iterable[tuple[str | None, Spec]] = (
        list(kernels.items()) if isinstance(kernels, Mapping) else [(None, k) for k in kernels]
    )
    found = [_entry_of(label, spec, chains, settings) for label, spec in named]
    if not found:
        raise InvalidSettingError("kernels is empty: name at least one")
    label, most = Counter(one.label for one in found).most_common(1)[0]
    if most > 1:
        raise InvalidSettingError(
            f"two kernels are called {label!r}: give a mapping from labels to kernels"
        )
    return found


def _entry_of(label: str | None, spec: Spec, chains: int, settings: SimpleSettings) -> Entry:
    """Return the entry of a kernel that a user names; its label is ``label`` or its name."""
    kernel, given = spec if isinstance(spec, tuple) and len(spec) == 2 else (spec, {})
    if isinstance(kernel, tuple) or not isinstance(given, Mapping):
        raise InvalidSettingError(
            f"{shown(spec)} is no kernel: expected a name, a kernel class, or (name, options)"
        )
    options, own = dict(given), dict[str, Any]()
    if isinstance(kernel, str) and kernel in PRESETS:
        label = label or kernel
        options = completed(kernel, options)
        kernel = str(options.pop("kernel"))
        options.pop("weights", None)
        own = {name: options.pop(name) for name in ("iterations", "planner") if name in options}
    info = info_of(kernel)
    for name in options:
        if name in _TAKEN:
            raise InvalidSettingError(
                f"kernel {info.name!r}: {name} is the same for all kernels; give it to compare()"
            )
    own_settings = options.pop("settings", settings)
    check_settings(own_settings)
    own_chains = options.pop("chains", chains)
    return Entry(label or info.name, kernel, options, own_chains, own_settings, own, info)


class ComparisonInterrupted(KeyboardInterrupt):
    """Ctrl-C in :func:`phase_ppl.compare`: a ``KeyboardInterrupt``.

    Attributes:
        comparison: comparison of the finished runs; None if no run was finished.
    """

    def __init__(self, comparison: Comparison | None) -> None:
        kept = "no run was finished yet" if comparison is None else "see .comparison"
        super().__init__(f"the comparison was interrupted; {kept}")
        self.comparison = comparison


@on_cpu()
def compare(
    event: Event | ClosedLoopPosterior,
    model: Model | None = None,
    *,
    kernels: Iterable[Spec] | Mapping[str, Spec] = ("local_mh", "prior_mh"),
    budget: Budget = BUDGET,
    repeats: int = REPEATS,
    chains: int = CHAINS,
    seed: int = 0,
    reference: Asked = None,
    settings: SimpleSettings | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Return a comparison of kernels on one event under the same budget.

    Repeat r of every kernel has the same seed, whatever the number of repeats. So two comparisons
    of equal settings share their first repeats. If one kernel cannot run, the call fails before the
    first simulation.

    Args:
        event: the event to explain; its truth, if known, is used to score the kernels. Or a result
            of the closed loop, as in ``compare(infer(event), kernels=[...])``: kernels then sample
            its table of likelihoods. That table's posterior is known exactly, and ten thousand
            draws take seconds. A model with a ``ClosedLoopLikelihood`` has the same effect: the
            video is read once, for all kernels and repeats.
        model: prior, simulator and likelihood; by default the paper's.
        kernels: kernels to compare, a list or label -> kernel. Each is a name, a kernel class, a
            function that makes a kernel, or a preset of SIMPLE such as "as_printed"; or a pair of
            one of these and its options, as in ``{"as printed": ("local_mh", {"rule": "paper"})}``.
            Options are the kernel's own, ``chains`` and ``settings``. A preset keeps its planner.
            How goals are proposed from the video follows from ``settings``, or from the settings
            among a kernel's options; the column ``proposals`` of the printed table names it.
        budget: limit for each run: ``phase_ppl.simulations(n)`` or ``phase_ppl.frames(n)``, the
            initial particles included; or ``phase_ppl.seconds(t)``, compiling included. The last
            iteration may exceed it. Default: 500 simulations.
        repeats: number of runs of every kernel. Default: 8.
        chains: number of particles, M in the paper. Default: 15.
        seed: a whole number >= 0, from which the seeds of all runs follow.
        reference: what kernels are compared with: a posterior of the same event and model;
            "enumeration" (:mod:`phase_ppl.inference.reference`), with 4 simulations per pair of
            goals, or as many as ``("enumeration", {"per_pair": 16})`` says; or "none". The default
            for a result of the closed loop is its exact posterior. Otherwise it is enumeration if
            ten times the budget suffices for that, else none. The printed comparison has the
            distance between two halves of the reference. Kernels that differ by less are not
            ranked.
        settings: settings of SIMPLE; by default those of the preset "simple". If proposals need a
            reading of the video by the closed loop, the time of a reading counts in each run, even
            if the video was read before.
        workers: number of processes; by default one per usable core. With an ``executor``: how many
            simulations to give it at a time; by default all.
        executor: any PEP 3148 executor to simulate in, as for :func:`phase_ppl.infer`.
        progress: whether to show a bar on stderr; None: if stderr is a terminal.
        checkpoint: a .json file that is rewritten after every run. If it exists, its runs are not
            repeated; kernels and repeats may be added. ``phase_ppl.Comparison.load`` reads it.

    Raises:
        InvalidSettingError, UnknownNameError: a setting or kernel cannot be used, or the checkpoint
            has other settings.
        InvalidEventError: ``event`` is no event, or the checkpoint is damaged.
        SimulationError: all initial simulations of a run failed, or the executor takes no more
            work.
        ComparisonInterrupted: Ctrl-C; its attribute ``comparison`` has the finished runs.
    """
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

    read = event if isinstance(event, ClosedLoopPosterior) else None
    if read is not None:
        from phase_ppl.inference.table_run import event_of, model_of

        event, model = event_of(read), model_of(read, model)
    event = check_event(event)
    model = (Model() if model is None else model).for_sampling()
    repeats = whole_number("repeats", repeats, maximum=_MOST_REPEATS)
    seed = whole_number("seed", seed, minimum=0)
    slots_of(workers, executor)
    instance_of("budget", budget, Budget, BUDGETS)
    settings = SimpleSettings() if settings is None else settings
    chosen = entries(kernels, chains, settings)
    wanted = Reference.asked_for(reference, event, budget)
    for entry in chosen:
        entry.check(event, model, budget)
    runs = [(repeat, entry) for repeat in range(repeats) for entry in chosen]
    with locked(checkpoint):
        record = _Record(
            {
                "versions": versions(),
                "event": event.id,
                "observed": event_digest(event),
                "model": model.fingerprint(),
                "kernels": {entry.label: entry.record() for entry in chosen},
                "proposals": {entry.label: entry.proposals(event.scene.world) for entry in chosen},
                "budget": str(budget),
                "chains": chains,
                "repeats": repeats,
                "seed": seed,
                "reference": {"asked": wanted.record()},
                **({} if read is None else {"read": read.settings}),
            },
            checkpoint,
        )
        done = {(run["repeat"], run["kernel"]) for run in record.runs}
        waiting = [(repeat, entry) for repeat, entry in runs if (repeat, entry.label) not in done]
        if waiting and checkpoint is not None:
            versions_so_far([record.settings["versions"]], checkpoint)
        try:
            with Bar(len(waiting) + 1, 0, progress, "run", "reference") as bar:
                to_do = bool(waiting) or record.reference is None
                if read is None and to_do and is_closed_loop(model.likelihood):
                    read = infer(event, model, seed=seed, workers=workers, progress=progress)
                if record.reference is None:
                    found = reference_of(wanted, event, model, read, seed, workers, executor)
                    if found["marginals"] is not None:
                        found["truth"] = of_truth(found["marginals"], event.truth)
                    record.keep_reference(found)
                bar.update()
                known = record.reference["marginals"]
                marginals = known and {name: np.array(p) for name, p in known.items()}
                for repeat, entry in waiting:
                    bar.set_description(f"{entry.label}, repeat {repeat + 1}")
                    run_seed = int(np.random.SeedSequence([seed, repeat]).generate_state(1)[0])
                    source = event if read is None else read
                    post = entry.run(source, model, budget, run_seed, workers, executor)
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
            finished = record.comparison() if record.runs else None
            raise ComparisonInterrupted(finished) from stopped
        return record.comparison()


class _Record:
    """The finished runs, and the file that keeps them, if there is one."""

    def __init__(self, settings: Mapping[str, Any], path: str | os.PathLike[str] | None) -> None:
        self.settings: dict[str, Any] = _stable(settings)
        self.runs: list[dict[str, Any]] = []
        self.curves: list[pd.DataFrame] = []
        self._path = None if path is None else Path(path)
        if self._path is not None and self._path.exists():
            self._take_up(Comparison.load(self._path))
        elif self._path is not None:
            self.comparison().save(self._path)  # fails now if it cannot be written

    @property
    def reference(self) -> Any:
        """The reference with its marginals; None where it is still to be made."""
        entry = self.settings["reference"]
        return entry if "marginals" in entry else None

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
        """Continue from a checkpoint."""
        old, new = dict(stored.settings), self.settings
        pairs = [(name, old.get(name), new[name]) for name in new
                 if name not in _MAY_DIFFER]  # fmt: skip
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
        for name in ("kernels", "proposals"):
            new[name] = {**old[name], **new[name]}
        new["repeats"] = max(old["repeats"], new["repeats"])
        new["reference"] = old["reference"]
        self.runs = stored.runs.to_dict("records")
        self.curves = [stored.curve] if len(stored.curve) else []


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
    """Return ``value`` as a file keeps it; kernels stay in order."""
    return stable(plain(value), sort_keys=False)
