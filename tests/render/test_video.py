"""Videos and animations, stills and film strips."""

from __future__ import annotations

import dataclasses
import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from phase_ppl.render import contact_sheet, image, strip, video, videos
from phase_ppl.render.frames import THUMBNAIL, UNKNOWN_COLOUR, Painter, thumbnail
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, OutputError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.picture import SCENARIO_COLOURS
from tests.world.examples import make_event, make_scene, make_trajectory


def read(path: Path) -> tuple[str, NDArray[np.uint8]]:
    """Return what ffmpeg says about a video, and its frames (frame, row, column, colour)."""
    source = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path)]
    result = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run([*source, *result], capture_output=True, check=True)
    about = next(line for line in done.stderr.decode().splitlines() if "Video: h264" in line)
    width, height = (int(n) for n in re.findall(r" (\d{3,})x(\d{3,})", about)[0])
    return about, np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)


def close(picture: NDArray[np.uint8], row: int, column: int, colour: tuple[int, ...]) -> bool:
    return bool(np.abs(picture[row, column].astype(int) - colour).max() < 25)


PINK, WHITE = (255, 153, 153), (255, 255, 255)


def test_a_video_shows_every_step_for_a_quarter_second_from_start_to_end(tmp_path: Path) -> None:
    trajectory = make_trajectory(4)
    trajectory[-1, 3] = (20.0, 16.0, 0.0)
    video(trajectory, tmp_path / "event.mp4", make_scene())
    about, frames = read(tmp_path / "event.mp4")
    assert "yuv420p" in about
    assert "20 fps" in about
    assert frames.shape == (3 * 5 + 1, 480, 640, 3)
    assert close(frames[0], 320, 400, PINK)  # (20, 8)
    assert close(frames[-1], 160, 400, PINK)  # (20, 16)
    assert not close(frames[-1], 320, 400, PINK)
    assert [p.name for p in tmp_path.iterdir()] == ["event.mp4"]


def test_observed_and_predicted_stand_beside_each_other_each_in_its_scene(tmp_path: Path) -> None:
    predicted = make_trajectory(6)
    predicted[:, 3, :2] = (20.0, 16.0)
    other = Event(make_scene(walls=[]), Observation(predicted))
    options = {"compare": other, "fps": 12, "frames_per_step": 2, "fields_of_view": True}
    video(make_event(n_frames=4), tmp_path / "both.mp4", **options)  # type: ignore[arg-type]
    about, frames = read(tmp_path / "both.mp4")
    assert "12 fps" in about
    assert frames.shape == (5 * 2 + 1, 480, 960, 3)  # as long as the longer one
    for shown in (frames[0], frames[-1]):
        assert close(shown, 320, 320, PINK)  # observed: (20, 8) in the left square
        assert close(shown, 160, 800, PINK)  # predicted: (20, 16) in the right square
    for half in (frames[0, 5:35, :480], frames[0, 5:35, 480:]):
        assert half.min() < 150  # the captions
    assert close(frames[0], 100, 240, (0, 0, 0))  # the wall up, on the left only
    assert close(frames[0], 100, 720, WHITE)


Write = Callable[..., object]


def picture(event: Event, path: Path, frame: int = 0) -> None:
    image(event, frame, path)


REFUSED: list[tuple[type[Exception], Write, str, dict[str, Any], str]] = [
    (OutputError, video, "event.webp", {}, "event.webp: expected a name in .mp4"),
    (OutputError, strip, "event.jpg", {"n": 2}, "event.jpg: expected a name in .png"),
    (OutputError, video, "none/event.mp4", {}, "cannot write .*none/event.mp4"),
    (InvalidSettingError, video, "event.mp4", {"fps": 0}, "fps=0"),
    (InvalidSettingError, strip, "strip.png", {"n": 5}, "n=5, expected one of 1..4"),
    (InvalidSettingError, picture, "event.png", {"frame": 4}, "frame=4, expected one of 0..3"),
    (InvalidEventError, video, "event.mp4", {"compare": np.zeros((3, 4))}, "trajectory"),
]  # fmt: skip


def test_what_cannot_be_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for error, write, name, options, said in REFUSED:
        with monkeypatch.context() as patch:
            if write is video:  # before anything is drawn
                patch.setattr(Painter, "draw", lambda *_: pytest.fail("drawn"))
            with pytest.raises(error, match=said):
                write(make_event(n_frames=4), tmp_path / name, **options)
    with pytest.raises(InvalidSettingError, match="give its scene="):
        video(make_trajectory(), tmp_path / "event.mp4")
    with pytest.raises(InvalidEventError, match="trajectory"):
        video(None, tmp_path / "event.mp4", make_scene())  # type: ignore[arg-type]
    assert not any(tmp_path.iterdir())


