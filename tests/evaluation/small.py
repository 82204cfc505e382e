"""A small evaluation, whose figures can be worked out by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.event import Event
from tests.analysis.factory import Simulation, hypothesis, make_tree
from tests.evaluation.judged import BLUE_TO_GREEN as GREEN
from tests.evaluation.judged import BLUE_TO_RED as RED
from tests.evaluation.judged import COLLABORATIVE, COMPETING, make_event, shares
from tests.world.examples import make_scene

HOSTILE = "<script>alert(1)</script> & \"x\" '$y$'"


def events(**changes: Any) -> list[Event]:
    """Return three events: competing, collaborative, and one whose truth is not known.

    In the first and last most people see the competing goals, and the relations 3, 0, 7.
    """
    seen = {
        "relation_counts": {"friendly": 3, "neutral": 0, "adversarial": 7},
        "goal_counts": {"red agent": {RED: 3}, "green agent": {GREEN: 3, RED: 1}},
    }
    other = {"<b>other</b>": {"goals": {"red agent": RED}, "relation": "neutral"}}
    made = [
        make_event("one", COMPETING, judgments=seen, predictions=other),
        make_event(HOSTILE, COLLABORATIVE, predictions=other),
        make_event("three", None, judgments=seen),
    ]
    return [dataclasses.replace(event, **changes) for event in made]


def prediction(event_id: str) -> Prediction:
    """Return a prediction: red's goal is RED, green's likely RED too, so friendly."""
    goals = {"goal_red": {RED: 0.9, GREEN: 0.1}, "goal_green": {RED: 0.6, GREEN: 0.4}}
    said = shares(event_id, **goals, relation=[0.5, 0.25, 0.25])
    return dataclasses.replace(said, cost={"seconds": 2.5})


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
    make_posterior("one").save(part / POSTERIOR)
