"""Markov kernels over hypotheses, one file each.

They are classes for NumPyro's ``MCMC``: ``ppl.kernels.LocalMH(program)`` of a
:func:`phase_ppl.program`. :func:`phase_ppl.infer` knows them by name.
"""

from phase_ppl.inference.kernels.enumerated_gibbs import EnumeratedGibbs
from phase_ppl.inference.kernels.generic_mh import MixtureMH, PriorMH, RandomWalkMH, SingleSiteMH
from phase_ppl.inference.kernels.local_mh import LocalMH

__all__ = ["EnumeratedGibbs", "LocalMH", "MixtureMH", "PriorMH", "RandomWalkMH", "SingleSiteMH"]


def __dir__() -> list[str]:
    return __all__
