"""The commands ``infer``, ``resume`` and ``compare``."""

from __future__ import annotations

import contextlib
import functools
import inspect
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.cli import users_parts
from phase_ppl.cli.commands import (
    BAD_INPUT,
    INTERRUPTED,
    POSTERIOR,
    Options,
    one_line,
)
from phase_ppl.world.errors import InvalidSettingError, OutputError, PhasePPLError
from phase_ppl.world.event import SHOWN_SECONDS_PER_FRAME, Event
from phase_ppl.world.files import locked, writable_folder, write_json

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

CHECKPOINT: Final = "run.ckpt"  # the file in the folder of results that holds an unfinished run
_SAMPLED: Final = (POSTERIOR, "summary.json", "posterior.png", "replay.mp4")
_CLOSED_LOOP: Final = (*_SAMPLED[:-1], "over_time.png", "why.png", "watch.mp4")
"""Files of results, by kind of posterior."""

_RESULTS: Final = tuple(dict.fromkeys((*_SAMPLED, *_CLOSED_LOOP)))

_OF_SAMPLING: Final = (
    *("kernel", "preset", "chains", "iterations", "budget", "dask", "on_failure"),
    *("weights", "simulation_seconds", "keep_checkpoint"),
)
"""Options of ``infer`` that ``--watch`` has no use for."""


def infer(options: Options) -> int:
    """Print, draw and save the posterior over goals, relation and strengths of an event.

    Args:
        $event
        $planner
        --preset NAME: $PRESET
        --model simple|closed_loop: closed_loop (the default): each frame is predicted
            from those before, summed over all hypotheses; simple: whole simulations, sampled, as
            with --kernel local_mh
        $model
        --watch: for the closed loop: show its beliefs as the video plays, and film it
        --kernel NAME: sample with it; local_mh is SIMPLE; default none, nothing is sampled; $FILE
        --chains N: default 15
        --option NAME=VALUE...: of the kernel, such as rule=paper, of SIMPLE's settings, such as
            eta=0.2, or of the closed loop, such as weight=1 or planner_seeds=8; may be given
            several times
        --on-failure reject|raise: what becomes of a failed simulation; default reject
        --simulation-seconds S: a simulation that takes longer has failed; default: none has
        --weights NAME: of the posterior; default: those that are valid for the kernel and the
            length
        --out DIR: for the posterior, a figure and a film
        $overwrite
        $run

    example: phase-ppl infer collaborate --planner fast --seed 0 --out out
    """
    event = options.load()
    if options.model == "simple":
        options.preset = options.preset or "simple"
    samples = options.kernel is not None or options.preset is not None
    closed_loop = _is_closed_loop(options, samples)
    kept = None if options.out is None else options.out / CHECKPOINT
    if kept is not None and kept.exists():
        raise OutputError(
            f"{kept} holds an unfinished run: continue it with 'phase-ppl resume {kept}', or "
            "delete it"
        )
    settings = users_parts.closed_loop_settings() if closed_loop else ()
    of_likelihood = {name: v for name, v in options.option.items() if name in settings}
    of_kernel = {name: v for name, v in options.option.items() if name not in settings}
    if taken := of_kernel.keys() & inspect.signature(phase_ppl.infer).parameters.keys():
        raise InvalidSettingError(f"--option {min(taken)}: no option of a kernel")
    with _results_folder(options, options.out, _RESULTS) as out:
        model = users_parts.model(
            options, options.planner if options.watch else None, **of_likelihood
        )
        if options.watch:
            wrong = [f"--{name.replace('_', '-')}" for name in options.given(*_OF_SAMPLING)]
            if wrong := wrong + [f"--option {name}" for name in of_kernel]:
                raise InvalidSettingError(
                    f"--watch shows the closed loop, which samples nothing: no {', '.join(wrong)}"
                )
            run = functools.partial(_watched, event, model, options)
        else:
            more = {"event": event, "model": model, "checkpoint": None if closed_loop else kept}
            given = {**options.of(phase_ppl.infer, **more), **of_kernel, **_kernel(options)}
            if options.preset:
                from phase_ppl.inference.settings import completed

                given = completed(options.preset, given)
            run = functools.partial(phase_ppl.infer, **given)
        return _finish(run, event, out, kept, options)


def _is_closed_loop(options: Options, samples: bool) -> bool:
    """Return whether the closed loop reads the video, also when a kernel then samples from it."""
    if options.likelihood is None and (options.model == "closed_loop" or not samples):
        options.likelihood = "closed_loop"
    named = (options.likelihood or "").partition(":")[0] == "closed_loop"
    if options.model and options.likelihood and named != (options.model == "closed_loop"):
        raise InvalidSettingError(
            f"--likelihood {options.likelihood} is not that of --model {options.model}"
        )
    return named


