"""Observers: what stands between what a model makes of a video and what a person answers."""
