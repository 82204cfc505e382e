"""Rooms, doors and the ways between them, on cases worked by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.rooms import DOWN, LEFT, RIGHT, ROOMS_OF_RAY, UNREACHABLE, UP, Rooms
from phase_ppl.world.scene import ARENA
from tests.world.examples import DIRECTIONS, walls

TOP_LEFT, TOP_RIGHT, BOTTOM_RIGHT, BOTTOM_LEFT = range(4)

# wall lengths up, left, down, right of the layouts of the published videos
LAYOUTS = {
    0: (0, 0, 0, 0), 2: (10, 5, 0, 0), 4: (10, 7.5, 0, 0), 6: (10, 0, 5, 0),
    7: (10, 5, 5, 0), 8: (10, 7.5, 5, 0), 9: (5, 10, 5, 0), 10: (7.5, 10, 5, 0),
    12: (10, 0, 7.5, 0), 13: (10, 5, 7.5, 0), 14: (10, 7.5, 7.5, 0), 15: (7.5, 10, 7.5, 0),
    16: (10, 5, 5, 5), 17: (10, 7.5, 5, 5), 18: (10, 5, 7.5, 5), 19: (10, 7.5, 7.5, 5),
    20: (7.5, 10, 7.5, 5), 21: (10, 7.5, 7.5, 7.5),
}  # fmt: skip

lengths = st.tuples(*[st.sampled_from([0.0, 2.0, 5.0, 7.5, 10.0])] * 4)
points = st.tuples(st.floats(6, 26), st.floats(2, 22)).map(np.array)


def rooms_of(*length: float) -> Rooms:
    """Return the rooms between walls of these lengths: up, left, down, right."""
    present = {name: r for name, r in zip(DIRECTIONS, length, strict=False) if r}
    return Rooms.from_walls(walls(**present), ARENA, quadrants=True)


THREE_WALLS = rooms_of(10, 7.5, 5)


def test_rooms_carry_the_ids_of_their_landmarks() -> None:
    corners = [[8.5, 19.5], [23.5, 19.5], [23.5, 4.5], [8.5, 4.5]]
    assert rooms_of().room_of(np.array(corners)).tolist() == [0, 1, 2, 3]


def test_a_door_is_as_wide_as_the_gap_that_the_wall_leaves() -> None:
    assert THREE_WALLS.door_width.tolist() == [0.0, 2.5, 5.0, 10.0]
    assert THREE_WALLS.door_position[LEFT].tolist() == [7.25, 12.0]
    assert THREE_WALLS.door_position[DOWN].tolist() == [16.0, 4.5]
    assert THREE_WALLS.door_position[RIGHT].tolist() == [21.0, 12.0]  # no wall: 5 from the centre


@pytest.mark.parametrize("ray", range(4))
def test_each_ray_joins_two_neighbouring_rooms(ray: int) -> None:
    rooms = rooms_of()
    corners = rooms.door_position[ray] + 0.01 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    assert {*rooms.room_of(corners).tolist()} == {*ROOMS_OF_RAY[ray]}


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


def test_of_two_ways_through_two_doors_the_shorter_is_taken() -> None:
    # from the middle of the left door (11, 12) to that of the lower one (16, 4.5); or from the
    # upper (16, 20.75) to the right (21, 12)
    assert rooms_of(7.5, 0, 5).route(TOP_LEFT, BOTTOM_RIGHT) == (LEFT, DOWN)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_in_every_published_layout_every_room_can_be_reached(layout: int) -> None:
    rooms = rooms_of(*LAYOUTS[layout])
    assert np.count_nonzero(rooms.door_width == 0) == (0 if layout == 0 else 1)
    for start, end in itertools.product(range(4), repeat=2):
        assert rooms.route(start, end) is not None


def fewest_doors(rooms: Rooms, start: int, end: int) -> int | None:
    """Breadth-first search over the room graph."""
    reached, edge = {start: 0}, [start]
    for room in edge:
        for ray, sides in enumerate(ROOMS_OF_RAY):
            following = sum(sides) - room
            if room in sides and rooms.door_width[ray] > 0 and following not in reached:
                reached[following] = reached[room] + 1
                edge.append(following)
    return reached.get(end)


@settings(deadline=None)
@given(lengths)
def test_routes_use_the_fewest_doors_and_are_the_same_both_ways(
    wall_lengths: tuple[float, ...],
) -> None:
    rooms = rooms_of(*wall_lengths)
    for start, end in itertools.product(range(4), repeat=2):
        route, back = rooms.route(start, end), rooms.route(end, start)
        count = None if route is None else len(route)
        assert count == fewest_doors(rooms, start, end)
        assert (None if back is None else back[::-1]) == route
        row = rooms.route_table[start, end].tolist()
        assert row[0] == (-1 if route is None else count)
        assert route is None or tuple(row[1 : 1 + len(route)]) == route


@settings(deadline=None)
@given(lengths, points, points, points)
def test_path_distance_is_symmetric_continuous_and_no_shorter_than_the_straight_line(
    wall_lengths: tuple[float, ...], start: np.ndarray, moved: np.ndarray, end: np.ndarray
) -> None:
    rooms = rooms_of(*wall_lengths)
    distance = rooms.path_distance(start, end)
    assert distance == pytest.approx(rooms.path_distance(end, start))
    assert distance >= np.linalg.norm(end - start) - 1e-9
    assert rooms.path_distance(start, start) == 0.0
    if rooms.room_of(start) == rooms.room_of(moved):
        change = distance - rooms.path_distance(moved, end)
        assert abs(change) <= np.linalg.norm(start - moved) + 1e-9


@settings(deadline=None)
@given(points, points, points)
def test_a_detour_is_never_shorter_where_every_way_is_unique(
    start: np.ndarray, over: np.ndarray, end: np.ndarray
) -> None:
    rooms = rooms_of(*LAYOUTS[13])
    detour = rooms.path_distance(start, over) + rooms.path_distance(over, end)
    assert rooms.path_distance(start, end) <= detour + 1e-9


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        ([[16, 13], [16, 22]], "does not run from the arena's centre"),  # detached from it
        ([[16, 12], [20, 16]], "does not run from the arena's centre"),  # slanted
        ([[15, 12], [6, 12]], "does not run from the arena's centre"),
        ([[16, 12], [16, 23]], r"wall \[\[16.0, 12.0\], \[16.0, 23.0\]\] leaves"),
    ],
)
def test_walls_that_cannot_be_are_refused(segment: list[list[float]], message: str) -> None:
    with pytest.raises(InvalidEventError, match=message):
        Rooms.from_walls(np.array([segment], float), ARENA, quadrants=True)


def test_a_wall_may_be_given_from_either_end() -> None:
    rooms = Rooms.from_walls(walls(left=5)[:, ::-1], ARENA, quadrants=True)
    assert rooms.wall_length.tolist() == [0, 5, 0, 0]
    assert rooms.wall_length[UP] == 0
