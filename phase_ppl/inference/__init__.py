"""Bottom-up proposals, kernels, their registry, and infer()."""
