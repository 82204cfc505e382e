"""All simulations weighed, those stopped early too, against enumeration on ever more frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene
from tests.inference import toy

ERRORS = toy.table_errors()
ERRORS[..., 1::3] *= 3  # so much in a frame that it matters whether that is looked at
EVENT = Event(toy.SCENE, Observation(np.repeat(toy.START[None], toy.N_FRAMES, axis=0)))


def off(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Be off what is observed by the errors of the table."""
    for error in ERRORS[(*hypothesis.effective_goals, int(rng.integers(toy.SEEDS)))]:
        frame = scene.start.copy()
        frame[0, 0] += error
        yield frame


def exact(n_frames: int) -> FloatArray:
    """Return (goal of red,) the posterior given the first frames."""
    errors = np.where(np.arange(toy.N_FRAMES) < n_frames, ERRORS, 0.0)
    found = np.zeros(36)
    masses = toy.exact_posterior(errors).ravel()
    for (_, hypothesis), mass in zip(toy.all_of_few_goals(), masses, strict=True):
        found[hypothesis.effective_goals[0]] += mass
    return found


@pytest.mark.filterwarnings("ignore:the first frame of the simulator")
def test_a_frame_is_weighed_by_how_probable_it_was_that_it_is_simulated() -> None:
    model = ppl.Model(toy.few_goals, off)
    given: dict[str, Any] = {"chains": 400, "iterations": 6, "workers": 1, "progress": False}
    post = ppl.infer(EVENT, model, kernel="prior_mh", **given)
    assert post.weights == "stratified"
    assert post.diagnostics()["frames_saved"] > 0
    over_time = post.over_time()["goal_red"].values
    apart = [toy.total_variation(over_time[t], exact(t + 1)) for t in range(toy.N_FRAMES)]
    assert max(apart) < 0.03
    assert toy.total_variation(post.marginal("goal_red").values, exact(toy.N_FRAMES)) < 0.03
