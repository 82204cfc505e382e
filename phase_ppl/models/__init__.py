"""Priors, likelihoods, and both together with a simulator, as NumPyro programs.

* ``model``: prior, simulator and likelihood. ``program``: these, bound to an event.
* ``sites``: the sites of a hypothesis. ``priors``: ready-made ones of PHASE. ``world_priors``: of
  any world, public as ``ppl.roles``.
* ``density``: draws and densities of a program. ``effective``: the prior of effective goals, with
  what does not matter summed out. ``prior_masses``: all hypotheses with their masses.
* ``likelihood``: whole simulations against the video. ``closed_loop``: each frame given those
  before it.
* ``bridge``: compiled kernels ask for simulations through it. ``compiled``: compiled functions kept
  on disk.
* ``predicate``, ``socialgnn`` and ``vlm``: the paper's other models.
"""
