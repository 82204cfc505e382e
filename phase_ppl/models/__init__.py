"""Programs over the sites of a hypothesis: priors, likelihood, the bridge to a simulator."""

from phase_ppl.models.likelihood import RadialLikelihood, RadialTrajectory
from phase_ppl.models.model import Model

__all__ = ["Model", "RadialLikelihood", "RadialTrajectory"]