def no_encoder() -> str:
    raise RuntimeError("No ffmpeg exe could be found.")


def test_an_interrupted_video_leaves_the_old_one_and_an_encoder_that_fails_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "event.mp4"
    target.write_bytes(b"old")
    drawn: list[int] = []
    draw = Painter.draw

    def failing(painter: Painter, poses: object) -> Image.Image:
        drawn.append(1)
        if len(drawn) == 6:
            raise KeyboardInterrupt
        return draw(painter, poses)  # type: ignore[arg-type]

    monkeypatch.setattr(Painter, "draw", failing)
    with pytest.raises(KeyboardInterrupt):
        video(make_event(), target)
    for encoder, said in (
        (no_encoder, "ffmpeg cannot be started .*: there is none"),
        (lambda: "false", "the video encoder failed"),
    ):
        monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", encoder)
        with pytest.raises(OutputError, match=rf"cannot write .*event.mp4: {said}") as raised:
            video(make_event(), target)
        assert "\n" not in str(raised.value)
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_film_strip_has_a_picture_per_frame_and_its_time(tmp_path: Path) -> None:
    event, n = make_event(n_frames=4), 4
    strip(event.observation, tmp_path / "strip.png", n=n, scene=event.scene)
    picture = np.asarray(Image.open(tmp_path / "strip.png"))
    assert picture.shape == (336, 300 * n, 3)
    for index in range(n):
        panel = picture[:, 300 * index : 300 * (index + 1)]
        blue_landmark = panel[62, 62].astype(int)
        assert np.abs(blue_landmark - (45, 45, 180)).max() < 5
        assert panel[300:].min() < 150  # the caption


def named(*ids: str) -> list[Event]:
    return [make_event(2, id) for id in ids]


def colours(path: Path) -> set[tuple[int, int, int]]:
    with Image.open(path) as picture:
        found = picture.convert("RGB").getcolors(2**24)
    return {colour for _, colour in found}  # type: ignore[misc, union-attr]


def test_a_thumbnail_shows_start_way_and_end() -> None:
    trajectory = np.repeat(make_trajectory(1), 3, axis=0)
    trajectory[:, 3, 0] = 20.0
    trajectory[:, 3, 1] = 8.0, 13.0, 18.0
    picture = np.asarray(thumbnail(Event(make_scene(walls=[]), Observation(trajectory)), 400))

    def at(x: float, y: float) -> list[int]:
        scale = 400 / (480 - 2 * 36) * 20
        row, column = 200 - (y - 12) * scale, 200 + (x - 16) * scale
        return picture[int(row), int(column)].astype(int).tolist()

    assert at(20, 18) == [255, 153, 153]
    faint = at(20.8, 8)
    assert 180 < faint[1] < 250
    assert at(20, 13) != [255, 255, 255]
    assert at(22.5, 13) == [255, 255, 255]


def test_a_sheet_has_a_thumbnail_and_a_colour_for_each_event(tmp_path: Path) -> None:
    one = make_event(2, "one")  # competing
    unknown = dataclasses.replace(one, id="two " * 30, truth=None)
    file = contact_sheet([one, unknown], tmp_path / "sheet.png", columns=2)
    assert {SCENARIO_COLOURS["competing"], UNKNOWN_COLOUR} <= colours(file)
    assert SCENARIO_COLOURS["opposing"] not in colours(file)
    with Image.open(file) as picture:
        assert 2 * THUMBNAIL < picture.width < 2.5 * THUMBNAIL
        # the key of each colour is above the thumbnails
        above = picture.convert("RGB").crop((0, 0, picture.width, picture.height - THUMBNAIL - 60))
        found = {colour for _, colour in above.getcolors(10**6)}  # type: ignore[misc, union-attr]
    assert {SCENARIO_COLOURS["competing"], UNKNOWN_COLOUR} <= found
    contact_sheet(named(*"abcdefghi"), file, progress=False)
    with Image.open(file) as picture:
        assert 0.75 < picture.width / picture.height < 1, "it is about square"


def test_every_event_gets_a_video_and_none_is_made_twice(tmp_path: Path) -> None:
    folder = tmp_path / "the films"
    files = videos(named("a", "b"), folder, workers=2)  # processes
    assert [file.name for file in files] == ["a.mp4", "b.mp4"]
    assert all(file.stat().st_size > 1000 for file in files)
    os.utime(files[0], (1, 1))
    files[1].unlink()
    assert videos(named("a", "b"), folder, workers=1) == files
    assert files[0].stat().st_mtime == 1
    assert sorted(folder.iterdir()) == files


def test_two_videos_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidEventError, match="'a'"):
        videos(named("a", "b", "a"), tmp_path)
    with pytest.raises(InvalidSettingError, match="workers"):
        videos(named("a"), tmp_path, workers=0)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        videos(named("a"), tmp_path / "file")
