"""The command ``simulate``, and the way to all commands."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import phase_ppl
from phase_ppl.cli import (
    compare,
    compare_models,
    describe,
    diagnose,
    evaluate,
    export,
    generate,
    infer,
    query,
    render,
    report,
    train,
)
from phase_ppl.cli.shared import (
    BAD_INPUT,
    Parser,
    check_suffix,
    command,
    load,
    one_line,
    whole,
    writable_folder,
)
from phase_ppl.dataset.load import SUFFIXES as EVENT_SUFFIXES
from phase_ppl.render.video import SUFFIXES as FILM_SUFFIXES
from phase_ppl.world.errors import PhasePPLError


def run(arguments: Sequence[str] | None) -> int:
    """Run a command; return the exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except PhasePPLError as error:
        print(f"phase-ppl: error: {one_line(error)}", file=sys.stderr)
        return BAD_INPUT


# --- simulate --------------------------------------------------------------------------------


def _simulate(options: argparse.Namespace) -> int:
    suffix = check_suffix(options.out, (*EVENT_SUFFIXES, *FILM_SUFFIXES))
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
    if suffix in EVENT_SUFFIXES:
        phase_ppl.save_event(simulated, options.out)
    else:
        phase_ppl.render.video(simulated, options.out)
    print(f"{hypothesis}\n{simulated.observation.n_frames} frames written to {options.out}")
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
    simulate.add_argument(
        "--out", metavar="FILE", type=Path, required=True, help=".json, .nc, .mp4 or .gif"
    )

    render.add_to(commands)
    compare.add_to(commands)
    query.add_to(commands)
    evaluate.add_to(commands)
    compare_models.add_to(commands)
    report.add_to(commands)
    diagnose.add_to(commands)
    generate.add_to(commands)
    describe.add_to(commands)
    train.add_to(commands)
    export.add_to(commands)
    return parser
