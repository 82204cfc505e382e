"""What holds for all tests."""

from __future__ import annotations

import signal

# a shell that runs something in the background has it ignore Ctrl-C, which is then tested in vain
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
