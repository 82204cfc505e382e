"""The command ``reproduce``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli.shared import (
    INTERRUPTED,
    add_progress,
    add_workers,
    command,
    shows_progress,
    whole,
)
from phase_ppl.evaluation.reproduce import PAGE, PROFILES, RESULT


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = command(
        commands,
        "reproduce",
        _reproduce,
        "Run the models of the paper, and hold every number and figure of it against what comes "
        "out, on one page. Without --videos it is a try on generated events, no reproduction.",
        "phase-ppl reproduce --videos test.json --profile quick --out paper",
    )
    parser.add_argument(
        "--videos", metavar="FILE", type=Path, help="phase-test JSON or the authors' release"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, required=True)
    parser.add_argument(
        "--profile",
        choices=PROFILES,
        default=PROFILES[0],
        help="quick (the default): few simulations, the fast planner; paper: as the paper has it; "
        "full: and all lesions, and what is beyond the paper",
    )
    parser.add_argument(
        "--judgments", metavar="FILE", type=Path, help="people's judgments, a .csv file"
    )
    parser.add_argument(
        "--vlm-store", metavar="DIR", type=Path, help="stored answers of a vision-language model"
    )
    parser.add_argument("--tags", metavar="FILE", type=Path, help="people's labels, a .csv file")
    parser.add_argument(
        "--likeness", metavar="FILE", type=Path, help="people's ratings of likeness, a .csv file"
    )
    parser.add_argument("--seed", metavar="N", type=whole(0), default=0, help="default 0")
    parser.add_argument("--resume", action="store_true", help="go on with what is in DIR")
    add_workers(parser)
    add_progress(parser)


def _reproduce(options: argparse.Namespace) -> int:
    names = ("profile", "judgments", "vlm_store", "tags", "likeness", "seed", "workers", "resume")
    try:
        made = phase_ppl.reproduce(
            options.out,
            options.videos,
            progress=shows_progress(options),
            say=_say,
            **{name: getattr(options, name) for name in names},
        )
    except KeyboardInterrupt:
        _say("phase-ppl: interrupted; go on with the same command and --resume")
        return INTERRUPTED
    print(made)
    print(f"\nWritten to {made.folder}: {PAGE}, {RESULT}")
    return 0


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
