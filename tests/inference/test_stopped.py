"""All simulations weighed, those stopped early too, against enumeration on ever more frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis
from phase_ppl.world.scene import Scene
from tests.inference.toy import (
    ALPHA_CODES,
    GREEN_GOALS,
    N_FRAMES,
    RED_GOALS,
    SCENE,
    SEEDS,
    START,
    exact_posterior,
    few_goals,
    table_errors,
    total_variation,
)

ERRORS = table_errors()
ERRORS[..., 1::3] *= 3  # so much in a frame that it matters whether that is looked at
EVENT = Event(SCENE, Observation(np.repeat(START[None], N_FRAMES, axis=0)))


def off(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Be off what is observed by the errors of the table."""
    for error in ERRORS[(*hypothesis.effective_goals, int(rng.integers(SEEDS)))]:
        frame = scene.start.copy()
        frame[0, 0] += error
        yield frame


def exact(n_frames: int) -> FloatArray:
    """Return (goal of red,) the posterior given the first frames."""
    errors = np.where(np.arange(N_FRAMES) < n_frames, ERRORS, 0.0)
    found = np.zeros(36)
    for place, mass in np.ndenumerate(exact_posterior(errors)):
        red, green, alpha = (
            codes[i] for codes, i in zip((RED_GOALS, GREEN_GOALS, ALPHA_CODES), place, strict=True)
        )
        found[Hypothesis(red, green, ALPHAS[alpha]).effective_goals[0]] += mass
    return found


@pytest.mark.filterwarnings("ignore:the first frame of the simulator")
def test_a_frame_is_weighed_by_how_probable_it_was_that_it_is_simulated() -> None:
    model = ppl.Model(few_goals, off)
    given: dict[str, Any] = {"chains": 400, "iterations": 6, "workers": 1, "progress": False}
    post = ppl.infer(EVENT, model, kernel="prior_mh", **given)
    assert post.weights == "stratified"
    assert post.diagnostics()["frames_saved"] > 0
    over_time = post.over_time()["goal_red"].values
    apart = [total_variation(over_time[t], exact(t + 1)) for t in range(N_FRAMES)]
    assert max(apart) < 0.03
    assert total_variation(post.marginal("goal_red").values, exact(N_FRAMES)) < 0.03
