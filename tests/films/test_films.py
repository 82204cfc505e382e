"""Films read back into events."""

from __future__ import annotations

import dataclasses
import functools
import subprocess
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import phase_ppl as ppl
from phase_films import reading as films
from phase_films.film import FilmFile
from phase_ppl.cli import main
from phase_ppl.world.errors import InvalidEventError, OutputError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.scene import Scene
from phase_ppl.world.worlds import SOLO
from tests.world.examples import check_refused, make_scene

STILL = {"fps": 4, "frames_per_step": 1}  # one frame of the film per frame of the event, as quick


def moving(scene: Scene, n_frames: int = 4) -> Event:
    steps = np.arange(n_frames)[:, None, None] * np.array([0.3, -0.2, 0.4])
    track = scene.start + steps
    track[:, len(scene.world.agents) :, 2] = 0.0
    return Event(scene, Observation(track))


def film(event: Event, path: Path) -> Path:
    ppl.render.video(event, path, **STILL)  # type: ignore[arg-type]
    return path


def encoded(path: Path, name: str, *options: str) -> Path:
    out = path.with_name(name)
    program = imageio_ffmpeg.get_ffmpeg_exe()
    subprocess.run([program, "-v", "error", "-i", path, *options, out], check=True)
    return out


def off(reading: ppl.VideoReading, event: Event) -> tuple[float, float]:
    """Return the largest errors of positions, units, and of agents' angles, rad."""
    read, true = reading.event.observation, event.observation
    turned = (read.angles - true.angles)[:, : len(event.scene.world.agents)]
    apart = np.linalg.norm(read.positions - true.positions, axis=2)
    return float(apart.max()), float(np.abs(np.angle(np.exp(1j * turned))).max())


@pytest.fixture(scope="module")
def phase(tmp_path_factory: pytest.TempPathFactory) -> tuple[Event, Path]:
    event = moving(make_scene())
    return event, film(event, tmp_path_factory.mktemp("films") / "phase.mp4")


def test_by_layout_a_film_gives_back_its_event(phase: tuple[Event, Path], tmp_path: Path) -> None:
    event, path = phase
    reading = ppl.read_video(path, layout="phase", progress=False)
    position, angle = off(reading, event)
    assert position < 0.08
    assert angle < 0.08
    scene = reading.event.scene
    assert scene.radius == pytest.approx(event.scene.radius, abs=0.02)
    assert np.array_equal(scene.walls, event.scene.walls[::-1]) or np.array_equal(
        scene.walls, event.scene.walls
    )
    assert np.array_equal(scene.landmark_centres, event.scene.landmark_centres)
    assert np.array_equal(scene.start, reading.event.observation.trajectory[0])
    assert reading.event.truth is None
    assert reading.confidence.shape == (4, 4)
    assert reading.confidence.min() > 0.7
    reading.picture(tmp_path / "check.png")
    with Image.open(tmp_path / "check.png") as picture:
        assert picture.size == (3 * 480, 2 * (480 + 30 + 4))


def test_a_small_film_of_another_world_is_read_by_its_scene_or_its_world(tmp_path: Path) -> None:
    world = dataclasses.replace(SOLO, predicates=[ppl.Predicate("in", "ball", room="barn")])
    event = moving(world.scene({"red agent": (5, 6, 3), "ball": (18, 8), "box": (19.8, 8.5)}))
    path = encoded(film(event, tmp_path / "large.mp4"), "small.mp4", "-vf", "scale=520:-2")
    reading = ppl.read_video(path, event.scene, progress=False)
    position, angle = off(reading, event)
    assert position < 0.15
    assert angle < 0.15
    assert reading.event.scene is event.scene
    by_world = ppl.read_video(path, layout=world, progress=False)
    assert by_world.event.scene.world == world
    assert off(by_world, event)[0] < 0.2


def test_a_rounded_rate_takes_no_frame_for_the_one_before(phase: tuple[Event, Path]) -> None:
    event, path = phase
    whole, rounded = (
        ppl.read_video(path, event.scene, frames_per_step=step, progress=False)
        for step in (2, 1.9999)
    )
    np.testing.assert_array_equal(
        rounded.event.observation.trajectory, whole.event.observation.trajectory
    )


