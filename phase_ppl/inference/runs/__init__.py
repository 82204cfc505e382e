"""Carrying out a run: chains, budgets, checkpoints, and the tree of draws it leaves."""
