"""The command ``render``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

import phase_ppl
from phase_ppl.cli.shared import check_suffix, command, load, whole, writable_folder
from phase_ppl.render.video import SUFFIXES as FILM_SUFFIXES
from phase_ppl.world.errors import InvalidSettingError

_PICTURE: Final = ".png"
_STRIP: Final = 6
"""Frames of a film strip, where the event has as many."""


def add_to(commands: Any) -> None:
    """Add the command."""
    parser = command(
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
