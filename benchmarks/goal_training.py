"""Learn which features of an agent's motion speak for which goal.

    python benchmarks/goal_training.py FOLDER

Events are simulated in scenes like PHASE's. The joint proposal
(:mod:`~phase_ppl.inference.tables`) gives the true effective goals a log probability. The weights
maximise it for whole events, and for its mean over windows of the paper's length. Writes
FOLDER/goal_weights.npz and the report FOLDER/goal_weights.json.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import common
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax.scipy.special import logsumexp
from numpy.typing import NDArray
from strength_training import draw_scene, in_processes
from tqdm.auto import tqdm

from phase_ppl.inference.tables import (
    FEATURES,
    GOALS_ABOUT,
    KINDS,
    WEIGHTS_FILE,
    goal_features,
    window_length,
)
from phase_ppl.models import priors
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.models.sites import IMPOSSIBLE
from phase_ppl.simulator.joint import simulate
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import N_GOALS, goal_index, goal_literal, opposed_goal
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, Hypothesis
from phase_ppl.world.names import AGENTS, BLUE_ITEM, ENTITIES, LANDMARKS, PINK_ITEM
from phase_ppl.world.scene import Scene

Array = jax.Array | NDArray[Any]

SHARES: Final = {"collaborative": 0.25, "independent": 0.25, "opposing": 0.3, "competing": 0.2}
"""Of the events that are drawn."""

FRAMES: Final = 101
QUIET: Final = 0.02
"""Units per frame below which nothing moves; events are cut soon after the last motion, as
PHASE's recordings are."""

AFTER_MOTION: Final = 8
SHORTEST: Final = 30
WINDOW: Final = 10
WINDOWS: Final = 20
"""Windows drawn per event for training."""

EVERY_WINDOW: Final = 0.3
"""Weight of the mean log probability over windows, beside the log of the mean."""

DECAY: Final = 1e-3
ITERATIONS: Final = 150


class Drawn(NamedTuple):
    """A simulated event with its effective goals."""

    scene: Scene
    observation: Observation
    goals: tuple[int, int]


# --- events ----------------------------------------------------------------------------------


def draw_goals(rng: np.random.Generator) -> tuple[str, tuple[int, int]]:
    """Return a scenario and a pair of effective goals of it."""
    scenario = str(rng.choice(list(SHARES), p=list(SHARES.values())))
    first = int(rng.integers(len(AGENTS)))
    if scenario == "collaborative":
        goal = _item_goal(rng) if rng.random() < 0.7 else _self_goal(rng, first)
        return scenario, (goal, goal)
    if scenario == "independent":
        red, green = (
            _item_goal(rng) if rng.random() < 0.6 else _self_goal(rng, agent)
            for agent in range(len(AGENTS))
        )
        return scenario, (red, green)
    if scenario == "opposing":
        about = rng.choice(3)
        if about == 0:
            goal = _item_goal(rng)
        else:
            other = AGENTS[1 - first]
            goal = _self_goal(rng, first) if about == 1 else goal_index(f"get to {other}")
        against = opposed_goal(goal, first)
        return scenario, (goal, against) if first == 0 else (against, goal)
    item = int(rng.choice((BLUE_ITEM, PINK_ITEM)))
    red, green = (_to(item, int(landmark)) for landmark in rng.permutation(len(LANDMARKS))[:2])
    return scenario, (red, green)


def _item_goal(rng: np.random.Generator) -> int:
    item = int(rng.choice((BLUE_ITEM, PINK_ITEM)))
    return _to(item, int(rng.integers(len(LANDMARKS))))


def _self_goal(rng: np.random.Generator, agent: int) -> int:
    return _to(agent, int(rng.integers(len(LANDMARKS))))


def _to(entity: int, landmark: int) -> int:
    """Return the goal to get an entity to a landmark."""
    return goal_index(f"{ENTITIES[entity]} to {LANDMARKS[landmark]}")


def draw_event(seed: int, index: int) -> Drawn | None:
    """Return one simulated event; None where it does not show what its goals say."""
    rng = np.random.default_rng([seed, index])
    scene = draw_scene(rng)
    scenario, goals = draw_goals(rng)
    strengths = map(float, rng.choice(STRENGTH_LEVELS, len(AGENTS)))
    if scenario != "opposing" and _achieved(scene, goals, scene.start[None]).any():
        return None
    event = simulate(
        scene, Hypothesis(*goals, (0, 0), *strengths), frames=FRAMES,
        seed=int(rng.integers(2**31)), overlapping=True,
    )  # fmt: skip
    track = event.observation.trajectory
    if scenario in ("collaborative", "independent") and not _achieved(scene, goals, track).all():
        return None
    moving = np.flatnonzero(np.abs(np.diff(track[..., :2], axis=0)).max(axis=(1, 2)) > QUIET)
    length = max(SHORTEST, int(moving.max(initial=0)) + 1 + AFTER_MOTION)
    return Drawn(scene, Observation(track[:length]), goals)


def _achieved(scene: Scene, goals: tuple[int, int], track: FloatArray) -> NDArray[np.bool_]:
    """Return (agent,) whether its goal about a landmark was true in some frame."""
    literals = [goal_literal(goal, agent) for agent, goal in enumerate(goals)]
    there = track[:, [literal.subject for literal in literals], :2]
    away = np.abs(there - scene.landmark_centres[[literal.target for literal in literals]])
    return np.asarray((away < scene.landmark_half_width).all(axis=-1).any(axis=0))


def draw_events(n: int, seed: int, workers: int) -> list[Drawn]:
    """Return the events among ``n`` draws that show what their goals say."""
    found = in_processes(functools.partial(draw_event, seed), n, workers)
    return [event for event in found if event is not None]


