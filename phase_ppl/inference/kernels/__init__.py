"""Kernels, the rules by which a chain moves from one hypothesis to the next.

They are classes for NumPyro's ``MCMC``, as in ``ppl.kernels.LocalMH(program)``, where ``program``
comes from :func:`phase_ppl.program`. In :func:`phase_ppl.infer` they have names, such as
"local_mh".
"""

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import PriorMH, SingleSiteMH
from phase_ppl.inference.kernels.numpyro_kernels import NumpyroKernel

__all__ = ["LocalMH", "NumpyroKernel", "PriorMH", "SingleSiteMH"]


def __dir__() -> list[str]:
    return __all__
