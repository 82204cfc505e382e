"""Markov kernels over hypotheses, a file each."""
