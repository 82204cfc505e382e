"""The command ``export``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli.shared import writable_folder
from phase_ppl.dataset.export import EXPORTS
from phase_ppl.dataset.load import PHASE_PICKLE


def add_to(commands: Any) -> None:
    """Add the command."""
    description = "write events in another format, or read the pickles of PHASE's authors"
    parser = commands.add_parser(
        "export",
        help=description,
        description=description,
        epilog="example: phase-ppl export collaborate compete --to phase-test --out two.json",
    )
    parser.set_defaults(run=_export)
    parser.add_argument(
        "events", metavar="EVENTS", nargs="+", help="files of events, or bundled events' names"
    )
    parser.add_argument(
        "--from",
        dest="source",
        choices=(PHASE_PICKLE,),
        help="the files are pickles of PHASE's authors; plain data are read, no code is run",
    )
    parser.add_argument("--to", choices=tuple(EXPORTS), required=True)
    parser.add_argument("--out", metavar="FILE", type=Path, required=True)


def _export(options: argparse.Namespace) -> int:
    writable_folder(options.out.parent)
    events = [
        event
        for path in options.events
        for event in phase_ppl.load_events(path, format=options.source)
    ]
    phase_ppl.export_events(events, options.out, options.to)
    print(f"{len(events)} event{'s' * (len(events) != 1)} written to {options.out}")
    return 0
