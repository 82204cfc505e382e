"""The commands ``generate`` and ``verify``."""

from __future__ import annotations

import argparse
import dataclasses
import re
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli.shared import (
    FAILED,
    INTERRUPTED,
    add_other_versions,
    add_planner,
    add_progress,
    command,
    shows_progress,
    whole,
)
from phase_ppl.dataset.generated import GeneratedEvents, verify
from phase_ppl.dataset.generation.generate import PRESETS, GenerationInterrupted, generate
from phase_ppl.dataset.generation.plan import PHASE500
from phase_ppl.world.scene import TURNINGS

VIDEOS: Final = "videos"
REJECTED_VIDEOS: Final = "videos_rejected"
"""Folders of films in that of the data set; those of rejected draws end in the reason."""


def add_to(commands: Any) -> None:
    """Add the commands."""
    parser = command(
        commands,
        "generate",
        _generate,
        "Make a data set like PHASE: draw situations, simulate them, keep those that show what "
        "they should.",
        "phase-ppl generate --n 20 --seed 1 --out events",
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--n", metavar="N", type=whole(1), help="events, in the paper's proportions")
    size.add_argument("--preset", choices=tuple(PRESETS), help="the paper's 500 events; default")
    size.add_argument(
        "--cell",
        metavar="FAMILY=N",
        type=_cell,
        action="append",
        help="events of a family, such as chasing=10 or hinder:LMA=5; may be given several times",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, required=True)
    add_planner(parser)
    parser.add_argument("--seed", metavar="N", type=whole(0), default=0, help="default 0")
    parser.add_argument(
        "--copies",
        metavar="K",
        type=whole(0),
        default=0,
        help="of each event, with other reflections and colours; default 0",
    )
    parser.add_argument(
        "--replans",
        metavar="K",
        type=whole(0),
        default=0,
        help="copies of each event simulated anew in a layout of the same kind, or with sizes and "
        "strengths moved by one, as far as its family allows; default 0",
    )
    parser.add_argument(
        "--turning",
        choices=TURNINGS,
        default="both",
        help="which way agents can turn, before any reflection; default both",
    )
    parser.add_argument("--workers", metavar="N", type=whole(1), help="default one per core")
    parser.add_argument(
        "--keep-rejected", action="store_true", help="keep the draws that were not good enough"
    )
    parser.add_argument(
        "--videos",
        action="store_true",
        help="film every event, rejected draws too if they are kept, and draw all on one picture",
    )
    parser.add_argument("--resume", action="store_true", help="go on with what DIR holds")
    add_progress(parser)
    add_other_versions(parser)

    check = command(
        commands,
        "verify",
        _verify,
        "Compare a generated data set with its checksums.",
        "phase-ppl verify events",
    )
    check.add_argument("folder", metavar="DIR", type=Path)


def _generate(options: argparse.Namespace) -> int:
    cells = dict(options.cell) if options.cell else PRESETS.get(options.preset, PHASE500)
    try:
        made = generate(
            options.out,
            options.n,
            cells=cells,
            planner=options.planner,
            seed=options.seed,
            copies=options.copies,
            replans=options.replans,
            turning=options.turning,
            workers=options.workers,
            keep_rejected=options.keep_rejected,
            resume=options.resume,
            other_versions=options.other_versions,
            progress=shows_progress(options),
        )
    except GenerationInterrupted as stopped:
        print(f"phase-ppl: {stopped}: phase-ppl generate ... --resume", file=sys.stderr)
        return INTERRUPTED
    _print(made)
    if options.videos:
        _film(made, options)
    given_up = made.manifest["given_up"]
    if given_up:
        print(f"Given up after too many draws: {', '.join(given_up)}", file=sys.stderr)
    return FAILED if given_up else 0


def _film(made: GeneratedEvents, options: argparse.Namespace) -> None:
    shown = shows_progress(options)
    folder = made.path / VIDEOS
    phase_ppl.render.videos(made, folder, workers=options.workers, progress=shown)
    sheets = phase_ppl.render.contact_sheet(made, made.path / "contact_sheet.png", progress=shown)
    print(f"{len(made)} films in {folder}; {', '.join(file.name for file in sheets)}")
    rejected = [
        dataclasses.replace(event, id=f"{event.id}-{re.sub(r'[^A-Za-z0-9]+', '-', reason)}")
        for event, reason in made.rejected()
    ]
    if rejected:
        folder = made.path / REJECTED_VIDEOS
        phase_ppl.render.videos(rejected, folder, workers=options.workers, progress=shown)
        print(f"{len(rejected)} films of rejected draws in {folder}")


def _print(made: GeneratedEvents) -> None:
    """Print how many draws of each kind were kept, and why others were not."""
    manifest = made.manifest
    for cell, kept in manifest["kept"].items():
        if not kept:
            continue
        refused = manifest["rejected"][cell]
        print(f"{cell:<22}{_kept(kept, refused, 'draws')}")
        replans = manifest.get("replans", {}).get(cell)
        if replans and (replans["kept"] or replans["rejected"]):
            told = _kept(replans["kept"], replans["rejected"], "simulations of re-planned copies")
            print(f"{'':<22}{told}")
    splits = Counter(entry["split"] for entry in made.entries)
    parts = ", ".join(f"{n} {name}" for name, n in splits.items())
    print(f"{len(made)} events ({parts}) in {made.path}")
    anew = manifest.get("made_anew")
    if anew:
        print(f"Made anew, since their parts were damaged: {', '.join(anew)}", file=sys.stderr)


def _kept(kept: int, refused: Mapping[str, int], what: str) -> str:
    why = "; ".join(f"{reason} {n}" for reason, n in refused.items())
    return f"{kept:>4} of {kept + sum(refused.values()):>4} {what}{'   ' + why if why else ''}"


def _verify(options: argparse.Namespace) -> int:
    wrong = verify(options.folder)
    for line in wrong:
        print(line)
    if wrong:
        return FAILED
    print(f"{options.folder}: all events are as they were made")
    return 0


def _cell(text: str) -> tuple[str, int]:
    name, equals, number = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form FAMILY=N")
    return name, whole(1)(number)
