"""The command ``read-video``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

import numpy as np

import phase_ppl
from phase_ppl.cli import commands as cli
from phase_ppl.dataset.load import SUFFIXES
from phase_ppl.world.files import check_output, writable_folder

_PICTURE: Final = ".png"


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = cli.command(
        commands,
        "read-video",
        _read_video,
        "phase-ppl read-video clip.mp4 --layout phase --out clip.json --picture check.png",
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
    cli.add_progress(parser)


def _read_video(options: argparse.Namespace) -> int:
    cli.check_suffix(options.out, SUFFIXES)
    writable_folder(options.out.parent)
    if options.picture is not None:
        check_output(options.picture, (_PICTURE,))
    layout, scene = options.layout, None
    if options.scene is not None:
        scene = phase_ppl.load_event(options.scene).scene
    elif Path(layout).suffix in SUFFIXES:
        layout = phase_ppl.load_events(layout)[0].scene.world
    reading = phase_ppl.read_video(
        options.film,
        scene,
        layout=layout,
        frames_per_step=options.frames_per_step,
        start=options.start,
        max_gap=options.max_gap,
        progress=cli.shows_progress(options),
    )
    phase_ppl.save_event(reading.event, options.out)
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
