"""Priors over hypotheses: NumPyro programs that sample the hypothesis sites."""

from __future__ import annotations

from phase_ppl.models import sites


def uniform() -> None:
    """Sample a hypothesis from the paper's prior: uniform goals, alpha and strengths."""
    sites.goals()
    sites.alpha()
    sites.strengths()
