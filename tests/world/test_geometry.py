"""Shapes and predicates, by hand and against brute-force sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.geometry import (
    TOUCH_ENLARGEMENT,
    agent_outline,
    centre_of_mass,
    heading,
    overlaps,
    penetration,
    rotation,
    shapes_meet,
    touches,
)
from phase_ppl.world.names import BLUE_ITEM, GREEN, PINK_ITEM, RED

SIZES = (0.8, 1.01, 1.2, 1.6)
FAR = [[100.0, 0, 0], [200.0, 0, 0], [300.0, 0, 0], [400.0, 0, 0]]
coordinate = st.floats(-3.5, 3.5)
pose = st.tuples(coordinate, coordinate, st.floats(-7, 7))
size = st.sampled_from(SIZES)
pairs = st.sampled_from(
    [(RED, GREEN), (GREEN, RED), (RED, BLUE_ITEM), (PINK_ITEM, GREEN), (BLUE_ITEM, PINK_ITEM)]
)


Pair = tuple[int, int, FloatArray, FloatArray]
"""Two entities, poses and radii of all, the others far away."""


@st.composite
def placed_pairs(draw: st.DrawFn) -> Pair:
    first, second = draw(pairs)
    poses, radii = np.array(FAR), np.ones(4)
    poses[[first, second]] = draw(pose), draw(pose)
    radii[[first, second]] = draw(size), draw(size)
    return first, second, poses, radii


def test_the_front_of_an_agent_is_the_short_side_its_heading_points_to() -> None:
    assert heading(0.0) == pytest.approx([0, 1])
    assert heading(math.pi / 2) == pytest.approx([-1, 0])  # counter-clockwise from up
    for angle in (0.7, -2.0, 9.0):
        corners = agent_outline(np.array([2.0, 3.0, angle]), 1.2)
        front = corners[1:3].mean(axis=0)
        assert front == pytest.approx(np.array([2.0, 3.0]) + 1.2 * heading(angle))
        assert np.linalg.norm(corners[2] - corners[1]) == pytest.approx(1.2)
        assert np.linalg.norm(corners[3] - corners[0]) == pytest.approx(3.6)
        assert heading(angle) == pytest.approx(rotation(angle) @ [0, 1])


def test_centre_of_mass_is_the_centroid_of_the_outline() -> None:
    radius = 1.01
    x, y = agent_outline(np.array([5.0, 5.0, 0.9]), radius).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = cross.sum() / 2
    centroid = [
        ((x + np.roll(x, -1)) * cross).sum() / (6 * area),
        ((y + np.roll(y, -1)) * cross).sum() / (6 * area),
    ]
    assert abs(area) == pytest.approx(4 * radius**2)
    assert centre_of_mass(np.array([5.0, 5.0]), 0.9, radius, RED) == pytest.approx(centroid)
    assert centre_of_mass(np.array([1.0, 2.0]), 0.9, radius, BLUE_ITEM).tolist() == [1.0, 2.0]


def test_two_touch_up_to_where_the_enlarged_one_reaches() -> None:
    for entity, other, radii, place, reach in (
        # one enlarged reaches the other
        (BLUE_ITEM, PINK_ITEM, [1, 1, 0.8, 1.6], (1, 0, 0), 0.8 + TOUCH_ENLARGEMENT * 1.6),
        # the agent's front lies at R, the item enlarged reaches 1.2 r
        (RED, BLUE_ITEM, [1, 1, 0.8, 0.8], (0, 1, 0), 1.0 + 1.2 * 0.8),
        # the front enlarged about the centre of mass: -1/6 + 1.2 (1 + 1/6) = 37/30
        (BLUE_ITEM, RED, [1, 1, 0.8, 0.8], (0, -1, 0), -1 / 6 + 1.2 * 7 / 6 + 0.8),
        # backs: own at -1; the other's, enlarged, 1/6 + 1.2 * 5/6 = 7/6 behind its centre
        (RED, GREEN, [1] * 4, (0, -1, math.pi), 1.0 + (-1 / 6 + 1.2 * 5 / 6 + 1 / 3)),
    ):
        for distance, touching in ((reach - 1e-9, True), (reach + 1e-6, False)):
            poses = np.array(FAR)
            poses[entity] = 0.0
            poses[other] = distance * place[0], distance * place[1], place[2]
            assert touches(entity, other, poses, np.array(radii)) is touching
    poses = np.array(FAR)
    poses[RED], poses[BLUE_ITEM] = 0.0, (0.1, -0.2, 0.0)  # an item inside an agent
    assert touches(RED, BLUE_ITEM, poses, np.array([1.6, 1.0, 0.1, 0.8]))


def test_two_that_just_touch_meet_and_are_not_inside_each_other() -> None:
    for place in ((2.0, 0.0), (0.0, 2.0)):
        poses = np.array(FAR)
        poses[BLUE_ITEM], poses[PINK_ITEM] = 0.0, (*place, 0.0)
        assert shapes_meet(BLUE_ITEM, PINK_ITEM, poses, np.ones(4))
        assert overlaps(poses, np.ones(4), np.empty((0, 2, 2)))
        assert penetration(poses[BLUE_ITEM, None, :2], poses[PINK_ITEM, None, :2], 2.0) == 0
    beside = np.array([[[-1.0, -3.0], [-1.0, 3.0]]])
    poses[PINK_ITEM] = FAR[PINK_ITEM]
    assert not overlaps(poses, np.ones(4), beside)  # a wall may be touched


def contains(
    entity: int, pose: FloatArray, radius: float, enlarge: float, points: FloatArray
) -> BoolArray:
    """Whether each point lies in the enlarged shape, by the definition of the shape."""
    if entity >= 2:
        return np.hypot(*(points - pose[:2]).T) <= radius * enlarge
    local = (points - pose[:2]) @ rotation(pose[2]) / radius
    centre = np.array([0.0, -1 / 6])
    x, y = ((local - centre) / enlarge + centre).T
    # half the width falls from 1.5 at the back to 0.5 at the front
    return (np.abs(y) <= 1) & (np.abs(x) <= 1 - y / 2)


def found_in_both(
    first: int, second: int, poses: FloatArray, radii: FloatArray, grown: float
) -> bool:
    """Whether any point of a fine grid lies in ``first`` and in ``second`` enlarged 1.2 times."""
    reach = 2.2 * radii[first] * grown
    side = np.linspace(-reach, reach, 120)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) + poses[first, :2]
    inside = contains(first, poses[first], radii[first], grown, grid)
    return bool((inside & contains(second, poses[second], radii[second], 1.2 * grown, grid)).any())


@settings(max_examples=60)
@given(placed_pairs())
def test_touch_agrees_with_sampled_points(pair: Pair) -> None:
    meets = touches(*pair)
    first, second, *placed = pair
    assert shapes_meet(*pair, 1.0, 1.3) == shapes_meet(second, first, *placed, 1.3, 1.0)
    if found_in_both(*pair, grown=1.0):
        assert meets
    if meets:  # a grid misses thin overlaps, not those of shapes a little larger
        assert found_in_both(*pair, grown=1.1)
