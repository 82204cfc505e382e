"""The terminal: ``phase-ppl infer | resume | simulate | render | compare | query``."""

from phase_ppl.cli.main import main

__all__ = ["main"]
