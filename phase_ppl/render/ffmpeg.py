"""ffmpeg, the program that writes and reads videos."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from typing import Any


def ffmpeg(options: Sequence[str], **streams: Any) -> subprocess.Popen[bytes]:
    """Start ffmpeg with options; ``streams`` are those of ``subprocess.Popen``.

    Raises:
        OSError: there is none, or it cannot be started; the message says what to do.
    """
    import imageio_ffmpeg

    program = "ffmpeg"
    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
        # Ctrl-C is for Python, which then ends it
        return subprocess.Popen([program, *options], start_new_session=True, **streams)
    except (OSError, RuntimeError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or "there is none"
        raise OSError(
            f"ffmpeg cannot be started ({program}: {reason}): install it, or let the environment "
            "variable IMAGEIO_FFMPEG_EXE name it"
        ) from error
