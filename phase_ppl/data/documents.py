"""JSON documents with checked fields, rows of CSV files, and one-line errors for bad files."""

from __future__ import annotations

import codecs
import contextlib
import csv
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, TypeVar, cast

import msgspec

from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    PhasePPLError,
    check_name,
    shown,
    unknown_name,
)
from phase_ppl.world.files import existing_file

T = TypeVar("T")
MAX_BYTES: Final = 512 * 2**20  # largest event file that is read
_PICKLE_SUFFIXES: Final = (".pkl", ".pickle", ".pik", ".pck", ".p")
_FAULTS_SHOWN: Final = 8
_QUALTRICS: Final = '{"ImportId"'
"""Begin of the cells of Qualtrics' third line."""

_PICKLE: Final = re.compile(rb"\x80[\x00-\x0f]|\([dli]|[\]}]q|c[A-Za-z_][\w.]*\n")
"""The first bytes of pickles; JSON never has them."""


def is_pickle(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a pickle, by its first bytes or by its name."""
    try:
        with open(path, "rb") as file:
            head = file.read(64)
    except OSError:  # the reader reports it
        return False
    return bool(_PICKLE.match(head)) or Path(path).suffix.lower() in _PICKLE_SUFFIXES


@contextlib.contextmanager
def reading_bytes(expected: str) -> Iterator[None]:
    """Turn errors of reading into one line; ``expected`` is what the file should be."""
    try:
        yield
    except IsADirectoryError:
        raise InvalidEventError(f"is a folder, expected {expected}") from None
    except FileNotFoundError:
        raise InvalidEventError("no such file") from None
    except OSError as error:
        raise InvalidEventError(f"cannot be read: {error.strerror or error}") from None


def too_large(limit: int) -> InvalidEventError:
    """Return the error for a file of more than ``limit`` bytes."""
    return InvalidEventError(f"is larger than the {limit // 2**20} MB that are read")


def read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the JSON object in a file.

    Raises:
        InvalidEventError: there is no such file, it holds no JSON object, an object has two
            fields of one name, or a number is not finite. The message names the file and the place.
    """
    with in_front(f"{path}: "):
        return read_document(path)


def read_document(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the JSON object in the file ``path``."""
    with reading_bytes("an event file"), open(path, "rb") as file:
        return parse_document(file.read(MAX_BYTES + 1))


def parse_document(content: bytes | str) -> dict[str, Any]:
    """Return the JSON object that ``content`` spells."""
    if len(content) > MAX_BYTES:
        raise too_large(MAX_BYTES)
    if not content.strip():
        raise InvalidEventError("is empty")
    if isinstance(content, str):
        content = content.encode(errors="replace")
    content = content.removeprefix(codecs.BOM_UTF8)
    try:
        document = msgspec.json.decode(content, type=dict[str, Any])
        # msgspec keeps the last of two fields of a name; numbers stay text here, which is fast
        json.loads(content, object_pairs_hook=_check_fields, parse_float=str, parse_int=str)
        return document
    except UnicodeError:
        raise InvalidEventError("is no text in UTF-8") from None
    except RecursionError:
        raise InvalidEventError("is nested too deeply for an event") from None
    except msgspec.ValidationError as error:
        raise InvalidEventError(f"is no JSON object: {error}") from None
    except msgspec.DecodeError as error:
        byte = re.search(r"\(byte (\d+)\)", str(error))
        line = content.count(b"\n", 0, int(byte[1]) if byte else None) + 1
        raise InvalidEventError(f"is not JSON: line {line}: {error}") from None


def _check_fields(pairs: Iterable[tuple[str, Any]]) -> None:
    check_once((name for name, _ in pairs), "holds an object with two fields")


def check_once(names: Iterable[str], what: str) -> None:
    """Raise InvalidEventError, with ``what`` and the name, if a name is there twice."""
    twice = [name for name, n in Counter(names).items() if n > 1]
    if twice:
        raise InvalidEventError(f"{what} {shown(twice[0])}")


# --- fields ----------------------------------------------------------------------------------

_WORDS = {dict: "an object", list: "a list", str: "a string", int: "a whole number"}


def converted(value: object, form: type[T], where: str = "") -> T:
    """Return a value of a file, converted to a type by msgspec.

    Raises:
        InvalidEventError: a part is missing or has a wrong type; the message names ``where`` and
            the path of the part.
        UnknownNameError: a field is unknown.
    """
    try:
        return msgspec.convert(value, form)
    except msgspec.ValidationError as error:
        said, _, path = str(error).replace("`", "'").partition(" - at '$")
        place = f"{where}{path[:-1]}".lstrip(".")
        if "unknown field" in said and not path:
            fields = cast("Any", form).__struct_encode_fields__
            raise unknown_name(
                f"field of {where or 'an event'}", said.split("'")[1], fields
            ) from None
        raise InvalidEventError(f"{place}: {said}" if place else said) from None


def of_kind(path: str, value: object, kind: type[T]) -> T:
    """Return a value of a file, which must be of a type; ``path`` is its place in the file."""
    fits = isinstance(value, Mapping if kind is dict else kind) and not isinstance(value, bool)
    if not fits:
        raise InvalidEventError(f"{path} is {shown(value)}, expected {_WORDS[kind]}")
    return cast("T", value)


def per_name(record: Mapping[str, Any], names: Sequence[str], where: str) -> list[Any]:
    """Return the values of an object with exactly the fields ``names``, in that order."""
    for name in record:
        check_name(f"field of {where}", name, names)
    missing = [name for name in names if name not in record]
    if missing:
        raise InvalidEventError(f"{where} has no {' and no '.join(missing)}")
    return [record[name] for name in names]


def event_id(name: object) -> str:
    """Return an event's id, which must be a string that can be printed."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise InvalidEventError(f"id is {shown(name)}, expected printable text")
    return name


def check_ids(ids: Sequence[str]) -> None:
    """Raise InvalidEventError if there are no ids, or an id is there twice."""
    if not ids:
        raise InvalidEventError("holds no videos: the list is empty")
    check_once(ids, "holds two videos with the id")


def check_schema(record: Mapping[str, Any], schema: str, where: object = "") -> None:
    """Raise InvalidEventError unless a document of the file ``where`` has the format ``schema``."""
    if record.get("schema") != schema:
        words = f"its schema is {shown(record.get('schema'))}, not {schema!r}"
        raise InvalidEventError(f"{where}: {words}" if where else words)


# --- files -----------------------------------------------------------------------------------


@contextlib.contextmanager
def in_front(words: str) -> Iterator[None]:
    """Put words in front of the message of any error."""
    try:
        yield
    except PhasePPLError as error:
        raise type(error)(f"{words}{error}") from None


@contextlib.contextmanager
def naming(path: str | os.PathLike[str], video: str | None = None) -> Iterator[None]:
    """Put the file, and the video if given, in front of the message of any error."""
    where = str(path) if video is None or video == Path(path).stem else f"{path}, video {video}"
    try:
        with in_front(f"{where}: "):
            yield
    except InvalidSettingError as error:  # a wrong value in a file is the file's fault
        raise InvalidEventError(str(error)) from None


# --- CSV: cells of text, and errors that name file and line ---------------------------------------


class Faults:
    """Collects faults of one thing, to report them all at once."""

    def __init__(self) -> None:
        self._found: list[PhasePPLError] = []

    @contextlib.contextmanager
    def noted(self, where: str = "") -> Iterator[None]:
        """Note an error of the block and go on after it; ``where`` comes before its message."""
        try:
            with in_front(where):
                yield
        except PhasePPLError as error:
            self._found.append(error)

    def check(self) -> None:
        """Raise all noted faults as one error, of one line."""
        if not self._found:
            return
        kinds = {type(error) for error in self._found}
        kind = kinds.pop() if len(kinds) == 1 else InvalidEventError
        said = [str(error) for error in self._found]
        if len(said) > _FAULTS_SHOWN:
            said[_FAULTS_SHOWN:] = [f"and {len(said) - _FAULTS_SHOWN} more"]
        raise kind("; ".join(said))


Keep: TypeAlias = Literal["refuse", "first", "last"]
"""What becomes of rows that are there a second time: all are refused, or one counts."""

Cells: TypeAlias = list[tuple[int, list[str]]]
"""The rows of a table that are not empty, each with its line, the header first."""


def read_rows(
    path: str | os.PathLike[str],
    check: Callable[[dict[str, str]], dict[str, Any]],
    check_header: Callable[[list[str]], None],
    once: Sequence[str],
    keep: Keep | None = None,
) -> list[dict[str, Any]]:
    """Return the checked rows of a CSV file; an error names the file and all faults.

    Cells are separated by commas, semicolons or tabs, whichever the first line has most of.

    Args:
        path: of the file.
        check: turns a row, column -> cell, into the result for that row.
        check_header: is called with the names of the columns.
        once: columns whose values together must differ between rows; None does not tell them apart.
        keep: which of those counts that do not; None: they are refused, and nobody can choose.
    """
    source = existing_file(path)
    with in_front(f"{source}"):
        return checked_rows(_cells_of(source), check, check_header, once, keep)


def _cells_of(source: Path) -> Cells:
    found: Cells = []
    line = after = 1
    if source.stat().st_size > MAX_BYTES:
        raise InvalidEventError(f": {too_large(MAX_BYTES)}")
    try:
        with open(source, "rb") as raw:
            utf_16 = raw.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        with open(source, encoding="utf-16" if utf_16 else "utf-8-sig", newline="") as file:
            separator = max(",;\t", key=file.readline().count)
            file.seek(0)
            reader = csv.reader(file, strict=True, delimiter=separator)
            for row in reader:
                line, after = after, reader.line_num + 1
                cells = [cell.strip() for cell in row]
                if "\0" in "".join(cells):
                    raise InvalidEventError(": is no CSV file in UTF-8: it holds zero bytes")
                if any(cells):
                    found.append((line, cells))
    except UnicodeError:
        raise InvalidEventError(": is no CSV file in UTF-8") from None
    except OSError as error:
        raise InvalidEventError(f": cannot be read: {error.strerror or error}") from None
    except csv.Error as error:
        raise InvalidEventError(f", line {after}: is no CSV: {error}") from None
    if not found:
        raise InvalidEventError(": is empty")
    return found


def checked_rows(
    table: Cells,
    check: Callable[[dict[str, str]], dict[str, Any]],
    check_header: Callable[[list[str]], None],
    once: Sequence[str],
    keep: Keep | None = None,
) -> list[dict[str, Any]]:
    """Return the checked rows of a table, as :func:`read_rows`; errors begin with ", line"."""
    (line, header), *rows = table
    for place, (_, cells) in enumerate(rows[:2], 1):
        if any(cell.startswith(_QUALTRICS) for cell in cells):  # above are the questions' texts
            rows = rows[place:]
            break
    if rows and len(rows[0][1]) == len(header) + 1 and rows[0][1][0] == "1":
        header = ["", *header]  # as R writes the names of rows
    with in_front(f", line {line}: "):
        check_header(header)
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    lines: dict[tuple[Any, ...], int] = {}
    faults = Faults()
    for number, row in rows:
        cells = row[: len(header)] if not any(row[len(header) :]) else row
        with faults.noted(f"line {number}: "):
            if len(cells) != len(header):
                raise InvalidEventError(f"has {len(cells)} cells, expected {len(header)}")
            given = check(dict(zip(header, cells, strict=True)))
            key = tuple(given.get(name) for name in once)
            if lines.setdefault(key, number) != number and keep not in ("first", "last"):
                what = ", ".join(f"{n} {shown(given[n])}" for n in once if given.get(n) is not None)
                how = "; repeated='first' or 'last' keeps one" if keep else ""
                raise InvalidEventError(f"has {what} a second time, after line {lines[key]}{how}")
            if keep == "last" or key not in found:
                found[key] = given
    with in_front(", "):
        faults.check()
    return list(found.values())
