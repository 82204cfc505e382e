"""What kernels that sample get instead of simulations where the likelihood is stepwise."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.runs.plan import Plan
from phase_ppl.inference.stepwise.enumerate import read_event
from phase_ppl.models.stepwise import level_of
from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.simulator.dispatch import Request
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene


class ReadingRunner(Runner):
    """Answers requests for simulations from a reading of the video, which is made once.

    The error of a frame is by how many nats, times the likelihood's weight, the best pair of
    goals explains it better; that of the first frame tells the same of the strengths, each of
    which counts as the nearest that was followed, as in the prior of the table of all hypotheses.
    The "trajectory" is the observed one, on which
    every frame is conditioned. Nothing is random, so seeds make no difference.

    Args:
        plan: what is sampled.
        post: what was read.
    """

    def __init__(self, plan: Plan, post: StepwisePosterior) -> None:
        super().__init__(_never, plan.event.scene, plan.event.observation, workers=1)
        found = post.dataset
        likelihood = found["log_likelihood"].values
        worst = likelihood.max(axis=(1, 2), keepdims=True) - likelihood
        self._errors = float(found.attrs["weight"]) * worst
        self._levels = found["strength_red"].values
        with np.errstate(divide="ignore"):
            strengths = np.log(found["strengths"].values[-1])
        self._strength_errors = strengths.max() - strengths
        self._trajectory = np.array(plan.event.observation.trajectory)

    def _run_here(self, request: Request) -> SimulationResult:
        self._check_cancelled()
        hypothesis, seed, _ = request
        red, green = hypothesis.effective_goals
        errors = self._errors[:, red, green].copy()
        place = [level_of(newtons, self._levels) for newtons in hypothesis.strengths]
        errors[0] += self._strength_errors[place[0], place[1]]
        if not np.isfinite(errors).all():
            reason = "impossible given what was seen"
            return self._count(SimulationResult.failed(hypothesis, seed, len(errors), reason))
        return self._count(
            SimulationResult(hypothesis, seed, self._trajectory, errors, len(errors), True)
        )


def reading_runner(
    plan: Plan, threads: int | None, executor: Executor | None, progress: bool | None
) -> ReadingRunner:
    """Read the event of a plan, and return a runner that answers from it.

    Raises:
        InvalidSettingError: an executor is given, in which there is nothing to simulate.
    """
    if executor is not None:
        raise InvalidSettingError("a stepwise likelihood simulates nothing: it takes no executor")
    post = read_event(plan.event, plan.model, seed=plan.seed, threads=threads, progress=progress)
    return ReadingRunner(plan, post)


def _never(
    scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator
) -> Iterator[NDArray[np.float64]]:
    raise AssertionError("requests are answered from the reading")
