"""The field of view, occlusion, touch and the observation chain."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from phase_ppl.agents.vision import HALF_ANGLE
from tests.agents.scenes import FULL_WALL_UP, look, scene


def test_half_angle_of_view_is_54_69_degrees() -> None:
    assert math.degrees(HALF_ANGLE) == pytest.approx(54.69, abs=0.01)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.2])
@pytest.mark.parametrize("side", [-1, 1])
def test_cells_inside_the_cone_are_seen_and_outside_are_not(angle: float, side: int) -> None:
    sight = look(scene(red=(16.0, 12.0, angle), blue=(7.0, 3.0), pink=(25.0, 3.0)))
    eye = np.array([16.0, 12.0]) - 0.8 / 6 * np.array([-math.sin(angle), math.cos(angle)])
    checked = 0
    for row in range(20):
        for column in range(20):
            offset = np.array([6.5 + column, 21.5 - row]) - eye
            bearing = math.atan2(-offset[0], offset[1]) - angle
            bearing = math.atan2(math.sin(bearing), math.cos(bearing))
            distance = np.linalg.norm(offset)
            if side * bearing < 0 or distance > 8 or abs(abs(bearing) - HALF_ANGLE) < 0.02:
                continue
            assert sight.cells[row, column] == (abs(bearing) < HALF_ANGLE)
            checked += 1
    assert checked > 40


@pytest.mark.parametrize(("degrees", "seen"), [(45.0, True), (75.0, False), (180.0, False)])
def test_an_item_is_seen_up_to_the_edge_of_the_view(degrees: float, seen: bool) -> None:
    x = 16.0 + 6.0 * math.sin(math.radians(degrees))
    y = 12.0 + 6.0 * math.cos(math.radians(degrees))
    assert look(scene(red=(16.0, 12.0, 0.0), blue=(x, y))).entities[2] == seen


def test_a_wall_and_a_big_body_hide_what_is_behind_them() -> None:
    there: dict[str, Any] = {"red": (13.0, 18.0, -math.pi / 2), "blue": (20.0, 18.0)}
    assert look(scene(**there)).entities[2]
    assert not look(scene(**there, walls=[FULL_WALL_UP])).entities[2]
    there = {"red": (16.0, 5.0, 0.0), "blue": (16.0, 14.0), "green": (24.0, 4.0, 0.0),
             "radius": [0.8, 0.8, 0.8, 1.6]}  # fmt: skip
    assert look(scene(**there, pink=(24.0, 20.0))).entities[2]
    assert not look(scene(**there, pink=(16.0, 9.0))).entities[2]


def test_what_is_touched_and_who_holds_or_is_held_along_with_it_is_observed() -> None:
    assert look(scene(red=(16.0, 12.0, 0.0), blue=(16.0, 10.3))).entities[2]  # from behind
    assert not look(scene(red=(16.0, 12.0, 0.0), blue=(16.0, 9.5))).entities[2]
    behind = scene(red=(16.0, 12.0, 0.0), blue=(16.0, 10.4), green=(16.0, 8.0, 0.0))
    assert look(behind, held=(2, 2)).entities[1]
    # green is in view; its item is behind a wall
    where = scene(
        red=(13.0, 16.0, -math.pi / 2 + 0.6),
        green=(15.0, 19.2, 0.0),
        blue=(17.2, 19.2),
        walls=[FULL_WALL_UP],
    )
    assert look(where).entities[:3] == [True, True, False]
    assert look(where, held=(-1, 2)).entities[:3] == [True, True, True]


def test_full_observation_sees_everything() -> None:
    sight = look(scene(walls=[FULL_WALL_UP]), full_view=True)
    assert sight.entities == [True] * 4
    assert sight.cells.all()
