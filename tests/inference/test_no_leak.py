"""Inference reads the scene and the observation of an event, and nothing else of it."""

from __future__ import annotations

import dataclasses

import numpy as np

import phase_ppl as ppl
from tests.inference.runs import MODEL, OPTIONS
from tests.inference.toy import walking_event


def infer(event: ppl.Event) -> ppl.Posterior:
    return ppl.infer(event, MODEL, **{**OPTIONS, "kernel": "local_mh", "iterations": 2})


def test_scrambling_truth_judgments_id_and_predictions_changes_no_byte() -> None:
    event = walking_event()
    scrambled = dataclasses.replace(
        event,
        id="other",
        truth=ppl.Truth("get away from green agent", "Get pink item to blue lm"),
        judgments={"friendly": 99},
        predictions={"someone": {"relation": "neutral"}},
    )
    bare = dataclasses.replace(event, id="", truth=None)
    first = infer(event)
    for other in (infer(scrambled), infer(bare)):
        assert other.settings == first.settings
        for group in first.tree.children:
            for name, values in first.tree[group].dataset.variables.items():
                again = other.tree[group].dataset.variables[name]
                assert again.values.tobytes() == values.values.tobytes(), f"{group}/{name}"


def test_another_observation_does_change_the_posterior() -> None:
    event = walking_event()
    moved = np.array(event.observation.trajectory)
    moved[3:, 0, 0] += 2.0
    other = dataclasses.replace(event, observation=ppl.Observation(moved))
    errors = [infer(e).tree["simulations"]["total_error"].values for e in (event, other)]
    assert not np.array_equal(*errors)
