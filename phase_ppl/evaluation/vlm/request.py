"""What passes between this package and whoever answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

from phase_ppl.evaluation.vlm.film import Film, Picture
from phase_ppl.world.errors import AnswerError


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
        tokens_in, tokens_out: as the service counts them; None where it does not say.
    """

    text: str
    finish: str | None = None
    model: str | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None


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
