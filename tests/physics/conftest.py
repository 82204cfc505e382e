"""Both engines of the dynamics behind one interface, so that each fact is tested on both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.physics import compiled, constants
from phase_ppl.physics.actions import NO_ACTION
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import State
from phase_ppl.world.scene import Scene


class CompiledWorld:
    """The compiled model with the interface of ``PymunkWorld``."""

    def __init__(
        self,
        scene: Scene,
        strengths: tuple[float, float],
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
        red, green = (int(action) for action in actions)
        compiled.step_mean(
            self.bodies, self.held, self.weld, np.array([red, green]), params, self.scratch, frame
        )
        return frame

    def step(self, actions: Sequence[int]) -> NDArray[np.float64]:
        return self._step(actions, self.params)

    def find_grab(self, agent: int) -> tuple[int, int]:
        return compiled.find_grab(self.bodies, self.held, agent, self.params)

    @property
    def state(self) -> State:
        return compiled.to_state(self.bodies, self.held, self.weld, self.params.radius)


@pytest.fixture(params=[PymunkWorld, CompiledWorld], ids=["pymunk", "compiled"])
def world(request: pytest.FixtureRequest) -> Any:
    """Each engine's class, as it is used: pymunk with 4 inner steps, the compiled model with 1."""
    return request.param


@pytest.fixture
def compiled_world() -> type[CompiledWorld]:
    return CompiledWorld


MakeScene = Callable[..., Scene]
CORNERS = [[8.0, 20.0], [24.0, 20.0], [8.0, 4.0], [24.0, 4.0]]


@pytest.fixture
def make_scene() -> MakeScene:
    """A scene with some bodies placed and the others out of the way in the corners."""

    def make(
        placed: dict[int, Sequence[float]],
        radius: dict[int, float] | None = None,
        walls: Sequence[Any] = (),
    ) -> Scene:
        start = np.array([[*corner, 0.0] for corner in CORNERS])
        for entity, pose in placed.items():
            start[entity, : len(pose)] = pose
        sizes = np.full(4, 0.8)
        for entity, size in (radius or {}).items():
            sizes[entity] = size
        return Scene(start, sizes, np.array(walls, np.float64).reshape(-1, 2, 2))

    return make


@pytest.fixture
def moving() -> Callable[[Scene, int, Sequence[float]], State]:
    """The start state of a scene with one body in motion."""

    def make(scene: Scene, entity: int, velocity: Sequence[float]) -> State:
        state = State.at_start(scene)
        state.velocity[entity] = velocity
        return state

    return make
