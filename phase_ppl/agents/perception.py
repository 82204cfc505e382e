"""What an agent sees, and what it therefore believes, whatever its goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents import beliefs as belief
from phase_ppl.agents import vision
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.mind import Mind
from phase_ppl.agents.rng import make_rng
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.world.state import State


class Perception:
    """The belief particles of one agent, kept up to date with what it sees.

    Args:
        agent: 0 red, 1 green.
        mind: layout and imagined physics; may be exchanged between observations.
        config: settings of the planner.
        generator: source of all randomness of this agent.

    Attributes:
        beliefs: the particles.
        rng: random numbers of the agent, as compiled code wants them.
        scratch: work space.
    """

    def __init__(
        self, agent: int, mind: Mind, config: PlannerConfig, generator: np.random.Generator
    ) -> None:
        self.agent = agent
        self.mind = mind
        self.config = config
        self.rng = make_rng(generator)
        bodies, _, _ = compiled.from_state(State.at_start(mind.scene), mind.scene.radius)
        self.beliefs = belief.initial_beliefs(
            bodies, agent, config.particles, mind.ground, generator
        )
        self.scratch = compiled.make_scratch()
        self._last_action: Action | None = None

    def done(self, action: Action) -> None:
        """Say what the agent has just executed, which its next prediction starts from."""
        self._last_action = action

    def observe(
        self, bodies: NDArray[np.float64], held: NDArray[np.int64], weld: NDArray[np.float64]
    ) -> None:
        """Look at the true state and bring the belief particles up to date.

        Args:
            bodies, held, weld: the true state as ``physics.compiled.from_state`` gives it.
        """
        mind, beliefs = self.mind, self.beliefs
        vision.observe(
            bodies,
            held,
            self.agent,
            self.config.full_observation,
            mind.params,
            mind.ground,
            beliefs.visible,
            beliefs.cells,
            beliefs.observed,
        )
        if self.config.true_state:
            beliefs.bodies[:], beliefs.held[:], beliefs.weld[:] = bodies, held, weld
            return
        own_action = Action.NO_FORCE if self._last_action is None else self._last_action
        belief.update(
            beliefs,
            bodies,
            held,
            weld,
            self.agent,
            int(own_action),
            self._last_action is not None,
            mind.params,
            mind.ground,
            self.scratch,
            self.rng,
        )
