"""Four simulators of milliseconds whose posteriors can be summed; none is like PHASE.

Effective goals are codes that say nothing of landmarks, so proposals from the video mislead.

* ``directions``: a goal is a direction, the strength is the speed, one of three bends the noise.
* ``places``: a goal is a place where the agent stays; there are three ways around the straight
  line.
* ``pairs``: every pair of goals, with each of eight seeds, has its own distance from the video.
  One pair teaches nothing about another.
* ``faint``: as ``directions``, seen through noise that leaves most goals possible.

Events are drawn from prior, simulator and likelihood, so their posterior is calibrated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.priors import uniform
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.goals import N_GOALS, is_self_referring
from phase_ppl.world.hypothesis import RELATION_TABLE, RELATIONS, STRENGTH_RANGE, Hypothesis
from phase_ppl.world.scene import Scene

FRAMES: Final = 8
LEVELS: Final = 24  # strengths of the exact sum, each in the middle of its part of the range
BENDS: Final = 3
SEEDS: Final = 8  # of ``pairs``


@dataclasses.dataclass(frozen=True)
class Toy:
    """A simulator of ``hypothesis`` and ``rng``, with the inverse temperature of its likelihood."""

    name: str
    beta: float

    @functools.cached_property
    def model(self) -> ppl.Model:
        simulator = functools.partial(simulate, self.name)
        return ppl.Model(simulator=simulator, likelihood=RadialLikelihood(self.beta))

    def event(self, seed: int) -> tuple[Event, Hypothesis]:
        """Return an event drawn from the model, and what it was drawn from."""
        rng = np.random.default_rng([TOYS.index(self), seed])
        scene, likelihood = stage(), RadialLikelihood(self.beta, 4)
        pairs, log_prior, _ = prior()
        pair = pairs[rng.choice(len(pairs), p=np.exp(log_prior))].tolist()
        (red, green), strengths = pair, rng.uniform(*STRENGTH_RANGE, 2).tolist()
        hypothesis = Hypothesis(red, green, (0, 0), *strengths)
        while True:  # what leaves the arena is drawn again, which is seldom
            frames = itertools.islice(simulate(self.name, scene, hypothesis, rng), FRAMES)
            shown = np.array(list(frames))
            shown[..., :2] = likelihood.replicate(shown[..., :2], rng)
            with contextlib.suppress(InvalidEventError):
                return Event(scene, Observation(shown), f"{self.name}-{seed}"), hypothesis

    def exact(self, event: Event) -> dict[str, FloatArray]:
        """Return the marginals of goals and relation, and the mean strengths."""
        seen = event.observation.trajectory[..., :2]
        start = event.scene.start
        pairs, log_prior, relation = prior()
        grid = levels()
        if self.name == "pairs":
            log_mass = self._of_pairs(seen, start, pairs)
            means = np.full(2, np.mean(STRENGTH_RANGE))
        else:
            log_mass, means = self._of_paths(seen, start, pairs, log_prior, grid)
        mass = np.exp(log_prior + log_mass - (log_prior + log_mass).max())
        mass /= mass.sum()
        return {
            "goal_red": np.bincount(pairs[:, 0], mass, N_GOALS),
            "goal_green": np.bincount(pairs[:, 1], mass, N_GOALS),
            "relation": np.bincount(relation, mass, len(RELATIONS)),
            "strength": means,
        }

    def _of_pairs(
        self, seen: FloatArray, start: FloatArray, pairs: NDArray[np.int64]
    ) -> FloatArray:
        aside = offsets()[pairs[:, 0], pairs[:, 1]].reshape(-1, 2)  # (pair * seed, xy)
        frames = np.repeat(np.broadcast_to(start[:, :2], seen.shape)[None], len(aside), axis=0)
        frames[:, 1:, 0] += aside[:, None]
        error = np.sqrt(((frames - seen) ** 2).sum(axis=(2, 3))).sum(axis=1)
        log_likelihood = (-self.beta * error).reshape(len(pairs), SEEDS)
        return np.logaddexp.reduce(log_likelihood, axis=1) - np.log(SEEDS)

    def _of_paths(
        self,
        seen: FloatArray,
        start: FloatArray,
        pairs: NDArray[np.int64],
        log_prior: FloatArray,
        grid: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        squares = []  # of each agent (goal * level * bend, time)
        for agent in range(2):
            ways = [
                path(self.name, agent, goal, level, bend, start[agent, :2])
                for goal, level, bend in itertools.product(range(N_GOALS), grid, range(BENDS))
            ]
            squares.append(((np.array(ways) - seen[None, :, agent]) ** 2).sum(axis=2))
        rest = ((seen[:, 2:] - start[2:, :2]) ** 2).sum(axis=(1, 2))
        n = LEVELS * BENDS
        found = np.empty((len(pairs), LEVELS, LEVELS))
        for row, (red, green) in enumerate(pairs):
            one = squares[0][red * n : (red + 1) * n]
            other = squares[1][green * n : (green + 1) * n]
            error = np.sqrt(one[:, None] + other[None] + rest).sum(axis=2)
            log_likelihood = (-self.beta * error).reshape(LEVELS, BENDS, LEVELS, BENDS)
            high = log_likelihood.max()
            found[row] = high + np.log(
                np.maximum(np.exp(log_likelihood - high).mean(axis=(1, 3)), 1e-300)
            )
        joint = found + log_prior[:, None, None]
        weights = np.exp(joint - joint.max())
        weights /= weights.sum()
        means = np.array(
            [(weights.sum(axis=(0, 2)) * grid).sum(), (weights.sum(axis=(0, 1)) * grid).sum()]
        )
        high = found.max(axis=(1, 2))
        log_mass = high + np.log(np.exp(found - high[:, None, None]).mean(axis=(1, 2)))
        return log_mass, means


TOYS: Final = (Toy("directions", 8.0), Toy("places", 4.0), Toy("pairs", 6.0), Toy("faint", 2.0))


@functools.cache
def stage() -> Scene:
    """Return an empty scene with both agents near its middle."""
    scene = ppl.load_event("independent").scene
    start = scene.start.copy()
    start[:2, :2] = (15.0, 12.0), (17.0, 12.0)
    start[2:, :2] = (8.0, 4.0), (24.0, 4.0)
    return dataclasses.replace(scene, start=start, walls=scene.walls[:0])


def levels() -> FloatArray:
    """Return the strengths of the exact sum, newtons."""
    low, high = STRENGTH_RANGE
    return low + (high - low) * (np.arange(LEVELS) + 0.5) / LEVELS


@functools.cache
def prior() -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
    """Return the pairs of effective goals, their log prior masses, and their relations."""
    pairs = np.array(
        [
            (red, green)
            for red, green in itertools.product(range(N_GOALS), repeat=2)
            if not is_self_referring(red, 0) and not is_self_referring(green, 1)
        ]
    )
    middle = {name: np.full(len(pairs), 400.0) for name in ("strength_red", "strength_green")}
    log_prior = log_prior_of_effective(uniform, pairs, middle)
    kept = np.isfinite(log_prior)
    pairs, log_prior = pairs[kept], log_prior[kept]
    log_prior = log_prior - np.logaddexp.reduce(log_prior)
    return pairs, log_prior, np.asarray(RELATION_TABLE[pairs[:, 0], pairs[:, 1]])


@functools.cache
def _codes() -> tuple[NDArray[np.int64], FloatArray]:
    rng = np.random.default_rng(5)
    order = np.array([rng.permutation(N_GOALS) for _ in range(2)])
    return order, rng.uniform(-5.0, 5.0, (2, N_GOALS, 2))


@functools.cache
def offsets() -> FloatArray:
    """Return (goal_red, goal_green, seed, xy) how far the red agent jumps in ``pairs``, units."""
    rng = np.random.default_rng(3)
    of_pair = rng.normal(0.0, 2.0, (N_GOALS, N_GOALS, 1, 2))
    return np.clip(of_pair + rng.normal(0.0, 0.1, (N_GOALS, N_GOALS, SEEDS, 2)), -6.0, 6.0)


@functools.lru_cache(200_000)
def _path(
    name: str, agent: int, goal: int, strength: float, bend: int, x: float, y: float
) -> FloatArray:
    order, places = _codes()
    time = np.arange(FRAMES)
    start = np.array([x, y])
    speed = strength / 1000.0
    if name in ("directions", "faint"):
        angle = 2 * np.pi * order[agent, goal] / N_GOALS + 0.06 * (bend - 1) * time
        steps = speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return start + np.concatenate([np.zeros((1, 2)), np.cumsum(steps[1:], axis=0)])
    towards = places[agent, goal]
    length = np.hypot(*towards)
    share = np.minimum(1.0, speed * time / length)[:, None]
    aside = np.array([-towards[1], towards[0]]) / length * (bend - 1)
    return start + share * towards + np.sin(np.pi * share) * aside


def path(
    name: str, agent: int, goal: int, strength: float, bend: int, start: FloatArray
) -> FloatArray:
    """Return (time, xy) the way of an agent."""
    return _path(
        name, agent, int(goal), float(strength), int(bend), float(start[0]), float(start[1])
    )


def simulate(
    name: str, scene: Any, hypothesis: Hypothesis, rng: np.random.Generator
) -> Iterator[FloatArray]:
    """Yield frames without end."""
    shown = np.repeat(scene.start[None], FRAMES, axis=0).astype(np.float64)
    goals = hypothesis.effective_goals
    if name == "pairs":
        shown[1:, 0, :2] += offsets()[goals[0], goals[1], rng.integers(SEEDS)]
    else:
        bends = rng.integers(BENDS, size=2)
        for agent, (goal, strength) in enumerate(zip(goals, hypothesis.strengths, strict=True)):
            where = _path.__wrapped__(
                name, agent, goal, strength, bends[agent], *scene.start[agent, :2]
            )
            shown[:, agent, :2] = where
    yield from shown
    while True:
        yield shown[-1]
