"""The terminal: ``phase-ppl infer | query | evaluate | ...``."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code.

    It is 0, or 1 where something failed that did not stop the rest, 2 for bad input, 130 where
    interrupted, 141 where output was not read to its end.
    """
    # nothing else is imported before the try, so that Ctrl-C is heard from the first moment on
    try:
        import phase_ppl

        if problem := phase_ppl.unsupported():
            raise OSError(problem)
        from phase_ppl.cli.commands import run

        if sys.stdout is not None and hasattr(sys.stdout, "reconfigure"):
            # where a letter cannot be printed, its number is
            sys.stdout.reconfigure(errors="backslashreplace")
        code = run(arguments)
        if sys.stdout is not None:  # it was closed
            sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print("phase-ppl: interrupted", file=sys.stderr)
        return 130
    except OSError as error:
        # of "| head", or of a full disk; Python must not try to write the rest at its end
        with contextlib.suppress(OSError, AttributeError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 141
        print(f"phase-ppl: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
