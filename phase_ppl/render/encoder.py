"""Frames to MP4 or GIF, by the ffmpeg that comes with imageio-ffmpeg."""

from __future__ import annotations

import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image

GIF_COLOURS: Final = 256
_FREQUENT_COLOURS: Final = 128
"""Colours of a GIF that are in it for being frequent; the rest for being unlike those."""

MAX_GIF_FPS: Final = 50
"""Frames of a GIF last whole hundredths of a second, and viewers slow down those that last one."""


def encode_mp4(frames: Iterable[Image.Image], path: Path, fps: float) -> None:
    """Write RGB frames of one even size as H.264 (yuv420p) into ``path``.

    Raises:
        OSError: there is no ffmpeg, or it failed; the message is its last word.
    """
    codec = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart"]
    _encode(frames, fps, [*codec, str(path)])


def encode_gif(
    frames: Iterable[Image.Image], path: Path, fps: float, samples: Iterable[Image.Image]
) -> None:
    """Write RGB frames of one size as a GIF that repeats for ever into ``path``.

    All frames share one palette, of colours in ``samples``; there is no dithering, which would
    put noise on plain areas. Of each frame only what changed is stored.

    Raises:
        OSError: there is no ffmpeg, or it failed; the message is its last word.
    """
    with tempfile.TemporaryDirectory() as folder:
        palette = Path(folder) / "palette.png"
        _palette(samples).save(palette)
        filters = ["-i", str(palette), "-lavfi", "paletteuse=dither=none:diff_mode=rectangle"]
        _encode(frames, fps, [*filters, "-loop", "0", str(path)])


def _palette(samples: Iterable[Image.Image]) -> Image.Image:
    """Return up to 256 colours as a picture of 16 x 16 pixels."""
    counts: Counter[Any] = Counter()
    for sample in samples:
        counts.update({c: n for n, c in sample.getcolors(sample.width * sample.height) or ()})
    colours = np.array([colour for colour, _ in counts.most_common()], float)
    chosen = colours[:_FREQUENT_COLOURS]
    # then always the one that is worst represented: edges between shapes that seldom meet
    missed = np.min([((colours - one) ** 2).sum(axis=1) for one in chosen], axis=0)
    while len(chosen) < GIF_COLOURS and missed.any():
        worst = colours[missed.argmax()]
        chosen = np.concatenate([chosen, worst[None]])
        missed = np.minimum(missed, ((colours - worst) ** 2).sum(axis=1))
    filled = chosen[np.arange(GIF_COLOURS) % len(chosen)]
    return Image.fromarray(filled.reshape(16, -1, 3).astype(np.uint8))


def _encode(frames: Iterable[Image.Image], fps: float, result: Sequence[str]) -> None:
    """Hand frames to ffmpeg with the options ``result``."""
    process: subprocess.Popen[bytes] | None = None
    try:
        for frame in frames:
            if process is None:
                process = _start(frame.size, fps, result)
            assert process.stdin is not None
            process.stdin.write(frame.tobytes())
    except BrokenPipeError:
        pass  # ffmpeg gave up: its exit code and its words tell why
    except BaseException:
        if process is not None:
            process.kill()
            process.communicate()
        raise
    if process is None:
        raise OSError("there are no frames")
    _, words = process.communicate()
    if process.returncode != 0:
        lines = words.decode(errors="replace").strip().splitlines() or ["without a word"]
        raise OSError(f"the video encoder failed: {lines[-1]}")


def _start(size: tuple[int, int], fps: float, result: Sequence[str]) -> subprocess.Popen[bytes]:
    import imageio_ffmpeg

    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise OSError(str(error)) from None
    rate = str(Fraction(fps).limit_denominator(1001))
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", rate]
    return subprocess.Popen(
        [program, "-v", "error", "-y", *source, "-i", "-", *result],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for Python, which then ends ffmpeg
    )
