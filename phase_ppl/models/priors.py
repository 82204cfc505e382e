"""Ready-made priors over hypotheses."""

from __future__ import annotations

from phase_ppl.models import sites


def uniform() -> None:
    """The paper's prior: goals alike, at most one agent with a social goal, strengths alike."""
    sites.goals()
    sites.alpha()
    sites.strengths()
