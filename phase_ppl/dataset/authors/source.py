"""The bytes of a pickle, and the plain values that its opcodes spell."""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

from phase_ppl.world.errors import InvalidEventError, shown

MAX_INTEGER_BYTES: Final = 9
"""Bytes of the largest whole number that is read: one of 64 bits, with or without sign."""

_MAX_NUMBER_CHARACTERS: Final = 32
_ESCAPED: Final = re.compile(rb"(?:[^\\]++|\\(?:[\\'\"nrt]|x[0-9a-f]{2}))*+")
"""What Python 2 writes between the quotes of a text. Possessive, so that it takes linear time."""


class Source:
    """Bytes that are taken from the front."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._place = 0

    @property
    def at_end(self) -> bool:
        """Whether all bytes were taken."""
        return self._place == len(self._content)

    def take(self, count: int) -> bytes:
        """Return the next ``count`` bytes.

        Raises:
            InvalidEventError: there are not as many.
        """
        start = self._place
        end = start + count
        if not start <= end <= len(self._content):
            raise InvalidEventError("is damaged: the pickle ends too early")
        self._place = end
        return self._content[start:end]

    def line(self) -> bytes:
        """Return what comes before the next line feed, which is taken too."""
        end = self._content.find(b"\n", self._place)
        if end < 0:
            raise InvalidEventError("is damaged: the pickle ends too early")
        return self.take(end + 1 - self._place)[:-1]

    def number(self, form: str) -> Any:
        """Return the number of ``struct`` format ``form``."""
        return struct.unpack(form, self.take(struct.calcsize(form)))[0]

    def text_line(self) -> str:
        """Return the next line as text."""
        return decoded(self.line(), "utf-8")


def decoded(content: bytes, encoding: str) -> str:
    """Return ``content`` as text.

    Raises:
        InvalidEventError: it is none.
    """
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        raise InvalidEventError(f"is damaged: it holds {shown(content[:40])} as a text") from None


def _integer_line(source: Source) -> int | bool:
    line = source.line()
    if line in (b"00", b"01"):  # how Python 2 writes false and true
        return line == b"01"
    return _integer(_number_of(int, line))


def integer_line(source: Source) -> int:
    """Return the whole number in the next line."""
    return _integer(_number_of(int, source.line().removesuffix(b"L")))


def _float_line(source: Source) -> float:
    return float(_number_of(float, source.line()))


def _number_of(kind: Callable[[bytes], Any], line: bytes) -> Any:
    try:
        if len(line) > _MAX_NUMBER_CHARACTERS:
            raise ValueError
        return kind(line)
    except ValueError:
        raise InvalidEventError(f"is damaged: it holds {shown(line[:40])} as a number") from None


def _integer(value: int) -> int:
    if not -(2**63) <= value < 2**64:
        raise InvalidEventError("holds a whole number of more than 64 bits")
    return value


def _long(form: str) -> Callable[[Source], int]:
    def read(source: Source) -> int:
        count = source.number(form)
        if not 0 <= count <= MAX_INTEGER_BYTES:
            raise InvalidEventError("holds a whole number of more than 64 bits")
        return _integer(int.from_bytes(source.take(count), "little", signed=True))

    return read


def _number(form: str) -> Callable[[Source], Any]:
    return lambda source: source.number(form)


def _bytes(form: str) -> Callable[[Source], bytes]:
    return lambda source: source.take(source.number(form))


def _text(form: str, encoding: str = "utf-8") -> Callable[[Source], str]:
    return lambda source: decoded(source.take(source.number(form)), encoding)


def _quoted(source: Source) -> str:
    line = source.line()
    inner = line[1:-1]
    if len(line) < 2 or line[:1] not in b"'\"" or line[:1] != line[-1:]:
        raise InvalidEventError("is damaged: a text has no quotes around it")
    if not _ESCAPED.fullmatch(inner):
        raise InvalidEventError("is damaged: a text has an unknown escape")
    return codecs.escape_decode(inner)[0].decode("latin-1")


def _escaped_line(source: Source) -> str:
    return decoded(source.line(), "raw-unicode-escape")


VALUES: Final[Mapping[bytes, Callable[[Source], Any]]] = {
    b"N": lambda source: None,
    b"\x88": lambda source: True,
    b"\x89": lambda source: False,
    b")": lambda source: (),
    b"]": lambda source: [],
    b"}": lambda source: {},
    b"I": _integer_line,
    b"L": integer_line,
    b"J": _number("<i"),
    b"K": _number("<B"),
    b"M": _number("<H"),
    b"\x8a": _long("<B"),
    b"\x8b": _long("<i"),
    b"F": _float_line,
    b"G": _number(">d"),
    b"S": _quoted,  # texts of Python 2 are bytes, which stand for the first 256 characters
    b"T": _text("<i", "latin-1"),
    b"U": _text("<B", "latin-1"),
    b"V": _escaped_line,
    b"X": _text("<I"),
    b"\x8c": _text("<B"),
    b"\x8d": _text("<Q"),
    b"B": _bytes("<I"),
    b"C": _bytes("<B"),
    b"\x8e": _bytes("<Q"),
    b"\x96": _bytes("<Q"),
}
"""Opcode -> how to read the value that it puts onto the stack (protocols 0 to 5)."""
