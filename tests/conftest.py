"""What holds for all tests."""

from __future__ import annotations

import os
import signal
from importlib import metadata

# Most of the tests' time is XLA compiling small programs, each of which then runs for
# milliseconds; this flag takes a third off it, in the scripts that tests start too. jaxlib ends
# the process at a flag that it does not know, hence only the version whose flag it is known to be.
if metadata.version("jaxlib").startswith("0.10."):
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

# a shell that runs something in the background has it ignore Ctrl-C, which is then tested in vain
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
