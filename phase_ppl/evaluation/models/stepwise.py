"""The closed-loop model: every frame explained from what was observed before it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from phase_ppl.evaluation.answer import Answer
from phase_ppl.evaluation.folder import POSTERIOR
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.models.model import Model


@dataclasses.dataclass(frozen=True)
class Stepwise:
    """The stepwise model, ready to be asked.

    Attributes:
        model: prior, planner and likelihood.
    """

    model: Model

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return the marginals of both effective goals and of the relation."""
        from phase_ppl.inference.stepwise import filter_event
        from phase_ppl.world.event import Event

        event = Event(scene, observation)
        post = filter_event(event, self.model, seed=seed, threads=1, progress=False)
        prediction = Prediction(
            "",
            probabilities={question: post.marginal(question).values for question in QUESTIONS},
            cost={"searches": post.cost["searches"]},
        )
        return Answer(prediction, {POSTERIOR: post.save})

    def warm_up(self) -> None:
        """Compile what reading needs, for all processes."""
        from phase_ppl.closed_loop.goal_filter import warm_up

        warm_up()

    def settings(self) -> dict[str, Any]:
        """Return what the model consists of."""
        return {"model": self.model.fingerprint()}


@register_model("stepwise")
def stepwise(
    *,
    prior: Any = "uniform",
    planner: Any = None,
    sharpness: float | None = None,
    lapse: float | None = None,
    weight: float | None = None,
    planner_seeds: int | None = None,
    strengths: Any = None,
    noise: float | None = None,
) -> Stepwise:
    """Closed loop: each frame given what was seen before, summed over all pairs of goals.

    Args:
        prior, planner: of the :class:`phase_ppl.Model`.
        sharpness, lapse, weight, planner_seeds: of the
            :class:`phase_ppl.StepwiseLikelihood`.
        strengths, noise: of its :class:`phase_ppl.Tracking`.

    Raises:
        InvalidSettingError, UnknownNameError: one of them cannot be used.
    """
    from phase_ppl.closed_loop.hidden_state import Tracking
    from phase_ppl.models.model import Model
    from phase_ppl.models.stepwise import StepwiseLikelihood

    tracking = Tracking(**_given(strengths=strengths, noise=noise))
    given = _given(
        sharpness=sharpness,
        lapse=lapse,
        weight=weight,
        planner_seeds=planner_seeds,
    )
    likelihood = StepwiseLikelihood(tracking=tracking, **given)
    return Stepwise(Model(prior=prior, planner=planner, likelihood=likelihood))


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
