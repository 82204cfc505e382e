"""Comparison of kernels: same event, same budget, several seeds, and a reference."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.inference.entries import Spec, entries
from phase_ppl.inference.infer import CHAINS, infer
from phase_ppl.inference.reference import Reference, reference_of
from phase_ppl.inference.run import check_event
from phase_ppl.inference.settings import BUDGETS, Budget, SimpleSettings, simulations
from phase_ppl.models.density import on_cpu
from phase_ppl.models.likelihood import is_stepwise
from phase_ppl.models.model import Model
from phase_ppl.models.program import event_salt
from phase_ppl.simulator.processes import slots_of
from phase_ppl.world.errors import (
    InvalidSettingError,
    instance_of,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked
from phase_ppl.world.identity import stable, versions, versions_so_far
from phase_ppl.world.picture import plain
from phase_ppl.world.progress import Bar

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

BUDGET: Final = simulations(500)
REPEATS: Final = 8

_MOST_REPEATS: Final = 10**6
_MAY_DIFFER: Final = ("kernels", "proposals", "repeats", "reference", "event", "versions")


class ComparisonInterrupted(KeyboardInterrupt):
    """The comparison was interrupted; the runs that were finished are kept.

    Attributes:
        comparison: comparison of the finished runs; None where there are none.
    """

    def __init__(self, comparison: Comparison | None) -> None:
        kept = "no run was finished yet" if comparison is None else "see .comparison"
        super().__init__(f"the comparison was interrupted; {kept}")
        self.comparison = comparison


@on_cpu()
def compare(
    event: Event | StepwisePosterior,
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
    progress: bool | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Return a comparison of kernels on one event under the same budget.

    Repeat r of every kernel runs with the same seed, so two comparisons of equal settings share
    their first repeats. If one kernel cannot run, the call fails before the first simulation.

    Args:
        event: event to explain. Its truth, if known, is used to judge the results. Also a result
            of the closed loop, ``compare(infer(event), kernels=[...])``: kernels then sample its
            table. The table's exact posterior is known, and ten thousand draws take seconds. A
            model with a ``StepwiseLikelihood`` does the same: the video is read once, for all
            kernels and repeats.
        model: prior, simulator and likelihood; by default the paper's.
        kernels: names, or label -> name. A name may also be ``(name, options)``, a kernel class,
            a function that makes a kernel, or a preset of SIMPLE such as "as_printed". A preset
            keeps its planner and length. Options are the kernel's own, ``chains`` and
            ``settings``, as in ``{"as printed": ("local_mh", {"rule": "paper"})}``. Kernels with
            bottom-up proposals share the same ones, unless their options differ; the table shows
            which.
        budget: of every single run; ``phase_ppl.simulations(n)`` or ``phase_ppl.frames(n)``,
            the initial ones included, or ``phase_ppl.seconds(t)``, compiling included. A run ends
            with the iteration that spends it; costs that kernels declare do not count.
        repeats: runs of every kernel.
        chains: particles M.
        seed: a whole number >= 0.
        reference: posterior that the results are compared with. A posterior of the same event and
            model; "enumeration" in PHASE (:mod:`phase_ppl.inference.reference`), or with more
            than 4 simulations per pair of goals ``("enumeration", {"per_pair": 16})``; "none"; or
            another kernel, as in ``kernels``. That kernel's options may have a ``budget`` or
            ``iterations``; by default it has ten times the budget. The default is enumeration if
            ten times the budget suffices, else four populations of ``smc`` that share that budget.
            If ``smc`` is compared, there is then none. The distance between the reference's halves
            is printed; kernels are not ranked within it.
        weights: of the draws; "count" is the only valid one for judging kernels.
        settings: of SIMPLE; by default the paper's numbers, with bottom-up proposals of goals.
            If proposals need a reading of the video, its time counts, also if it was read before.
        workers: processes; by default one per usable core. With an ``executor``, how many
            simulations to give it at a time; by default all.
        executor: any PEP 3148 executor to simulate in, as for :func:`phase_ppl.infer`.
        progress: show a bar on stderr; by default if stderr is a terminal.
        checkpoint: a .json file that is rewritten after every run. If it exists, its runs are not
            repeated, and kernels and repeats may be added. The file is itself a comparison.

    Raises:
        InvalidSettingError, UnknownNameError: a setting or kernel that cannot be used, or a
            checkpoint of other settings.
        InvalidEventError: ``event`` is no event, or the checkpoint is damaged.
        SimulationError: all initial simulations of a run failed, or the executor takes no more
            work.
        ComparisonInterrupted: Ctrl-C; it carries the finished runs.
    """
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

    read = event if isinstance(event, StepwisePosterior) else None
    if read is not None:
        from phase_ppl.inference.table_run import event_of, model_of

        event, model = event_of(read), model_of(read, model)
    event = check_event(event)
    model = (Model() if model is None else model).for_sampling()
    repeats = whole_number("repeats", repeats, maximum=_MOST_REPEATS)
    seed = whole_number("seed", seed, minimum=0)
    slots_of(workers, executor)
    if weights not in WEIGHTINGS:
        raise unknown_name("weights", weights, WEIGHTINGS)
    instance_of("budget", budget, Budget, BUDGETS)
    settings = SimpleSettings() if settings is None else settings
    chosen = entries(kernels, chains, settings)
    wanted = Reference.asked_for(reference, event, budget, chains, settings, weights, chosen)
    for entry in chosen if wanted.kernel is None else (*chosen, wanted.kernel):
        entry.check(event, model, budget)
    runs = [(repeat, entry) for repeat in range(repeats) for entry in chosen]
    with locked(checkpoint):
        record = _Record(
            {
                "versions": versions(),
                "event": event.id,
                "observed": event_salt(event.scene, event.observation),
                "model": model.fingerprint(),
                "kernels": {entry.label: entry.record() for entry in chosen},
                "proposals": {entry.label: entry.proposals(event.scene.world) for entry in chosen},
                "budget": str(budget),
                "chains": chains,
                "repeats": repeats,
                "seed": seed,
                "weights": weights,
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
                if read is None and to_do and is_stepwise(model.likelihood):
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
                    post = Posterior(post.tree, entry.own.get("weights", weights))
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
        for name in ("kernels", "proposals"):  # files did not always have the latter
            new[name] = {**old.get(name, {}), **new[name]}
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
