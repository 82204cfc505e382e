"""The commands ``infer``, ``resume`` and ``compare``."""

from __future__ import annotations

import argparse
import functools
import inspect
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import phase_ppl
from phase_ppl.agents.config import PLANNERS
from phase_ppl.cli import commands as cli
from phase_ppl.cli import own
from phase_ppl.inference.settings import completed
from phase_ppl.world.errors import InvalidSettingError, OutputError, PhasePPLError
from phase_ppl.world.event import SHOWN_SECONDS_PER_FRAME, Event
from phase_ppl.world.files import write_json
from phase_ppl.world.scene import PHASE

if TYPE_CHECKING:
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

CHECKPOINT: Final = "run.ckpt"  # the file in the folder of results that holds an unfinished run
_SAMPLED: Final = (cli.POSTERIOR, "summary.json", "posterior.png", "replay.mp4")
_STEPWISE: Final = (*_SAMPLED[:-1], "over_time.png", "why.png", "watch.mp4")
"""Files of results, by kind of posterior."""

_RESULTS: Final = tuple(dict.fromkeys((*_SAMPLED, *_STEPWISE)))


def add_to(commands: Any) -> None:
    """Add the commands."""
    infer = cli.event_command(
        commands, "infer", _infer, "phase-ppl infer collaborate --planner fast --seed 0 --out out"
    )
    cli.share(infer, "planner")
    infer.set_defaults(planner=None)  # the preset's
    cli.add(infer, "--preset NAME", cli.PRESET)
    says = (
        "stepwise, the closed loop: every frame given those before it, summed over all hypotheses "
        "(the default); simple: whole simulations, sampled, as with --kernel local_mh"
    )
    cli.add(infer, "--model", says, choices=("simple", "stepwise"))
    own.add_model(infer)
    says = "of the stepwise model: show what it believes as the video plays, and film it"
    cli.add(infer, "--watch", says)
    says = f"sample by it; local_mh is SIMPLE; default none, nothing is sampled; {own.FILE}"
    cli.add(infer, "--kernel NAME", says)
    cli.add(infer, "--chains M", "default 15", cli.whole(1))
    cli.add_options(
        infer,
        "of the kernel, such as rule=paper, of SIMPLE's settings, such as beta=0.1, or of the "
        "stepwise model, such as weight=1 or planner_seeds=8; may be given several times",
    )
    cli.add(infer, "--out DIR", "for the posterior, a figure and a film", Path)
    cli.share(infer, "overwrite")
    _add_run_options(infer)

    resume = cli.command(
        commands,
        "resume",
        _resume,
        "phase-ppl resume out/run.ckpt --workers 4",
        "Go on with an interrupted run, or extend one, as if it had never stopped.",
    )
    cli.add(resume, "file FILE", "the run.ckpt that it left", Path)
    own.add_model(resume)
    cli.add(resume, "--kernel NAME", "as before, if it was one of your own")
    cli.add(resume, "--out DIR", "default: where FILE is", Path)
    cli.share(resume, "overwrite", "other_versions")
    _add_run_options(resume)

    _add_compare(commands)


