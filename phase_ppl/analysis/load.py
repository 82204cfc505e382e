"""Reading a posterior whichever way it came about."""

from __future__ import annotations

import os

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior, is_stepwise
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.files import existing_file


def load_posterior(
    path: str | os.PathLike[str], weights: str | None = None
) -> Posterior | StepwisePosterior:
    """Read a posterior that was saved, sampled or read step by step.

    Args:
        path: the .nc file.
        weights: of the draws of a sampled one; by default those it was saved with.

    Raises:
        InvalidEventError: there is no such file, or it is damaged or of another kind.
        InvalidSettingError: weights for one that has no draws.
        UnknownNameError: there are no such weights.
    """
    if not is_stepwise(existing_file(path)):
        return Posterior.load(path, weights)
    if weights is not None:
        raise InvalidSettingError(
            f"weights={weights!r}: {path} was read step by step and has no draws to be weighted"
        )
    return StepwisePosterior.load(path)
