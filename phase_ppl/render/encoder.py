"""Frames to MP4, by the ffmpeg that comes with imageio-ffmpeg."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

from PIL import Image


def encode(frames: Iterable[Image.Image], path: Path, fps: float) -> None:
    """Write RGB frames of one even size as H.264 (yuv420p) into ``path``.

    Raises:
        OSError: there is no ffmpeg, or it failed; the message is its last word.
    """
    process: subprocess.Popen[bytes] | None = None
    try:
        for frame in frames:
            if process is None:
                process = _start(frame.size, path, fps)
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


def _start(size: tuple[int, int], path: Path, fps: float) -> subprocess.Popen[bytes]:
    import imageio_ffmpeg

    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise OSError(str(error)) from None
    rate = str(Fraction(fps).limit_denominator(1001))
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", rate]
    result = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart"]
    return subprocess.Popen(
        [program, "-v", "error", "-y", *source, "-i", "-", "-an", *result, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for Python, which then ends ffmpeg
    )
