"""Priors, likelihoods and the bridge to the simulator, as NumPyro programs."""
