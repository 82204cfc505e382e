"""The commands ``infer`` and ``resume``."""

from __future__ import annotations

import argparse
import functools
import inspect
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli.shared import (
    BAD_INPUT,
    BUDGET,
    INTERRUPTED,
    POSTERIOR,
    add_other_versions,
    add_overwrite,
    add_progress,
    budget,
    command,
    load,
    named_value,
    one_line,
    report_hint,
    results_folder,
    shows_progress,
    whole,
)
from phase_ppl.cli.watch import MODELS, READING, model_of, watched, write_reading
from phase_ppl.world.errors import InvalidSettingError, OutputError, PhasePPLError
from phase_ppl.world.files import write_json

if TYPE_CHECKING:
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
    from phase_ppl.world.event import Event

CHECKPOINT: Final = "run.ckpt"
"""The file in the folder of results that holds an unfinished run."""

_SAMPLED: Final = (POSTERIOR, "summary.json", "posterior.png", "replay.mp4")
_RESULTS: Final = tuple(dict.fromkeys((*_SAMPLED, *READING)))


def add_to(commands: Any) -> None:
    """Add the commands."""
    infer = command(
        commands,
        "infer",
        _infer,
        "print, draw and save the posterior over goals, relation and strengths of an event",
        "phase-ppl infer collaborate --planner fast --seed 0 --out out",
    )
    infer.add_argument("--planner", choices=("fast", "paper"), default="fast")
    infer.add_argument("--prior", metavar="NAME", default="uniform", help="default uniform")
    infer.add_argument(
        "--model",
        choices=MODELS,
        default=MODELS[0],
        help="simple: whole simulations, sampled (the default); stepwise: every frame given those "
        "before it, over all hypotheses",
    )
    infer.add_argument(
        "--watch",
        action="store_true",
        help="of the stepwise model: show what it believes as the video plays, and film it",
    )
    infer.add_argument(
        "--kernel", metavar="NAME", help="default local_mh; of the stepwise model none, no sampling"
    )
    infer.add_argument("--chains", metavar="M", type=whole(1), help="default 15")
    infer.add_argument(
        "--option",
        metavar="NAME=VALUE",
        type=named_value,
        action="append",
        default=[],
        help="of the kernel, such as rule=paper; may be given several times",
    )
    infer.add_argument(
        "--out", metavar="DIR", type=Path, help="for the posterior, a figure and a film"
    )
    add_overwrite(infer)
    _add_means(infer)

    resume = commands.add_parser(
        "resume",
        help="go on with an interrupted run, or extend one",
        description="Go on with an interrupted run, or extend one, as if it had never stopped.",
        epilog="example: phase-ppl resume out/run.ckpt --workers 4",
    )
    resume.set_defaults(run=_resume)
    resume.add_argument("file", metavar="FILE", type=Path, help="the run.ckpt that it left")
    resume.add_argument("--out", metavar="DIR", type=Path, help="default: where FILE is")
    add_overwrite(resume)
    add_other_versions(resume)
    _add_means(resume)


def _add_means(command: argparse.ArgumentParser) -> None:
    """Add what ``infer`` and ``resume`` share."""
    length = command.add_mutually_exclusive_group()
    length.add_argument("--iterations", metavar="L", type=whole(1), help="default 6, or as before")
    length.add_argument("--budget", metavar="B", type=budget, help=BUDGET)
    command.add_argument(
        "--workers", metavar="N", type=whole(1), help="processes; default one per usable core"
    )
    command.add_argument(
        "--on-failure",
        choices=("reject", "raise", "retry"),
        help="what becomes of a failed simulation; default reject, or as before",
    )
    command.add_argument("--retries", metavar="N", type=whole(1), help="of retry; default 3")
    command.add_argument(
        "--burn-in",
        metavar="N",
        type=whole(0),
        help="draws at the beginning of each chain that do not count; default a quarter of 20 "
        "iterations or more, else none",
    )
    command.add_argument(
        "--simulation-seconds",
        metavar="S",
        type=float,
        help="a simulation that takes longer has failed; default: none has",
    )
    command.add_argument(
        "--keep-checkpoint",
        action="store_true",
        help=f"keep {CHECKPOINT} when the run is complete, to extend it",
    )
    add_progress(command)


