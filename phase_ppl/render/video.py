"""Animations as MP4: an event, or a prediction beside the observation."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import os
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from phase_ppl.render.frames import (
    Drawable,
    Painter,
    between_frames,
    panel,
    scene_and_trajectory,
    side_by_side,
    write_centred,
)
from phase_ppl.world.errors import (
    InvalidEventError,
    number_of_workers,
    positive_number,
    shown,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import atomic_output, writable_folder
from phase_ppl.world.progress import Bar, counted
from phase_ppl.world.scene import Scene


class Film(os.PathLike[str]):
    """A film in a file; notebooks play it. ``path`` is the file."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    def __repr__(self) -> str:
        return f"<film {self.path}>"

    def _repr_html_(self) -> str:
        data = base64.b64encode(self.path.read_bytes()).decode("ascii")
        source = f"data:video/mp4;base64,{data}"
        return f'<video controls loop style="max-width: 100%" src="{source}"></video>'


def encode_mp4(frames: Iterable[Image.Image], path: Path, fps: float) -> None:
    """Write RGB frames of one even size as H.264 (yuv420p); OSError: ffmpeg's last line."""
    process: subprocess.Popen[bytes] | None = None
    try:
        for frame in frames:
            if process is None:
                process = _start(frame.size, fps, path)
            assert process.stdin is not None
            process.stdin.write(frame.tobytes())
    except BrokenPipeError:
        pass  # ffmpeg gave up: its exit code and its output say why
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


