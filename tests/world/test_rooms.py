"""Rooms, doors and the ways between them, on cases worked by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import shortest_path

from phase_ppl.world.rooms import DOWN, LEFT, RIGHT, ROOMS_OF_RAY, UNREACHABLE, Rooms
from phase_ppl.world.scene import ARENA
from tests.world.examples import DIRECTIONS, walls

TOP_LEFT, TOP_RIGHT, BOTTOM_RIGHT, BOTTOM_LEFT = range(4)

lengths = st.tuples(*[st.sampled_from([0.0, 2.0, 5.0, 7.5, 10.0])] * 4)


def rooms_of(*length: float) -> Rooms:
    present = {name: r for name, r in zip(DIRECTIONS, length, strict=False) if r}
    return Rooms.from_walls(walls(**present), ARENA, quadrants=True)


THREE_WALLS = rooms_of(10, 7.5, 5)


def test_rooms_carry_the_ids_of_their_landmarks_and_doors_are_the_gaps_between_them() -> None:
    corners = [[8.5, 19.5], [23.5, 19.5], [23.5, 4.5], [8.5, 4.5]]
    rooms = rooms_of()
    assert rooms.room_of(np.array(corners)).tolist() == [0, 1, 2, 3]
    for ray in range(4):
        near = rooms.door_position[ray] + 0.01 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        assert {*rooms.room_of(near).tolist()} == {*ROOMS_OF_RAY[ray]}
    assert THREE_WALLS.door_width.tolist() == [0.0, 2.5, 5.0, 10.0]
    assert THREE_WALLS.door_position[LEFT].tolist() == [7.25, 12.0]
    assert THREE_WALLS.door_position[DOWN].tolist() == [16.0, 4.5]
    assert THREE_WALLS.door_position[RIGHT].tolist() == [21.0, 12.0]  # no wall: 5 from the centre


def test_a_closed_door_sends_the_way_round() -> None:
    assert THREE_WALLS.route(TOP_LEFT, TOP_RIGHT) == (LEFT, DOWN, RIGHT)
    assert THREE_WALLS.route(TOP_RIGHT, TOP_LEFT) == (RIGHT, DOWN, LEFT)
    assert THREE_WALLS.narrowest(TOP_LEFT, TOP_RIGHT) == 2.5
    assert THREE_WALLS.route(TOP_LEFT, TOP_LEFT) == ()
    assert THREE_WALLS.narrowest(TOP_LEFT, TOP_LEFT) == math.inf


def test_paths_lead_through_the_middles_of_doors_and_straight_in_an_open_arena() -> None:
    # (8, 20) -> (7.25, 12) -> (16, 4.5) -> (21, 12) -> (24, 20)
    legs = [(0.75, 8), (8.75, 7.5), (5, 7.5), (3, 8)]
    expected = sum(math.hypot(*leg) for leg in legs)
    assert THREE_WALLS.path_distance([8, 20], [24, 20]) == pytest.approx(expected)
    below = THREE_WALLS.path_distance([[8, 20]], [[8, 4], [12, 14]])
    assert below == pytest.approx([2 * math.hypot(0.75, 8), math.hypot(4, 6)])
    assert THREE_WALLS.distance_into(BOTTOM_LEFT, [8, 20]) == pytest.approx(math.hypot(0.75, 8))
    assert rooms_of().is_open
    assert rooms_of().path_distance([8, 20], [24, 4]) == pytest.approx(16 * math.sqrt(2))
    assert not rooms_of(2).is_open


def test_a_room_behind_two_full_walls_cannot_be_reached() -> None:
    rooms = rooms_of(10, 10)
    assert rooms.route(TOP_LEFT, TOP_RIGHT) is None
    assert rooms.narrowest(TOP_LEFT, TOP_RIGHT) == 0.0
    assert rooms.path_distance([8, 20], [24, 20]) == UNREACHABLE
    assert rooms.route_table[TOP_LEFT, TOP_RIGHT, 0] == -1
    # of two ways through two doors the shorter is taken: from the middle of the left door
    # (11, 12) to that of the lower one (16, 4.5), or from the upper (16, 20.75) to the right one
    assert rooms_of(7.5, 0, 5).route(TOP_LEFT, BOTTOM_RIGHT) == (LEFT, DOWN)


def fewest_doors(rooms: Rooms) -> np.ndarray:
    joined = np.zeros((4, 4))
    for (one, other), width in zip(ROOMS_OF_RAY, rooms.door_width, strict=True):
        joined[one, other] = width > 0
    return shortest_path(joined, directed=False, unweighted=True)


@settings(max_examples=60)
@given(lengths)
def test_routes_use_fewest_doors_and_are_alike_both_ways(wall_lengths: tuple[float, ...]) -> None:
    rooms = rooms_of(*wall_lengths)
    fewest = fewest_doors(rooms)
    for start, end in itertools.product(range(4), repeat=2):
        route, back = rooms.route(start, end), rooms.route(end, start)
        count = math.inf if route is None else len(route)
        assert count == fewest[start, end]
        assert (None if back is None else back[::-1]) == route
        row = rooms.route_table[start, end].tolist()
        assert row[0] == (-1 if route is None else count)
        assert route is None or tuple(row[1 : 1 + len(route)]) == route
