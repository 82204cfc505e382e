"""CSV files of studies: cells of text, and errors that name file and line."""

from __future__ import annotations

import contextlib
import csv
import io
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from phase_ppl.dataset.documents import MAX_BYTES
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.files import existing_file


def csv_text(source: Path) -> str:
    """Return the text of a file (InvalidEventError: it is none; begins with a colon)."""
    try:
        with open(source, "rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InvalidEventError(f": cannot be read: {error.strerror or error}") from None
    if len(content) > MAX_BYTES:
        raise InvalidEventError(f": is larger than the {MAX_BYTES // 2**20} MB that are read")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidEventError(f": is no CSV file: byte {error.start} is not UTF-8") from None
    if "\0" in text:
        raise InvalidEventError(": is no CSV file in UTF-8: it holds zero bytes")
    return text


def csv_lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of its first line and the cells of each row that is not blank."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    while True:
        line = reader.line_num + 1
        try:
            cells = [cell.strip() for cell in next(reader)]
        except StopIteration:
            return
        except csv.Error as error:
            raise InvalidEventError(f", line {line}: is no CSV: {error}") from None
        if any(cells):
            yield line, cells


@contextlib.contextmanager
def naming_line(line: int) -> Iterator[None]:
    """Begin the messages of errors in the block with the line."""
    try:
        yield
    except PhasePPLError as error:
        raise type(error)(f", line {line}: {error}") from None


def read_rows(
    path: str | os.PathLike[str],
    names: Sequence[str],
    check: Callable[[dict[str, Any]], None],
    required: Sequence[str] | None = None,
) -> list[dict[str, Any]]:
    """Return the cells of some columns of a CSV file, row by row, as text.

    Args:
        path: of the file.
        names: of the columns; others are not read.
        check: is given each row, and may change it, or raise.
        required: those whose cells must not be empty; default all.
    """
    source = existing_file(path)
    found: list[dict[str, Any]] = []
    try:
        lines = csv_lines(csv_text(source))
        line, header = next(lines, (0, []))
        for name in names:
            if header.count(name) != 1:
                raise InvalidEventError(f", line {line}: expected a column {name}")
        for line, cells in lines:
            with naming_line(line):
                if len(cells) != len(header):
                    raise InvalidEventError(f"has {len(cells)} cells, expected {len(header)}")
                row = dict(zip(header, cells, strict=True))
                for name in names if required is None else required:
                    if not row[name]:
                        raise InvalidEventError(f"{name} is empty")
                found.append({name: row[name] for name in names})
                check(found[-1])
    except PhasePPLError as error:
        raise type(error)(f"{source}{error}") from None
    if not found:
        raise InvalidEventError(f"{source}: holds no rows")
    return found


def csv_bytes(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Return a CSV file of rows; cells that are None stay empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(["" if cell is None else cell for cell in row] for row in rows)
    return text.getvalue().encode()
