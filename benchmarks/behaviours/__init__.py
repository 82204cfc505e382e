"""Scenes of the behaviour battery, and what must be seen in them."""
