"""Fields of view are drawn by the simulator's rule."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from phase_ppl.agents import vision
from phase_ppl.agents.world_model import Layout
from phase_ppl.physics import compiled
from phase_ppl.render import draw_frame, image, strip, video
from phase_ppl.render.frames import field_of_view
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import State
from phase_ppl.world.geometry import centre_of_mass
from phase_ppl.world.scene import Scene
from tests.world.examples import make_event, make_scene, walls

from .test_frames import WHITE, colour_at


def inside(corners: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Whether each of (n, 2) points is inside a polygon: a ray to the right crosses it oddly."""
    x, y = points[:, :1], points[:, 1:]
    (ax, ay), (bx, by) = corners.T, np.roll(corners, -1, axis=0).T
    between = (ay > y) != (by > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = ax + (y - ay) * (bx - ax) / (by - ay)
    return np.asarray((between & (x < crossing)).sum(axis=1) % 2 == 1)


def distance_to_edge(corners: FloatArray, points: FloatArray) -> FloatArray:
    edge = np.roll(corners, -1, axis=0) - corners
    offset = points[:, None] - corners
    along = np.clip((offset * edge).sum(2) / np.maximum((edge**2).sum(1), 1e-30), 0, 1)
    return np.asarray(np.linalg.norm(offset - along[..., None] * edge, axis=2).min(axis=1))


def seen_by_the_simulator(
    scene: Scene, agent: int, shift: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return points on a grid shifted by ``shift``, and which the simulator's rule has in view."""
    bodies, _, _ = compiled.from_state(State.at_start(scene), scene.radius)
    layout = Layout.of(scene)
    layout = layout._replace(origin=layout.origin + shift)
    visible = np.zeros(layout.rows * layout.columns, bool)
    params = compiled.make_params(scene, (450.0, 450.0))
    vision.visible_cells(bodies, agent, params, layout, visible)
    row, column = np.divmod(np.arange(len(visible)), layout.columns)
    return layout.origin + np.stack([0.5 + column, -0.5 - row], axis=1), visible


ROOMS = [walls(), walls(up=10), walls(up=7.5, left=10, down=5), walls(left=7.5, right=7.5, up=10)]


@pytest.mark.parametrize("room", range(len(ROOMS)))
def test_a_field_of_view_is_what_the_simulator_lets_an_agent_see(room: int) -> None:
    rng = np.random.default_rng(room)
    far, different, in_view = 0, 0, 0
    for _ in range(25):
        place = rng.uniform((7.5, 3.5, -4), (24.5, 20.5, 4), (4, 3))
        scene = make_scene(walls=ROOMS[room], start=place, radius=rng.uniform(0.5, 2, 4))
        agent = int(rng.integers(2))
        points, visible = seen_by_the_simulator(scene, agent, rng.uniform(-0.5, 0.5, 2))
        corners = field_of_view(scene, scene.start, agent)
        clear = distance_to_edge(corners, points) > 0.01
        far += int(clear.sum())
        different += int((inside(corners, points) != visible)[clear].sum())
        in_view += int(visible.sum())
    assert far > 9500
    assert in_view > 700
    assert different <= 0.0005 * far


def alone(**changes: object) -> Scene:
    """Red in the middle, looking up; everybody else behind it."""
    start = [[16.0, 12.0, 0.0], [8.0, 4.0, 0.0], [12.0, 4.0, 0.0], [20.0, 4.0, 0.0]]
    return make_scene(**{"start": start, "radius": [0.6] * 4, "walls": [], **changes})


def test_without_anything_in_the_way_it_is_a_cone_from_the_centre_of_mass() -> None:
    scene = alone()
    corners = field_of_view(scene, scene.start, 0)
    assert corners[0] == pytest.approx(centre_of_mass(scene.start[0, :2], 0.0, 0.6, 0))
    right, left = corners[1] - corners[0], corners[-1] - corners[0]
    assert math.atan2(right[0], right[1]) == pytest.approx(vision.HALF_ANGLE)
    assert math.atan2(left[0], left[1]) == pytest.approx(-vision.HALF_ANGLE)
    assert np.linalg.norm(corners[1:] - corners[0], axis=1).min() > 40  # far beyond the arena


def test_a_disc_ends_sight_at_its_centre() -> None:
    scene = alone(start=[[16.0, 12.1, 0.0], [8, 4, 0], [16.0, 18.0, 0.0], [20, 4, 0]])
    corners = field_of_view(scene, scene.start, 0)
    eye = corners[0]
    assert eye == pytest.approx([16.0, 12.0])
    points = np.array([[16.0, 17.99], [16.0, 18.01], [16.65, 18.0], [16.55, 18.1]])
    assert inside(corners, points).tolist() == [True, False, True, False]


def test_an_agent_whose_eye_lies_in_a_wall_or_in_another_body_sees_as_the_rule_says() -> None:
    in_wall = alone(
        start=[[16.0, 17.1, 0.0], [8, 4, 0], [12, 4, 0], [20, 4, 0]], walls=walls(up=10)
    )
    corners = field_of_view(in_wall, in_wall.start, 0)
    assert np.abs(corners - corners[0]).max() < 1e-6
    held = alone(start=[[16.0, 12.1, 0.0], [8, 4, 0], [16.0, 12.3, 0.0], [20, 4, 0]])
    corners = field_of_view(held, held.start, 0)
    points, visible = seen_by_the_simulator(held, 0, np.array([0.03, 0.01]))
    assert np.array_equal(inside(corners, points), visible)
    assert np.linalg.norm(corners - corners[0], axis=1).max() < 0.31


# --- drawn -----------------------------------------------------------------------------------


def test_what_an_agent_sees_is_tinted_with_its_colour() -> None:
    scene = alone(walls=walls(right=5))
    poses = scene.start.copy()
    poses[0] = (18.0, 9.0, 0.0)  # red below the wall to the right, looking up
    poses[1] = (9.0, 12.0, math.pi / 2)  # green at the left, looking left
    plain, tinted = draw_frame(scene, poses), draw_frame(scene, poses, fields_of_view=True)
    red, green = colour_at(tinted, 18.0, 11.0), colour_at(tinted, 7.0, 12.0)
    assert red[0] > red[1] + 20
    assert green[1] > green[0] + 20
    for hidden in ((18.5, 14.0), (18.0, 7.5), (10.5, 13.0)):  # by the wall, behind, outside
        assert colour_at(tinted, *hidden) == WHITE
    blue, under = colour_at(plain, 8.5, 18.0), colour_at(tinted, 8.5, 18.0)
    assert (blue[0] + 10 < under[0], blue[2] - 10 > under[2]) == (True, True)  # red's, over a lm
    for x, y in (
        (18.0, 9.0),
        (18.0, 12.0),
        (5.0, 12.0),
        (8.5, 4.5),
    ):  # bodies, wall, outside, yellow lm
        assert colour_at(tinted, x, y) == colour_at(plain, x, y)
    outside = np.ones((480, 640), bool)
    outside[38:443, 118:523] = False
    assert (tinted[outside] == plain[outside]).all()


def test_without_the_option_nothing_is_tinted(tmp_path: Path) -> None:
    event = make_event()
    image(event, -1, tmp_path / "plain.png")
    image(event, -1, tmp_path / "tinted.png", fields_of_view=True)
    plain, tinted = (
        np.asarray(Image.open(tmp_path / name)) for name in ("plain.png", "tinted.png")
    )
    poses = event.observation.trajectory[-1]
    assert np.array_equal(plain, draw_frame(event.scene, poses))
    assert np.array_equal(tinted, draw_frame(event.scene, poses, fields_of_view=True))
    assert not np.array_equal(plain, tinted)


def test_strips_and_videos_show_them_too(tmp_path: Path) -> None:
    event = make_event(n_frames=2)
    strip(event, tmp_path / "plain.png", n=2)
    strip(event, tmp_path / "strip.png", n=2, fields_of_view=True)
    assert (tmp_path / "plain.png").read_bytes() != (tmp_path / "strip.png").read_bytes()
    video(event, tmp_path / "v.gif", fields_of_view=True, compare=event, frames_per_step=1)
    with Image.open(tmp_path / "v.gif") as picture:
        both = np.asarray(picture.convert("RGB")).astype(int)
    poses = event.observation.trajectory[0]
    alone = draw_frame(event.scene, poses, fields_of_view=True)[60:, 80:560]
    assert np.abs(both[60:, :480] - alone).mean() < 0.1
    assert np.abs(both[60:, 480:] - alone).mean() < 0.1


@pytest.mark.parametrize("place", [(5.8, 12.0), (26.2, 12.0), (1e12, 3.0), (1e300, 1e300)])
def test_an_agent_at_or_beyond_the_border_is_drawn(place: tuple[float, float]) -> None:
    poses = alone().start.copy()
    poses[0, :2] = place
    draw_frame(alone(), poses, fields_of_view=True)
