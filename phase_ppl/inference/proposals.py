"""Bottom-up proposals Q(h | S^{t1:t2}) from the observed trajectory (paper, Appendix 4B).

Everything that depends on the video is computed once, in NumPy, as tables over the local
intervals; the guide is a NumPyro program that looks them up. The last row of each table is for
the whole video and serves the initial particles.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpy.typing import NDArray

from phase_ppl.agents.ground import DISTANCE_UNIT
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.strength import VALIDATION_SD, estimate, strength_levels_hit
from phase_ppl.models.sites import ALPHA_PROBABILITIES, GOAL_LOGITS, GOAL_SITES, STRENGTH_SITES
from phase_ppl.world.goals import N_GOALS, goal_literal
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.literals import Predicate
from phase_ppl.world.names import AGENTS
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

FloatArray = NDArray[np.float64]

_WIDE: Final = 1e4
"""A normal this wide is flat over the strengths' support, newtons."""


@dataclasses.dataclass(frozen=True, eq=False)
class Proposals:
    """Tables of the proposal distribution; W local intervals, then the whole video.

    Attributes:
        starts: (W + 1,) first frame of each interval; length: frames in a local interval.
        goal_logits: (W + 1, agent, goal).
        strength_mean, strength_sd: (W + 1, agent) newtons.
        eta: scaling factor of the interval draw; prior_share: of proposals from the prior.
    """

    starts: NDArray[np.int32]
    length: int
    goal_logits: NDArray[np.float32]
    strength_mean: NDArray[np.float32]
    strength_sd: NDArray[np.float32]
    eta: float
    prior_share: float

    @property
    def n_windows(self) -> int:
        """W, the number of local intervals."""
        return len(self.starts) - 1

    def guide(self, window: jax.Array) -> None:
        """Sample a hypothesis from the interval's data alone: a NumPyro program."""
        logits = jnp.asarray(self.goal_logits)[window]
        mean = jnp.asarray(self.strength_mean)[window]
        sd = jnp.asarray(self.strength_sd)[window]
        for agent, name in enumerate(GOAL_SITES):
            numpyro.sample(name, dist.Categorical(logits=logits[agent], validate_args=False))
        numpyro.sample("alpha", dist.Categorical(probs=jnp.array(ALPHA_PROBABILITIES)))
        low, high = STRENGTH_RANGE
        for agent, name in enumerate(STRENGTH_SITES):
            numpyro.sample(name, dist.TruncatedNormal(mean[agent], sd[agent], low=low, high=high))

    def window_log_weights(self, errors: jax.Array) -> jax.Array:
        """Return (W,) log probabilities of the intervals, proportional to exp(eta sum of errors).

        Args:
            errors: (time,) of the current simulation; where it is not finite, intervals are
                equally likely.
        """
        finite = jnp.isfinite(errors).all()
        sums = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.where(finite, errors, 0.0))])
        starts = jnp.asarray(self.starts[:-1])
        return jax.nn.log_softmax(self.eta * (sums[starts + self.length + 1] - sums[starts]))


def goal_distances(scene: Scene, observation: Observation, away_radius: float) -> FloatArray:
    """Return how far each goal is from being true, per frame.

    The distance is that of the goal's own entity: the item, the named agent, or between agents.
    For "away" goals it is the distance to the set of places that count as away.

    Returns:
        (time, agent, goal) in units of the arena's diagonal.
    """
    x = observation.positions
    radius = away_radius * (scene.arena[1] - scene.arena[0]) / 2
    distances = np.zeros((observation.n_frames, len(AGENTS), N_GOALS))
    for agent in range(len(AGENTS)):
        for goal in range(N_GOALS):
            literal = goal_literal(goal, agent)
            if literal.predicate is Predicate.ON:
                target = scene.landmark_centres[literal.target]
            else:
                target = x[:, literal.target]
            d = np.linalg.norm(x[:, literal.subject] - target, axis=-1)
            distances[:, agent, goal] = d if literal.positive else np.maximum(0.0, radius - d)
    return distances / DISTANCE_UNIT


def bottom_up(scene: Scene, observation: Observation, settings: SimpleSettings) -> Proposals:
    """Return the proposal tables of one observed event.

    Q(g | S) ∝ exp(-gamma (2 d(t2) - d(t1))): achievement at the end of the interval, or progress
    during it, makes a goal likely. Strengths: normal around the analytic estimate, truncated to
    the support; the prior's width where the interval shows no free motion.
    """
    n_frames = observation.n_frames
    length = min(settings.window, n_frames - 1)
    starts = np.arange(n_frames - length)
    ends = starts + length
    starts, ends = np.append(starts, 0), np.append(ends, n_frames - 1)
    distance = goal_distances(scene, observation, settings.away_radius)
    sign = -1.0 if settings.sign == "intended" else 1.0
    logits = sign * settings.gamma * (2 * distance[ends] - distance[starts]) + GOAL_LOGITS
    levels = strength_levels_hit(scene, observation)
    shown = np.array([estimate(levels[a : b + 1]) for a, b in zip(starts, ends, strict=True)])
    known = np.isfinite(shown)
    return Proposals(
        starts=starts.astype(np.int32),
        length=length,
        goal_logits=logits.astype(np.float32),
        strength_mean=np.where(known, shown, np.mean(STRENGTH_RANGE)).astype(np.float32),
        strength_sd=np.where(known, VALIDATION_SD, _WIDE).astype(np.float32),
        eta=settings.eta,
        prior_share=settings.prior_share,
    )
