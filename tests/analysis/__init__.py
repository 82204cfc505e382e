"""Tests of phase_ppl.analysis."""
