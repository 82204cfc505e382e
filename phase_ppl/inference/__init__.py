"""Inference: the closed loop, and kernels that sample hypotheses.

* ``infer``: the call, and ``resume``. ``settings``: of SIMPLE, budgets and presets.
* ``closed_loop``: the closed loop reads a video, frame by frame.
* ``registry``: kernels by name. ``kernels``: themselves.
* ``tables``, with ``strength``: what each window of the video says of goals and strengths.
  ``guide``: the proposal from these.
* ``run``: what determines the draws of a run. ``sampler``: simulates and iterates. ``checkpoint``:
  its file. ``draws``: its particles as a tree.
* ``table_run``: the same on what the closed loop has read. ``native``: NumPyro's own ``MCMC``.
* ``compare``, with ``reference``: kernels against a reference.
"""
