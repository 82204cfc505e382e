"""A baseline that looks at the last frame only."""

from __future__ import annotations

import numpy as np

from phase_ppl.evaluation.answer import Predict
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.names import AGENTS, ENTITIES, ITEMS, LANDMARKS
from phase_ppl.world.observation import Observation
from phase_ppl.world.relations import relation
from phase_ppl.world.scene import Scene


# a prediction takes less than a process does to start
@register_model("last_frame", parallel=False)
def last_frame() -> Predict:
    """Each agent wants what is nearest to a landmark at the end: itself or an item that moved.

    Of its own body and the items that moved, the one nearest to a landmark's centre in the last
    frame is to be there; ties go to the own body, then to the blue item, and to landmarks in
    their order. An item moved if it ends farther than its own radius from where it began. The
    relation follows from the two goals. There are no probabilities: it only names its answers.
    """
    return _predict


def _predict(scene: Scene, observation: Observation, seed: int) -> Prediction:
    start, end = observation.positions[0], observation.positions[-1]
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
