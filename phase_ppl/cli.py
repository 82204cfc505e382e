"""The terminal: ``phase-ppl infer | resume | simulate | render``."""

from __future__ import annotations

import argparse
import functools
import inspect
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import phase_ppl
from phase_ppl.world.errors import InvalidSettingError, OutputError, PhasePPLError

if TYPE_CHECKING:
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.world.event import Event

BAD_INPUT = 2
INTERRUPTED = 130

CHECKPOINT = "run.ckpt"
"""The file in the folder of results that holds an unfinished run."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code (0 fine, 2 bad input, 130 interrupted)."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except PhasePPLError as error:
        print(f"phase-ppl: error: {_one_line(error)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("phase-ppl: interrupted", file=sys.stderr)
        return INTERRUPTED


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())


# --- infer -----------------------------------------------------------------------------------


def _infer(options: argparse.Namespace) -> int:
    event = _load(options)
    out = None if options.out is None else _writable_folder(options.out)
    kept = None if out is None else out / CHECKPOINT
    if kept is not None and kept.exists():
        raise OutputError(
            f"{kept} holds an unfinished run: continue it with 'phase-ppl resume {kept}', or "
            "delete it"
        )
    run = functools.partial(
        phase_ppl.infer,
        event,
        kernel=options.kernel,
        planner=options.planner,
        chains=options.chains,
        seed=options.seed,
        checkpoint=kept,
        **_means(options),
        **_kernel_options(options.option),
    )
    return _finish(run, event, out, kept, options)


def _resume(options: argparse.Namespace) -> int:
    from phase_ppl.inference.checkpoint import Checkpoint

    out = _writable_folder(options.file.parent if options.out is None else options.out)
    event = Checkpoint(options.file).event
    run = functools.partial(phase_ppl.resume, options.file, **_means(options))
    return _finish(run, event, out, options.file, options)


def _finish(
    run: Callable[[], Posterior],
    event: Event,
    out: Path | None,
    kept: Path | None,
    options: argparse.Namespace,
) -> int:
    """Do a run, print and write what came out, and delete the file of one that is complete."""
    code = 0
    try:
        post = run()
    except phase_ppl.Interrupted as stopped:
        if stopped.posterior is None:
            print("phase-ppl: interrupted before the first draws", file=sys.stderr)
            return INTERRUPTED
        print("phase-ppl: interrupted; this is what was done until then", file=sys.stderr)
        post, code = stopped.posterior, INTERRUPTED
    except PhasePPLError as error:
        if getattr(error, "posterior", None) is None:
            raise
        print(f"phase-ppl: error: {_one_line(error)}", file=sys.stderr)
        print("phase-ppl: this is what was done until then", file=sys.stderr)
        post, code = error.posterior, BAD_INPUT  # type: ignore[attr-defined]
    print(post)
    if out is None:
        print("\nNothing was saved; --out DIR keeps the posterior, a figure and a video.")
    else:
        _write_results(post, event, out)
    if kept is not None and kept.exists():
        if code:
            print(f"Go on with: phase-ppl resume {kept}")
        elif not options.keep_checkpoint:
            kept.unlink()
    return code


def _means(options: argparse.Namespace) -> dict[str, Any]:
    given = ("iterations", "budget", "workers", "on_failure", "retries")
    found = {name: getattr(options, name) for name in given}
    return {
        "progress": not options.quiet,
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


def _write_results(post: Posterior, event: Event, out: Path) -> None:
    """Write posterior.nc, summary.json, posterior.png and replay.mp4 into ``out``."""
    post.save(out / "posterior.nc")
    text = json.dumps(post.summary(), indent=2, ensure_ascii=False, allow_nan=False)
    _write_text(out / "summary.json", text + "\n")
    phase_ppl.plot.posterior(post, path=out / "posterior.png")
    phase_ppl.render.video(event, out / "replay.mp4", compare=post.replay())
    print(f"\nWritten to {out}: posterior.nc, summary.json, posterior.png, replay.mp4")


# --- simulate --------------------------------------------------------------------------------


def _simulate(options: argparse.Namespace) -> int:
    suffixes = (".json", ".mp4")
    if options.out.suffix.lower() not in suffixes:
        raise OutputError(f"--out {options.out}: expected a file ending in {' or '.join(suffixes)}")
    event = _load(options)
    _writable_folder(options.out.parent)
    hypothesis = phase_ppl.Hypothesis(
        goal_red=options.goal_red,
        goal_green=options.goal_green,
        alpha=(options.alpha_red, options.alpha_green),
        strength_red=options.strength_red,
        strength_green=options.strength_green,
    )
    simulated = phase_ppl.simulate(
        event.scene,
        hypothesis,
        frames=options.frames or event.observation.n_frames,
        seed=options.seed,
        planner=options.planner,
        id=f"{event.id}-simulated",
    )
    if options.out.suffix.lower() == ".json":
        phase_ppl.save_event(simulated, options.out)
    else:
        phase_ppl.render.video(simulated, options.out)
    print(f"{hypothesis}\n{simulated.observation.n_frames} frames written to {options.out}")
    return 0


# --- render ----------------------------------------------------------------------------------


def _render(options: argparse.Namespace) -> int:
    event = _load(options)
    _writable_folder(options.out.parent)
    phase_ppl.render.video(event, options.out)
    print(f"{event.observation.n_frames} frames of {event.id} written to {options.out}")
    return 0


# --- shared ----------------------------------------------------------------------------------


def _load(options: argparse.Namespace) -> Event:
    return phase_ppl.load_event(options.event, video=options.video, turning=options.turning)


def _writable_folder(folder: Path) -> Path:
    """Create ``folder`` and check that it can be written, before any work is done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"cannot write into folder {folder}: {error.strerror or error}") from None
    return folder