def test_a_film_that_does_not_say_how_fast_it_is_needs_to_be_told(
    phase: tuple[Event, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    event, path = phase

    class Unknown(FilmFile):
        def __init__(self, path: Any) -> None:
            super().__init__(path)
            self.fps = 0.0

    monkeypatch.setattr(films, "FilmFile", Unknown)
    for given, said in (
        ({}, "does not say how fast it is: give frames_per_step="),
        ({"frames_per_step": 1, "start": 0.25}, "how fast it is: start= cannot be found"),
    ):
        with pytest.raises(InvalidEventError, match=said):
            ppl.read_video(path, event.scene, progress=False, **given)


def test_bars_beside_it_and_a_still_beginning_are_left_out(phase: tuple[Event, Path]) -> None:
    event, path = phase
    filters = "tpad=start=2:start_mode=clone,pad=900:500:100:10"
    wide = encoded(path, "bars.mp4", "-vf", filters)
    reading = ppl.read_video(wide, event.scene, start=0.5, progress=False)
    assert reading.event.observation.n_frames == event.observation.n_frames
    assert off(reading, event)[0] < 0.15


def test_what_is_covered_is_interpolated_or_named_with_its_frames(tmp_path: Path) -> None:
    # the blue item lies still; in frames 1 and 2 the green agent is above it
    scene = make_scene(radius=[0.8, 1.6, 0.5, 1.2])
    track = np.repeat(scene.start[None], 8, axis=0)
    track[1:3, 1, :2] = scene.start[2, :2] + [0.1, 0.2]
    event = Event(scene, Observation(track))
    path = film(event, tmp_path / "hidden.mp4")
    reading = ppl.read_video(path, scene, progress=False)
    assert np.flatnonzero(reading.confidence[:, 2] == 0).tolist() == [1, 2]
    assert off(reading, event)[0] < 0.08
    assert "2 places interpolated" in repr(reading)
    with pytest.raises(
        InvalidEventError, match=r"blue item is not found in frames 1 to 2, 0.25 to"
    ):
        ppl.read_video(path, scene, max_gap=1, progress=False)


def test_a_film_of_another_scene_is_refused(phase: tuple[Event, Path]) -> None:
    event, path = phase
    more = [*event.scene.walls, [(16, 12), (16, 4)]]
    elsewhere = np.array(event.scene.start)
    elsewhere[0, 1] += 1
    for change, said in (
        ({"walls": more}, r"does not show the scene's wall .*16.0, 4.0"),
        ({"walls": event.scene.walls[:1]}, "a wall .* that the scene does not have"),
        ({"start": elsewhere}, "red agent starts at .8.0, 21.0. in the scene, but at .8"),
    ):
        scene = dataclasses.replace(event.scene, **change)
        with pytest.raises(InvalidEventError, match=said):
            ppl.read_video(path, scene, progress=False)


def test_what_is_no_film_or_one_of_another_world_is_refused(
    phase: tuple[Event, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    event, path = phase
    grey = ppl.World(["red agent", "grey agent"], [], {"home": (8, 8)}, name="small")
    alike = ppl.World(["red agent", "red one"], [], {"home": (8, 8)})
    (tmp_path / "text.mp4").write_text("no film")
    for source, given, said in (
        (path, {"layout": grey}, "the colour of the grey agent, (130, 130, 130)"),
        (path, {"layout": "trio"}, "no arena is found"),
        (path, {"layout": alike}, "too near each other"),
        (path, {"layout": "phas"}, "did you mean 'PHASE'"),
        (path, {}, "either the scene= "),
        (path, {"scene": event.scene, "layout": "phase"}, "either the scene= "),
        (path, {"layout": "phase", "frames_per_step": 0.5}, "frames_per_step=0.5, expected"),
        (path, {"layout": "phase", "start": -1}, "start=-1, expected"),
        (path, {"layout": "phase", "max_gap": -1}, "max_gap=-1, expected"),
        (path, {"layout": 5}, "layout=5, expected a phase_ppl.World"),
        (path, {"layout": "phase", "frames_per_step": 9}, "fewer than 2 frames of an event"),
        (tmp_path / "text.mp4", {"layout": "phase"}, "text.mp4: not a video that can be read"),
        (tmp_path / "none.mp4", {"layout": "phase"}, "none.mp4: no such file"),
    ):
        check_refused(functools.partial(ppl.read_video, source, **given), said)  # type: ignore[arg-type]
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    said = r"ffmpeg cannot be started \(/nowhere/ffmpeg: No such file.*IMAGEIO_FFMPEG_EXE"
    with pytest.raises(InvalidEventError, match=said):
        ppl.read_video(path, layout="phase")
    with pytest.raises(OutputError, match=r"check.jpg: expected a name in .png"):
        ppl.VideoReading(event, np.ones((4, 4)), {}).picture(tmp_path / "check.jpg")


def test_the_terminal_reads_a_film(
    phase: tuple[Event, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    event, path = phase
    ppl.save_event(event, tmp_path / "true.json")
    out, picture = tmp_path / "read.json", tmp_path / "check.png"
    command = ["read-video", str(path), "--scene", str(tmp_path / "true.json"), "--out", str(out)]
    assert main([*command, "--picture", str(picture), "--quiet"]) == 0
    assert "4 frames written" in capsys.readouterr().out
    assert ppl.load_event(out).observation.positions == pytest.approx(
        event.observation.positions, abs=0.08
    )
    assert picture.is_file()
