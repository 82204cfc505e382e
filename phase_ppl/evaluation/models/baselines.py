"""Baselines: one looks at the last frame only, two do not look at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phase_ppl.data.statistics import goal_type, shares
from phase_ppl.evaluation.prediction import Prediction, independent
from phase_ppl.evaluation.registry import Predict, register_model
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import N_GOALS, goal_literal, is_self_referring, is_true, possible_goals
from phase_ppl.world.hypothesis import RELATIONS, relation
from phase_ppl.world.names import AGENTS, ENTITIES, ITEMS, LANDMARKS
from phase_ppl.world.scene import PHASE as PHASE_WORLD
from phase_ppl.world.scene import Scene


# parallel: a prediction of these takes less than a process does to start
@register_model("last_frame", parallel=False, any_world=True)
def last_frame() -> Predict:
    """Each agent wants what is nearest to a landmark at the end: itself or an item that moved.

    The candidates are its own body and the items that moved. Its goal is to get the candidate
    nearest to a landmark's centre in the last frame to that landmark. Ties go to its own body, then
    to the blue item, and to landmarks in their order. An item moved if it ends farther than its own
    radius from its start. The relation follows from the two goals. It gives no probabilities.

    In other worlds than PHASE an agent's goals to get somewhere are equally probable if they are
    true at the end and were not at the start; without any, all its possible goals are. Goals of
    agents are independent, and relations follow from them.
    """
    return _predict


def _predict_elsewhere(scene: Scene, observation: Observation) -> Prediction:
    world, frames = scene.world, observation.whole("the last frame").trajectory
    shares = np.zeros((len(world.agents), len(world.goals)))
    for agent, share in enumerate(shares):
        possible = possible_goals(agent, world)
        literals = {goal: goal_literal(goal, agent, world) for goal in possible}
        came_true = [
            goal
            for goal, literal in literals.items()
            if literal.positive
            and is_true(literal, frames[-1], scene)
            and not is_true(literal, frames[0], scene)
        ]
        alike = came_true or possible
        share[alike] = 1 / len(alike)
    return Prediction("", independent(shares, world), world=world)


def _predict(scene: Scene, observation: Observation, seed: int) -> Prediction:
    if scene.world != PHASE_WORLD:
        return _predict_elsewhere(scene, observation)
    start, *_, end = observation.whole("the last frame").positions
    moved = np.linalg.norm(end - start, axis=1) > scene.radius
    distance = np.linalg.norm(end[:, None] - scene.landmark_centres, axis=2)
    goals = []
    for agent in range(len(AGENTS)):
        own = [agent, *(item for item in map(ENTITIES.index, ITEMS) if moved[item])]
        which, landmark = np.unravel_index(distance[own].argmin(), (len(own), len(LANDMARKS)))
        goals.append(f"Get {ENTITIES[own[which]]} to {LANDMARKS[landmark]}")
    red, green = goals
    return Prediction(
        "", answers={"goal_red": red, "goal_green": green, "relation": relation(red, green)}
    )


@register_model("majority", parallel=False)
def majority() -> Predict:
    """The most frequent relation and goals of PHASE; it does not look at the video.

    Shares are those of the 500 original events (:mod:`phase_ppl.data.statistics`), from the paper
    and the names of the recordings, for all events. PHASE's 100 test videos are among the 500.
    Shares of goals are known by type (item or agent, landmark or agent, to or away from); goals of
    one type are equally frequent. So eight goals are the most frequent, and the first of them in
    label order is the answer.
    """
    goals = [goal_shares(agent) for agent in range(len(AGENTS))]
    relations = np.array([shares("relation")[relation] for relation in RELATIONS])
    prediction = Prediction(
        "", {"goal_red": goals[0], "goal_green": goals[1], "relation": relations}
    )
    return lambda scene, observation, seed: prediction


@register_model("chance", parallel=False)
def chance() -> Predict:
    """Uniform over relations: with an observer, it shows what surface cues alone can tell."""
    prediction = Prediction("", {"relation": np.full(len(RELATIONS), 1 / len(RELATIONS))})
    return lambda scene, observation, seed: prediction


def goal_shares(agent: int) -> NDArray[np.float64]:
    """Return (36,) how frequent an agent's effective goals are in PHASE, sum 1; 0 red, 1 green."""
    known = shares("goal_type")
    types = [None if is_self_referring(goal, agent) else goal_type(goal) for goal in range(N_GOALS)]
    return np.array([0.0 if name is None else known[name] / types.count(name) for name in types])
