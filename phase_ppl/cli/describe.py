"""The command ``describe``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import phase_ppl
from phase_ppl.cli.shared import add_progress, shows_progress, writable_folder
from phase_ppl.dataset.counts import PHASE
from phase_ppl.dataset.generation.store import MANIFEST, read_manifest
from phase_ppl.evaluation.judgments import all_events
from phase_ppl.world.event import Event
from phase_ppl.world.files import write_json


def add_to(commands: Any) -> None:
    """Add the command."""
    description = "print and draw the statistics of a set of events beside those of PHASE"
    parser = commands.add_parser(
        "describe",
        help=description,
        description=description,
        epilog="example: phase-ppl describe events.json --out out",
    )
    parser.set_defaults(run=_describe)
    parser.add_argument(
        "events",
        metavar="EVENTS",
        type=Path,
        help="a generated set, an event file, or a folder of event files",
    )
    parser.add_argument(
        "--beside", metavar="EVENTS", type=Path, help="another set to compare with, not PHASE"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="write statistics.json, data_card.png and contact_sheet.png there",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, not a table")
    add_progress(parser)


def _describe(options: argparse.Namespace) -> int:
    from phase_ppl.analysis.data_table import data_table

    out = None if options.out is None else writable_folder(options.out)
    events, found = _statistics(options.events)
    beside = PHASE if options.beside is None else _statistics(options.beside)[1]
    if options.json:
        print(json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False))
    else:
        print(data_table(found, beside))
    if out is None:
        return 0
    write_json(out / "statistics.json", found)
    phase_ppl.plot.data_card(found, out / "data_card.png", beside=beside)
    sheets = phase_ppl.render.contact_sheet(
        events, out / "contact_sheet.png", progress=shows_progress(options)
    )
    if not options.json:
        names = ", ".join(["statistics.json", "data_card.png", *(sheet.name for sheet in sheets)])
        print(f"\nWritten to {out}: {names}")
    return 0


def _statistics(path: Path) -> tuple[list[Event], Mapping[str, Any]]:
    events = all_events(path)
    whole = path.resolve()
    generated = (path / MANIFEST).is_file()
    manifest = read_manifest(path) if generated else None
    name = whole.name if path.is_dir() else whole.stem
    return events, phase_ppl.statistics(events, manifest, name=name)
