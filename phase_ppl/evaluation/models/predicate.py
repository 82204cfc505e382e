"""Predicate inverse planning, the paper's physics-agnostic variant of SIMPLE."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    from phase_ppl.models.predicate import Rationality, Thresholds


@dataclasses.dataclass(frozen=True, eq=False)
class PredicateInversePlanning:
    """The model with its options, ready to be asked."""

    prior: str  # name of the prior over pairs of effective goals
    log_prior: NDArray[np.float64]  # (goal of red, goal of green)
    thresholds: Thresholds
    rationality: Rationality

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Prediction:
        """Return the marginals of both effective goals and of the relation; nothing is random."""
        from phase_ppl.models.predicate import ForwardModel, posterior, symbolic_trajectory

        trajectory = symbolic_trajectory(scene, observation, self.thresholds)
        likelihood = ForwardModel(scene, self.rationality).log_likelihood(trajectory)
        found = posterior(likelihood, self.log_prior)
        return Prediction("", {question: getattr(found, question) for question in QUESTIONS})

    def settings(self) -> dict[str, Any]:
        """Return what determines the answers."""
        return {
            "prior": self.prior,
            **dataclasses.asdict(self.thresholds),
            **dataclasses.asdict(self.rationality),
        }


def more_options(given: Mapping[str, Any]) -> list[str]:
    """Return the options beside the prior: thresholds and rationality, whatever is given."""
    from phase_ppl.models.predicate import Rationality, Thresholds

    return [field.name for kind in (Thresholds, Rationality) for field in dataclasses.fields(kind)]


@register_model("predicate", more_options=more_options)
def predicate(
    *, prior: str | None = None, preset: str = "default", **options: Any
) -> PredicateInversePlanning:
    """Predicate inverse planning: goals and relation from symbols alone, without physics.

    Args:
        prior: name of a prior over hypotheses, as SIMPLE takes it, "uniform" by default; or
            "independent", under which all pairs of effective goals are alike.
        preset: of :func:`phase_ppl.preset`; what else is given goes before it. The paper's have
            its uniform P(g), "independent", and the thresholds of SIMPLE's planner.
        **options: fields of :class:`~phase_ppl.models.predicate.Thresholds` and of
            :class:`~phase_ppl.models.predicate.Rationality`.
    """
    from phase_ppl.inference.settings import preset as check_preset
    from phase_ppl.models.predicate import AS_THE_PAPER, Rationality, Thresholds, log_prior_of_pairs

    check_preset(preset)
    usual = AS_THE_PAPER if preset != "default" else {}
    prior = usual.get("prior", "uniform") if prior is None else prior
    known = more_options(options)
    for name in options:
        if name not in known:
            raise InvalidSettingError(
                f"{name} is no option of model 'predicate': allowed are "
                f"{', '.join(['prior', 'preset', *known])}"
            )
    options = {**usual, **options}
    thresholds, rationality = (
        {field.name: options[field.name] for field in dataclasses.fields(kind)
         if field.name in options}
        for kind in (Thresholds, Rationality)
    )  # fmt: skip
    return PredicateInversePlanning(
        prior, log_prior_of_pairs(prior), Thresholds(**thresholds), Rationality(**rationality)
    )
