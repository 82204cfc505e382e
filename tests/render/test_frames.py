"""One frame looks as the PHASE animations do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.path import Path as Polygon
from numpy.typing import NDArray

from phase_ppl.agents import vision
from phase_ppl.agents.world_model import Layout
from phase_ppl.physics import compiled
from phase_ppl.render import draw_frame
from phase_ppl.render.frames import field_of_view
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import State
from phase_ppl.world.geometry import heading
from phase_ppl.world.names import BLUE_ITEM, GREEN, PINK_ITEM, RED
from phase_ppl.world.picture import ENTITY_COLOURS, LANDMARK_COLOURS
from phase_ppl.world.scene import LANDMARK_CENTRES, Scene
from tests.world.examples import make_scene, walls

WHITE, BLACK = (255, 255, 255), (0, 0, 0)
POSES = np.array([[13.5, 16.0, 0.0], [19.0, 16.0, 0.7], [13.0, 8.0, 0.0], [19.0, 8.0, 0.0]])
SIZES = [0.8, 1.2, 1.01, 1.6]


def frame(poses: object = POSES, **changes: object) -> NDArray[np.uint8]:
    return draw_frame(make_scene(**{"radius": SIZES, **changes}), poses)  # type: ignore[arg-type]


def colour_at(picture: NDArray[np.uint8], x: float, y: float) -> tuple[int, ...]:
    """The colour at a point of the world: 20 pixels per unit, (16, 12) in the middle, y up."""
    return tuple(int(v) for v in picture[round(240 - 20 * (y - 12)), round(320 + 20 * (x - 16))])


def covered(picture: NDArray[np.uint8], colour: tuple[int, ...]) -> int:
    return int((picture == colour).all(axis=2).sum())


def test_a_frame_has_landmarks_and_bodies_in_their_places_and_colours() -> None:
    picture = frame()
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert tuple(picture[0, 0]) == WHITE
    for centre, colour in zip(LANDMARK_CENTRES, LANDMARK_COLOURS, strict=True):
        assert colour_at(picture, *centre) == colour
        for dx, dy in ((2.2, 2.2), (-2.2, 2.2), (2.2, -2.2), (-2.2, -2.2)):
            assert colour_at(picture, centre[0] + dx, centre[1] + dy) == colour
        inward = np.sign(np.array([16.0, 12.0]) - centre)
        assert colour_at(picture, *(centre + 2.7 * inward)) == WHITE
    assert colour_at(picture, 8.5, 19.5) == (45, 45, 180)  # blue, top left
    assert colour_at(picture, 8.5, 4.5) == (180, 180, 45)  # yellow, bottom left
    for pose, colour in zip(POSES, ENTITY_COLOURS, strict=True):
        assert colour_at(picture, pose[0], pose[1]) == colour
    assert ENTITY_COLOURS[BLUE_ITEM] == (117, 216, 230)
    # edges are smooth
    shades = {tuple(map(int, pixel)) for pixel in picture[290:345, 230:300].reshape(-1, 3)}
    assert len(shades - {WHITE, ENTITY_COLOURS[BLUE_ITEM]}) > 10
    # a full turn changes nothing
    difference = frame(POSES + np.array([0, 0, 2 * math.pi])).astype(int) - picture.astype(int)
    assert np.abs(difference).max() <= 8


def test_walls_are_black_and_five_pixels_wide() -> None:
    picture = frame(walls=walls(up=7.5, right=5))
    column = picture[:, 200].astype(int)
    black = (column == 0).all(axis=1)
    assert black.sum() == 10  # the arena's border above and below
    row = (picture[100] == 0).all(axis=1)
    assert row.sum() == 15  # border, inner wall, border
    assert np.flatnonzero(row).tolist()[5:10] == [318, 319, 320, 321, 322]
    assert colour_at(picture, 16, 19) == BLACK
    assert colour_at(picture, 16, 20) == WHITE
    assert colour_at(picture, 20.5, 12) == BLACK
    assert colour_at(picture, 11, 12) == WHITE


def test_two_eyes_look_out_of_the_short_front() -> None:
    angle = 0.5
    poses = POSES.copy()
    poses[GREEN, 2] = angle
    picture = frame(poses, radius=[0.8, 1.6, 1, 1])
    ahead = heading(angle)
    aside = np.array([ahead[1], -ahead[0]])
    for side in (-1, 1):
        eye = poses[GREEN, :2] + 1.6 * (0.62 * ahead + side * 0.24 * aside)
        assert colour_at(picture, *eye) == BLACK
        behind = poses[GREEN, :2] - 1.6 * (0.62 * ahead + side * 0.24 * aside)
        assert colour_at(picture, *behind) == ENTITY_COLOURS[GREEN]
        beside_front = poses[GREEN, :2] + 1.6 * (0.8 * ahead + side * 0.9 * aside)
        assert colour_at(picture, *beside_front) == WHITE
        beside_back = poses[GREEN, :2] + 1.6 * (-0.8 * ahead + side * 1.2 * aside)
        assert colour_at(picture, *beside_back) == ENTITY_COLOURS[GREEN]


def test_what_is_out_of_the_picture_is_not_drawn_and_what_is_half_out_in_part() -> None:
    for far in (-1e4, 30.0, 300.0, 1e12, 1e300):
        assert covered(frame(np.full((4, 3), far)), ENTITY_COLOURS[PINK_ITEM]) == 0
    poses = POSES.copy()
    poses[PINK_ITEM, :2] = (0.0, 12.0)
    half = math.pi * (20 * 1.6) ** 2 / 2
    assert covered(frame(poses), ENTITY_COLOURS[PINK_ITEM]) == pytest.approx(half, rel=0.1)
    for x, y in ((5.8, 12.0), (26.2, 12.0), (1e12, 3.0), (1e300, 1e300)):
        poses[RED, :2] = x, y
        draw_frame(alone(), poses, fields_of_view=True)
    for wrong in (POSES[:3], [[math.inf] * 3] * 4, "poses", None):
        with pytest.raises(InvalidEventError, match="poses"):
            frame(wrong)


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


def test_a_field_of_view_is_what_the_simulator_lets_an_agent_see() -> None:
    rng = np.random.default_rng(0)
    far, different, in_view = 0, 0, 0
    for room in ROOMS * 5:
        place = rng.uniform((7.5, 3.5, -4), (24.5, 20.5, 4), (4, 3))
        scene = make_scene(walls=room, start=place, radius=rng.uniform(0.5, 2, 4))
        agent = int(rng.integers(2))
        points, visible = seen_by_the_simulator(scene, agent, rng.uniform(-0.5, 0.5, 2))
        corners = field_of_view(scene, scene.start, agent)
        clear = distance_to_edge(corners, points) > 0.01
        far += int(clear.sum())
        different += int((Polygon(corners).contains_points(points) != visible)[clear].sum())
        in_view += int(visible.sum())
    assert far > 7500
    assert in_view > 600
    assert different <= 0.0005 * far


def alone(**changes: object) -> Scene:
    """Red in the middle, looking up; everybody else behind it."""
    start = [[16.0, 12.0, 0.0], [8.0, 4.0, 0.0], [12.0, 4.0, 0.0], [20.0, 4.0, 0.0]]
    return make_scene(**{"start": start, "radius": [0.6] * 4, "walls": [], **changes})


def test_an_agent_whose_eye_lies_in_a_wall_or_in_another_body_sees_as_the_rule_says() -> None:
    in_wall = alone(
        start=[[16.0, 17.1, 0.0], [8, 4, 0], [12, 4, 0], [20, 4, 0]], walls=walls(up=10)
    )
    corners = field_of_view(in_wall, in_wall.start, 0)
    assert np.abs(corners - corners[0]).max() < 1e-6
    held = alone(start=[[16.0, 12.1, 0.0], [8, 4, 0], [16.0, 12.3, 0.0], [20, 4, 0]])
    corners = field_of_view(held, held.start, 0)
    points, visible = seen_by_the_simulator(held, 0, np.array([0.03, 0.01]))
    assert np.array_equal(Polygon(corners).contains_points(points), visible)
    assert np.linalg.norm(corners - corners[0], axis=1).max() < 0.31


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
