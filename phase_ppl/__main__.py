"""``python -m phase_ppl``."""

import sys

from phase_ppl.cli import main

if __name__ == "__main__":
    sys.exit(main())
