"""CSV files of studies: cells of text, and errors that name file and line."""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Iterator
from pathlib import Path

from phase_ppl.dataset.documents import MAX_BYTES
from phase_ppl.world.errors import InvalidEventError, PhasePPLError


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
