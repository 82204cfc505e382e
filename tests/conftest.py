"""What holds for all tests."""

from __future__ import annotations

import os
import signal
import warnings
from importlib import metadata

import pytest

LONGEST = ("test_examples.py", "test_readme.py", "test_cli.py")
"""Files of tests of which one alone can take most of a minute."""

# Most of the tests' time is XLA compiling small programs, each of which then runs for
# milliseconds; this flag takes a third off it, in the scripts that tests start too. jaxlib ends
# the process at a flag that it does not know, hence only the version whose flag it is known to be.
if metadata.version("jaxlib").startswith("0.10."):
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

# a shell that runs something in the background has it ignore Ctrl-C, which is then tested in vain
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Import ArviZ once before there are several processes.

    Version 0.23 notes the day of its first import in a file; processes that do so at the same
    moment take it from each other, and the import fails.
    """
    if not hasattr(config, "workerinput"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import arviz  # noqa: F401


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest, so that no process is left alone with it at the end."""
    items.sort(key=lambda item: item.path.name not in LONGEST)