def _start(size: tuple[int, int], fps: float, path: Path) -> subprocess.Popen[bytes]:
    """Start ffmpeg (OSError: it is missing, or cannot be started)."""
    import imageio_ffmpeg

    rate = str(Fraction(fps).limit_denominator(1001))
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", rate]
    codec = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart"]
    program = "ffmpeg"
    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
        return subprocess.Popen(
            [program, "-v", "error", "-y", *source, "-i", "-", *codec, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C reaches Python only, which then ends it
        )  # fmt: skip
    except (OSError, RuntimeError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or "there is none"
        raise OSError(
            f"ffmpeg cannot be started ({program}: {reason}): install it, or let the environment "
            "variable IMAGEIO_FFMPEG_EXE name it"
        ) from error


FRAMES_PER_SECOND: Final = 20
FRAMES_PER_STEP: Final = 5
"""At 20 frames per second a planner step lasts 0.25 s, three times its simulated time."""

_CAPTION_SIZE: Final = 20
_CAPTION_Y: Final = 19


def video(
    what: Drawable,
    path: str | os.PathLike[str],
    scene: Scene | None = None,
    *,
    fps: float = FRAMES_PER_SECOND,
    frames_per_step: int = FRAMES_PER_STEP,
    fields_of_view: bool = False,
    compare: Drawable | None = None,
    compare_scene: Scene | None = None,
    captions: tuple[str, str] = ("observed", "predicted"),
    progress: bool = False,
) -> Film:
    """Write an animation in the look of the PHASE videos as MP4 (H.264).

    Frames of a trajectory are means over a step. Between them, bodies move on straight lines.

    Args:
        what: an event, an observation, or an array (time, entity, coord) of x, y [units],
            angle [rad].
        path: the file, ending in ".mp4"; it appears only once it is complete.
        scene: walls, landmarks and sizes; required unless ``what`` is an event.
        fps: number of drawn frames per second of the film.
        frames_per_step: number of drawn frames per frame of the trajectory.
        fields_of_view: whether to show what each agent can see from its drawn place.
        compare: a second event, observation or array to draw beside the first. An event is drawn in
            its own scene, others in the first's. The shorter one stands still at its end.
        compare_scene: scene in which to draw ``compare``, in place of these.
        captions: texts above the first and the second.
        progress: whether to show a progress bar.

    Returns:
        The film, which a notebook plays.

    Raises:
        InvalidSettingError: a number is out of range, or a trajectory comes without a scene.
        InvalidEventError: a trajectory has the wrong shape, or no frames.
        OutputError: the film cannot be written, or there is no ffmpeg.
    """
    positive_number("fps", fps)
    whole_number("frames_per_step", frames_per_step)
    shown = [scene_and_trajectory(what, scene)]
    if compare is not None:
        beside = None if isinstance(compare, Event) else shown[0][0]
        shown.append(scene_and_trajectory(compare, compare_scene or beside))
    painters = [Painter(of, fields_of_view) for of, _ in shown]
    tracks = [between_frames(track, frames_per_step) for _, track in shown]
    n_frames = max(map(len, tracks))
    poses = [
        np.pad(track, ((0, n_frames - len(track)), (0, 0), (0, 0)), mode="edge") for track in tracks
    ]

    def draw(index: int) -> Image.Image:
        drawn = [painter.draw(track[index]) for painter, track in zip(painters, poses, strict=True)]
        return drawn[0] if compare is None else _beside(drawn, captions)

    moments = counted(range(n_frames), progress, "frame", "drawing")
    return _written(map(draw, moments), path, fps)


def film(draw: Callable[[int], Image.Image], n_frames: int, path: str | os.PathLike[str]) -> Film:
    """Write frames 0, 1, ... that ``draw`` returns as MP4 (OutputError: it cannot be written)."""
    return _written(map(draw, range(n_frames)), path, FRAMES_PER_SECOND)


def _written(frames: Iterable[Image.Image], path: str | os.PathLike[str], fps: float) -> Film:
    with atomic_output(path, (".mp4",)) as part:
        encode_mp4(frames, part, fps)
    return Film(path)


def _beside(drawn: list[Image.Image], captions: tuple[str, str]) -> Image.Image:
    picture = side_by_side([panel(frame) for frame in drawn])
    for index, text in enumerate(captions):
        x = (index + 0.5) * picture.width / len(captions)
        write_centred(picture, text, x, _CAPTION_Y, _CAPTION_SIZE)
    return picture


# --- videos of a whole set of events, in parallel -------------------------------------------------

_LONGEST_NAME: Final = 80


def videos(
    events: Sequence[Event],
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: bool | None = None,
) -> list[Path]:
    """Write an MP4 of each event, ID.mp4, in the look of the PHASE videos.

    A finished video is not made again, so a second call continues an interrupted one. A video
    appears only once it is complete.

    Args:
        events: the events, whose ids are the files' names; characters other than letters, digits,
            ".", "_" and "-" are replaced.
        folder: folder of the videos; it is made unless it exists.
        workers: number of processes; by default one per usable core.
        progress: whether to show a progress bar; None: if stderr is a terminal.

    Returns:
        The files, in the order of the events.

    Raises:
        InvalidEventError: two events have the same id.
        InvalidSettingError: ``workers`` is out of range.
        OutputError: the folder or a film cannot be written, or there is no ffmpeg.
    """
    from phase_ppl.simulator.processes import results

    n_workers = number_of_workers(workers)
    target = writable_folder(folder)
    paths = [target / name for name in _names(events)]
    waiting = [pair for pair in zip(events, paths, strict=True) if not pair[1].is_file()]
    done = len(events) - len(waiting)
    made = results(_filmed, None, waiting, min(n_workers, len(waiting)), "the events")
    with Bar(len(events), done, progress, "video", "filming") as bar, contextlib.closing(made):
        for _, failure in made:
            if failure is not None:
                raise failure.error or OSError(failure.reason)
            bar.update()
    return paths


def _filmed(_: None, job: tuple[Event, Path]) -> None:
    video(*job)


def _names(events: Sequence[Event]) -> list[str]:
    """Return a file name for each event: its id if possible."""
    ids = Counter(event.id for event in events)
    twice = next((name for name, n in ids.items() if n > 1), None)
    if twice is not None:
        raise InvalidEventError(f"two events have the id {shown(twice)}")
    lower = Counter(name.lower() for name in ids)  # many file systems ignore case
    names = []
    for name in ids:
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name)[:_LONGEST_NAME]
        if plain != name or plain.startswith(".") or lower[name.lower()] > 1:
            code = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
            plain = f"{plain.lstrip('.')}-{code}"
        names.append(f"{plain}.mp4")
    return names