def _add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add what ``infer`` and ``resume`` share."""
    length = parser.add_mutually_exclusive_group()
    cli.add(length, "--iterations L", "default 6, or as before", cli.whole(1))
    cli.add(length, "--budget B", cli.BUDGET, cli.budget)
    cli.share(parser, "workers", "dask")
    says = "what becomes of a failed simulation; default reject, or as before"
    cli.add(parser, "--on-failure", says, choices=("reject", "raise", "retry"))
    cli.add(parser, "--retries N", "of retry; default 3", cli.whole(1))
    says = (
        "draws at the beginning of each chain that do not count; default a quarter of 20 "
        "iterations or more, else none"
    )
    cli.add(parser, "--burn-in N", says, cli.whole(0))
    says = "of the posterior; default: those that are valid for the kernel and the length"
    cli.add(parser, "--weights NAME", says)
    says = "a simulation that takes longer has failed; default: none has"
    cli.add(parser, "--simulation-seconds S", says, float)
    cli.add(
        parser, "--keep-checkpoint", f"keep {CHECKPOINT} when the run is complete, to extend it"
    )
    cli.share(parser, "progress")


def _infer(options: argparse.Namespace) -> int:
    event = cli.load(options)
    if options.model == "simple":
        options.preset = options.preset or "simple"
    samples = options.kernel is not None or options.preset is not None
    stepwise = _is_stepwise(options, samples)
    if options.watch and samples:
        raise InvalidSettingError(
            "--watch shows the closed loop: no kernel, preset or --model simple"
        )
    kept = None if options.out is None else options.out / CHECKPOINT
    if kept is not None and kept.exists():
        raise OutputError(
            f"{kept} holds an unfinished run: continue it with 'phase-ppl resume {kept}', or "
            "delete it"
        )
    with cli.results_folder(options.out, _RESULTS, options.overwrite) as out:
        if options.watch:
            return _watched(event, out, options)
        model, of_kernel = _model_of(options, stepwise)
        own_ones = {"event": event, "model": model, "checkpoint": None if stepwise else kept}
        given = cli.arguments(phase_ppl.infer, options, **own_ones, **of_kernel, **_kernel(options))
        given = completed(options.preset, given) if options.preset else given
        run = functools.partial(phase_ppl.infer, **given)
        return _finish(run, event, out, kept, options)


def _is_stepwise(options: argparse.Namespace, samples: bool) -> bool:
    """Return whether the video is read by the closed loop, be it for a kernel to sample from."""
    named = own.is_stepwise(options.likelihood)
    if named and options.model == "simple":
        raise InvalidSettingError("--likelihood stepwise is not that of --model simple")
    reads = options.model == "stepwise" or not samples
    if reads and options.likelihood is None:
        options.likelihood = "stepwise"
    elif reads and not named:
        own.likelihood(options.likelihood, {})  # what is none at all is refused as that
        if options.model == "stepwise":
            raise InvalidSettingError(
                f"--likelihood {options.likelihood} is not that of --model stepwise"
            )
        raise InvalidSettingError(
            f"--likelihood {options.likelihood} compares whole simulations with the video: name a "
            "kernel that samples, as in --kernel local_mh"
        )
    return named or reads


def _model_of(
    options: argparse.Namespace, stepwise: bool
) -> tuple[phase_ppl.Model, dict[str, Any]]:
    """Return the model, and those of ``--option`` that are not of its likelihood."""
    given = cli.once(options.option)
    names = own.stepwise_settings() if stepwise else ()
    rest = {name: value for name, value in given.items() if name not in names}
    if taken := rest.keys() & inspect.signature(phase_ppl.infer).parameters.keys():
        raise InvalidSettingError(f"--option {min(taken)}: no option of a kernel")
    if not stepwise:  # its planner is an argument of ``infer``, where a preset may have one
        return own.model(options), rest
    of_likelihood = {name: value for name, value in given.items() if name in names}
    return own.model(options, options.planner, **of_likelihood), rest


def _kernel(options: argparse.Namespace) -> dict[str, Any]:
    return {} if options.kernel is None else {"kernel": own.taken(options.kernel, "kernel")}


def _resume(options: argparse.Namespace) -> int:
    from phase_ppl.inference.checkpoint import Checkpoint

    saved = Checkpoint(options.file)
    folder = options.file.parent
    # what is beside the file is of the same run
    elsewhere = options.out is not None and options.out.resolve() != folder.resolve()
    with cli.results_folder(
        options.out or folder, _RESULTS if elsewhere else (), options.overwrite
    ) as out:
        run = functools.partial(
            phase_ppl.resume,
            options.file,
            **cli.arguments(
                phase_ppl.resume,
                options,
                model=_model_again(options, saved.identity["model"]),
                **_kernel(options),
            ),
        )
        return _finish(run, saved.event, out, options.file, options)


def _model_again(options: argparse.Namespace, before: Mapping[str, Any]) -> phase_ppl.Model | None:
    """Return the model of a run that has parts of one's own; None where none are given."""
    if not cli.given(options, *own.PARTS):
        return None
    planner = None
    if options.simulator is None and before["planner"] is not None:
        planner = phase_ppl.PlannerConfig.from_dict(before["planner"])
    options.noise = options.noise or before["noise"]
    return own.model(options, planner)


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
            return cli.INTERRUPTED
        print("phase-ppl: interrupted; this is what was done until then", file=sys.stderr)
        post, code = stopped.posterior, cli.INTERRUPTED
    except PhasePPLError as error:
        if getattr(error, "posterior", None) is None:
            raise
        print(f"phase-ppl: error: {cli.one_line(error)}", file=sys.stderr)
        print("phase-ppl: this is what was done until then", file=sys.stderr)
        post, code = error.posterior, cli.BAD_INPUT  # type: ignore[attr-defined]
    print(post)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the posterior, a figure and a video.")
    else:
        told = {"preset": options.preset} if getattr(options, "preset", None) else {}
        _write_results(post, event, out, **told)
    if kept is not None and kept.exists():
        if code:
            again = own.given_again(options)
            print(f"Go on with: phase-ppl resume {shlex.quote(str(kept))}{again}")
        elif not options.keep_checkpoint:
            kept.unlink()
    return code


