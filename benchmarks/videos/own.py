"""Videos drawn from the closed-loop model itself, so that reading them has an exact reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.agent import Policies
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.closed_loop.hidden_state import filter_gains
from phase_ppl.data.generation.situation import LAYOUTS, CannotDraw, Draw, Situation
from phase_ppl.models.closed_loop import ClosedLoopLikelihood
from phase_ppl.physics import compiled, inverse
from phase_ppl.physics.actions import N_ACTIONS, Action, executed
from phase_ppl.physics.constants import WORLD_INNER_STEPS
from phase_ppl.world.event import Event, Observation, State, Truth
from phase_ppl.world.goals import GOALS, N_GOALS, effective_goals, is_self_referring
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import AGENTS, ENTITIES, ITEMS
from phase_ppl.world.scene import PHASE

ALPHA_PROBABILITIES = (1 / 3, *[1 / 6] * 4)
"""Of the uniform prior, in the order of ``ALPHAS``."""


def drawn_from_prior(rng: np.random.Generator) -> Situation:
    """Return a scene of any layout with roles from the uniform prior over levels."""
    goals = [
        int(rng.choice([g for g in range(N_GOALS) if not is_self_referring(g, agent)]))
        for agent in range(len(AGENTS))
    ]
    alpha = ALPHAS[int(rng.choice(len(ALPHAS), p=ALPHA_PROBABILITIES))]
    while True:
        draw = Draw(PHASE, rng, int(rng.choice(list(LAYOUTS))))
        try:
            return draw.situation(
                effective_goals(goals[0], goals[1], alpha),
                rooms=[draw.room() for _ in ENTITIES],
                size=[draw.size() for _ in ENTITIES],
                strength=(draw.strength(), draw.strength()),
            )
        except CannotDraw:
            continue


def own_event(number: int, likelihood: ClosedLoopLikelihood, n_frames: int = 41) -> Event:
    """Return a video from the model: its policies, its physics, its noise of tracking.

    It is read back with ``Tracking(noise=0)``. Then all assumptions of the reader hold, and
    only its approximations are left.
    """
    rng = np.random.default_rng([7, number])
    drawn = drawn_from_prior(rng)
    scene, goals = drawn.scene, drawn.roles.effective_goals
    strengths = drawn.roles.strengths
    planner, tracking = PlannerConfig.fast(), likelihood.tracking
    world_model = WorldModel.of(scene, strengths, planner)
    agents = [
        Policies(a, world_model, planner, int(rng.integers(2**60)), [goals])
        for a in range(len(AGENTS))
    ]
    start = compiled.from_state(State.at_start(scene), scene.radius)
    bodies, held, weld = start[0][None].copy(), start[1][None].copy(), start[2][None].copy()
    params = compiled.make_params(scene, strengths, inner_steps=WORLD_INNER_STEPS)
    scratch, trial = compiled.make_scratch(), inverse.make_trial()
    newtons, unseen = np.array([strengths]), np.zeros(len(ENTITIES), np.int64)
    gains = np.tile(filter_gains(tracking.scale, 0.0), (len(ENTITIES), 1))
    trajectory = [np.array(scene.start)]
    policy = likelihood.policy
    for _ in range(n_frames - 1):
        meant = []
        for agent in agents:
            agent.observe(bodies[0], held[0], weld[0])
            found = policy.of(agent.root_statistics(agent.intents)[0])
            meant.append(Action(int(rng.choice(N_ACTIONS, p=found))))
            agent.acted(meant[-1])
        done = [executed(action, scene.turning) for action in meant]
        trial.actions[:] = done
        inverse.attempt(bodies[0], held[0], weld[0], params, scratch, trial)
        frame = trial.frame + noise(rng, tracking.scale, tracking.angle_scale, tracking.tail)
        x0, x1, y0, y1 = scene.arena
        frame[:, 0], frame[:, 1] = frame[:, 0].clip(x0, x1), frame[:, 1].clip(y0, y1)
        after = bodies.copy(), held.copy(), weld.copy()
        inverse.follow(bodies, held, weld, newtons, np.zeros(1, np.int64), np.array([done]), frame,
                       gains, unseen, params, scratch, trial, *after)  # fmt: skip
        bodies, held, weld = after
        trajectory.append(frame)
    red, green = strengths
    truth = Truth(GOALS[goals[0]], GOALS[goals[1]], strength_red=red, strength_green=green)
    return Event(scene, Observation(np.array(trajectory)), truth=truth, id=f"own-{number}")


def noise(
    rng: np.random.Generator, scale: float, angle_scale: float, tail: float
) -> NDArray[np.float64]:
    """Return (entity, [x, y, angle]) deviations with the density of ``physics.inverse``."""
    drawn = np.zeros((len(ENTITIES), 3))
    shrunk = np.sqrt(tail / rng.chisquare(tail, (len(ENTITIES), 1)))
    drawn[:, :2] = scale * shrunk * rng.standard_normal((len(ENTITIES), 2))
    drawn[: len(ENTITIES) - len(ITEMS), 2] = angle_scale * rng.standard_t(tail, len(AGENTS))
    return drawn
