"""Rooms, doors and the ways between them, on cases worked by hand."""

from __future__ import annotations

import itertools
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.rooms import DOWN, LEFT, RIGHT, ROOMS_OF_RAY, UNREACHABLE, UP, Rooms
from phase_ppl.world.scene import ARENA
from tests.world.examples import walls

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


def rooms_of(up: float = 0, left: float = 0, down: float = 0, right: float = 0) -> Rooms:
    given_walls = {"up": up, "left": left, "down": down, "right": right}
    present = {name: length for name, length in given_walls.items() if length}
    return Rooms.from_walls(walls(**present), ARENA, quadrants=True)


def test_rooms_carry_the_ids_of_their_landmarks() -> None:
    corners = [[8.5, 19.5], [23.5, 19.5], [23.5, 4.5], [8.5, 4.5]]
    assert rooms_of().room_of(np.array(corners)).tolist() == [0, 1, 2, 3]


def test_a_door_is_as_wide_as_the_gap_that_the_wall_leaves() -> None:
    rooms = rooms_of(up=10, left=7.5, down=5)
    assert rooms.door_width.tolist() == [0.0, 2.5, 5.0, 10.0]
    assert rooms.door_position[LEFT].tolist() == [7.25, 12.0]
    assert rooms.door_position[DOWN].tolist() == [16.0, 4.5]
    assert rooms.door_position[RIGHT].tolist() == [21.0, 12.0]  # no wall: 5 from the centre


def test_each_ray_joins_two_neighbouring_rooms() -> None:
    rooms = rooms_of()
    for ray, (first, second) in enumerate(ROOMS_OF_RAY):
        step = np.array([0.01, 0.01])
        sides = {int(rooms.room_of(rooms.door_position[ray] + s * step)) for s in (-1, 1)}
        sides |= {
            int(rooms.room_of(rooms.door_position[ray] + step * [1, -1] * s)) for s in (-1, 1)
        }
        assert sides == {first, second}


def test_a_closed_door_sends_the_way_round() -> None:
    rooms = rooms_of(up=10, left=7.5, down=5)
    assert rooms.route(TOP_LEFT, TOP_RIGHT) == (LEFT, DOWN, RIGHT)
    assert rooms.route(TOP_RIGHT, TOP_LEFT) == (RIGHT, DOWN, LEFT)
    assert rooms.narrowest(TOP_LEFT, TOP_RIGHT) == 2.5
    assert rooms.route(TOP_LEFT, TOP_LEFT) == ()
    assert rooms.narrowest(TOP_LEFT, TOP_LEFT) == math.inf


def test_path_length_through_one_door() -> None:
    rooms = rooms_of(up=10, left=7.5)
    # (8, 20) -> middle of the left gap (7.25, 12) -> (8, 4)
    expected = 2 * math.hypot(0.75, 8)
    assert rooms.path_distance([8, 20], [8, 4]) == pytest.approx(expected)


def test_path_length_through_three_doors() -> None:
    rooms = rooms_of(up=10, left=7.5, down=5)
    # (8, 20) -> (7.25, 12) -> (16, 4.5) -> (21, 12) -> (24, 20)
    legs = [(0.75, 8), (8.75, 7.5), (5, 7.5), (3, 8)]
    expected = sum(math.hypot(*leg) for leg in legs)
    assert rooms.path_distance([8, 20], [24, 20]) == pytest.approx(expected)


def test_path_is_straight_in_an_open_arena() -> None:
    rooms = rooms_of()
    assert rooms.is_open
    assert rooms.path_distance([8, 20], [24, 4]) == pytest.approx(16 * math.sqrt(2))
    assert not rooms_of(up=2).is_open


def test_doors_count_only_if_wider_than_who_is_to_pass() -> None:
    rooms = rooms_of(up=10, left=7.5, down=5)
    assert rooms.route(TOP_LEFT, BOTTOM_LEFT, width=2.4) == (LEFT,)
    assert rooms.route(TOP_LEFT, BOTTOM_LEFT, width=2.5) is None
    assert rooms.path_distance([8, 20], [8, 4], width=3.0) == UNREACHABLE
    assert rooms.path_distance([8, 20], [12, 14], width=99.0) == pytest.approx(math.hypot(4, 6))


def test_a_room_behind_two_full_walls_cannot_be_reached() -> None:
    rooms = rooms_of(up=10, left=10)
    assert rooms.route(TOP_LEFT, TOP_RIGHT) is None
    assert rooms.narrowest(TOP_LEFT, TOP_RIGHT) == 0.0
    assert rooms.path_distance([8, 20], [24, 20]) == UNREACHABLE
    assert rooms.route_table[TOP_LEFT, TOP_RIGHT, 0] == -1


