"""The compiled model against the pymunk world, both against Box2D and against recorded events."""

from __future__ import annotations

import functools
import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phase_ppl.physics import compiled
from phase_ppl.physics.actions import ACTION_NAMES, DIRECTIONS, N_ACTIONS, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import State
from phase_ppl.world.geometry import UNIT_TRAPEZOID
from phase_ppl.world.scene import Scene
from tests.physics.conftest import CompiledWorld, after, make_scene, start_in

REPLAYS = Path(__file__).parents[3] / "shared" / "phase-test" / "dev_replays.json"
WALLS = [[[16, 12], end] for end in ([16, 22], [11, 12], [16, 7], [21, 12])]
STRENGTHS = (450.0, 300.0)

TURN_LEFT, UP, WAIT, ATTACH = Action.TURN_LEFT, Action.UP, Action.NO_FORCE, Action.ATTACH

Case = tuple[tuple[Any, ...], list[list[int]]]
"""Arguments of a scene, and the actions of both agents in each step."""


def random_steps(rng: np.random.Generator, below: int = N_ACTIONS) -> list[list[int]]:
    return (rng.integers(0, N_ACTIONS, (10, 2)) % below).tolist()


def free(rng: np.random.Generator) -> Case:
    places = {0: (12, 16, rng.uniform(-4, 4)), 1: (20, 8, rng.uniform(-4, 4))}
    actions = random_steps(rng, Action.ATTACH)
    return (places, {0: rng.choice([0.8, 1.2])}), actions


def push_into_wall(rng: np.random.Generator) -> Case:
    x = rng.uniform(10, 14)
    places = {0: (x, 16, rng.uniform(-0.3, 0.3)), 2: (x + rng.uniform(-0.5, 0.5), 18.0)}
    return (places,), [[UP, WAIT]] * 10


def drive_into_wall(rng: np.random.Generator) -> Case:
    places = {0: (13, 16, rng.uniform(-4, 4)), 1: (19, 8, rng.uniform(-4, 4))}
    return (places, {1: 1.2}, WALLS), [[UP, UP]] * 10


def carry(rng: np.random.Generator) -> Case:
    angle = rng.uniform(-4, 4)
    side = angle + rng.choice([0, math.pi / 2, math.pi, -math.pi / 2]) + rng.uniform(-0.2, 0.2)
    item = 16 - 1.8 * math.sin(side), 12 + 1.8 * math.cos(side)
    actions = [[ATTACH, WAIT], *random_steps(rng, Action.ATTACH)[1:]]
    return ({0: (16, 12, angle), 2: item},), actions


def crowded(rng: np.random.Generator) -> Case:
    spots = rng.permutation(np.array([[13, 13], [13, 16], [10, 14.5], [13, 19], [10, 18]]))[:4]
    poses = np.column_stack([spots + rng.uniform(-0.3, 0.3, (4, 2)), rng.uniform(-4, 4, 4)])
    return (dict(enumerate(poses.tolist())), {}, WALLS), random_steps(rng)


@pytest.mark.parametrize("resets", [False, True])
@pytest.mark.parametrize("case", [free, push_into_wall, drive_into_wall, carry, crowded])
def test_compiled_model_follows_the_pymunk_world_at_equal_recipe(case: Any, resets: bool) -> None:
    drifts = []
    for seed in range(20):
        where, actions = case(np.random.default_rng(seed))
        options = {"strengths": STRENGTHS, "resets": resets, "inner_steps": 4, "iterations": 20}
        engines = [start_in(engine, *where, **options) for engine in (PymunkWorld, CompiledWorld)]
        for pair in actions:
            first, second = (engine.step(pair) for engine in engines)
        assert engines[0].state.held.tolist() == engines[1].state.held.tolist()
        drifts.append(np.linalg.norm(first[:, :2] - second[:, :2], axis=1).max())
    assert np.median(drifts) < 1e-3
    assert np.quantile(drifts, 0.9) < 0.02


def test_step_and_step_mean_do_the_same() -> None:
    where, actions = crowded(np.random.default_rng(7))
    means = start_in(CompiledWorld, *where, strengths=STRENGTHS)
    state = [part.copy() for part in (means.bodies, means.held, means.weld)]
    for pair in actions:
        means.step(pair)
        compiled.step(*state, np.array(pair), means.params, means.scratch)
    for part, other in zip(state, (means.bodies, means.held, means.weld), strict=True):
        assert np.array_equal(part, other)


