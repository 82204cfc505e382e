"""One frame looks as the PHASE animations do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from phase_ppl.render import draw_frame
from phase_ppl.render.frames import Painter
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.geometry import heading
from phase_ppl.world.names import BLUE_ITEM, GREEN, PINK_ITEM, RED
from phase_ppl.world.picture import ENTITY_COLOURS, LANDMARK_COLOURS
from phase_ppl.world.scene import LANDMARK_CENTRES
from tests.world.examples import START, make_scene, walls

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


def test_a_frame_is_640_by_480_in_rgb() -> None:
    picture = frame()
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert tuple(picture[0, 0]) == WHITE


def test_landmarks_have_their_places_and_colours() -> None:
    picture = frame()
    for centre, colour in zip(LANDMARK_CENTRES, LANDMARK_COLOURS, strict=True):
        assert colour_at(picture, *centre) == colour
        for dx, dy in ((2.2, 2.2), (-2.2, 2.2), (2.2, -2.2), (-2.2, -2.2)):
            assert colour_at(picture, centre[0] + dx, centre[1] + dy) == colour
        inward = np.sign(np.array([16.0, 12.0]) - centre)
        assert colour_at(picture, *(centre + 2.7 * inward)) == WHITE
    assert colour_at(picture, 8.5, 19.5) == (45, 45, 180)  # blue, top left
    assert colour_at(picture, 8.5, 4.5) == (180, 180, 45)  # yellow, bottom left


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


def test_entities_have_their_places_and_colours() -> None:
    picture = frame()
    for pose, colour in zip(POSES, ENTITY_COLOURS, strict=True):
        assert colour_at(picture, pose[0], pose[1]) == colour
    assert ENTITY_COLOURS[BLUE_ITEM] == (117, 216, 230)


@pytest.mark.parametrize("size", [0.8, 1.01, 1.2, 1.6])
def test_bodies_cover_the_area_they_have(size: float) -> None:
    picture = frame(radius=[size] * 4)
    disc = math.pi * (20 * size) ** 2
    assert covered(picture, ENTITY_COLOURS[PINK_ITEM]) == pytest.approx(disc, rel=0.08)
    eyes = 2 * math.pi * (0.14 * 20 * size) ** 2
    agent = 4 * (20 * size) ** 2 - eyes
    assert covered(picture, ENTITY_COLOURS[GREEN]) == pytest.approx(agent, rel=0.14)


@pytest.mark.parametrize("angle", [0.0, 0.5, math.pi / 2, 2.5, -2.0])
def test_two_eyes_look_out_of_the_short_front(angle: float) -> None:
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


def test_edges_are_smooth() -> None:
    picture = frame()
    box = picture[290:345, 230:300].reshape(-1, 3)
    shades = {tuple(int(v) for v in pixel) for pixel in np.unique(box, axis=0)}
    assert len(shades - {WHITE, ENTITY_COLOURS[BLUE_ITEM]}) > 10


def test_a_full_turn_changes_nothing() -> None:
    turned = POSES + np.array([0, 0, 2 * math.pi])
    difference = frame(turned).astype(int) - frame().astype(int)
    assert np.abs(difference).max() <= 8


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1e4, 1e4), min_size=12, max_size=12))
def test_what_is_out_of_the_picture_is_not_drawn(values: list[float]) -> None:
    assert frame(np.array(values).reshape(4, 3)).shape == (480, 640, 3)


def test_a_body_half_out_of_the_picture_is_drawn_in_part() -> None:
    poses = POSES.copy()
    poses[PINK_ITEM, :2] = (0.0, 12.0)
    poses[BLUE_ITEM, :2] = (1e12, 1e12)
    picture = frame(poses)
    half = math.pi * (20 * 1.6) ** 2 / 2
    assert covered(picture, ENTITY_COLOURS[PINK_ITEM]) == pytest.approx(half, rel=0.1)
    assert covered(picture, ENTITY_COLOURS[BLUE_ITEM]) == 0


def test_an_arena_of_another_size_fills_the_same_square() -> None:
    scene = make_scene(
        arena=(0, 10, 0, 10),
        landmark_centres=[[1, 9], [9, 9], [9, 1], [1, 1]],
        landmark_half_width=1,
        start=[[2, 5, 0], [4, 5, 0], [6, 5, 0], [8, 5, 0]],
        radius=[0.5] * 4,
        walls=[],
    )
    assert Painter(scene).pixel([[0, 0], [10, 10]]) == pytest.approx(
        np.array([[120.5, 440.5], [520.5, 40.5]])
    )
    picture = draw_frame(scene, scene.start)
    assert tuple(picture[240, 200]) == ENTITY_COLOURS[RED]


@pytest.mark.parametrize("poses", [START[:3], [[math.nan] * 3] * 4, "poses", None])
def test_poses_that_are_none_are_refused(poses: object) -> None:
    with pytest.raises(InvalidEventError, match="poses"):
        frame(poses)
