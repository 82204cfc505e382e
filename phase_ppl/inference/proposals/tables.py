"""What a window of the observation says about goals and strengths (paper, Appendix 4B).

Computed once per event, in NumPy, in one of two forms.

"learned". Goals are scored by :mod:`~phase_ppl.inference.proposals.goal_features`, which also see
what the agent itself did, and proposed together with alpha
(:func:`joint_logits`). The weights of the features were learned from
simulated events. Strengths are estimated from the whole observation.

"paper". A goal is proposed for a window from t1 to t2 in proportion to
exp(-gamma (2 d(t2) - d(t1)) / 28.28): it is likely if it is nearly achieved at the end (d(t2)
small) or has come closer (d(t1) - d(t2) large); alpha comes from the prior. The paper prints the
opposite sign, which its text contradicts; ``sign="printed"`` keeps it.

d is the distance of the goal's own entity: of the item for a goal about an item, of the named
agent for a goal about an agent at a landmark, between the agents for "get to". For a goal to be
*away* it is the distance to the set of places that are away: max(0, R - distance), with R the
diagonal of the arena. A smaller R leaves many goals at distance 0 that nobody works for.
"""

from __future__ import annotations

import functools
import importlib.resources
from typing import Any, Final, Literal, NamedTuple, get_args

import jax
import numpy as np

from phase_ppl.inference.proposals.goal_features import GOAL_PARTS, goal_features
from phase_ppl.inference.proposals.strength import DEFAULT_ESTIMATOR, Estimator, estimated_strengths
from phase_ppl.models.sites import IMPOSSIBLE, SELF_REFERRING
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.goals import N_GOALS, effective_goals, goal_literal
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import AGENTS, Predicate
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

Sign = Literal["intended", "printed"]
Form = Literal["learned", "paper"]

SIGNS: Final = get_args(Sign)
FORMS: Final = get_args(Form)

WEIGHTS_FILE: Final = "goal_weights.npz"
"""Weights of the features, (kind, feature): ``window`` and ``whole``."""


def window_length(n_frames: int, window: int) -> int:
    """Return Delta T, the steps from the first to the last frame of a window."""
    return min(window, n_frames - 1)


def window_count(n_frames: int, window: int) -> int:
    """Return the number of windows; window k holds the frames k, ..., k + Delta T."""
    return n_frames - window_length(n_frames, window)


class BottomUpTables(NamedTuple):
    """What each window says; the last entry is about the whole observation.

    Attributes:
        goal_logits: (window + 1, agent, goal) unnormalised log probabilities of stated goals; or
            (window + 1, alpha, agent, goal), given alpha.
        strength: (window + 1, agent) estimate, newtons; NaN where there is none.
        strength_sd: (window + 1, agent) its standard deviation, newtons; NaN likewise.
        alpha_logits: (window + 1, alpha) beside the prior's; None: alpha as in the prior.
    """

    goal_logits: FloatArray | jax.Array
    strength: FloatArray | jax.Array
    strength_sd: FloatArray | jax.Array
    alpha_logits: FloatArray | jax.Array | None = None


def padded(tables: BottomUpTables, n_windows: int) -> BottomUpTables:
    """Return the tables with room for so many windows; what comes last is repeated."""

    def longer(table: Any) -> Any:
        beyond = [(0, n_windows + 1 - len(table)), *[(0, 0)] * (np.ndim(table) - 1)]
        return np.pad(np.asarray(table, np.float32), beyond, mode="edge")

    return BottomUpTables(*(None if table is None else longer(table) for table in tables))


