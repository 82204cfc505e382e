"""One call that makes a data set."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.dataset.generation.making import Made, make
from phase_ppl.dataset.generation.plan import PHASE500, Plan, Slot, scaled
from phase_ppl.dataset.generation.store import GeneratedEvents
from phase_ppl.dataset.generation.workshop import Workshop
from phase_ppl.simulator.jobs import Failure, results
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.checks import number_of_workers
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.files import locked, writable_folder

PRESETS: Final[Mapping[str, Mapping[str, int]]] = {"phase500": PHASE500}
"""Name -> cells: the paper's set."""


class GenerationInterrupted(KeyboardInterrupt):
    """The generation was interrupted; what was finished is kept and can be resumed."""


def generate(
    out: str | os.PathLike[str],
    n: int | None = None,
    *,
    cells: Mapping[str, int] = PHASE500,
    splits: Mapping[str, float] | None = None,
    copies: int = 0,
    replans: int = 0,
    planner: str | PlannerConfig = "fast",
    seed: int = 0,
    turning: Any = "both",
    frames: int | None = None,
    max_tries: int | None = None,
    reflect: bool = True,
    recolour: bool = True,
    keep_rejected: bool = False,
    resume: bool = False,
    other_versions: bool = False,
    workers: int | None = None,
    progress: bool | None = None,
) -> GeneratedEvents:
    """Make a data set like PHASE: draw situations, simulate them, keep those that show something.

    Each event follows from ``seed`` and its number in the plan: the set is the same for any number
    of workers, and after any interruption.

    Args:
        out: folder of the data set (:mod:`phase_ppl.dataset.generation.store`).
        n: number of events in the proportions of ``cells``; None: the numbers of ``cells``.
        cells: FAMILY or FAMILY:VARIANT -> number; by default the paper's 500
            (``available_families`` lists the families).
        splits: name -> share; by default the paper's 320 / 80 / 100.
        copies: further copies of each event with other reflections and colours, in its split.
        replans: further copies of each event at most, in its split: the same situation simulated
            in a layout of the same kind, or with all sizes and strengths one id further, where its
            family allows that and the result shows what it should.
        planner: "fast", "paper" or a ``PlannerConfig``.
        seed: of everything random.
        turning: which way agents can turn before any reflection: "both", "ccw" or "cw".
        frames: length before the cut after the last motion; default 101, as in PHASE.
        max_tries: draws after which an event is given up; default 200.
        reflect, recolour: whether events are reflected, and colours exchanged, at random.
        keep_rejected: whether rejected draws are kept, with the reason.
        resume: go on with what ``out`` holds.
        other_versions: also where that was made by other versions of this package, or of what it
            builds on; the manifest keeps both.
        workers: processes; by default one per usable core.
        progress: True or False for a bar on stderr; None: where stderr is a terminal.

    Returns:
        The events, a sequence; ``.manifest`` and ``.entries`` say how each was made.

    Raises:
        UnknownNameError, InvalidSettingError: a setting that is not allowed.
        OutputError: the folder cannot be used.
        SimulationError: an event could not be made; the others are kept.
        GenerationInterrupted: Ctrl-C; what was finished is kept.
    """
    given = {"splits": splits, "frames": frames, "max_tries": max_tries}
    plan = Plan(
        cells=cells if n is None else scaled(cells, n),
        copies=copies,
        replans=replans,
        planner=planner,
        seed=seed,
        turning=turning,
        reflect=reflect,
        recolour=recolour,
        **{name: value for name, value in given.items() if value is not None},  # type: ignore[arg-type]
    )
    n_workers = number_of_workers(workers)
    with locked(writable_folder(out)):
        workshop = Workshop(
            out, plan, keep_rejected=keep_rejected, resume=resume, other_versions=other_versions
        )
        return _carry_out(plan, workshop, n_workers, progress)


def _carry_out(
    plan: Plan, workshop: Workshop, n_workers: int, progress: bool | None
) -> GeneratedEvents:
    """Make what is missing, and put everything together."""
    missing = workshop.missing()
    clock = time.perf_counter()
    failures: list[str] = []
    bar = _bar(len(plan.slots()), len(missing), progress)
    made = results(_make, _Maker(plan), missing, n_workers, "the plan")
    try:
        with contextlib.closing(made), bar:
            for slot, result in made:
                if isinstance(result, Failure):
                    failures.append(f"{slot.cell}, number {slot.number}: {result.reason}")
                else:
                    workshop.add(result)
                bar.update()
    except KeyboardInterrupt:
        left = len(workshop.missing())
        raise GenerationInterrupted(
            f"interrupted with {left} of {len(plan.slots())} events to be made; resume goes on"
        ) from None
    if failures:
        raise SimulationError(
            f"{len(failures)} events could not be made, the first: {failures[0]}; the others are "
            f"kept in {workshop.path}"
        )
    seconds = time.perf_counter() - clock
    return workshop.finish({"seconds": seconds, "workers": n_workers, "made_now": len(missing)})


class _Maker:
    """What all events of a set have in common."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan

    def warm_up(self) -> None:
        JointSimulator(self.plan.planner).warm_up()


def _make(maker: _Maker, slot: Slot) -> Made:
    return make(maker.plan, slot)


def _bar(total: int, missing: int, progress: bool | None) -> Any:
    from tqdm import tqdm

    return tqdm(
        total=total,
        initial=total - missing,
        desc="events",
        unit="event",
        disable=None if progress is None else not progress,
        dynamic_ncols=True,
    )
