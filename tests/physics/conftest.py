"""Both engines of the dynamics behind one interface, so that each fact is tested on both."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.physics import compiled, constants
from phase_ppl.physics.actions import NO_ACTION
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import State
from phase_ppl.world.scene import Scene

CORNERS = [[8.0, 20.0], [24.0, 20.0], [8.0, 4.0], [24.0, 4.0]]
Placed = Mapping[int, Sequence[float]]


class CompiledWorld:
    """The compiled model with the interface of ``PymunkWorld``."""

    def __init__(
        self,
        scene: Scene,
        strengths: Sequence[float],
        inner_steps: int = constants.IMAGINATION_INNER_STEPS,
        initial: State | None = None,
        iterations: int = constants.IMAGINATION_ITERATIONS,
    ) -> None:
        self.params = compiled.make_params(scene, strengths, inner_steps, iterations)
        self.scratch = compiled.make_scratch()
        state = State.at_start(scene) if initial is None else initial
        self.bodies, self.held, self.weld = compiled.from_state(state, scene.radius)
        if initial is None:
            self._step((NO_ACTION, NO_ACTION), self.params._replace(substeps=1))

    def _step(self, actions: Sequence[int], params: compiled.Params) -> NDArray[np.float64]:
        frame = np.empty((4, 3))
        state = self.bodies, self.held, self.weld
        compiled.step_mean(*state, np.array(actions, np.int64), params, self.scratch, frame)
        return frame

    def step(self, actions: Sequence[int]) -> NDArray[np.float64]:
        return self._step(actions, self.params)

    def find_grab(self, agent: int) -> tuple[int, int]:
        return compiled.find_grab(self.bodies, self.held, agent, self.params)

    @property
    def state(self) -> State:
        return compiled.to_state(self.bodies, self.held, self.weld, self.params.radius)


def make_scene(
    placed: Placed, sizes: Mapping[int, float] | None = None, walls: Any = (), **changes: Any
) -> Scene:
    """Return a scene with some bodies placed, the others out of the way in the corners."""
    poses = np.array([[*corner, 0.0] for corner in CORNERS])
    for entity, pose in placed.items():
        poses[entity, : len(pose)] = pose
    radius = [(sizes or {}).get(entity, 0.8) for entity in range(4)]
    return Scene(poses, radius, np.reshape(np.array(walls, float), (-1, 2, 2)), **changes)


def start_in(
    world: Any,
    placed: Placed,
    sizes: Mapping[int, float] | None = None,
    walls: Any = (),
    strengths: Sequence[float] = (450.0, 450.0),
    moving: tuple[int, Sequence[float]] | None = None,
    resets: bool = False,
    **options: Any,
) -> Any:
    """Return an engine at the start of a scene, one body perhaps in motion."""
    scene = make_scene(placed, sizes, walls, resets_velocity=resets)
    if moving is not None:
        options["initial"] = State.at_start(scene)
        options["initial"].velocity[moving[0]] = moving[1]
    return world(scene, strengths, **options)


def after(engine: Any, *pairs: Sequence[int], times: int = 1) -> State:
    """Return the state after steps by these actions of both agents, each so many times."""
    for pair in pairs:
        for _ in range(times):
            engine.step(pair)
    state: State = engine.state
    return state


@pytest.fixture(params=[PymunkWorld, CompiledWorld], ids=["pymunk", "compiled"])
def world(request: pytest.FixtureRequest) -> Any:
    """Each engine's class, as it is used: pymunk with 4 inner steps, the compiled model with 1."""
    return request.param


@pytest.fixture
def start(world: Any) -> Callable[..., Any]:
    """Start each engine; arguments as of ``start_in``."""
    return functools.partial(start_in, world)
