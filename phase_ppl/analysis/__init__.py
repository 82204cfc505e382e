"""Posterior of goals, relation and strengths: queries, weights, diagnostics, figures."""

from phase_ppl.analysis.posterior import Posterior

__all__ = ["Posterior"]