def test_compiled_model_has_no_state_outside_its_arrays() -> None:
    where, actions = crowded(np.random.default_rng(9))
    first, second = (start_in(CompiledWorld, *where, strengths=STRENGTHS) for _ in range(2))
    after(first, *actions[:5])
    second.bodies[:], second.held[:], second.weld[:] = first.bodies, first.held, first.weld
    for pair in actions[5:]:
        assert np.array_equal(first.step(pair), second.step(pair))


def test_threads_with_their_own_scratch_do_not_disturb_each_other() -> None:
    cases = [crowded(np.random.default_rng(seed)) for seed in range(8)]

    def run(case: Case) -> FloatArray:
        running = start_in(CompiledWorld, *case[0], strengths=STRENGTHS)
        return np.array([running.step(pair) for _ in range(20) for pair in case[1]])

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(run, cases))
    for case, result in zip(cases, together, strict=True):
        assert np.array_equal(run(case), result)


def test_states_survive_the_way_through_flat_arrays() -> None:
    rng = np.random.default_rng(0)
    state = State(
        pose=rng.uniform(8, 20, (4, 3)),
        velocity=rng.normal(size=(4, 2)),
        spin=rng.normal(size=4),
        held=np.array([3, -1]),
        weld=rng.normal(size=(2, 3)),
    )
    radius = np.array([0.8, 1.2, 1.6, 1.01])
    arrays = compiled.from_state(state, radius)
    back = compiled.to_state(*arrays, radius)
    for name in ("pose", "velocity", "spin", "held", "weld"):
        assert getattr(back, name) == pytest.approx(getattr(state, name))
    # the centre of mass of an agent lies R/6 behind its origin
    assert np.linalg.norm(arrays[0][:, :2] - state.pose[:, :2], axis=1) == pytest.approx(
        [0.8 / 6, 0.2, 0.0, 0.0]
    )


class Box2DWorld:
    """The dynamics written directly in the original's engine, as an oracle; no grabs."""

    def __init__(self, scene: Scene, strengths: tuple[float, float]) -> None:
        box2d = pytest.importorskip("Box2D")
        self.strengths, self.radius = strengths, scene.radius
        self.world = box2d.b2World(gravity=(0, 0), doSleep=True)
        room = self.world.CreateBody(position=(0, 0))
        for start, end in [*scene.border.tolist(), *scene.walls.tolist()]:
            room.CreateEdgeChain([start, end])
        # friction joints need another body; one far outside touches nothing
        anchor = self.world.CreateStaticBody(position=(100, 100))
        self.bodies = []
        for entity in range(4):
            x, y, angle = scene.start[entity].tolist()
            body = self.world.CreateDynamicBody(position=(x, y), angle=angle)
            if entity < 2:
                outline = (scene.radius[entity] * UNIT_TRAPEZOID).tolist()
                body.CreatePolygonFixture(vertices=outline, density=1, friction=0)
            else:
                body.CreateCircleFixture(radius=scene.radius[entity], density=1, friction=0)
            self.world.CreateJoint(
                box2d.b2FrictionJointDef(
                    bodyA=body, bodyB=anchor, localAnchorA=(0, 0), maxForce=100, maxTorque=0
                )
            )
            self.bodies.append(body)
        self.world.Step(1 / 60, 10, 10)

    def step(self, actions: tuple[int, int]) -> FloatArray:
        frame = np.zeros((4, 3))
        for _ in range(5):
            for agent, action in enumerate(actions):
                self._act(agent, action)
            self.world.Step(1 / 60, 10, 10)
            frame += [[*body.position, body.angle] for body in self.bodies]
        for body in self.bodies[:2]:
            body.angularVelocity = 0.0
        return frame / 5

    def _act(self, agent: int, action: int) -> None:
        body, size = self.bodies[agent], float(self.radius[agent])
        if action in (Action.TURN_LEFT, Action.TURN_RIGHT):
            torque = 300 * (size / 0.8) ** 2
            body.ApplyTorque(torque if action == Action.TURN_LEFT else -torque, True)
        elif action == Action.STOP:
            body.linearVelocity = (0.0, 0.0)
        elif DIRECTIONS[action].any():
            force = (self.strengths[agent] * DIRECTIONS[action]).tolist()
            point = body.GetWorldPoint((0.0, -size / 12))
            body.ApplyForce(body.GetWorldVector(force), point, True)


