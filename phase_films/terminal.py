"""The command ``read-video``."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

import phase_ppl as ppl

_EVENTS: Final = (".json", ".nc")  # endings of the files of events


def add_to(commands: Any, cli: ModuleType) -> None:
    """Add the command, with the help of what the core's own commands are made of."""
    parser = cli.command(
        commands,
        "read-video",
        functools.partial(_read_video, cli),
        "phase-ppl read-video clip.mp4 --layout phase --out clip.json --picture check.png",
        "read an event back from a film of it",
    )
    cli.add(parser, "film FILM", "an .mp4, a .gif, or anything else that ffmpeg reads", Path)
    known = parser.add_mutually_exclusive_group(required=True)
    says = "the world that it shows, such as phase, or an event file of that world"
    cli.add(known, "--layout WORLD", says)
    says = "an event file or a bundled event's name, whose scene it shows: walls, sizes, starts"
    cli.add(known, "--scene EVENT", says)
    says = "frames of the film per frame of the event; default a quarter of a second of the film"
    cli.add(parser, "--frames-per-step N", says, float)
    cli.add(parser, "--start S", "seconds of the film before the event begins", float, 0.0)
    says = "frames in a row in which a body may be lost; default 6"
    cli.add(parser, "--max-gap N", says, cli.whole(0), 6)
    cli.add(
        parser, "--out FILE", ".json or .nc, which the other commands take", Path, required=True
    )
    says = "where to draw what was read over frames of the film, to check it by eye"
    cli.add(parser, "--picture FILE.png", says, Path)
    cli.share(parser, "progress")


def _read_video(cli: ModuleType, options: argparse.Namespace) -> int:
    cli.check_suffix(options.out, _EVENTS)
    ppl.files.writable_folder(options.out.parent)
    if options.picture is not None:
        ppl.files.check_output(options.picture, (".png",))
    layout, scene = options.layout, None
    if options.scene is not None:
        scene = ppl.load_event(options.scene).scene
    elif Path(layout).suffix in _EVENTS:
        layout = ppl.load_events(layout)[0].scene.world
    more = cli.arguments(ppl.read_video, options, scene=scene, layout=layout)
    reading = ppl.read_video(options.film, **more)
    ppl.save_event(reading.event, options.out)
    print(f"{'':16}confidence  least  in frame  interpolated")
    for name, sure in zip(reading.event.scene.world.entities, reading.confidence.T, strict=True):
        least = int(sure.argmin())
        print(
            f"{name:16}{np.median(sure):10.2f}{sure[least]:7.2f}{least:10d}{(sure == 0).sum():14d}"
        )
    written = [options.out]
    if options.picture is not None:
        reading.picture(options.picture)
        written.append(options.picture)
    frames = reading.event.observation.n_frames
    print(f"\n{frames} frames written to {' and '.join(map(str, written))}")
    return 0
