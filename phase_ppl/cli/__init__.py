"""The terminal: ``phase-ppl infer | query | evaluate | ...``."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code.

    The code is 0, or 1 if a part failed but the rest was done. It is 2 for bad input, 130 after an
    interrupt, and 141 if a reader closed the output early.
    """
    # nothing else is imported before the try, so that Ctrl-C is handled from the first moment
    try:
        import phase_ppl

        if problem := phase_ppl.unsupported():
            raise OSError(problem)
        from phase_ppl.cli.commands import run

        if sys.stdout is not None and hasattr(sys.stdout, "reconfigure"):
            # a letter that cannot be printed is shown by its number
            sys.stdout.reconfigure(errors="backslashreplace")
        code = run(arguments)
        if sys.stdout is not None:  # None: it was closed
            sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print("phase-ppl: interrupted", file=sys.stderr)
        return 130
    except OSError as error:
        # as after "| head", or on a full disk; Python must not try to write the rest at its end
        with contextlib.suppress(OSError, AttributeError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 141
        print(f"phase-ppl: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
