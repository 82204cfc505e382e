"""Measurements of the simulator's speed, a file each."""
