"""Asking until there is an answer that can be used, or until the limit."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Sequence
from typing import Final

from phase_ppl.evaluation.vlm.parser import Parsed, parse
from phase_ppl.evaluation.vlm.request import (
    Client,
    NoReply,
    Reply,
    Request,
    in_a_line,
    writable,
)
from phase_ppl.evaluation.vlm.store import Attempt
from phase_ppl.world.errors import AnswerError, shown

FIRST_WAIT: Final = 2.0
LONGEST_WAIT: Final = 120.0
"""Seconds to wait before another request: doubled every time, or what the service asks for. If it
asks for more than the longest, nothing is tried again."""


def pause(seconds: float) -> None:
    """Wait."""
    time.sleep(seconds)


def first_readable(
    attempts: Sequence[Attempt], remaining: str
) -> tuple[Parsed | None, int, str | None]:
    """Return the first answer that can be used, its place, and why the last one cannot.

    Where there is none, the place is the number of attempts.
    """
    reason = None
    for place, attempt in enumerate(attempts):
        if attempt.text is None:
            reason = attempt.failure
            continue
        try:
            return parse(attempt.text, remaining), place, None
        except AnswerError as error:
            reason = f"{error} (ended by: {attempt.finish})" if attempt.finish else str(error)
    return None, len(attempts), reason


def ask(
    client: Client,
    request: Request,
    remaining: str,
    retries: int,
    keep: Callable[[Attempt], None],
) -> None:
    """Ask until there is an answer that can be used.

    The same request is made again, as if for the first time: an answer never knows of another.

    Args:
        client: is asked.
        request: the question.
        remaining: as of :func:`~phase_ppl.evaluation.vlm.parser.parse`.
        retries: how often it is asked again, at most.
        keep: gets each attempt, before the next.

    Raises:
        AnswerError: the limit was reached, or another request would be in vain.
    """
    wait = FIRST_WAIT
    for n in range(1, retries + 2):
        attempt, again, asked_wait = _try(client, request)
        keep(attempt)
        parsed, _, reason = first_readable([attempt], remaining)
        if parsed is not None:
            return
        if asked_wait is not None and asked_wait > LONGEST_WAIT:
            reason = f"{reason}; it asks to wait {asked_wait:.0f} s, longer than {LONGEST_WAIT:.0f}"
            again = False
        if n == retries + 1 or not again:
            requests = f"{n} request{'s' * (n > 1)}"
            raise AnswerError(f"no answer that can be used in {requests}; the last: {reason}")
        if attempt.text is None:
            pause(wait if asked_wait is None else asked_wait)
            wait = min(2 * wait, LONGEST_WAIT)


def _try(client: Client, request: Request) -> tuple[Attempt, bool, float | None]:
    """Return an attempt, whether to try again if it was in vain, and after how many seconds."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    clock = time.perf_counter()

    def seconds() -> float:
        return round(time.perf_counter() - clock, 3)

    def failed(reason: str) -> Attempt:
        return Attempt(now, seconds(), failure=writable(reason))

    try:
        given = client(request)
    except NoReply as error:
        return failed(str(error)), error.again, error.wait
    except (ConnectionError, TimeoutError) as error:
        return failed(in_a_line(f"{type(error).__name__}: {error}")), True, None
    if isinstance(given, str):
        given = Reply(given)
    if not isinstance(given, Reply):
        return failed(f"the client returned {shown(given)}, expected text"), False, None
    finish, model = (
        None if words is None else in_a_line(words) for words in (given.finish, given.model)
    )
    counts = given.tokens_in, given.tokens_out
    return Attempt(now, seconds(), writable(given.text), None, finish, model, *counts), True, None