def _write_results(post: Any, event: Event, out: Path, **told: str) -> None:
    """Write the posterior, a summary with what else is told, figures and a film into ``out``."""
    post.save(out / cli.POSTERIOR)
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
        written = _STEPWISE
    for name in set(_RESULTS) - set(written):  # of another run, which was to be overwritten
        (out / name).unlink(missing_ok=True)
    print(f"\nWritten to {out}: {', '.join(written)}")
    if event.scene.world == PHASE:
        print(cli.report_hint(out))


# --- watching --------------------------------------------------------------------------------

_BAR: Final = 24
_TITLE: Final = 10
_NAME: Final = 32
_LINES_A_SECOND: Final = 4
"""Frames between two lines where the output is no terminal: one a second of the video."""


def _watched(event: Event, out: Path | None, options: argparse.Namespace) -> int:
    """Show the posterior after every frame; print and keep the last one."""
    sampling = ("chains", "iterations", "budget", "on_failure", "retries")
    given = [f"--{name.replace('_', '-')}" for name in sampling if getattr(options, name)]
    given += [f"--option {name}" for name, _ in options.option
              if name not in own.stepwise_settings()]  # fmt: skip
    if given:
        raise InvalidSettingError(f"{', '.join(given)}: nothing is sampled")
    code = 0
    screen = _Screen(sys.stdout.isatty() and not options.quiet)
    with phase_ppl.watch(
        event.scene,
        _model_of(options, True)[0],
        seed=options.seed,
        threads=options.workers,
        event_id=event.id,
    ) as watch:
        try:
            for index, frame in enumerate(event.observation.trajectory):
                post = watch.update(frame)
                if not options.quiet:
                    screen.show(post, index)
        except KeyboardInterrupt:
            print("phase-ppl: interrupted; this is what was seen until then", file=sys.stderr)
            code = cli.INTERRUPTED
        post = watch.posterior()
    print(f"\n{post}")
    if out is None:
        print("\nNothing was saved; --out DIR keeps the posterior, figures and a film.")
    else:
        _write_results(post, event, out)
    return code


class _Screen:
    """Bars that move in place on a terminal; elsewhere a line a second of the video."""

    def __init__(self, in_place: bool) -> None:
        self._in_place = in_place
        self._lines = 0

    def show(self, post: StepwisePosterior, frame: int) -> None:
        seconds = frame * SHOWN_SECONDS_PER_FRAME
        if not self._in_place:
            if frame % _LINES_A_SECOND == 0:
                print(f"{seconds:5.1f} s  {_in_a_line(post)}", flush=True)
            return
        width = shutil.get_terminal_size().columns - 1
        lines = [f"{post.event_id}, {seconds:.1f} s", *_bars(post)]
        back = f"\x1b[{self._lines}F" if self._lines else ""
        print(back + "\n".join(f"\x1b[2K{line[:width]}" for line in lines), flush=True)
        self._lines = len(lines)


def _bars(post: StepwisePosterior) -> list[str]:
    lines = []
    for title, name in _followed(post).items():
        for label, share in post.top(name, 3):
            bar = "#" * round(share * _BAR)
            lines.append(f"{title:<{_TITLE}}{label:<{_NAME}}{share:5.2f}  {bar}")
            title = ""
    return lines


