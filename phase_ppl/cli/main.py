"""The commands ``simulate`` and ``render``, and the way to all commands."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import phase_ppl
from phase_ppl.cli import compare, export, infer
from phase_ppl.cli.shared import (
    BAD_INPUT,
    INTERRUPTED,
    Parser,
    command,
    load,
    one_line,
    whole,
    writable_folder,
)
from phase_ppl.world.errors import OutputError, PhasePPLError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code (0 fine, 2 bad input, 130 interrupted)."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except PhasePPLError as error:
        print(f"phase-ppl: error: {one_line(error)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("phase-ppl: interrupted", file=sys.stderr)
        return INTERRUPTED


# --- simulate --------------------------------------------------------------------------------


def _simulate(options: argparse.Namespace) -> int:
    suffixes = (".json", ".mp4")
    if options.out.suffix.lower() not in suffixes:
        raise OutputError(f"--out {options.out}: expected a file ending in {' or '.join(suffixes)}")
    event = load(options)
    writable_folder(options.out.parent)
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
    event = load(options)
    writable_folder(options.out.parent)
    phase_ppl.render.video(event, options.out)
    print(f"{event.observation.n_frames} frames of {event.id} written to {options.out}")
    return 0


# --- options ----------------------------------------------------------------------------------


def _alpha(text: str) -> int:
    if text not in ("-1", "0", "1", "+1"):
        raise argparse.ArgumentTypeError(f"{text!r} is none of -1, 0, 1")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="phase-ppl",
        description="Who wants what? Social perception grounded in intuitive physics.",
        epilog="example: phase-ppl infer collaborate --out out",
    )
    parser.add_argument("--version", action="version", version=phase_ppl.__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    infer.add_to(commands)

    simulate = command(
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
        "--frames", metavar="T", type=whole(2), help="default: as long as the event"
    )
    simulate.add_argument("--out", metavar="FILE", type=Path, required=True, help=".json or .mp4")

    render = command(
        commands,
        "render",
        _render,
        "film an event",
        "phase-ppl render collaborate --out collaborate.mp4",
    )
    render.add_argument("--out", metavar="FILE", type=Path, required=True, help=".mp4")
    compare.add_to(commands)
    export.add_to(commands)
    return parser