def test_free_motion_is_that_of_the_original_engine(world: Any) -> None:
    scene = make_scene({0: (16, 9, 0.4), 1: (16, 16, 2.0)}, {0: 1.2, 1: 1.6})
    oracle, engine = (one(scene, (300.0, 150.0)) for one in (Box2DWorld, world))
    actions = [Action.UP_LEFT, TURN_LEFT, TURN_LEFT, WAIT, Action.STOP, Action.RIGHT, Action.DOWN]
    for action in actions:
        expected, frame = oracle.step((action, action)), engine.step((action, action))
        # Box2D computes in single precision
        assert frame == pytest.approx(expected, abs=2e-4)


def test_crowded_motion_stays_close_to_that_of_the_original_engine(world: Any) -> None:
    errors = []
    for seed in range(30):
        where, actions = crowded(np.random.default_rng(seed))
        oracle, engine = (one(make_scene(*where), STRENGTHS) for one in (Box2DWorld, world))
        pairs = [[action % Action.ATTACH for action in pair] for pair in actions[:5]]
        apart = [(engine.step(pair) - oracle.step(pair))[:2, :2] for pair in pairs]
        errors.append(np.linalg.norm(apart, axis=-1).max(axis=-1))
    medians = np.median(errors, axis=0)
    assert medians[0] < 1e-3
    assert medians[4] < 0.03


@functools.cache
def replays() -> list[dict[str, Any]]:
    if not REPLAYS.exists():
        pytest.skip("recorded events with recovered actions are not at ../shared/phase-test")
    videos: list[dict[str, Any]] = json.loads(REPLAYS.read_text())["videos"]
    return videos


def replay_errors(engine: Any, inner_steps: int) -> list[FloatArray]:
    """Per video, the largest distance of an entity from its recorded place, over 20 rows."""
    errors = []
    for video in replays():
        angles = [*video["start_angle"], 0.0, 0.0]
        scene = Scene(
            np.column_stack([video["start_position"], angles]),
            video["radius"],
            np.array(video["walls"], np.float64).reshape(-1, 2, 2),
        )
        running = engine(scene, tuple(video["strength_newton"]), inner_steps)
        error = []
        rows = video["rows"][1 : min(video["exact_rows"], 20) + 1]
        for row, names in zip(rows, video["actions"], strict=False):
            actions = tuple(ACTION_NAMES.index(name) for name in names)
            places = running.step(actions)[:, :2]
            error.append(np.linalg.norm(places - np.array(row), axis=1).max())
        errors.append(np.array(error))
    return errors


@pytest.mark.parametrize(
    ("engine", "inner_steps", "limits"),
    [
        (PymunkWorld, 4, (0.02, 0.12, 1.6)),
        (CompiledWorld, 4, (0.02, 0.12, 1.6)),
        (CompiledWorld, 2, (0.02, 0.15, 1.6)),
        (CompiledWorld, 1, (0.02, 0.25, 2.6)),
    ],
)
def test_recorded_events_are_followed_open_loop_until_contacts_turn_chaotic(
    engine: Any, inner_steps: int, limits: tuple[float, ...]
) -> None:
    errors = replay_errors(engine, inner_steps)
    medians = [
        np.median([error[row - 1] for error in errors if len(error) >= row]) for row in (5, 10, 20)
    ]
    assert (np.array(medians) < limits).all(), medians


def test_a_restored_world_goes_on_as_a_new_one() -> None:
    placed: Any = {0: (16, 12, 0.0), 2: (16, 13.6)}
    source, used = (start_in(PymunkWorld, placed, strengths=STRENGTHS) for _ in range(2))
    state = after(source, (ATTACH, WAIT))
    assert state.held[0] == 2
    after(used, *free(np.random.default_rng(3))[1])
    used.restore(state)
    fresh = start_in(PymunkWorld, placed, strengths=STRENGTHS, initial=state)
    for action in (UP, TURN_LEFT, Action.DETACH, UP):
        np.testing.assert_allclose(used.step((action, UP)), fresh.step((action, UP)), atol=1e-9)
