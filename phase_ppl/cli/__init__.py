"""The terminal: ``phase-ppl infer | query | evaluate | ...``, a file each."""

from phase_ppl.cli.main import main

__all__ = ["main"]
