"""A small evaluation, whose figures can be worked out by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.evaluation.evaluation import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.prediction import Prediction, probabilities_of
from phase_ppl.world.event import Event, Truth
from tests.analysis.factory import Simulation, hypothesis, make_tree
from tests.world.examples import make_event, make_scene

HOSTILE = "<script>alert(1)</script> & \"x\" '$y$'"
RED, GREEN = "Get blue item to red lm", "Get blue item to green lm"

COMPETING = Truth(RED, GREEN)
COLLABORATIVE = Truth(RED, RED)


def goals(count: int = 3) -> dict[str, Any]:
    """Return judgments in which most see the competing goals and all three relations."""
    return {
        "relation_counts": {"friendly": 3, "neutral": 0, "adversarial": 7},
        "goal_counts": {"red agent": {RED: count}, "green agent": {GREEN: count, RED: 1}},
    }


def events(**changes: Any) -> list[Event]:
    """Return three events: competing, collaborative, and one whose truth is not known."""
    made = [
        dataclasses.replace(make_event(id="one"), truth=COMPETING, judgments=goals()),
        dataclasses.replace(make_event(id=HOSTILE), truth=COLLABORATIVE, judgments=None),
        dataclasses.replace(make_event(id="three"), truth=None, judgments=goals(), predictions={}),
    ]
    references = {"<b>other</b>": {"goals": {"red agent": RED}, "relation": "neutral"}}
    made = [
        dataclasses.replace(e, predictions=references if e.id != "three" else None) for e in made
    ]
    return [dataclasses.replace(event, **changes) for event in made]


def prediction(event_id: str) -> Prediction:
    """Return a prediction: red's goal is RED, green's likely RED too, so friendly."""
    shares: dict[str, Mapping[str, float]] = {
        "goal_red": {RED: 0.9, GREEN: 0.1},
        "goal_green": {RED: 0.6, GREEN: 0.4},
        "relation": {"friendly": 0.5, "neutral": 0.25, "adversarial": 0.25},
    }
    given = {question: probabilities_of(question, values) for question, values in shares.items()}
    return Prediction(event_id, given, cost={"seconds": 2.5})


def make_folder(
    path: Path, of: Sequence[Event] | None = None, predicted: Callable[[str], bool] = lambda _: True
) -> ResultsFolder:
    """Return a folder in which the events that ``predicted`` names have predictions."""
    folder = ResultsFolder.create(path, {"model": "simple", "seed": 0}, of or events())
    for event in folder.events:
        if predicted(event.id):
            folder.add(prediction(event.id))
    return folder


def make_posterior(event_id: str, n_frames: int = 4) -> Posterior:
    """Return a posterior with two draws over the scene of :func:`make_event`."""
    scene = make_scene()
    observed = np.repeat(scene.start[None], n_frames, axis=0)
    simulations = [Simulation(hypothesis(RED, GREEN), 0), Simulation(hypothesis(RED, RED), 1)]
    predicted = np.stack([observed, observed])
    tree = make_tree(simulations, [[0, 1]], scene=scene, observed=observed, predicted=predicted)
    tree.attrs["event_id"] = event_id
    return Posterior(tree)


def with_posterior(part: Path) -> None:
    """Keep :func:`make_posterior` in the folder of the event "one"."""
    make_posterior("one").save(part / POSTERIOR)
