"""Small worlds in which inference can be checked against exact enumeration."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import lax
from numpy.typing import NDArray
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.guide import Mixture, bottom_up_guide
from phase_ppl.inference.proposals import BottomUpTables, window_count
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.models import sites
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS, N_GOALS, goal_literal
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from phase_ppl.world.literals import Predicate
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

FloatArray = NDArray[np.float64]

N_FRAMES = 5
SETTINGS = SimpleSettings(eta=0.1, window=2)
SEEDS = 3
"""Simulator seeds make one of so many equally likely simulations."""

RED_GOALS = (0, 5, 18)
GREEN_GOALS = (3, 9)
ALPHA_CODES = (0, 1, 4)


def few_goals() -> None:
    """A prior with mass on eighteen combinations, unequal ones."""
    for name, codes, mass in (
        ("goal_red", RED_GOALS, (0.5, 0.3, 0.2)),
        ("goal_green", GREEN_GOALS, (0.6, 0.4)),
    ):
        probs = np.zeros(N_GOALS)
        probs[list(codes)] = mass
        numpyro.sample(name, dist.Categorical(probs=jnp.asarray(probs)))
    probs = np.zeros(len(ALPHAS))
    probs[list(ALPHA_CODES)] = (0.5, 0.3, 0.2)
    numpyro.sample("alpha", dist.Categorical(probs=jnp.asarray(probs)))
    sites.strengths()


class TableRunner:
    """Looks errors up instead of simulating; stands for a runner and its simulator.

    Args:
        errors: (effective red, effective green, seed modulo SEEDS, time), units.
    """

    def __init__(self, errors: FloatArray) -> None:
        self.errors = errors
        self.batches: list[int] = []

    def run(
        self,
        hypotheses: Sequence[Hypothesis],
        seeds: Sequence[int],
        error_ceilings: Sequence[float],
    ) -> list[SimulationResult]:
        self.batches.append(len(hypotheses))
        rows = zip(hypotheses, seeds, error_ceilings, strict=True)
        return [self._simulate(*row) for row in rows]

    def _simulate(self, hypothesis: Hypothesis, seed: int, ceiling: float) -> SimulationResult:
        red, green = hypothesis.effective_goals
        errors = self.errors[red, green, seed % SEEDS].copy()
        over = np.cumsum(errors) > ceiling
        frames = int(over.argmax()) + 1 if over.any() else len(errors)
        errors[frames:] = np.inf
        trajectory = np.zeros((len(errors), 4, 3), np.float32)
        return SimulationResult(hypothesis, seed, trajectory, errors, frames, not over.any())


def table_errors(seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    level = rng.gamma(2.0, 5.0, (N_GOALS, N_GOALS, 1, 1))
    return level * rng.gamma(3.0, 0.5, (N_GOALS, N_GOALS, SEEDS, N_FRAMES))


def table_program(
    runner: TableRunner, prior: Any = few_goals
) -> tuple[EventProgram, SimulatorBridge]:
    """Return a program and its bridge, which must be kept for as long as the program runs."""
    model = Model(prior=prior, simulator=never_called)
    bridge = SimulatorBridge(runner, N_FRAMES)
    return EventProgram(model, bridge.handle, N_FRAMES), bridge


def table_guide(prior: Any = few_goals, seed: int = 1) -> Mixture:
    """A guide whose windows disagree: each one has goals of its own in mind."""
    n_windows = window_count(N_FRAMES, SETTINGS.window)
    rng = np.random.default_rng(seed)
    logits = rng.normal(0.0, 2.0, (n_windows + 1, 2, N_GOALS))
    strength = np.full((n_windows + 1, 2), np.nan)
    strength[1] = 300.0, 450.0
    tables = BottomUpTables(logits, strength, np.where(np.isnan(strength), np.nan, 40.0))
    return bottom_up_guide(prior, Model(prior=prior).sites, tables, prior_share=0.1)


def exact_posterior(errors: FloatArray) -> FloatArray:
    """Return (red, green, alpha) of the stated hypotheses of ``few_goals``, by enumeration."""
    likelihood = RadialLikelihood()
    prior = np.einsum("r,g,a->rga", (0.5, 0.3, 0.2), (0.6, 0.4), (0.5, 0.3, 0.2))
    mass = np.zeros_like(prior)
    for r, g, a in itertools.product(*map(range, prior.shape)):
        h = Hypothesis(RED_GOALS[r], GREEN_GOALS[g], ALPHAS[ALPHA_CODES[a]])
        log_likelihood = likelihood.log_prob(errors[h.effective_goals]).sum(axis=-1)
        mass[r, g, a] = prior[r, g, a] * np.exp(log_likelihood + N_FRAMES * 36).mean()
    return mass / mass.sum()


def visited_share(z: dict[str, NDArray[Any]]) -> FloatArray:
    """Return (red, green, alpha) how often draws visit each stated hypothesis."""
    axes = ((z["goal_red"], RED_GOALS), (z["goal_green"], GREEN_GOALS), (z["alpha"], ALPHA_CODES))
    share = np.zeros([len(codes) for _, codes in axes])
    where = [np.searchsorted(codes, np.asarray(drawn).ravel()) for drawn, codes in axes]
    np.add.at(share, tuple(where), 1.0)
    return share / share.sum()


compiled = functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
"""Compilation that does not take longer than the test."""


def run(kernel: MCMCKernel, n_steps: int, keys: jax.Array) -> Any:
    """Return the states (step, chain, ...) of all chains together; (step, ...) for a single key."""

    def whole(keys: jax.Array) -> Any:
        def advance(state: Any, _: None) -> tuple[Any, Any]:
            state = kernel.sample(state, (), {})
            return state, state

        return lax.scan(advance, kernel.init(keys, 0, None, (), {}), None, length=n_steps)[1]

    return jax.block_until_ready(compiled(whole)(keys))


def total_variation(one: FloatArray, other: FloatArray) -> float:
    return 0.5 * float(np.abs(one - other).sum())


def never_called(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Any:
    raise AssertionError("nothing was to be simulated")


# --- a simulator for whole runs ----------------------------------------------------------------


def walkers(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Each goal's entity walks straight to its target, the faster the stronger its agent."""
    frame = scene.start.copy()
    while True:
        yield frame.copy()
        for agent, goal in enumerate(hypothesis.effective_goals):
            literal = goal_literal(goal, agent)
            on = literal.predicate is Predicate.ON
            target = scene.landmark_centres[literal.target] if on else frame[literal.target, :2]
            way = (target - frame[literal.subject, :2]) * (1 if literal.positive else -1)
            step = hypothesis.strengths[agent] / 600 * way / max(np.linalg.norm(way), 1.0)
            frame[literal.subject, :2] += 0.5 * step + rng.normal(0.0, 0.02, 2)
            frame[literal.subject, :2] = np.clip(frame[literal.subject, :2], 6.5, 21.5)


def walking_event(n_frames: int = 14) -> Event:
    start = np.array([[8, 10, 0.3], [20, 8, 1.0], [14, 16, 0], [18, 12, 0]], float)
    scene = Scene(start, np.array([0.8, 1.2, 1.01, 0.8]))
    truth = Truth("Get blue item to red lm", "get to red agent")
    h = Hypothesis(GOALS.index(truth.goal_red), GOALS.index(truth.goal_green), (0, 0), 400, 300)
    frames = itertools.islice(walkers(scene, h, np.random.default_rng(1)), n_frames)
    return Event(scene, Observation(np.array(list(frames))), id="walk", truth=truth)
