"""The way to all commands."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import Final

import phase_ppl
from phase_ppl.cli.shared import BAD_INPUT, Parser, one_line
from phase_ppl.world.errors import PhasePPLError

COMMANDS: Final = {
    "infer": (
        "infer",
        "print, draw and save the posterior over goals, relation and strengths of an event",
    ),
    "resume": ("infer", "go on with an interrupted run, or extend one"),
    "goals": ("events", "list the 36 goals that an agent can have"),
    "simulate": ("events", "run the joint simulator from an event's start under a hypothesis"),
    "render": ("events", "film an event, or draw a frame or a film strip of it"),
    "compare": (
        "compare",
        "compare kernels on an event: same budget, several seeds, against a reference",
    ),
    "query": (
        "results",
        "ask a saved posterior, as in 'P(relation=friendly | goal_red=get to green agent)'",
    ),
    "evaluate": ("evaluate", "ask a model about many events, and score what it answers"),
    "compare-models": (
        "compare_models",
        "compare evaluations of several models, and people, on the same events",
    ),
    "fit-people": ("fit_people", "fit an observer to people's judgments"),
    "reproduce": ("reproduce", "the paper's tables and figures, cell by cell"),
    "report": (
        "results",
        "make one self-contained HTML page of a run, an evaluation or a comparison",
    ),
    "diagnose": ("results", "say whether the chains of a posterior can be trusted"),
    "generate": ("generate", "make a data set of simulated social events"),
    "verify": ("generate", "compare a generated data set with its checksums"),
    "describe": (
        "events",
        "print and draw the statistics of a set of events beside those of PHASE",
    ),
    "train": ("train", "train a model of social perception on a generated data set"),
    "study": ("study", "put events before people, in the browser"),
    "export": (
        "events",
        "write events in another format, or read the pickles of PHASE's authors",
    ),
}
"""Command -> the module that adds it, which is imported where it is asked for; what it does."""


def run(arguments: Sequence[str] | None) -> int:
    """Run a command; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = Parser(
        prog="phase-ppl",
        description="Who wants what? Social perception grounded in intuitive physics.",
        epilog="example: phase-ppl infer collaborate --out out",
    )
    parser.add_argument("--version", action="version", version=phase_ppl.__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    if given and given[0] in COMMANDS:
        importlib.import_module(f"phase_ppl.cli.{COMMANDS[given[0]][0]}").add_to(commands)
    else:
        for name, (_, does) in COMMANDS.items():
            commands.add_parser(name, help=does)
    options: argparse.Namespace = parser.parse_args(given)
    try:
        code: int = options.run(options)
        return code
    except PhasePPLError as error:
        print(f"phase-ppl: error: {one_line(error)}", file=sys.stderr)
        return BAD_INPUT
