"""PyTorch, for the parts that need it: the extra ``neural``."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator
from typing import Any

from phase_ppl.world.errors import InvalidSettingError


def needs_torch() -> Any:
    """Return PyTorch."""
    try:
        return importlib.import_module("torch")
    except ImportError as error:
        raise InvalidSettingError(
            "training needs PyTorch: pip install 'phase_ppl[neural]'"
        ) from error


@contextlib.contextmanager
def threads(number: int) -> Iterator[None]:
    """Have PyTorch use so many threads within; sums, and so all numbers, depend on how many."""
    torch = needs_torch()
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)
