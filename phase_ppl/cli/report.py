"""The command ``report``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli.shared import add_progress, check_suffix, shows_progress, writable_folder


def add_to(commands: Any) -> None:
    """Add the command."""
    report = commands.add_parser(
        "report",
        help="make one self-contained HTML page of a run, an evaluation or a comparison",
        description="Make one self-contained HTML page of a run, an evaluation, or a comparison of "
        "models.",
        epilog="example: phase-ppl report out",
    )
    report.set_defaults(run=_report)
    report.add_argument(
        "folder",
        metavar="DIR",
        type=Path,
        help="written by infer --out, evaluate --out or compare-models --out",
    )
    report.add_argument(
        "--out", metavar="FILE", type=Path, help=".html; default report.html in DIR"
    )
    report.add_argument(
        "--videos", action="store_true", help="film every event of an evaluation as well"
    )
    add_progress(report)


def _report(options: argparse.Namespace) -> int:
    if options.out is not None:
        check_suffix(options.out, (".html",))
        writable_folder(options.out.parent)
    path = phase_ppl.report(
        options.folder, options.out, videos=options.videos, progress=shows_progress(options)
    )
    print(f"{path.stat().st_size / 1e6:.1f} MB written to {path}")
    return 0
