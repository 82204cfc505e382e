"""Animations as GIF: all frames, at the right speed, in the right colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from phase_ppl.render import video
from phase_ppl.render.frames import Painter, between_frames
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.picture import ENTITY_COLOURS
from tests.world.examples import make_event, make_scene, make_trajectory


def read(path: Path) -> tuple[list[NDArray[np.uint8]], list[int]]:
    """Return the frames of a GIF (row, column, colour) and how long each is shown, ms."""
    frames, durations = [], []
    with Image.open(path) as picture:
        assert picture.format == "GIF"
        assert picture.info["loop"] == 0  # for ever
        for index in range(picture.n_frames):
            picture.seek(index)
            frames.append(np.asarray(picture.convert("RGB")))
            durations.append(picture.info["duration"])
    return frames, durations


@pytest.mark.parametrize("fields_of_view", [False, True])
def test_a_gif_shows_what_is_drawn_at_20_frames_per_second(
    tmp_path: Path, fields_of_view: bool
) -> None:
    event = make_event(n_frames=5)
    video(event, tmp_path / "event.gif", fields_of_view=fields_of_view)
    frames, durations = read(tmp_path / "event.gif")
    poses = between_frames(event.observation.trajectory, 5)
    painter = Painter(event.scene, fields_of_view)
    assert durations == [50] * 21
    for frame, pose in zip(frames, poses, strict=True):
        drawn = np.asarray(painter.draw(pose)).astype(int)
        difference = np.abs(frame - drawn).max(axis=2)
        assert difference.mean() < 0.1
        assert (difference > 40).sum() < 20  # pixels on an edge
        for colour in ENTITY_COLOURS:  # plain areas are exact
            assert (frame[(drawn == colour).all(axis=2)] == colour).all()
    assert [p.name for p in tmp_path.iterdir()] == ["event.gif"]


@pytest.mark.parametrize("fps", [12, 30, 50, 7.5])
def test_a_gif_lasts_as_long_as_its_frames(tmp_path: Path, fps: float) -> None:
    video(make_event(n_frames=13), tmp_path / "event.gif", fps=fps, frames_per_step=1)
    _, durations = read(tmp_path / "event.gif")
    assert len(durations) == 13
    assert sum(durations) == pytest.approx(1000 * 13 / fps, abs=20)


def test_a_gif_has_at_most_50_frames_per_second(tmp_path: Path) -> None:
    with pytest.raises(InvalidSettingError, match=r"fps=60, but a GIF has at most 50"):
        video(make_event(), tmp_path / "event.gif", fps=60)


def test_observed_and_predicted_stand_beside_each_other(tmp_path: Path) -> None:
    predicted = make_trajectory(3)
    predicted[:, 3, :2] = (20.0, 16.0)
    video(make_event(3), tmp_path / "both.GIF", compare=predicted)
    frames, _ = read(tmp_path / "both.GIF")
    assert frames[-1].shape == (480, 960, 3)
    assert tuple(frames[-1][160, 800]) == ENTITY_COLOURS[3]
    assert frames[-1][5:35, 480:].min() < 150  # the caption


def test_a_single_frame_is_a_gif_too(tmp_path: Path) -> None:
    video(make_trajectory(1), tmp_path / "still.gif", make_scene())
    assert len(read(tmp_path / "still.gif")[0]) == 1
