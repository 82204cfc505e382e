"""The log evidence that kernels estimate, against the sum over all hypotheses."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.world.arrays import FloatArray
from tests.inference.toy import SCENE, all_of_few_goals, few_goals

LIKELIHOOD = ppl.RadialLikelihood(1.0)
N_FRAMES = 5


def stands(scene: ppl.Scene, hypothesis: Any, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Agents go at once to places of their goals, without chance."""
    yield scene.start
    frame = scene.start.copy()
    frame[:2, :2] += [[np.cos(goal), np.sin(goal)] for goal in hypothesis.effective_goals]
    yield from itertools.repeat(frame)


MODEL = ppl.Model(prior=few_goals, simulator=stands, likelihood=LIKELIHOOD)


@functools.cache
def event() -> ppl.Event:
    rng = np.random.default_rng(0)
    frames = np.repeat(SCENE.start[None], N_FRAMES, axis=0)
    frames[1:, :2, :2] += np.array([1.0, 0.0]) + rng.normal(0, 0.3, (N_FRAMES - 1, 2, 2))
    return ppl.Event(SCENE, ppl.Observation(frames), id="stands")


def exact() -> float:
    found, seen = [], event().observation.trajectory
    for mass, hypothesis in all_of_few_goals():
        frames = stands(SCENE, hypothesis, np.random.default_rng())
        shown = np.array(list(itertools.islice(frames, N_FRAMES)))
        errors = np.sqrt(((seen - shown)[..., :2] ** 2).sum(axis=(1, 2)))
        found.append(np.log(mass) + LIKELIHOOD.log_prob(errors).sum())
    return float(np.logaddexp.reduce(found))


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["importance", "amis", "smc"])
def test_it_is_the_sum_over_all_hypotheses_within_its_error(kernel: str) -> None:
    post = ppl.infer(
        event(), MODEL, kernel=kernel, chains=30, iterations=8, workers=1, progress=False
    )
    found = post.log_evidence
    error = 0.25 if kernel == "smc" else found.error  # one population does not tell it
    assert 0 < error < 0.5
    assert found == pytest.approx(exact(), abs=3 * error)
