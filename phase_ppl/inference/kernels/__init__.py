"""Markov kernels over hypotheses, one file each.

They are classes for NumPyro's ``MCMC``: ``ppl.kernels.LocalMH(program)`` of a
:func:`phase_ppl.program`. :func:`phase_ppl.infer` knows them by name.
"""

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import PriorMH, SingleSiteMH
from phase_ppl.inference.kernels.numpyro_kernels import NumpyroKernel

__all__ = ["LocalMH", "NumpyroKernel", "PriorMH", "SingleSiteMH"]


def __dir__() -> list[str]:
    return __all__
