"""A video file as frames, decoded by ffmpeg."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import tempfile
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import IO, Final

import imageio_ffmpeg
from PIL import Image

import phase_ppl as ppl

MOST_SAMPLES: Final = 16
_WIDEST: Final = 1280  # pixels; wider films are made smaller


class FilmFile:
    """A video file, decoded by ffmpeg (InvalidEventError: it is missing, or no video)."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = ppl.files.existing_file(path)
        self.said = ppl.errors.shown_path(self.path)  # its name in messages
        self.fps = 0.0  # frames per second, 0 if the file does not say
        self.samples: list[Image.Image] = []  # evenly spaced, the first frame among them
        every, self.n_frames = 1, 0
        for frame in self._decoded():
            if self.n_frames % every == 0:
                self.samples.append(frame)
                if len(self.samples) > MOST_SAMPLES:
                    self.samples, every = self.samples[::2], 2 * every
            self.n_frames += 1

    def frames(self, wanted: set[int]) -> Iterator[tuple[int, Image.Image]]:
        """Yield (number, frame) of the wanted ones, in order."""
        with contextlib.closing(self._decoded()) as decoded:
            for number, frame in enumerate(decoded):
                if number in wanted:
                    yield number, frame
                if number >= max(wanted):
                    return

    def _decoded(self) -> Generator[Image.Image, None, None]:
        """Yield all frames, and note the frame rate."""
        options = ["-hide_banner", "-nostats", "-i", str(self.path)]
        options += ["-f", "image2pipe", "-c:v", "ppm", "-"]
        some = False
        with tempfile.TemporaryFile() as said, self._started(options, said) as process:
            assert process.stdout is not None
            try:
                while process.stdout.readline():  # of each picture: its kind, size, depth
                    width, height = map(int, process.stdout.readline().split())
                    process.stdout.readline()
                    data = process.stdout.read(3 * width * height)
                    if len(data) < 3 * width * height:
                        break
                    some, frame = True, Image.frombytes("RGB", (width, height), data)
                    smaller = _WIDEST, max(1, round(height * _WIDEST / width))
                    yield frame if width <= _WIDEST else frame.resize(smaller)
                process.wait()
            finally:
                process.kill()
            said.seek(0)
            words = said.read().decode(errors="replace")
        if not some:
            last = (words.split("\n\n")[0].strip().splitlines() or ["it is empty"])[-1]
            raise ppl.errors.InvalidEventError(
                f"{self.said}: not a video that can be read ({last.strip()[:200]})"
            )
        rate = re.search(r"Video:.* ([\d.]+) fps", words)
        self.fps = float(rate[1]) if rate else 0.0

    def _started(self, options: Sequence[str], said: IO[bytes]) -> subprocess.Popen[bytes]:
        program = "ffmpeg"
        try:
            program = imageio_ffmpeg.get_ffmpeg_exe()
            # Ctrl-C reaches Python only, which then ends it
            return subprocess.Popen(
                [program, *options], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said,
                start_new_session=True,
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            reason = (isinstance(error, OSError) and error.strerror) or "there is none"
            raise ppl.errors.InvalidEventError(
                f"{self.said}: ffmpeg cannot be started ({program}: {reason}): install "
                "it, or let the environment variable IMAGEIO_FFMPEG_EXE name it"
            ) from error
