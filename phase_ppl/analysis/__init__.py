"""What draws say of goals, relation and strengths: numbers, diagnostics, figures.

Numbers, each built on those before it:

* ``tree``: the draws of a run and their file; ``quantities``: what can be asked for.
* ``weights``: from draws to a weighted table of hypotheses, on the video or ever more of it.
* ``estimate``: statistics of such a table with their errors; ``query``: questions in words;
  ``definitions``: quantities of one's own.
* ``hypotheses``: what one can ask a table; ``event_posterior``: what is asked of an event, and
  ``what_if``; ``posterior`` and ``stepwise_posterior`` (with ``stepwise_table``) are such
  tables.
* ``comparison``: posteriors against a reference and each other.

``with_arviz`` has what ArviZ estimates and is given; ``diagnostics`` says how chains went, and
``verdict`` whether they can be trusted. ``figures`` draws them, as ``ppl.plot``.
"""