def _followed(post: StepwisePosterior) -> dict[str, str]:
    """Return title -> quantity of what is shown as the video plays."""
    return {title.removesuffix(" agent"): name for title, name in post.goals_of.items()} | dict(
        post.relations_of
    )


def _in_a_line(post: StepwisePosterior) -> str:
    parts = []
    for title, name in _followed(post).items():
        label, share = post.top(name, 1)[0]
        parts.append(f"{title}: {label} {share:.2f}")
    return "; ".join(parts)


# --- compare --------------------------------------------------------------------------------------

COMPARISON: Final = "comparison.json"
FIGURE: Final = "comparison.png"


def _add_compare(commands: Any) -> None:
    parser = cli.event_command(
        commands,
        "compare",
        _compare,
        "phase-ppl compare collaborate --kernels local_mh,local_mh:rule=paper,prior_mh "
        "--budget 500 --repeats 8 --out out",
    )
    says = (
        "names, with options as NAME:OPTION=VALUE:OPTION=VALUE; simple, guided, as_printed and "
        "as_intended are SIMPLE by a preset; " + own.FILE
    )
    cli.add(parser, "--kernels A,B", says, required=True)
    cli.add(parser, "--budget B", f"{cli.BUDGET}; default 500", cli.budget)
    cli.add(parser, "--repeats R", "default 8", cli.whole(1))
    cli.add(parser, "--chains M", "default 15", cli.whole(1))
    own.add_model(parser)
    cli.add(parser, "--planner", "default fast", choices=PLANNERS)
    says = (
        "a posterior's .nc file, 'enumeration' (more precise: enumeration:per_pair=16) or a "
        "kernel, with options as in --kernels; default: what is affordable"
    )
    cli.add(parser, "--reference R", says)
    cli.add(parser, "--weights NAME", "default count")
    cli.share(parser, "workers", "dask")
    cli.add(parser, "--checkpoint FILE", ".json; keeps and takes up finished runs", Path)
    cli.add(parser, "--out DIR", "for the runs and a figure", Path)
    cli.share(parser, "overwrite", "progress")


def _compare(options: argparse.Namespace) -> int:
    event = cli.load(options)
    names = [COMPARISON, FIGURE]
    if options.out is not None and options.checkpoint is not None:
        kept = options.checkpoint.resolve()
        names = [name for name in names if (options.out / name).resolve() != kept]
    with cli.results_folder(options.out, names, options.overwrite) as out:
        arguments = cli.arguments(
            phase_ppl.compare,
            options,
            event=event,
            model=own.model(options, options.planner),
            kernels=_kernels(options.kernels),
            reference=_reference(options.reference),
        )
        return _compared(arguments, out)


def _compared(arguments: Mapping[str, Any], out: Path | None) -> int:
    interrupted = False
    try:
        found = phase_ppl.compare(**arguments)
    except phase_ppl.ComparisonInterrupted as stopped:
        if stopped.comparison is None:
            print("phase-ppl: interrupted before the first run was finished", file=sys.stderr)
            return cli.INTERRUPTED
        print("phase-ppl: interrupted; this is what was finished until then", file=sys.stderr)
        found, interrupted = stopped.comparison, True
    print(found)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the table, the runs and a figure.")
    else:
        found.save(out / COMPARISON)
        phase_ppl.plot.comparison(found, path=out / FIGURE)
        print(f"\nWritten to {out}: {COMPARISON}, {FIGURE}")
    return cli.INTERRUPTED if interrupted else 0


def _kernels(text: str) -> dict[str, Any]:
    """Return label -> (name, options) of ``a,b:option=value``."""
    found: dict[str, Any] = {}
    for label in (part.strip() for part in text.split(",")):
        if not label.partition(":")[0] or label in found:
            raise InvalidSettingError(f"--kernels {text}: expected different names, as in a,b,c")
        name, given = own.with_settings(label, "--kernels")
        found[label] = own.taken(name, "kernel"), given
    return found


def _reference(text: str | None) -> Any:
    if text is not None and text.endswith(".nc"):
        return phase_ppl.Posterior.load(text)
    if text is None or ":" not in text:
        return text
    name, given = own.with_settings(text, "--reference")
    return own.taken(name, "kernel"), given
