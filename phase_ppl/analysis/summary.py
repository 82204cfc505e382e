"""What summaries are made of: JSON's types, and lines of a table in a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

WIDTH: Final = 88  # columns of a table
LABEL: Final = 13  # columns of what stands before a line

_NAME, _NUMBER, _BAR = 36, 16, 22


def plain(value: Any) -> Any:
    """Return ``value`` in JSON's types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return float(value) if np.isfinite(value) else None
    return value


def bars(label: str, entries: Sequence[tuple[str, float]]) -> Iterator[str]:
    """Yield a line for each name and probability, the first of which begins with the label."""
    for name, probability in entries:
        bar = "#" * round(probability * _BAR)
        yield f"{f'{label} ':<{LABEL}}{name:<{_NAME}}{probability!s:<{_NUMBER}}{bar}".rstrip()
        label = ""


def wrapped(label: str, text: str) -> list[str]:
    """Return ``text`` as lines of a table, the first of which begins with the label."""
    indent = " " * LABEL
    return textwrap.wrap(text, WIDTH, initial_indent=f"{label:<{LABEL}}", subsequent_indent=indent)