def _kernel(options: Options) -> dict[str, Any]:
    return {} if options.kernel is None else {"kernel": users_parts.taken(options.kernel, "kernel")}


def resume(options: Options) -> int:
    """Continue an interrupted run, or extend one, with the same result as without a break.

    Args:
        FILE: the run's run.ckpt
        $model
        --kernel NAME: as before, if it was user-defined
        --out DIR: default: the folder of FILE
        $overwrite
        $versions
        $run

    example: phase-ppl resume out/run.ckpt --workers 4
    """
    from phase_ppl.inference.checkpoint import Checkpoint

    saved = Checkpoint(options.file)
    before = saved.identity["model"]
    model = None
    if options.given(*users_parts.PARTS):
        planner = None
        if options.simulator is None and before["planner"] is not None:
            planner = phase_ppl.PlannerConfig.from_dict(before["planner"])
        model = users_parts.model(options, planner)
    folder = options.file.parent
    # a posterior beside the file is of the same run
    elsewhere = options.out is not None and options.out.resolve() != folder.resolve()
    with _results_folder(options, options.out or folder, _RESULTS if elsewhere else ()) as out:
        given = {**options.of(phase_ppl.resume, model=model), **_kernel(options)}
        run = functools.partial(phase_ppl.resume, options.file, **given)
        return _finish(run, saved.event, out, options.file, options)


@contextlib.contextmanager
def _results_folder(
    options: Options, out: Path | None, names: Sequence[str]
) -> Iterator[Path | None]:
    """Lock the folder of results, before any work is done."""
    if out is None:
        yield None
        return
    with locked(writable_folder(out)):
        there = [name for name in names if (out / name).exists()]
        if there and not options.overwrite:
            raise OutputError(
                f"{out} holds results already ({', '.join(there)}): name another folder, or "
                "--overwrite"
            )
        yield out


def _finish(
    run: Callable[[], Any], event: Event, out: Path | None, kept: Path | None, options: Options
) -> int:
    """Do a run, print and write the results, and delete the checkpoint if it is complete."""
    code, told = 0, "interrupted"
    try:
        post = run()
    except (phase_ppl.Interrupted, phase_ppl.ClosedLoopInterrupted, PhasePPLError) as stopped:
        post, code = getattr(stopped, "posterior", None), INTERRUPTED
        if isinstance(stopped, PhasePPLError):
            if post is None:
                raise
            code, told = BAD_INPUT, f"error: {one_line(stopped)}"
        if post is None:
            print("phase-ppl: interrupted before the first draws", file=sys.stderr)
            return code
        print(f"phase-ppl: {told}; this is what was done until then", file=sys.stderr)
    print(post)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the posterior, figures and a film.")
    else:
        _write_results(post, event, out, **options.given("preset"))
    if kept is not None and kept.exists():
        if code:
            found = options.given(*users_parts.PARTS, "kernel")
            # a file cannot hold everything of a run
            needed = any(".py:" in text or "closed_loop" in text for text in found.values())
            again = [f" --{name} {shlex.quote(text)}" for name, text in found.items() if needed]
            print(f"Go on with: phase-ppl resume {shlex.quote(str(kept))}{''.join(again)}")
        elif not options.keep_checkpoint:
            kept.unlink()
    return code


def _write_results(post: Any, event: Event, out: Path, **told: str) -> None:
    """Write the posterior, a summary with ``told``, figures and a film into ``out``."""
    post.save(out / POSTERIOR)
    write_json(out / "summary.json", {**post.summary(), **told})
    phase_ppl.plot.posterior(post, path=out / "posterior.png")
    if (predicted := post.replay()) is not None:
        phase_ppl.render.video(event, out / "replay.mp4", compare=predicted)
        written: tuple[str, ...] = _SAMPLED
    else:
        asked = next(iter((*post.relations_of.values(), *post.goals_of.values())))
        best, second = (label for label, _ in post.top(asked, 2))
        phase_ppl.plot.over_time(post, path=out / "over_time.png")
        phase_ppl.plot.why(post, f"{asked}={best}", f"{asked}={second}", path=out / "why.png")
        phase_ppl.watch_film(post, out / "watch.mp4")
        written = _CLOSED_LOOP
    for name in set(_RESULTS) - set(written):  # of another run, to be overwritten
        (out / name).unlink(missing_ok=True)
    print(f"\nWritten to {out}: {', '.join(written)}")


# --- watching --------------------------------------------------------------------------------

_LINES_A_SECOND: Final = 4
"""Frames between two lines if the output is no terminal: one line a second of the video."""


