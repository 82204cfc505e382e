"""From a file's bytes to a JSON object, or one line that says why not."""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter
from pathlib import Path
from typing import Any, Final, NoReturn

from phase_ppl.world.errors import InvalidEventError, shown

MAX_BYTES: Final = 512 * 2**20
"""Largest event file that is read."""

PICKLE_SUFFIXES: Final = (".pkl", ".pickle", ".pik", ".pck", ".p")
_HEAD_BYTES: Final = 64
_OLD_PICKLE: Final = re.compile(rb"\([dli]|[\]}]q|c[A-Za-z_][\w.]*\n")
"""How pickles of the text protocols begin; JSON never does."""


def read_document(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the JSON object in the file ``path``.

    A pickle is recognised by its name or its first bytes and never loaded: loading one runs
    whatever code its author put into it.

    Raises:
        InvalidEventError: no such file, a folder, a pickle, too large, or not a JSON object.
    """
    if Path(path).suffix.lower() in PICKLE_SUFFIXES:
        raise InvalidEventError(_REFUSED_PICKLE)
    try:
        with open(path, "rb") as file:
            content = file.read(_HEAD_BYTES)
            _refuse_binary(content)
            content += file.read(MAX_BYTES + 1 - len(content))
    except IsADirectoryError:
        raise InvalidEventError("is a folder, expected an event file") from None
    except FileNotFoundError:
        raise InvalidEventError("no such file") from None
    except OSError as error:
        raise InvalidEventError(f"cannot be read: {error.strerror or error}") from None
    return parse_document(content)


def read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the JSON object in the file ``path``, as :func:`read_document`.

    Raises:
        InvalidEventError: as there; the message names the file.
    """
    try:
        return read_document(path)
    except InvalidEventError as error:
        raise InvalidEventError(f"{path}: {error}") from None


def parse_document(content: bytes) -> dict[str, Any]:
    """Return the JSON object that ``content`` spells.

    Raises:
        InvalidEventError: too large, not UTF-8, not strict JSON (NaN and Infinity are not JSON),
            a key given twice, nested too deeply, or not an object.
    """
    _refuse_binary(content[:_HEAD_BYTES])
    if len(content) > MAX_BYTES:
        raise InvalidEventError(f"is larger than the {MAX_BYTES // 2**20} MB that are read")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidEventError(f"is not text: byte {error.start} is not UTF-8") from None
    return parse_text(text)


def parse_text(text: str) -> dict[str, Any]:
    """Return the JSON object that ``text`` spells.

    Raises:
        InvalidEventError: as for :func:`parse_document`.
    """
    if not text.strip():
        raise InvalidEventError("is empty")
    try:
        document = json.loads(
            text,
            object_pairs_hook=_without_duplicates,
            parse_constant=_refuse_constant,
            parse_float=_finite,
        )
    except json.JSONDecodeError as error:
        cut = " (the file ends too early)" if error.pos >= len(text.rstrip()) else ""
        raise InvalidEventError(
            f"is not JSON: line {error.lineno}, column {error.colno}: {error.msg}{cut}"
        ) from None
    except RecursionError:
        raise InvalidEventError("is nested too deeply for an event") from None
    except InvalidEventError:
        raise
    except ValueError:
        raise InvalidEventError("holds a whole number with thousands of digits") from None
    if not isinstance(document, dict):
        raise InvalidEventError(f"holds {shown(document)}, expected a JSON object")
    return document


_REFUSED_PICKLE: Final = (
    "is a pickle, which is never loaded as an event because loading one can run any code; "
    "expected a JSON file; for a pickle of PHASE's authors say so by format='phase-pickle', or "
    "convert it by 'phase-ppl export --from phase-pickle'"
)


def _refuse_binary(head: bytes) -> None:
    new_style = len(head) > 1 and head[0] == 0x80 and head[1] <= 0x0F
    if new_style or _OLD_PICKLE.match(head):
        raise InvalidEventError(_REFUSED_PICKLE)
    if b"\0" in head:
        raise InvalidEventError("is a binary file, expected a JSON file")


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = next(name for name, n in counts.items() if n > 1)
        raise InvalidEventError(f"gives {shown(twice)} twice in one object")
    return result


def _refuse_constant(token: str) -> NoReturn:
    raise InvalidEventError(f"holds {token}, expected finite numbers")


def _finite(token: str) -> float:
    value = float(token)
    if not math.isfinite(value):
        raise InvalidEventError(f"holds {token[:40]}, expected finite numbers")
    return value
