"""The way to all commands."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Final

import phase_ppl
from phase_ppl.cli import (
    compare,
    compare_models,
    evaluate,
    events,
    fit_people,
    generate,
    infer,
    results,
    study,
    train,
)
from phase_ppl.cli.shared import BAD_INPUT, Parser, one_line
from phase_ppl.world.errors import PhasePPLError

_COMMANDS: Final = (
    infer.add_to,
    events.add_simulate,
    events.add_render,
    compare.add_to,
    results.add_query,
    evaluate.add_to,
    compare_models.add_to,
    fit_people.add_to,
    results.add_report,
    results.add_diagnose,
    generate.add_to,
    events.add_describe,
    train.add_to,
    study.add_to,
    events.add_export,
)
"""What adds the commands, in the order in which ``--help`` lists them."""


def run(arguments: Sequence[str] | None) -> int:
    """Run a command; return the exit code."""
    parser = Parser(
        prog="phase-ppl",
        description="Who wants what? Social perception grounded in intuitive physics.",
        epilog="example: phase-ppl infer collaborate --out out",
    )
    parser.add_argument("--version", action="version", version=phase_ppl.__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for add in _COMMANDS:
        add(commands)
    options: argparse.Namespace = parser.parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except PhasePPLError as error:
        print(f"phase-ppl: error: {one_line(error)}", file=sys.stderr)
        return BAD_INPUT
