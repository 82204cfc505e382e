"""CSV files of studies: cells of text, and errors that name file and line."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from phase_ppl.dataset.documents import MAX_BYTES, in_front, reading_bytes, too_large
from phase_ppl.world.errors import InvalidEventError, shown
from phase_ppl.world.files import existing_file


def csv_text(source: Path) -> str:
    """Return the text of a file (InvalidEventError: it is none)."""
    with reading_bytes("a CSV file"), open(source, "rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise too_large(MAX_BYTES)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidEventError(f"is no CSV file: byte {error.start} is not UTF-8") from None
    if "\0" in text:
        raise InvalidEventError("is no CSV file in UTF-8: it holds zero bytes")
    return text


def csv_lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of its first line and the cells of each row that is not blank."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    line = 1
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                yield line, cells
            line = reader.line_num + 1
    except csv.Error as error:
        raise InvalidEventError(f", line {line}: is no CSV: {error}") from None


def read_rows(
    path: str | os.PathLike[str],
    check: Callable[[dict[str, str]], dict[str, Any]],
    check_header: Callable[[list[str]], None],
    once: Sequence[str],
) -> list[dict[str, Any]]:
    """Return the rows of a CSV file; an error's message begins with file and line.

    Args:
        path: of the file.
        check: makes what is returned of a row, of column -> cell.
        check_header: is given the names of the columns.
        once: columns whose values no two rows have in common.
    """
    source = existing_file(path)
    found = []
    seen: dict[tuple[Any, ...], int] = {}
    with in_front(f"{source}: "):
        text = csv_text(source)
    with in_front(str(source)):
        lines = csv_lines(text)
        line, header = next(lines, (0, []))
        if not header:
            raise InvalidEventError(": is empty")
        with in_front(f", line {line}: "):
            check_header(header)
        for line, cells in lines:
            with in_front(f", line {line}: "):
                if len(cells) != len(header):
                    raise InvalidEventError(f"has {len(cells)} cells, expected {len(header)}")
                row = check(dict(zip(header, cells, strict=True)))
                given = tuple(row[name] for name in once)
                if given in seen:
                    what = ", ".join(f"{name} {shown(row[name])}" for name in once)
                    raise InvalidEventError(f"has {what} a second time, after line {seen[given]}")
                seen[given] = line
                found.append(row)
    return found


def read_columns(
    path: str | os.PathLike[str],
    names: Sequence[str],
    check: Callable[[dict[str, Any]], None],
    required: Sequence[str],
    once: Sequence[str],
) -> list[dict[str, Any]]:
    """Return some columns of a CSV file, row by row, as ``check`` leaves or refuses them.

    Cells of the ``required`` ones must not be empty; other columns are not read.
    """

    def header(given: list[str]) -> None:
        for name in names:
            if given.count(name) != 1:
                raise InvalidEventError(f"expected a column {name}")

    def row(cells: dict[str, str]) -> dict[str, Any]:
        for name in required:
            if not cells[name]:
                raise InvalidEventError(f"{name} is empty")
        kept: dict[str, Any] = {name: cells[name] for name in names}
        check(kept)
        return kept

    found = read_rows(path, row, header, once)
    if not found:
        raise InvalidEventError(f"{path}: holds no rows")
    return found


def csv_bytes(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Return a CSV file of rows; cells that are None stay empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(["" if cell is None else cell for cell in row] for row in rows)
    return text.getvalue().encode()
