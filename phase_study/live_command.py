"""The command ``live``."""

from __future__ import annotations

import contextlib
import signal
import sys
from typing import Any

import phase_ppl as ppl


def live(options: Any) -> None:
    """Steer an agent in the browser, and see what the model believes you want.

    Beside the game stands the posterior over goals, relation and strengths, at every frame.
    docs/live.md tells more. In Python, ppl.study.Live takes worlds of your own.

    Args:
        [EVENT]: play in the scene of an event file, or of a bundled event
        --video ID: one event of a file with many
        --world NAME: $WORLDS, whose scenes are drawn
        --port N: default 8000; 0: any
        --host NAME: default 127.0.0.1: this machine only
        --url URL: address by which people come, such as https://game.example.org
        $seed

    example: phase-ppl live
    """
    from phase_study.study import check_extra

    check_extra()
    from phase_study.live import Live

    scenes = options.world or "PHASE"
    if options.event is not None:
        if options.world is not None:
            raise ppl.errors.InvalidSettingError("--world: an event has a world already")
        scenes = ppl.load_event(options.event, video=options.video).scene
    game = Live(scenes, options.seed or 0)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with contextlib.suppress(KeyboardInterrupt):
        options.call(game.run, ready=lambda url: print(f"{url}   Ctrl-C ends", flush=True))
