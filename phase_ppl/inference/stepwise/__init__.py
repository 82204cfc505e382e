"""Exact inference with the closed-loop likelihood: of a whole video, or as it plays."""
