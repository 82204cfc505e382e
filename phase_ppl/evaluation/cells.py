"""Figures of the metrics, and other values, as text: in tables, on pages and in pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

NOTHING: Final = "-"  # what a table of a terminal has where there is no figure


def figure_text(found: Mapping[str, Any] | None, signed: bool = False) -> str:
    """Return a figure of the metrics with its interval for a terminal: "0.50 [0.40, 0.60]"."""
    if found is None:
        return NOTHING
    digits = "+.2f" if signed else ".2f"
    text = f"{found['value']:{digits}}"
    if found["ci_low"] is not None:
        text += f" [{found['ci_low']:{digits}}, {found['ci_high']:{digits}}]"
    return text


def p_text(value: float | None) -> str:
    """Return a p-value for a terminal."""
    if value is None:
        return NOTHING
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table: names on the left, figures on the right of their columns."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for name, *cells in table:
        padded = [f"{cell:>{width}}" for cell, width in zip(cells, widths[1:], strict=True)]
        lines.append("  ".join([f"{name:<{widths[0]}}", *padded]).rstrip())
    return lines


def fitting(widths: Mapping[int, int], room: int) -> Iterator[list[int]]:
    """Yield as many columns, by their widths, as fit side by side, again and again."""
    block: list[int] = []
    left = room
    for column, width in widths.items():
        if block and width > left:
            yield block
            block, left = [], room
        block.append(column)
        left -= width
    if block:
        yield block


def short(name: str, most: int) -> str:
    """Return a name; of a long one both ends, as one of them tells it from others."""
    half = (most - 3) // 2
    return name if len(name) <= most else f"{name[: most - 3 - half]}...{name[-half:]}"


def number(value: float | None, digits: int = 2, *, signed: bool = False) -> str:
    """Return a number as it is typeset; a dash where there is none."""
    if value is None:
        return "\N{EN DASH}"
    rounded = round(value, digits) + 0.0  # without the sign of a zero
    sign = "+" if signed and rounded else ""
    return f"{rounded:{sign}.{digits}f}".replace("-", "\N{MINUS SIGN}")
