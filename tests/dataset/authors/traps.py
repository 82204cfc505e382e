"""Pickles that must not be read, and what is said of them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from phase_ppl.dataset.authors.pickles import unpickled
from phase_ppl.world.errors import InvalidEventError

SPRUNG = "PHASE_PPL_TEST_TRAP"
"""A folder, or a variable of the environment, that is there once code of a pickle has run."""

F8 = b"cnumpy\ndtype\nVf8\nI00\nI01\n\x87R(K\x03V<\nNNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
EIGHT = b"C\x08" + bytes(8)


class Trap:
    """Its pickle, when loaded, calls a function."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> tuple[Any, ...]:
        return self.call


def is_sprung() -> bool:
    return SPRUNG in os.environ or Path(SPRUNG).exists()


def complaint(content: bytes) -> str | None:
    """Return the one line with which a pickle is refused; None where it is read."""
    try:
        unpickled(content)
    except InvalidEventError as error:
        message = str(error)
    else:
        return None
    assert "\n" not in message
    assert len(message) < 250
    return message


def refused(content: bytes) -> str:
    message = complaint(content)
    assert message is not None
    return message


def array(shape: bytes, dtype: bytes = F8, content: bytes = EIGHT) -> bytes:
    """Return the pickle of an array in parts: (1, shape, dtype, False, content)."""
    return EMPTY + b"(K\x01" + shape + dtype + b"\x89" + content + b"tb."
