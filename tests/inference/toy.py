"""Small worlds in which inference can be checked against exact enumeration."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import lax
from numpy.typing import NDArray
from numpyro.infer.mcmc import MCMCKernel

from phase_ppl.inference.guide import Guide, bottom_up_guide
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.tables import BottomUpTables, window_count
from phase_ppl.models import sites
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.goals import GOALS, N_GOALS, goal_literal
from phase_ppl.world.hypothesis import ALPHAS, STRENGTH_RANGE, Hypothesis
from phase_ppl.world.names import PredicateKind
from phase_ppl.world.scene import Scene

N_FRAMES = 5
SETTINGS = SimpleSettings(eta=0.1, window=2)
SEEDS = 3
"""Simulator seeds make one of so many equally likely simulations."""

RED_GOALS, RED_MASS = (0, 5, 18), (0.5, 0.3, 0.2)
GREEN_GOALS, GREEN_MASS = (3, 9), (0.6, 0.4)
ALPHA_CODES, ALPHA_MASS = (0, 1, 4), (0.5, 0.3, 0.2)


def few_goals() -> None:
    """A prior with mass on eighteen combinations, unequal ones."""
    _goals()
    _categorical("alpha", ALPHA_CODES, jnp.array(ALPHA_MASS), len(ALPHAS))
    sites.strengths()


def all_of_few_goals() -> list[tuple[float, Hypothesis]]:
    """Return the eighteen combinations of ``few_goals`` with their prior masses."""
    axes = ((RED_GOALS, RED_MASS), (GREEN_GOALS, GREEN_MASS), (ALPHA_CODES, ALPHA_MASS))
    return [
        (p * q * s, Hypothesis(red, green, ALPHAS[alpha]))
        for (red, p), (green, q), (alpha, s) in itertools.product(
            *(zip(*one, strict=True) for one in axes)
        )
    ]


def characters() -> None:
    """The goals of ``few_goals`` and sites of one's own: a vector, above a bounded number whose
    bounds it sets, above alpha; and one below a goal."""
    red = _goals()
    outgoing = numpyro.sample("outgoing", dist.Bernoulli(OUTGOING).expand([2]).to_event(1))
    low, high = sociability_bounds(outgoing.sum())
    sociability = numpyro.sample("sociability", dist.Uniform(low, high))
    shares = jnp.array([1.0, 0.0, 0.0]) + sociability * jnp.array(SOCIABLE)
    _categorical("alpha", ALPHA_CODES, shares, len(ALPHAS))
    numpyro.sample("haste", dist.Normal(red / 10, 1.0))
    sites.strengths()


OUTGOING = 0.4
SOCIABLE = (-1.0, 0.6, 0.4)
"""How the shares of the three alphas change with sociability."""


def sociability_bounds(outgoing: Any) -> tuple[Any, Any]:
    return 0.1 * outgoing, 0.5 + 0.25 * outgoing


def _goals() -> jax.Array:
    red = _categorical("goal_red", RED_GOALS, jnp.array(RED_MASS), N_GOALS)
    _categorical("goal_green", GREEN_GOALS, jnp.array(GREEN_MASS), N_GOALS)
    return red


def _categorical(name: str, codes: Sequence[int], mass: jax.Array, n: int) -> jax.Array:
    probs = jnp.zeros(n).at[jnp.array(codes)].set(mass)
    return numpyro.sample(name, dist.Categorical(probs=probs))


class TableRunner:
    """Looks errors up instead of simulating; stands for a runner and its simulator.

    Args:
        errors: (effective goal of each agent, ..., seed modulo SEEDS, time), units.
        stops_early: whether it stops where it may.

    Attributes:
        batches: the error ceilings of each call.
    """

    def __init__(self, errors: FloatArray, stops_early: bool = True) -> None:
        self.errors = errors
        self.stops_early = stops_early
        self.batches: list[list[float]] = []

    def run(
        self,
        hypotheses: Sequence[Hypothesis],
        seeds: Sequence[int],
        error_ceilings: Sequence[float],
    ) -> list[SimulationResult]:
        self.batches.append(list(error_ceilings))
        rows = zip(hypotheses, seeds, error_ceilings, strict=True)
        return [self._simulate(*row) for row in rows]

    def _simulate(self, hypothesis: Hypothesis, seed: int, ceiling: float) -> SimulationResult:
        errors = self.errors[(*hypothesis.effective_goals, seed % SEEDS)].copy()
        over = np.cumsum(errors) > (ceiling if self.stops_early else np.inf)
        frames = int(over.argmax()) + 1 if over.any() else len(errors)
        errors[frames:] = np.inf
        trajectory = np.zeros((len(errors), 4, 3))
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


def table_guide(prior: Any = few_goals, seed: int = 1) -> Guide:
    """A guide whose windows disagree: each one has goals of its own in mind."""
    n_windows = window_count(N_FRAMES, SETTINGS.window)
    logits = np.random.default_rng(seed).normal(0.0, 2.0, (n_windows + 1, 2, N_GOALS))
    return guide_of_logits(prior, logits)


def guide_of_logits(prior: Any, logits: FloatArray) -> Guide:
    """A guide with estimates of strengths in window 1 only."""
    strength = np.full((len(logits), 2), np.nan)
    strength[1] = 300.0, 450.0
    tables = BottomUpTables(logits, strength, np.where(np.isnan(strength), np.nan, 40.0))
    return bottom_up_guide(prior, Model(prior=prior).sites, tables, prior_share=0.1)


def exact_posterior(errors: FloatArray, alpha_mass: Sequence[float] = ALPHA_MASS) -> FloatArray:
    """Return (red, green, alpha) of the stated hypotheses of ``few_goals``, by enumeration."""
    mass = _exact_masses(errors, alpha_mass)
    return mass / mass.sum()


def exact_log_evidence(errors: FloatArray) -> float:
    """Return the log probability of the observation under ``few_goals``, by enumeration."""
    return float(np.log(_exact_masses(errors, ALPHA_MASS).sum())) - N_FRAMES * 36


def _exact_masses(errors: FloatArray, alpha_mass: Sequence[float]) -> FloatArray:
    """Return (red, green, alpha) prior times likelihood, times exp(36) a frame."""
    likelihood = RadialLikelihood()
    mass = np.einsum("r,g,a->rga", RED_MASS, GREEN_MASS, alpha_mass)
    for r, g, a in np.ndindex(mass.shape):
        h = Hypothesis(RED_GOALS[r], GREEN_GOALS[g], ALPHAS[ALPHA_CODES[a]])
        log_likelihood = likelihood.log_prob(errors[h.effective_goals]).sum(axis=-1)
        mass[r, g, a] *= np.exp(log_likelihood + N_FRAMES * 36).mean()
    return mass


class Characters(NamedTuple):
    """Posterior under the prior ``characters``: the hypotheses, and means of its own sites."""

    share: FloatArray
    means: dict[str, float]


def exact_characters(errors: FloatArray) -> Characters:
    """Return the posterior by enumeration of what is discrete; the rest has closed forms."""
    outgoing = np.arange(3)
    mass = np.array([1.0, 2.0, 1.0]) * OUTGOING**outgoing * (1 - OUTGOING) ** (2 - outgoing)
    low, high = sociability_bounds(outgoing)
    # moments of sociability given the number of outgoing agents
    m1, m2 = (low + high) / 2, (low**2 + low * high + high**2) / 3
    constant, slope = np.array([1.0, 0, 0]), np.array(SOCIABLE)
    alpha = constant[:, None] + slope[:, None] * m1  # (alpha, outgoing)
    sociable = constant[:, None] * m1 + slope[:, None] * m2
    share = exact_posterior(errors, alpha @ mass)
    given = share.sum(axis=(0, 1)) / (alpha @ mass)
    return Characters(
        share,
        {
            "outgoing": float(given @ alpha @ (mass * outgoing)) / 2,
            "sociability": float(given @ sociable @ mass),
            "haste": float(share.sum(axis=(1, 2)) @ np.array(RED_GOALS)) / 10,
            **dict.fromkeys(sites.STRENGTH_SITES, float(np.mean(STRENGTH_RANGE))),
        },
    )


def visited_share(z: dict[str, NDArray[Any]], log_weight: Any = 0.0) -> FloatArray:
    """Return (red, green, alpha) how often draws visit each stated hypothesis, by their weights."""
    axes = ((z["goal_red"], RED_GOALS), (z["goal_green"], GREEN_GOALS), (z["alpha"], ALPHA_CODES))
    share = np.zeros([len(codes) for _, codes in axes])
    where = [np.searchsorted(codes, np.asarray(drawn).ravel()) for drawn, codes in axes]
    np.add.at(share, tuple(where), np.exp(np.ravel(log_weight) - np.max(log_weight)))
    return share / share.sum()


def run(kernel: MCMCKernel, n_steps: int, keys: jax.Array, start: Any = None) -> Any:
    """Return the states (step, chain, ...) of all chains together, from their own start or one."""

    def whole(keys: jax.Array) -> Any:
        def advance(state: Any, _: None) -> tuple[Any, Any]:
            state = kernel.sample(state, (), {})
            return state, state

        state = kernel.init(keys, 0, None, (), {}) if start is None else start
        return lax.scan(advance, state, None, length=n_steps)[1]

    return jax.block_until_ready(compiled_quickly(whole)(keys))


def total_variation(one: FloatArray, other: FloatArray) -> float:
    return 0.5 * float(np.abs(one - other).sum())


def never_called(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Any:
    raise AssertionError("nothing was to be simulated")


def walkers(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Each goal's entity walks straight to its target, the faster the stronger its agent."""
    frame = scene.start.copy()
    while True:
        yield frame.copy()
        for agent, goal in enumerate(hypothesis.effective_goals):
            literal = goal_literal(goal, agent)
            on = literal.predicate is PredicateKind.ON
            target = scene.landmark_centres[literal.target] if on else frame[literal.target, :2]
            way = (target - frame[literal.subject, :2]) * (1 if literal.positive else -1)
            step = hypothesis.strengths[agent] / 600 * way / max(float(np.linalg.norm(way)), 1.0)
            frame[literal.subject, :2] += 0.5 * step + rng.normal(0.0, 0.02, 2)
            frame[literal.subject, :2] = np.clip(frame[literal.subject, :2], 6.5, 21.5)


START = np.array([[8, 10, 0.3], [20, 8, 1.0], [10, 16, 0], [18, 12, 0]], float)
SCENE = Scene(START, np.array([0.8, 1.2, 1.01, 0.8]))


def moving(n_frames: int = 21, **towards: tuple[float, float]) -> Observation:
    """Entities named by their index go straight to places: ``_0=(x, y)``; the others rest."""
    frames = np.repeat(START[None], n_frames, axis=0)
    for name, place in towards.items():
        entity = int(name[1:])
        frames[:, entity, :2] = np.linspace(START[entity, :2], place, n_frames)
    return Observation(frames)


def walking_event(n_frames: int = 14) -> Event:
    scene = Scene(START + np.array([[0], [0], [1], [0]]) * [4, 0, 0], SCENE.radius)
    truth = Truth("Get blue item to red lm", "get to red agent")
    h = Hypothesis(GOALS.index(truth.goal_red), GOALS.index(truth.goal_green), (0, 0), 400, 300)
    frames = itertools.islice(walkers(scene, h, np.random.default_rng(1)), n_frames)
    return Event(scene, Observation(np.array(list(frames))), id="walk", truth=truth)