def bottom_up_tables(
    scene: Scene,
    observation: Observation,
    *,
    window: int = 10,
    form: Form = "learned",
    gamma: float = 10.0,
    sign: Sign = "intended",
    strength: str | Estimator = DEFAULT_ESTIMATOR,
) -> BottomUpTables:
    """Return the tables of an event.

    Args:
        scene, observation: what was seen.
        window: Delta T, steps; shorter where the observation is.
        form: of the proposal of goals, "learned" or "paper".
        gamma: weight of the distances in the paper's form.
        sign: "intended", or "printed" as in the paper.
        strength: name of an estimator of strengths, or one.
    """
    n_frames = observation.n_frames
    length = window_length(n_frames, window)
    starts = np.arange(window_count(n_frames, window))
    first, last = np.append(starts, 0), np.append(starts + length, n_frames - 1)
    windows = np.column_stack([first, last])
    estimates = estimated_strengths(strength, scene, observation, windows)
    if form == "learned":
        goal, alpha = joint_logits(_scores(scene, observation, first, last))
        # an agent is as strong in one window as in another: the whole observation says it best
        strength_of_all, sd_of_all = (np.broadcast_to(part[-1], part.shape) for part in estimates)
        return BottomUpTables(goal, strength_of_all, sd_of_all, alpha)
    distance = goal_distances(scene, observation)
    x0, x1, y0, y1 = scene.arena
    unit = float(np.hypot(x1 - x0, y1 - y0))
    closeness = gamma * (2 * distance[last] - distance[first]) / unit
    logits = closeness if sign == "printed" else -closeness
    return BottomUpTables(np.where(SELF_REFERRING, IMPOSSIBLE, logits), *estimates)


_EFFECTIVE: Final = [
    np.array([effective_goals(goal, goal, alpha) for goal in range(N_GOALS)]).T for alpha in ALPHAS
]
"""Per alpha, (agent, goal) what an agent does for each stated goal of the one it acts on."""


def joint_logits(scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unnormalised log probabilities of stated goals and alpha.

    Args:
        scores: (..., agent, goal) of effective goals.

    Returns:
        (..., alpha, agent, goal) of the stated goals given alpha; (..., alpha) beside the prior's.
    """
    goal = np.where(SELF_REFERRING, IMPOSSIBLE, 0.0)
    goal = np.broadcast_to(goal, (*scores.shape[:-2], len(ALPHAS), *goal.shape)).copy()
    for index, alpha in enumerate(ALPHAS):
        for agent, effective in enumerate(_EFFECTIVE[index]):
            owner = agent if alpha[agent] == 0 else 1 - agent  # of the goal that it acts on
            goal[..., index, owner, :] += scores[..., agent, :][..., effective]
    goal = np.where(SELF_REFERRING, IMPOSSIBLE, goal)
    evidence = np.logaddexp.reduce(goal, axis=-1).sum(axis=-1)
    return goal, evidence - evidence.max(axis=-1, keepdims=True)


def _scores(scene: Scene, observation: Observation, first: IntArray, last: IntArray) -> FloatArray:
    """Return (window + 1, agent, goal) scores; the last stretch is the whole observation."""
    features = goal_features(scene, observation, first, last)
    weights = goal_weights()
    scores = (features * weights["window"][GOAL_PARTS.kind]).sum(axis=-1)
    scores[-1] = (features[-1] * weights["whole"][GOAL_PARTS.kind]).sum(axis=-1)
    return scores


@functools.cache
def goal_weights() -> dict[str, FloatArray]:
    """Return the weights that come with the package, (kind, feature) each."""
    file = importlib.resources.files(__package__) / WEIGHTS_FILE
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
        return {name: stored[name].astype(np.float64) for name in ("window", "whole")}


def goal_distances(scene: Scene, observation: Observation) -> FloatArray:
    """Return (time, agent, goal) how far each goal is from being achieved, units."""
    position = observation.positions
    x0, x1, y0, y1 = scene.arena
    farthest = float(np.hypot(x1 - x0, y1 - y0))
    distance = np.empty((len(position), len(AGENTS), N_GOALS))
    for holder in range(len(AGENTS)):
        for goal in range(N_GOALS):
            literal = goal_literal(goal, holder)
            if literal.predicate is Predicate.ON:
                target = scene.landmark_centres[literal.target]
            else:
                target = position[:, literal.target]
            apart = np.linalg.norm(position[:, literal.subject] - target, axis=-1)
            distance[:, holder, goal] = (
                apart if literal.positive else np.maximum(0.0, farthest - apart)
            )
    return distance