def _watched(event: Event, model: phase_ppl.Model, options: Options) -> ClosedLoopPosterior:
    """Show the posterior after every frame, in a terminal in place; return the last one."""
    drawn = 0
    seed, threads = options.seed or 0, options.workers
    how = {"seed": seed, "threads": threads, "observation": event.observation}
    with phase_ppl.watch(event.scene, model, event_id=event.id, **how) as watch:
        try:
            for index, frame in enumerate(event.observation.trajectory):
                post = watch.update(frame)
                if options.progress is False:
                    continue
                seconds = index * SHOWN_SECONDS_PER_FRAME
                if sys.stdout.isatty():
                    width = shutil.get_terminal_size().columns - 1
                    lines = [f"{event.id}, {seconds:.1f} s", *_bars(post)]
                    lines = [f"\x1b[2K{line[:width]}" for line in lines]
                    print(f"\x1b[{drawn}F" * bool(drawn) + "\n".join(lines), flush=True)
                    drawn = len(lines)
                elif index % _LINES_A_SECOND == 0:
                    best = [f"{title}: {label} {share:.2f}" for title, ((label, share), *_)
                            in _followed(post)]  # fmt: skip
                    print(f"{seconds:5.1f} s  {'; '.join(best)}", flush=True)
        except KeyboardInterrupt:
            raise phase_ppl.ClosedLoopInterrupted(watch.posterior()) from None
        print()
        return watch.posterior()


def _bars(post: ClosedLoopPosterior) -> Iterator[str]:
    for title, leading in _followed(post):
        for place, (label, share) in enumerate(leading):
            yield f"{title * (not place):<10}{label:<32}{share:5.2f}  {'#' * round(24 * share)}"


def _followed(post: ClosedLoopPosterior) -> Iterator[tuple[str, Any]]:
    """Yield title and leading values of the quantities shown as the video plays."""
    for title, name in (*post.goals_of.items(), *post.relations_of.items()):
        yield title.removesuffix(" agent"), post.top(name, 3)


# --- compare --------------------------------------------------------------------------------------


def compare(options: Options) -> int:
    """Compare kernels on an event: same budget, several seeds, against a reference.

    Args:
        $event
        --kernels A,B: names, with options as NAME:OPTION=VALUE:OPTION=VALUE; simple, guided,
            as_printed and as_intended are SIMPLE by a preset; $FILE; required
        --budget B: $BUDGET; default 500
        --repeats N: default 8
        --chains N: default 15
        $model
        $planner
        --reference R: a posterior's .nc file, 'none' or 'enumeration' (more precise:
            enumeration:per_pair=16); default: the best affordable one
        $cluster
        --checkpoint FILE: .json; stores finished runs and continues from them
        --out DIR: for the runs and a figure
        $overwrite
        $progress

    example: phase-ppl compare collaborate --kernels local_mh,local_mh:rule=paper,prior_mh
      --budget 500 --repeats 8 --out out
    """
    event = options.load()
    table, figure = names = ["comparison.json", "comparison.png"]
    if options.out is not None and options.checkpoint is not None:
        kept = options.checkpoint.resolve()
        names = [name for name in names if (options.out / name).resolve() != kept]
    with _results_folder(options, options.out, names) as out:
        model = users_parts.model(options, options.planner)
        parts = {"kernels": _kernels(options.kernels), "reference": _reference(options.reference)}
        code = 0
        try:
            found = options.call(phase_ppl.compare, event=event, model=model, **parts)
        except phase_ppl.ComparisonInterrupted as stopped:
            if stopped.comparison is None:
                print("phase-ppl: interrupted before the first run was finished", file=sys.stderr)
                return INTERRUPTED
            print("phase-ppl: interrupted; this is what was finished until then", file=sys.stderr)
            found, code = stopped.comparison, INTERRUPTED
        print(found)
        if out is None:
            print("\nNothing was saved; --out DIR keeps the table, the runs and a figure.")
        else:
            found.save(out / table)
            phase_ppl.plot.comparison(found, path=out / figure)
            print(f"\nWritten to {out}: {table}, {figure}")
        return code


def _kernels(text: str) -> dict[str, Any]:
    """Return label -> (name, options) of ``a,b:option=value``."""
    found: dict[str, Any] = {}
    for label in (part.strip() for part in text.split(",")):
        if not label.partition(":")[0] or label in found:
            raise InvalidSettingError(f"--kernels {text}: expected different names, as in a,b,c")
        name, given = users_parts.with_settings(label, "--kernels")
        found[label] = users_parts.taken(name, "kernel"), given
    return found


def _reference(text: str | None) -> Any:
    if text is not None and text.endswith(".nc"):
        return phase_ppl.load_posterior(text)
    if text is None or ":" not in text:
        return text
    return users_parts.with_settings(text, "--reference")
