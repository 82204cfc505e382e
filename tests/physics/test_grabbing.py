"""Facts about grabbing and holding items, and what the authors' agents imagine of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.physics import compiled
from phase_ppl.physics.actions import NO_ACTION, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import State
from phase_ppl.world.geometry import GRAB_POINTS, rotation
from phase_ppl.world.names import NOTHING
from tests.physics.conftest import CompiledWorld, after, make_scene, start_in

WAIT, UP, DOWN = Action.NO_FORCE, Action.UP, Action.DOWN
ATTACH, DETACH = Action.ATTACH, Action.DETACH
POINTS = range(len(GRAB_POINTS))
MIDDLE = {0: (16, 12)}


def place_of(item: int, agent: int, state: State) -> NDArray[np.float64]:
    """The item's centre in the agent's body frame."""
    offset = state.pose[item, :2] - state.pose[agent, :2]
    return np.asarray(offset @ rotation(state.pose[agent, 2]))


def at_point(point: int, distance: float, *angle: float) -> list[float]:
    """A place beyond a grab point of an unturned agent in the middle, as seen from its origin."""
    return [*(np.array([16.0, 12.0]) + distance * GRAB_POINTS[point]).tolist(), *angle]


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize(("size", "radius"), [(0.8, 0.8), (1.2, 1.6), (1.6, 1.01)])
def test_grab_pulls_the_item_to_the_grab_point_and_keeps_the_relative_angle(
    start: Any, point: int, size: float, radius: float
) -> None:
    placed = {**MIDDLE, 2: at_point(point, size + radius + 0.4, 1.0)}
    state = after(start(placed, {0: size, 2: radius}), (ATTACH, WAIT))
    assert state.held.tolist() == [2, NOTHING]
    place = (size + radius) * GRAB_POINTS[point]
    assert place_of(2, 0, state) == pytest.approx(place, abs=1e-6)
    assert state.pose[2, 2] - state.pose[0, 2] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("point", POINTS)
def test_hold_stays_rigid_through_fifty_random_steps(start: Any, point: int) -> None:
    engine = start({**MIDDLE, 2: at_point(point, 1.8, -2.0)}, strengths=(600, 450))
    after(engine, (ATTACH, WAIT))
    for pair in np.random.default_rng(point).integers(0, Action.ATTACH, (50, 2)).tolist():
        state = after(engine, pair)
        assert place_of(2, 0, state) == pytest.approx(1.6 * GRAB_POINTS[point], abs=0.02)
        assert state.pose[2, 2] - state.pose[0, 2] == pytest.approx(-2.0, abs=0.02)


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize(("gap", "grabs"), [(-1e-6, True), (1e-6, False)])
def test_items_can_be_grabbed_from_less_than_half_a_unit_beyond_their_radius(
    start: Any, point: int, gap: float, grabs: bool
) -> None:
    # reach is measured from the grab point to the item's centre: radius + 0.5
    engine = start({**MIDDLE, 2: at_point(point, 1.2 + 1.01 + 0.5 + gap)}, {0: 1.2, 2: 1.01})
    assert engine.find_grab(0) == ((2, point) if grabs else (NOTHING, -1))
    assert after(engine, (ATTACH, WAIT)).held[0] == (2 if grabs else NOTHING)


@pytest.mark.parametrize(
    ("items", "sizes", "found"),
    [
        ({2: at_point(2, 2.0), 3: at_point(3, 1.9)}, {}, (3, 3)),
        # to centres: the large item's rim is nearer than the small one's
        ({2: at_point(2, 2.6), 3: at_point(3, 2.0)}, {2: 1.6}, (3, 3)),
        ({2: [17.3, 12.9]}, {}, (2, 2)),
        ({2: [16.9, 13.3]}, {}, (2, 0)),
    ],
)
def test_the_nearest_item_is_grabbed_at_the_nearest_point(
    start: Any, items: Any, sizes: Any, found: tuple[int, int]
) -> None:
    assert start({**MIDDLE, **items}, sizes).find_grab(0) == found


def test_attach_and_detach_do_nothing_where_there_is_nothing_to_do(start: Any) -> None:
    state = after(start(MIDDLE), (ATTACH, ATTACH))  # out of reach
    assert state.held.tolist() == [NOTHING, NOTHING]
    assert state.pose == pytest.approx(make_scene(MIDDLE).start, abs=1e-12)
    engine = start({**MIDDLE, 2: at_point(0, 1.7), 3: at_point(1, 1.8)})
    before = after(engine, (ATTACH, WAIT))
    assert engine.find_grab(0) == (NOTHING, -1)
    state = after(engine, (ATTACH, WAIT))  # while holding
    assert state.held.tolist() == [2, NOTHING]
    assert state.pose == pytest.approx(before.pose, abs=1e-9)
    before = after(engine, (DETACH, DETACH), (DETACH, DETACH))
    assert before.held.tolist() == [NOTHING, NOTHING]
    state = after(engine, (DOWN, WAIT), times=10)
    assert state.pose[2] == pytest.approx(before.pose[2], abs=1e-4)
    assert state.pose[0, 1] < 10.0


def test_attach_and_detach_exert_no_force(start: Any) -> None:
    free, grabbing = (start(MIDDLE, moving=(0, (0.0, 10.0))) for _ in range(2))
    assert np.array_equal(free.step((WAIT, WAIT)), grabbing.step((ATTACH, DETACH)))


def test_both_agents_may_hold_the_same_item(start: Any) -> None:
    engine = start({**MIDDLE, 1: (16, 15.6), 2: (16, 13.8)})
    assert after(engine, (ATTACH, ATTACH)).held.tolist() == [2, 2]
    pairs = np.random.default_rng(0).integers(0, Action.ATTACH, (20, 2)).tolist()
    state = after(engine, *pairs)
    assert place_of(2, 0, state) == pytest.approx([0.0, 1.6], abs=0.05)
    assert place_of(2, 1, state) == pytest.approx([0.0, -1.6], abs=0.05)
    assert after(engine, (DETACH, WAIT)).held.tolist() == [NOTHING, 2]


@pytest.mark.parametrize("size", [0.8, 1.2, 1.6])
@pytest.mark.parametrize(("point", "push"), [(0, UP), (0, DOWN), (1, UP), (1, DOWN)])
def test_strength_zero_agent_cannot_drag_item(
    start: Any, size: float, point: int, push: Action
) -> None:
    # 150 N against the friction of two bodies, 200 N
    engine = start({**MIDDLE, 2: at_point(point, size + 0.8)}, {0: size}, strengths=(150, 150))
    before = after(engine, (ATTACH, WAIT)).pose
    assert np.abs(after(engine, (push, WAIT), times=20).pose - before).max() < 0.05


def test_a_weak_agent_can_swing_an_item_and_a_stronger_one_drags_it(start: Any) -> None:
    engine = start({**MIDDLE, 2: at_point(0, 1.6)}, strengths=(150, 150))
    after(engine, (ATTACH, WAIT))
    assert after(engine, (Action.TURN_LEFT, WAIT), times=20).pose[0, 2] > 0.5
    engine = start({0: (16, 6), 2: (16, 7.6)}, strengths=(300, 150))
    after(engine, (ATTACH, WAIT))
    # 300 N against 200 N on the masses of both
    acceleration = 100.0 / (4 * 0.64 + np.pi * 0.64)
    velocity = after(engine, (UP, WAIT), times=10).velocity[2, 1]
    assert velocity == pytest.approx(10 * acceleration / 12, rel=0.02)


@pytest.mark.parametrize("pushes", [(UP, UP), (DOWN, DOWN), (UP, DOWN), (DOWN, UP)])
def test_two_strength_zero_agents_with_one_item_stand_still(
    start: Any, pushes: tuple[Action, Action]
) -> None:
    # together 300 N against the friction of three bodies, 300 N
    engine = start({0: (16, 10), 1: (16, 13.2), 2: (16, 11.6)}, strengths=(150, 150))
    before = after(engine, (ATTACH, ATTACH)).pose
    state = after(engine, pushes, times=20)
    assert state.held.tolist() == [2, 2]
    assert np.abs(state.pose - before).max() < 0.05


def test_holder_and_item_pass_through_each_other_but_not_through_others(start: Any) -> None:
    # the item of size 0.8 at the side of the slanted agent overlaps it, and stays there
    engine = start({**MIDDLE, 2: at_point(2, 1.9), 3: at_point(2, 4.6)}, strengths=(600, 150))
    after(engine, (ATTACH, WAIT))
    state = after(engine, (WAIT, WAIT), times=5)
    assert place_of(2, 0, state) == pytest.approx([1.6, 0.0], abs=1e-6)
    pose = after(engine, (Action.RIGHT, WAIT), times=8).pose
    assert pose[3, 0] > 21.0
    assert np.linalg.norm(pose[2, :2] - pose[3, :2]) > 1.6 - 0.1


def test_both_engines_find_the_same_grab() -> None:
    rng = np.random.default_rng(5)
    found = []
    for _ in range(100):
        poses = np.column_stack([rng.uniform(13, 19, (3, 2)), rng.uniform(-7, 7, 3)]).tolist()
        placed, sizes = dict(zip((0, 2, 3), poses, strict=True)), {0: 1.2, 2: 1.6}
        initial = State.at_start(make_scene(placed, sizes))
        one, other = (
            start_in(engine, placed, sizes, initial=initial).find_grab(0)
            for engine in (PymunkWorld, CompiledWorld)
        )
        assert one == other
        found.append(one)
    assert {item for item, _ in found} == {NOTHING, 2, 3}
    assert {point for _, point in found} == {-1, 0, 1, 2, 3}


# --- a rod that swivels, and a push at the origin -------------------------------------------------


def imagined(
    swivel: bool, *actions: Action, item: tuple[float, float] = (16.0, 13.6)
) -> tuple[NDArray[np.float64], bool]:
    """Red in the middle heads up and does ``actions``; return poses, and whether it holds."""
    scene = make_scene({**MIDDLE, 2: item})
    params = compiled.make_params(scene, (600.0, 600.0), swivel=swivel)
    state = compiled.from_state(State.at_start(scene), scene.radius)
    for action in actions:
        compiled.step(*state, np.array([action, NO_ACTION]), params, compiled.make_scratch())
    return compiled.to_state(*state, scene.radius).pose, state[1][0] == 2


def test_a_turn_leaves_a_swivelling_item_where_it_is_and_swings_a_welded_one() -> None:
    actions = [ATTACH, *[Action.TURN_LEFT] * 3]
    (loose, held), (welded, _) = imagined(True, *actions), imagined(False, *actions)
    assert held
    assert loose[0, 2] > 2.5
    assert loose[2, :2] == pytest.approx([16.0, 13.6], abs=0.15)
    assert welded[2, 0] < 15.5


def test_the_rod_keeps_its_length_while_it_is_pulled_about() -> None:
    rng = np.random.default_rng(1)
    pushes = [Action(int(a)) for a in rng.integers(Action.UP, Action.DOWN_RIGHT + 1, 30)]
    for n in range(1, len(pushes)):
        pose, _ = imagined(True, ATTACH, *pushes[:n])
        assert math.dist(pose[2, :2], pose[0, :2]) == pytest.approx(1.6, abs=0.02)


def test_an_imagined_grab_takes_the_item_where_it_lies() -> None:
    beside = (16.9, 13.4)
    (loose, held), (welded, _) = (imagined(swivel, ATTACH, item=beside) for swivel in (True, False))
    assert held
    assert loose[2, :2] == pytest.approx(beside, abs=1e-6)
    assert math.dist(welded[2, :2], beside) > 0.1


def test_a_push_at_the_origin_turns_the_body_more() -> None:
    at_origin, behind_it = (imagined(s, Action.LEFT, item=(8.0, 4.0))[0] for s in (True, False))
    # torque over R: the push minus friction at R/6, or the push at R/12 minus friction at R/6
    expected = (600 / 6 - 100 / 6) / (600 / 12 - 100 / 6)
    assert at_origin[0, 2] / behind_it[0, 2] == pytest.approx(expected, rel=0.01)
