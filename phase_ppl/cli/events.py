"""The commands on events: ``simulate``, ``render``, ``describe`` and ``export``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli.shared import (
    add_planner,
    add_progress,
    check_suffix,
    command,
    event_command,
    load,
    shows_progress,
    whole,
    writable_folder,
)
from phase_ppl.dataset.generated import MANIFEST, read_manifest
from phase_ppl.dataset.load import EXPORTS, PHASE_PICKLE
from phase_ppl.dataset.load import SUFFIXES as EVENT_SUFFIXES
from phase_ppl.dataset.statistics import PHASE
from phase_ppl.evaluation.judgments import all_events
from phase_ppl.render.video import SUFFIXES as FILM_SUFFIXES
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event
from phase_ppl.world.files import write_json

_PICTURE: Final = ".png"
_STRIP: Final = 6
"""Frames of a film strip, where the event has as many."""


def _alpha(text: str) -> int:
    if text not in ("-1", "0", "1", "+1"):
        raise argparse.ArgumentTypeError(f"{text!r} is none of -1, 0, 1")
    return int(text)


def add_to(commands: Any) -> None:
    """Add the commands."""
    _add_goals(commands)
    _add_simulate(commands)
    _add_render(commands)
    _add_describe(commands)
    _add_export(commands)


def _add_goals(commands: Any) -> None:
    command(
        commands, "goals", _goals, "list the 36 goals that an agent can have", "phase-ppl goals"
    )


def _goals(_: argparse.Namespace) -> int:
    print("\n".join(phase_ppl.GOALS))
    return 0


def _add_simulate(commands: Any) -> None:
    parser = event_command(
        commands,
        "simulate",
        _simulate,
        "run the joint simulator from an event's start under a hypothesis",
        "phase-ppl simulate collaborate --goal-red 'Get blue item to red lm' "
        "--goal-green 'get to red agent' --out simulated.mp4",
    )
    for agent in ("red", "green"):
        parser.add_argument(f"--goal-{agent}", metavar="GOAL", required=True)
        parser.add_argument(
            f"--alpha-{agent}", metavar="A", type=_alpha, default=0, help="-1, 0 or 1"
        )
        parser.add_argument(
            f"--strength-{agent}", metavar="NEWTON", type=float, default=450.0, help="default 450"
        )
    add_planner(parser)
    parser.add_argument(
        "--frames", metavar="T", type=whole(2), help="default: as long as the event"
    )
    parser.add_argument(
        "--overlapping", action="store_true", help="though bodies overlap at the start"
    )
    parser.add_argument(
        "--out", metavar="FILE", type=Path, required=True, help=".json, .nc, .mp4 or .gif"
    )


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
        overlapping=options.overlapping,
    )
    if suffix in EVENT_SUFFIXES:
        phase_ppl.save_event(simulated, options.out)
    else:
        phase_ppl.render.video(simulated, options.out)
    print(f"{hypothesis}\n{simulated.observation.n_frames} frames written to {options.out}")
    return 0


def _add_render(commands: Any) -> None:
    parser = event_command(
        commands,
        "render",
        _render,
        "film an event, or draw a frame or a film strip of it",
        "phase-ppl render collaborate --fields-of-view --out collaborate.gif",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--frame", metavar="N", type=int, help="one frame as .png; 0 is the first, -1 the last"
    )
    which.add_argument(
        "--strip",
        metavar="N",
        type=whole(1),
        help=f"N frames side by side as .png; default {_STRIP}",
    )
    parser.add_argument(
        "--fields-of-view", action="store_true", help="show what each agent can see"
    )
    parser.add_argument(
        "--out", metavar="FILE", type=Path, required=True, help=".mp4 or .gif, or .png for pictures"
    )


def _render(options: argparse.Namespace) -> int:
    suffix = check_suffix(options.out, (*FILM_SUFFIXES, _PICTURE))
    one_frame = options.frame is not None
    if suffix != _PICTURE and (one_frame or options.strip is not None):
        what = "--frame" if one_frame else "--strip"
        raise InvalidSettingError(f"{what} draws a picture: --out {options.out} must end in .png")
    event = load(options)
    writable_folder(options.out.parent)
    n_frames = event.observation.n_frames
    shown = f"{n_frames} frames"
    if suffix != _PICTURE:
        phase_ppl.render.video(event, options.out, fields_of_view=options.fields_of_view)
    elif one_frame:
        shown = f"frame {options.frame}"
        phase_ppl.render.image(
            event, options.frame, options.out, fields_of_view=options.fields_of_view
        )
    else:
        n = options.strip or min(_STRIP, n_frames)
        shown = f"{n} frames"
        phase_ppl.render.strip(event, options.out, n, fields_of_view=options.fields_of_view)
    print(f"{shown} of {event.id} written to {options.out}")
    return 0


def _add_describe(commands: Any) -> None:
    parser = command(
        commands,
        "describe",
        _describe,
        "print and draw the statistics of a set of events beside those of PHASE",
        "phase-ppl describe events.json --out out",
    )
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


def _add_export(commands: Any) -> None:
    parser = command(
        commands,
        "export",
        _export,
        "write events in another format, or read the pickles of PHASE's authors",
        "phase-ppl export collaborate compete --to phase-test --out two.json",
    )
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