def _write_text(path: Path, text: str) -> None:
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from None


class _Parser(argparse.ArgumentParser):
    """Reports a usage error in one line, exit code 2."""

    def error(self, message: str) -> Any:
        self.exit(BAD_INPUT, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _whole(minimum: int) -> Any:
    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
        if value < minimum:
            raise argparse.ArgumentTypeError(f"{value} is too small, expected at least {minimum}")
        return value

    return parse


def _budget(text: str) -> Any:
    try:
        if text.endswith("s"):
            return phase_ppl.seconds(float(text[:-1]))
        return phase_ppl.simulations(int(text))
    except ValueError:  # of ours too
        raise argparse.ArgumentTypeError(
            f"{text!r} is no budget; expected simulations, as in 500, or seconds, as in 60s"
        ) from None


def _option(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier()):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


def _alpha(text: str) -> int:
    if text not in ("-1", "0", "1", "+1"):
        raise argparse.ArgumentTypeError(f"{text!r} is none of -1, 0, 1")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="phase-ppl",
        description="Who wants what? Social perception grounded in intuitive physics.",
        epilog="example: phase-ppl infer collaborate --out out",
    )
    parser.add_argument("--version", action="version", version=phase_ppl.__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    infer = _command(
        commands,
        "infer",
        _infer,
        "print, draw and save the posterior over goals, relation and strengths of an event",
        "phase-ppl infer collaborate --planner fast --seed 0 --out out",
    )
    infer.add_argument("--planner", choices=("fast", "paper"), default="fast")
    infer.add_argument("--kernel", metavar="NAME", default="local_mh")
    infer.add_argument("--chains", metavar="M", type=_whole(1), default=15, help="default 15")
    infer.add_argument(
        "--option",
        metavar="NAME=VALUE",
        type=_option,
        action="append",
        default=[],
        help="of the kernel, such as rule=paper; may be given several times",
    )
    infer.add_argument("--out", metavar="DIR", type=Path)
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
    _add_means(resume)

    simulate = _command(
        commands,
        "simulate",
        _simulate,
        "run the joint simulator from an event's start under a hypothesis",
        "phase-ppl simulate collaborate --goal-red 'Get blue item to red lm' "
        "--goal-green 'get to red agent' --out simulated.mp4",
    )
    for agent in ("red", "green"):
        simulate.add_argument(f"--goal-{agent}", metavar="GOAL", required=True)
        simulate.add_argument(
            f"--alpha-{agent}", metavar="A", type=_alpha, default=0, help="-1, 0 or 1"
        )
        simulate.add_argument(
            f"--strength-{agent}", metavar="NEWTON", type=float, default=450.0, help="default 450"
        )
    simulate.add_argument("--planner", choices=("fast", "paper"), default="fast")
    simulate.add_argument(
        "--frames", metavar="T", type=_whole(2), help="default: as long as the event"
    )
    simulate.add_argument("--out", metavar="FILE", type=Path, required=True, help=".json or .mp4")

    render = _command(
        commands,
        "render",
        _render,
        "film an event",
        "phase-ppl render collaborate --out collaborate.mp4",
    )
    render.add_argument("--out", metavar="FILE", type=Path, required=True, help=".mp4")
    return parser


def _add_means(command: argparse.ArgumentParser) -> None:
    """Add what ``infer`` and ``resume`` share."""
    length = command.add_mutually_exclusive_group()
    length.add_argument("--iterations", metavar="L", type=_whole(1), help="default 6, or as before")
    length.add_argument(
        "--budget", metavar="B", type=_budget, help="simulations, as in 500, or seconds, as in 60s"
    )
    command.add_argument(
        "--workers", metavar="N", type=_whole(1), help="processes; default one per usable core"
    )
    command.add_argument(
        "--on-failure",
        choices=("reject", "raise", "retry"),
        help="what becomes of a failed simulation; default reject, or as before",
    )
    command.add_argument("--retries", metavar="N", type=_whole(1), help="of retry; default 3")
    command.add_argument(
        "--keep-checkpoint",
        action="store_true",
        help=f"keep {CHECKPOINT} when the run is complete, to extend it",
    )
    command.add_argument("--quiet", action="store_true", help="no progress bar")


def _command(
    commands: Any, name: str, run: Any, description: str, example: str
) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(
        name, help=description, description=description, epilog=f"example: {example}"
    )
    command.set_defaults(run=run)
    command.add_argument("event", metavar="EVENT", help="an event file, or a bundled event's name")
    command.add_argument("--video", metavar="ID", help="one event of a file with many")
    command.add_argument("--seed", metavar="N", type=_whole(0), default=0, help="default 0")
    command.add_argument(
        "--turning",
        choices=("both", "ccw", "cw"),
        help="which way agents can turn; default: as observed",
    )
    return command


if __name__ == "__main__":
    sys.exit(main())
