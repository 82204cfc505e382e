"""The terminal: ``phase-ppl infer | simulate | render | compare``."""

from phase_ppl.cli.main import main

__all__ = ["main"]
