"""The terminal: ``phase-ppl infer | resume | simulate | render | compare``."""

from phase_ppl.cli.main import main

__all__ = ["main"]
