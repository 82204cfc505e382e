"""The command ``reproduce``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.evaluation.reproduce import PAGE, PROFILES, RESULT


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "reproduce",
        _reproduce,
        "phase-ppl reproduce --videos test.json --profile quick --out paper",
        "Run the models of the paper, and hold every number and figure of it against what comes "
        "out, on one page. Without --videos it is a try on generated events, no reproduction.",
    )
    cli.add(parser, "--videos FILE", "phase-test JSON or the authors' release", Path)
    cli.add(parser, "--out DIR", type=Path, required=True)
    says = (
        "quick (the default): few simulations, the fast planner; paper: as the paper has it; "
        "full: and all lesions, and what is beyond the paper"
    )
    cli.add(parser, "--profile", says, choices=PROFILES, default=PROFILES[0])
    cli.add(parser, "--judgments FILE", "people's judgments, a .csv file", Path)
    cli.add(parser, "--vlm-store DIR", "stored answers of a vision-language model", Path)
    cli.add(parser, "--tags FILE", "people's labels, a .csv file", Path)
    cli.add(parser, "--likeness FILE", "people's ratings of likeness, a .csv file", Path)
    cli.share(parser, "seed")
    cli.add(parser, "--resume", "go on with what is in DIR")
    cli.share(parser, "workers", "progress")


def _reproduce(options: argparse.Namespace) -> int:
    try:
        made = phase_ppl.reproduce(**cli.arguments(phase_ppl.reproduce, options, say=_say))
    except KeyboardInterrupt:
        _say("phase-ppl: interrupted; go on with the same command and --resume")
        return cli.INTERRUPTED
    print(made)
    print(f"\nWritten to {made.folder}: {PAGE}, {RESULT}")
    return 0


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
