"""Facts about grabbing and holding items."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import State
from phase_ppl.world.geometry import GRAB_POINTS, rotation
from phase_ppl.world.names import NOTHING

WAIT, UP, DOWN, ATTACH, DETACH = (
    Action.NO_FORCE,
    Action.UP,
    Action.DOWN,
    Action.ATTACH,
    Action.DETACH,
)
POINTS = range(len(GRAB_POINTS))


def place_of(item: int, agent: int, state: State) -> NDArray[np.float64]:
    """The item's centre in the agent's body frame."""
    offset = state.pose[item, :2] - state.pose[agent, :2]
    return np.asarray(offset @ rotation(state.pose[agent, 2]))


def at_point(
    point: int, distance: float, centre: tuple[float, float] = (16.0, 12.0)
) -> list[float]:
    """A place beyond a grab point of an unturned agent, as seen from its origin."""
    x, y = (np.array(centre) + distance * GRAB_POINTS[point]).tolist()
    return [x, y]


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize(("size", "radius"), [(0.8, 0.8), (1.2, 1.6), (1.6, 1.01)])
def test_grab_pulls_the_item_to_the_grab_point_and_keeps_the_relative_angle(
    world: Any, make_scene: Any, point: int, size: float, radius: float
) -> None:
    distance = size + radius + 0.4
    scene = make_scene(
        {0: (16, 12, 0.0), 2: [*at_point(point, distance), 1.0]}, {0: size, 2: radius}
    )
    engine = world(scene, (450.0, 450.0))
    engine.step((ATTACH, WAIT))
    state = engine.state
    assert state.held.tolist() == [2, NOTHING]
    place = (size + radius) * GRAB_POINTS[point]
    assert place_of(2, 0, state) == pytest.approx(place, abs=1e-6)
    assert state.pose[2, 2] - state.pose[0, 2] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("point", POINTS)
def test_hold_stays_rigid_through_fifty_random_steps(
    world: Any, make_scene: Any, point: int
) -> None:
    scene = make_scene({0: (16, 12), 2: [*at_point(point, 1.8), -2.0]})
    engine = world(scene, (600.0, 450.0))
    engine.step((ATTACH, WAIT))
    actions = np.random.default_rng(point).integers(0, Action.ATTACH, (50, 2))
    for red, green in actions:
        engine.step((red, green))
        state = engine.state
        assert place_of(2, 0, state) == pytest.approx(1.6 * GRAB_POINTS[point], abs=0.02)
        assert state.pose[2, 2] - state.pose[0, 2] == pytest.approx(-2.0, abs=0.02)


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize(("gap", "grabs"), [(-1e-6, True), (1e-6, False)])
def test_items_can_be_grabbed_from_less_than_half_a_unit_beyond_their_radius(
    world: Any, make_scene: Any, point: int, gap: float, grabs: bool
) -> None:
    # reach is measured from the grab point to the item's centre: radius + 0.5
    scene = make_scene({0: (16, 12), 2: at_point(point, 1.2 + 1.01 + 0.5 + gap)}, {0: 1.2, 2: 1.01})
    engine = world(scene, (450.0, 450.0))
    assert engine.find_grab(0) == ((2, point) if grabs else (NOTHING, -1))
    engine.step((ATTACH, WAIT))
    assert engine.state.held[0] == (2 if grabs else NOTHING)


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
    world: Any, make_scene: Any, items: Any, sizes: Any, found: tuple[int, int]
) -> None:
    scene = make_scene({0: (16, 12), **items}, sizes)
    assert world(scene, (450.0, 450.0)).find_grab(0) == found


def test_attach_out_of_reach_does_nothing(world: Any, make_scene: Any) -> None:
    scene = make_scene({0: (16, 12)})
    engine = world(scene, (450.0, 450.0))
    engine.step((ATTACH, ATTACH))
    assert engine.state.held.tolist() == [NOTHING, NOTHING]
    assert engine.state.pose == pytest.approx(scene.start, abs=1e-12)


def test_attach_while_holding_does_nothing(world: Any, make_scene: Any) -> None:
    scene = make_scene({0: (16, 12), 2: at_point(0, 1.7), 3: at_point(1, 1.8)})
    engine = world(scene, (450.0, 450.0))
    engine.step((ATTACH, WAIT))
    before = engine.state
    assert engine.find_grab(0) == (NOTHING, -1)
    engine.step((ATTACH, WAIT))
    assert engine.state.held.tolist() == [2, NOTHING]
    assert engine.state.pose == pytest.approx(before.pose, abs=1e-9)


def test_detach_lets_go_and_detach_without_an_item_does_nothing(
    world: Any, make_scene: Any
) -> None:
    engine = world(make_scene({0: (16, 12), 2: at_point(0, 1.7)}), (450.0, 450.0))
    engine.step((ATTACH, DETACH))
    engine.step((DETACH, DETACH))
    assert engine.state.held.tolist() == [NOTHING, NOTHING]
    item = engine.state.pose[2].copy()
    for _ in range(10):
        engine.step((DOWN, WAIT))
    assert engine.state.pose[2] == pytest.approx(item, abs=1e-4)
    assert engine.state.pose[0, 1] < 10.0


def test_attach_and_detach_exert_no_force(world: Any, make_scene: Any, moving: Any) -> None:
    scene = make_scene({0: (16, 12)})
    free = world(scene, (450.0, 450.0), initial=moving(scene, 0, (0.0, 10.0)))
    grabbing = world(scene, (450.0, 450.0), initial=moving(scene, 0, (0.0, 10.0)))
    assert np.array_equal(free.step((WAIT, WAIT)), grabbing.step((ATTACH, DETACH)))


def test_both_agents_may_hold_the_same_item(world: Any, make_scene: Any) -> None:
    scene = make_scene({0: (16, 12), 1: (16, 15.6), 2: (16, 13.8)})
    engine = world(scene, (450.0, 450.0))
    engine.step((ATTACH, ATTACH))
    assert engine.state.held.tolist() == [2, 2]
    for red, green in np.random.default_rng(0).integers(0, Action.ATTACH, (20, 2)):
        engine.step((red, green))
    assert place_of(2, 0, engine.state) == pytest.approx([0.0, 1.6], abs=0.05)
    assert place_of(2, 1, engine.state) == pytest.approx([0.0, -1.6], abs=0.05)
    engine.step((DETACH, WAIT))
    assert engine.state.held.tolist() == [NOTHING, 2]


@pytest.mark.parametrize("size", [0.8, 1.2, 1.6])
@pytest.mark.parametrize(("point", "push"), [(0, UP), (0, DOWN), (1, UP), (1, DOWN)])
def test_strength_zero_agent_cannot_drag_item(
    world: Any, make_scene: Any, size: float, point: int, push: Action
) -> None:
    # 150 N against the friction of two bodies, 200 N
    engine = world(
        make_scene({0: (16, 12), 2: at_point(point, size + 0.8)}, {0: size}), (150.0,) * 2
    )
    engine.step((ATTACH, WAIT))
    before = engine.state.pose
    for _ in range(20):
        engine.step((push, WAIT))
    assert np.abs(engine.state.pose - before).max() < 0.05


def test_strength_zero_agent_can_swing_the_item_around_itself(world: Any, make_scene: Any) -> None:
    engine = world(make_scene({0: (16, 12), 2: at_point(0, 1.6)}), (150.0, 150.0))
    engine.step((ATTACH, WAIT))
    for _ in range(20):
        engine.step((Action.TURN_LEFT, WAIT))
    assert engine.state.pose[0, 2] > 0.5


def test_stronger_agent_drags_the_item(world: Any, make_scene: Any) -> None:
    engine = world(make_scene({0: (16, 6), 2: (16, 7.6)}), (300.0, 150.0))
    engine.step((ATTACH, WAIT))
    for _ in range(10):
        engine.step((UP, WAIT))
    # 300 N against 200 N on the masses of both
    acceleration = 100.0 / (4 * 0.64 + np.pi * 0.64)
    assert engine.state.velocity[2, 1] == pytest.approx(10 * acceleration / 12, rel=0.02)


@pytest.mark.parametrize("pushes", [(UP, UP), (DOWN, DOWN), (UP, DOWN), (DOWN, UP)])
def test_two_strength_zero_agents_with_one_item_stand_still(
    world: Any, make_scene: Any, pushes: tuple[Action, Action]
) -> None:
    # together 300 N against the friction of three bodies, 300 N
    engine = world(make_scene({0: (16, 10), 1: (16, 13.2), 2: (16, 11.6)}), (150.0, 150.0))
    engine.step((ATTACH, ATTACH))
    before = engine.state.pose
    for _ in range(20):
        engine.step(pushes)
    assert engine.state.held.tolist() == [2, 2]
    assert np.abs(engine.state.pose - before).max() < 0.05


def test_holder_and_item_pass_through_each_other_but_not_through_others(
    world: Any, make_scene: Any
) -> None:
    # the item of size 0.8 at the side of the slanted agent overlaps it, and stays there
    scene = make_scene({0: (16, 12), 2: at_point(2, 1.9), 3: at_point(2, 4.6)})
    engine = world(scene, (600.0, 150.0))
    engine.step((ATTACH, WAIT))
    for _ in range(5):
        engine.step((WAIT, WAIT))
    assert place_of(2, 0, engine.state) == pytest.approx([1.6, 0.0], abs=1e-6)
    for _ in range(8):
        engine.step((Action.RIGHT, WAIT))
    gap = np.linalg.norm(engine.state.pose[2, :2] - engine.state.pose[3, :2])
    assert engine.state.pose[3, 0] > 21.0
    assert gap > 1.6 - 0.1


def test_both_engines_find_the_same_grab(compiled_world: Any, make_scene: Any) -> None:
    rng = np.random.default_rng(5)
    found = []
    for _ in range(200):
        poses = np.column_stack([rng.uniform(13, 19, (3, 2)), rng.uniform(-7, 7, 3)])
        scene = make_scene(dict(zip((0, 2, 3), poses.tolist(), strict=True)), {0: 1.2, 2: 1.6})
        start = State.at_start(scene)
        grabs = [
            engine(scene, (150.0, 150.0), initial=start).find_grab(0)
            for engine in (PymunkWorld, compiled_world)
        ]
        assert grabs[0] == grabs[1]
        found.append(grabs[0])
    assert {item for item, _ in found} == {NOTHING, 2, 3}
    assert {point for _, point in found} == {-1, 0, 1, 2, 3}


def test_actions_do_not_disturb_the_hold_of_a_restored_state(world: Any, make_scene: Any) -> None:
    scene = make_scene({0: (16, 12), 2: at_point(0, 1.7)})
    first = world(scene, (450.0, 450.0))
    first.step((ATTACH, WAIT))
    actions = np.random.default_rng(1).integers(0, N_ACTIONS - 2, (5, 2))
    second = world(scene, (450.0, 450.0), initial=first.state)
    for red, green in actions:
        expected, frame = first.step((red, green)), second.step((red, green))
        assert frame == pytest.approx(expected, abs=1e-6)