def _infer(options: argparse.Namespace) -> int:
    event = load(options)
    if options.watch and (options.model != "stepwise" or options.kernel is not None):
        raise InvalidSettingError("--watch needs --model stepwise, and no kernel")
    kept = None if options.out is None else options.out / CHECKPOINT
    if kept is not None and kept.exists():
        raise OutputError(
            f"{kept} holds an unfinished run: continue it with 'phase-ppl resume {kept}', or "
            "delete it"
        )
    with results_folder(options.out, _RESULTS, options.overwrite) as out:
        if options.watch:
            return watched(event, out, options)
        exact = options.model == "stepwise" and options.kernel is None
        run = functools.partial(
            phase_ppl.infer,
            event,
            model_of(options),
            kernel=options.kernel,
            seed=options.seed,
            checkpoint=None if exact else kept,
            **({} if options.chains is None else {"chains": options.chains}),
            **_means(options),
            **_kernel_options(options.option),
        )
        return _finish(run, event, out, kept, options)


def _resume(options: argparse.Namespace) -> int:
    from phase_ppl.inference.runs.checkpoint import Checkpoint

    event = Checkpoint(options.file).event
    own = options.file.parent
    # what is beside the file is of the same run
    elsewhere = options.out is not None and options.out.resolve() != own.resolve()
    with results_folder(
        options.out or own, _RESULTS if elsewhere else (), options.overwrite
    ) as out:
        run = functools.partial(
            phase_ppl.resume,
            options.file,
            other_versions=options.other_versions,
            **_means(options),
        )
        return _finish(run, event, out, options.file, options)


def _finish(
    run: Callable[[], Posterior | StepwisePosterior],
    event: Event,
    out: Path | None,
    kept: Path | None,
    options: argparse.Namespace,
) -> int:
    """Do a run, print and write what came out, and delete the file of one that is complete."""
    code = 0
    try:
        post = run()
    except (phase_ppl.Interrupted, phase_ppl.StepwiseInterrupted) as stopped:
        if stopped.posterior is None:
            print("phase-ppl: interrupted before the first draws", file=sys.stderr)
            return INTERRUPTED
        print("phase-ppl: interrupted; this is what was done until then", file=sys.stderr)
        post, code = stopped.posterior, INTERRUPTED
    except PhasePPLError as error:
        if getattr(error, "posterior", None) is None:
            raise
        print(f"phase-ppl: error: {one_line(error)}", file=sys.stderr)
        print("phase-ppl: this is what was done until then", file=sys.stderr)
        post, code = error.posterior, BAD_INPUT  # type: ignore[attr-defined]
    print(post)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the posterior, a figure and a video.")
    else:
        _write_results(post, event, out)
    if kept is not None and kept.exists():
        if code:
            print(f"Go on with: phase-ppl resume {shlex.quote(str(kept))}")
        elif not options.keep_checkpoint:
            kept.unlink()
    return code


def _means(options: argparse.Namespace) -> dict[str, Any]:
    given = (
        *("iterations", "budget", "workers", "on_failure", "retries"),
        *("simulation_seconds", "burn_in"),
    )
    found = {name: getattr(options, name) for name in given}
    return {
        "progress": shows_progress(options),
        **{name: value for name, value in found.items() if value is not None},
    }


def _kernel_options(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    taken = inspect.signature(phase_ppl.infer).parameters
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in taken or name in found:
            why = "given twice" if name in found else "no option of a kernel"
            raise InvalidSettingError(f"--option {name}: {why}")
        found[name] = value
    return found


def _write_results(post: Posterior | StepwisePosterior, event: Event, out: Path) -> None:
    """Write the posterior, a summary, figures and a film into ``out``."""
    if isinstance(post, phase_ppl.Posterior):
        post.save(out / POSTERIOR)
        write_json(out / "summary.json", post.summary())
        phase_ppl.plot.posterior(post, path=out / "posterior.png")
        phase_ppl.render.video(event, out / "replay.mp4", compare=post.replay())
        written: tuple[str, ...] = _SAMPLED
    else:
        written = write_reading(post, out)
    for name in set(_RESULTS) - set(written):  # of another run, which was to be overwritten
        (out / name).unlink(missing_ok=True)
    print(f"\nWritten to {out}: {', '.join(written)}")
    print(report_hint(out))
