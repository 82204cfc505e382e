"""The command ``merge``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli import commands as cli


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "merge",
        _merge,
        "phase-ppl merge shards/* --out events",
        "Put the shards of a data set, an evaluation or a comparison together, to what one call "
        "without --shard makes.",
    )
    cli.add(parser, "folders DIR", "of each shard, in any order", Path, nargs="+")
    cli.add(parser, "--out DIR", "for the whole", Path, required=True)


def _merge(options: argparse.Namespace) -> int:
    merged = phase_ppl.merge(options.folders, options.out)
    print(merged)
    failed = isinstance(merged, phase_ppl.Evaluation) and merged.failures
    return cli.FAILED if failed else 0
