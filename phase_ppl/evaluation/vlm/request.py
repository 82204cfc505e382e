"""What passes between this package and whoever answers."""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Callable
from typing import Final, TypeAlias

from phase_ppl.evaluation.vlm.film import Film, Picture
from phase_ppl.world.errors import AnswerError

_EXCERPT: Final = 200
"""Characters of a line about a request, at most."""


@dataclasses.dataclass(frozen=True, eq=False)
class Request:
    """A question about one event.

    Attributes:
        prompt: the question; it says how the animation is shown.
        model: who is asked, as the service or the user calls it.
        film: the animation.
    """

    prompt: str
    model: str
    film: Film = dataclasses.field(repr=False)

    @property
    def video(self) -> bytes:
        """The animation as MP4."""
        return self.film.video

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """Frames of the animation, PNG, each with the second at which the video shows it."""
        return self.film.pictures


@dataclasses.dataclass(frozen=True)
class Reply:
    """What came back.

    Attributes:
        text: as it came; empty where there is none.
        finish: why the text ends there, in the service's words.
        model: what answered, in the service's words, such as a version.
        tokens_in, tokens_out: as the service counts them; None where it does not say, or
            something that is no whole number.

    Raises:
        AnswerError: ``text`` is no text.
    """

    text: str
    finish: str | None = None
    model: str | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None

    def __post_init__(self) -> None:
        # servers send what they like, and one field of another type must not cost the answer
        if not isinstance(self.text, str):
            kind = type(self.text).__name__
            raise AnswerError(f"the text of a reply is of type {kind}, expected str")
        for name in ("finish", "model"):
            given = getattr(self, name)
            object.__setattr__(self, name, None if given is None else str(given))
        for name in ("tokens_in", "tokens_out"):
            object.__setattr__(self, name, _count(getattr(self, name)))


Client: TypeAlias = Callable[[Request], str | Reply]
"""Who answers. A ``ConnectionError`` or ``TimeoutError`` that it raises is worth another try."""


class NoReply(AnswerError):
    """A request to which no answer came.

    Attributes:
        again: whether the same request may succeed later.
        wait: seconds after which the service asked to be tried again, if it did.
    """

    def __init__(self, reason: str, again: bool = False, wait: float | None = None) -> None:
        super().__init__(reason)
        self.again, self.wait = again, wait


def writable(text: str) -> str:
    """Return a text without halves of surrogate pairs, which no file can hold."""
    return text.encode("utf-8", "replace").decode()


def in_a_line(text: str) -> str:
    """Return a text, or its beginning, in one line that a file can hold."""
    words = " ".join(writable(text).split())
    return words if len(words) <= _EXCERPT else words[: _EXCERPT - 3] + "..."


def _count(given: object) -> int | None:
    whole = isinstance(given, numbers.Integral) and not isinstance(given, bool)
    if whole or (isinstance(given, float) and given.is_integer()):
        return int(given)  # type: ignore[call-overload]
    return None