def test_of_two_ways_through_two_doors_the_shorter_is_taken() -> None:
    # door middles: left (11, 12), down (16, 4.5); up (16, 20.75), right (21, 12)
    rooms = rooms_of(up=7.5, down=5)
    by_left_and_down = math.hypot(5, 7.5)
    by_up_and_right = math.hypot(5, 8.75)
    assert by_left_and_down < by_up_and_right
    assert rooms.route(TOP_LEFT, BOTTOM_RIGHT) == (LEFT, DOWN)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_in_every_published_layout_every_room_can_be_reached(layout: int) -> None:
    rooms = rooms_of(*LAYOUTS[layout])
    closed = np.flatnonzero(rooms.door_width == 0)
    assert len(closed) == (0 if layout == 0 else 1)
    for start, end in itertools.product(range(4), repeat=2):
        assert rooms.route(start, end) is not None


def fewest_doors(rooms: Rooms, start: int, end: int, width: float) -> int | None:
    """Breadth-first search over the room graph."""
    reached, edge = {start: 0}, [start]
    while edge:
        room = edge.pop(0)
        for ray, sides in enumerate(ROOMS_OF_RAY):
            if room in sides and rooms.door_width[ray] > width:
                following = sum(sides) - room
                if following not in reached:
                    reached[following] = reached[room] + 1
                    edge.append(following)
    return reached.get(end)


@settings(deadline=None)
@given(lengths, st.sampled_from([0.0, 2.4, 3.0, 6.0]))
def test_routes_use_the_fewest_doors_and_are_the_same_both_ways(
    wall_lengths: tuple[float, ...], width: float
) -> None:
    rooms = rooms_of(*wall_lengths)
    for start, end in itertools.product(range(4), repeat=2):
        route = rooms.route(start, end, width)
        count = fewest_doors(rooms, start, end, width)
        assert (None if route is None else len(route)) == count
        back = rooms.route(end, start, width)
        assert (None if back is None else back[::-1]) == route
        if width == 0 and route is not None:
            row = rooms.route_table[start, end]
            assert row[0] == len(route)
            assert tuple(row[1 : 1 + len(route)]) == route


@settings(deadline=None)
@given(lengths, points, points)
def test_path_distance_is_symmetric_and_no_shorter_than_the_straight_line(
    wall_lengths: tuple[float, ...], start: np.ndarray, end: np.ndarray
) -> None:
    rooms = rooms_of(*wall_lengths)
    distance = rooms.path_distance(start, end)
    assert distance == pytest.approx(rooms.path_distance(end, start))
    assert distance >= np.linalg.norm(end - start) - 1e-9
    assert rooms.path_distance(start, start) == 0.0


@settings(deadline=None)
@given(lengths, points, points, points)
def test_a_step_within_a_room_changes_a_path_by_at_most_the_step(
    wall_lengths: tuple[float, ...], start: np.ndarray, moved: np.ndarray, end: np.ndarray
) -> None:
    rooms = rooms_of(*wall_lengths)
    if rooms.room_of(start) != rooms.room_of(moved):
        moved = start
    change = rooms.path_distance(start, end) - rooms.path_distance(moved, end)
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
    "segment",
    [
        [[16, 13], [16, 22]],  # detached from the centre
        [[16, 12], [20, 16]],  # slanted
        [[15, 12], [6, 12]],
    ],
)
def test_walls_that_are_not_on_a_ray_from_the_centre_are_refused(segment: list) -> None:
    with pytest.raises(InvalidEventError, match="does not run from the arena's centre"):
        Rooms.from_walls(np.array([segment], float), ARENA, quadrants=True)


def test_a_wall_that_leaves_the_arena_is_refused() -> None:
    with pytest.raises(InvalidEventError, match=r"wall \[\[16.0, 12.0\], \[16.0, 23.0\]\] leaves"):
        rooms_of(up=11)


def test_a_wall_may_be_given_from_either_end() -> None:
    backwards = walls(left=5)[:, ::-1]
    rooms = Rooms.from_walls(backwards, ARENA, quadrants=True)
    assert rooms.wall_length.tolist() == [0, 5, 0, 0]
    assert rooms.wall_length[UP] == 0


def test_rooms_can_be_sent_to_another_process() -> None:
    rooms = rooms_of(up=10, left=5)
    rooms.route(TOP_LEFT, TOP_RIGHT)
    copy = pickle.loads(pickle.dumps(rooms))
    assert copy.route(TOP_LEFT, TOP_RIGHT) == rooms.route(TOP_LEFT, TOP_RIGHT)
