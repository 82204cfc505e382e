"""Posteriors over goals, relation and strengths: numbers, diagnostics, figures.

Modules for numbers, each built on those before it:

* ``tree``: the draws of a run and their file; ``quantities``: quantities that can be asked for.
* ``weights``: weighted tables of hypotheses from draws, given the video or its first frames.
* ``estimate``: statistics of such a table with their errors; ``query``: questions in words, and a
  user's own quantities.
* ``hypotheses``: methods of all tables. ``event_posterior``: methods of an event's posterior.
  ``what_if``: counterfactual simulations. ``posterior`` and ``closed_loop_posterior`` (with
  ``closed_loop_table``, and ``users_sites`` for a user's prior) are the two kinds of posterior.
* ``comparison``: posteriors against a reference and each other.

``with_arviz`` calls ArviZ and converts for it. ``diagnostics`` describes the chains, and
``verdict`` says whether to trust them. ``figures`` draws them, as ``ppl.plot``.
"""
