"""MCMC kernels, a file each; importing this package registers them."""

from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.prior_mh import PriorMH

__all__ = ["LocalMH", "PriorMH"]
