"""The terminal: ``phase-ppl infer | resume | simulate | render | compare | export``."""

from phase_ppl.cli.main import main

__all__ = ["main"]
