"""Comparisons of the simulator with real videos, a file each."""
