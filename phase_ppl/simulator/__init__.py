"""Simulators run hypotheses: agents in physics, or a user's code.

* ``contract``: what a simulator is, and how one simulation is compared with the video.
* ``joint``: the paper's, agents in physics. ``no_physics``: the same planner without physics.
* ``runner``: many simulations, each once, with early stopping and counts.
* ``processes``: worker processes, or a user's executor, that run them.
* ``stage``: a scene in motion, for people and scripts.
"""