# --- learning --------------------------------------------------------------------------------


class Examples(NamedTuple):
    """Features (event, window + 1, agent, goal, feature), the whole event last; true goals."""

    features: NDArray[np.float32]
    goals: NDArray[np.int64]


def examples(events: list[Drawn], seed: int) -> Examples:
    """Return the features of drawn windows and of whole events."""
    rng = np.random.default_rng(seed)
    rows = []
    for event in tqdm(events, desc="features", disable=None):
        n_frames = event.observation.n_frames
        length = window_length(n_frames, WINDOW)
        starts = rng.choice(n_frames - length, WINDOWS, replace=n_frames - length < WINDOWS)
        first, last = np.append(starts, 0), np.append(starts + length, n_frames - 1)
        rows.append(goal_features(event.scene, event.observation, first, last))
    return Examples(np.array(rows, np.float32), np.array([event.goals for event in events]))


@functools.cache
def _log_prior() -> NDArray[np.float32]:
    """Return (goal red, goal green) the paper's prior of effective goals, up to a constant."""
    pairs = np.array(list(np.ndindex(N_GOALS, N_GOALS)))
    strengths = {f"strength_{name}": np.full(len(pairs), 300.0) for name in ("red", "green")}
    with jax.ensure_compile_time_eval():
        log_prior = log_prior_of_effective(priors.uniform, pairs, strengths)
    return np.maximum(log_prior, IMPOSSIBLE).reshape(N_GOALS, N_GOALS).astype(np.float32)


def log_proposal(weights: jax.Array, features: Array, goals: Array) -> jax.Array:
    """Return (event, ...) log probabilities of the true pairs of effective goals (event, agent).

    Weights are (kind, feature), features (event, ..., agent, goal, feature).
    """
    scores = (jnp.asarray(features) * weights[jnp.asarray(GOALS_ABOUT.kind)]).sum(axis=-1)
    joint = jnp.asarray(_log_prior()) + scores[..., 0, :, None] + scores[..., 1, None, :]
    total = logsumexp(joint, axis=(-2, -1))
    true = jax.vmap(lambda table, pair: table[..., pair[0], pair[1]])(joint, jnp.asarray(goals))
    return true - total


def loss_of_whole(weights: jax.Array, features: Array, goals: Array) -> jax.Array:
    """Return the mean negative log probability from whole events."""
    return -log_proposal(weights, features[:, -1], goals).mean()


def loss_of_windows(weights: jax.Array, features: Array, goals: Array) -> jax.Array:
    """Return the negative log of the mean probability over windows, and a share of each one's."""
    found = log_proposal(weights, features[:, :-1], goals)
    together = logsumexp(found, axis=1) - np.log(found.shape[1])
    return -together.mean() - EVERY_WINDOW * found.mean()


def learned(loss: Callable[..., jax.Array], data: Examples, batch: int = 64) -> FloatArray:
    """Return the (kind, feature) weights of least loss, with a quadratic penalty."""
    shape = len(KINDS), len(FEATURES)
    gradient = jax.jit(jax.value_and_grad(loss))
    parts = np.array_split(np.arange(len(data.goals)), max(1, len(data.goals) // batch))

    def objective(flat: FloatArray) -> tuple[float, FloatArray]:
        value, slope = DECAY * float(flat @ flat), 2 * DECAY * flat
        for part in parts:
            weights = jnp.asarray(flat.reshape(shape), jnp.float32)
            one, other = gradient(weights, data.features[part], data.goals[part])
            share = len(part) / len(data.goals)
            value += share * float(one)
            slope = slope + share * np.asarray(other, np.float64).ravel()
        return value, slope

    with tqdm(total=ITERATIONS, desc=loss.__name__.replace("_", " "), disable=None) as bar:
        found = scipy.optimize.minimize(
            objective,
            np.zeros(np.prod(shape)),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": ITERATIONS},
            callback=lambda _: bar.update(1),
        )
    return np.asarray(found.x, np.float64).reshape(shape)


def main(arguments: list[str] | None = None) -> dict[str, Any]:
    """Draw events, learn, write the weights and a report, and return the report."""
    parser = common.parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--draws", type=int, default=1200, help="events drawn, before the filter")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    events = draw_events(options.draws, options.seed, options.workers)
    data = examples(events, options.seed)
    kept_back = np.arange(len(events)) % 10 == 0
    parts = {
        name: Examples(data.features[chosen], data.goals[chosen])
        for name, chosen in (("training", ~kept_back), ("validation", kept_back))
    }
    losses = {"window": loss_of_windows, "whole": loss_of_whole}
    weights = {name: learned(loss, parts["training"]) for name, loss in losses.items()}
    report = {
        "command": "python benchmarks/goal_training.py",
        "draws": options.draws,
        "seed": options.seed,
        "events": len(events),
        "shares": SHARES,
        "loss": {
            name: {
                part: float(loss(jnp.asarray(weights[name], jnp.float32), *some))
                for part, some in parts.items()
            }
            for name, loss in losses.items()
        },
        "features": FEATURES,
        "kinds": KINDS,
    }
    options.folder.mkdir(parents=True, exist_ok=True)
    stored = {name: values.astype(np.float32) for name, values in weights.items()}
    np.savez(options.folder / WEIGHTS_FILE, allow_pickle=False, **stored)
    report_file = (options.folder / WEIGHTS_FILE).with_suffix(".json")
    report_file.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report["loss"], indent=1))
    return report


if __name__ == "__main__":
    main()
