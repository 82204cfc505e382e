"""The command ``read-video``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

import phase_ppl as ppl

_EVENTS: Final = (".json", ".nc")  # endings of event files


def read_video(options: Any) -> None:
    """Read an event back from a film of it.

    Args:
        FILM: an .mp4, a .gif, or anything else that ffmpeg reads
        --layout WORLD: the world of the film, such as phase, or an event file of that world; this
            or --scene is required
        | --scene EVENT: an event file or a bundled event's name with the scene of the film: walls,
            sizes, starts
        --frames-per-step X: frames of the film per frame of the event; default a quarter of a
            second of the film
        --start S: seconds of the film before the event begins
        --max-gap N: frames in a row in which a body may be lost; default 6
        --out FILE: .json or .nc, which the other commands take; required
        --picture FILE: .png, where to draw the reading over frames of the film, to check it by eye
        $progress

    example: phase-ppl read-video clip.mp4 --layout phase --out clip.json --picture check.png
    """
    options.suffix(*_EVENTS)
    if options.picture is not None:
        ppl.files.check_output(options.picture, (".png",))
    layout, scene = options.layout, None
    if options.scene is not None:
        scene = ppl.load_event(options.scene).scene
    elif Path(layout).suffix in _EVENTS:
        layout = ppl.load_events(layout)[0].scene.world
    reading = options.call(ppl.read_video, path=options.film, scene=scene, layout=layout)
    ppl.save_event(reading.event, options.out)
    print(f"{'':16}confidence  least  in frame  interpolated")
    for name, sure in zip(reading.event.scene.world.entities, reading.confidence.T, strict=True):
        least = int(sure.argmin())
        print(
            f"{name:16}{np.median(sure):10.2f}{sure[least]:7.2f}{least:10d}{(sure == 0).sum():14d}"
        )
    if options.picture is not None:
        reading.picture(options.picture)
    written = " and ".join(str(path) for path in (options.out, options.picture) if path)
    print(f"\n{reading.event.observation.n_frames} frames written to {written}")
