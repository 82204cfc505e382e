"""A vision-language model that is asked about events until its answer can be used."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation.answer import Answer
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.vlm.answers import Attempt, Parsed, Store, as_json, parse
from phase_ppl.evaluation.vlm.request import (
    RENDERING,
    TEXT,
    Client,
    NoReply,
    Reply,
    Request,
    in_a_line,
    writable,
)
from phase_ppl.evaluation.vlm.services import Service
from phase_ppl.world.errors import AnswerError, shown
from phase_ppl.world.files import write_json
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

ANSWER: Final = "answer.json"
"""The file in an event's folder that holds the request and all that came of it."""

FIRST_WAIT: Final = 2.0
LONGEST_WAIT: Final = 120.0
"""Seconds to wait after a failure that may pass: doubled every time."""


def pause(seconds: float) -> None:
    """Wait."""
    time.sleep(seconds)


@dataclasses.dataclass(frozen=True)
class Vlm:
    """A vision-language model, ready to be asked.

    Attributes:
        client: answers.
        named: what of the client determines its answers: ``client``, ``model`` and settings.
        pictures: how many frames there are to see, at most.
        as_video: whether the prompt speaks of a video.
        store: keeps the answers, if they are to be kept.
        replay: whether stored answers are all there is.
        retries: how often an event is asked about again, at most.
        remaining: what becomes of probability that an answer gives to no goal.
    """

    client: Client
    named: Mapping[str, Any]
    pictures: int
    as_video: bool
    store: Store | None
    replay: bool
    retries: int
    remaining: str

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return what the model answers, or has answered to the same request and seed before."""
        who = str(self.named["model"])
        request = Request(scene, observation, who, self.pictures, self.as_video)
        determines = {
            **self.named,
            "prompt_sha256": hashlib.sha256(request.prompt.encode()).hexdigest(),
            "film_sha256": request.digest,
        }
        found = self.store.find(determines, seed) if self.store else None
        record = found or {"request": determines, "seed": seed, "prompt": request.prompt}
        attempts: list[Attempt] = record.setdefault("attempts", [])
        parsed, place, reason = self._first_readable(attempts)
        stored = parsed is not None
        if not stored and self.replay:
            raise AnswerError(self._missing(determines, seed, reason))
        made, wait = 0, FIRST_WAIT
        while parsed is None:
            # the same request, as if for the first time: an answer never knows of another
            attempt, again = self._try(request, self.retries - made)
            attempts.append(attempt)
            record["film"] = request.drawn()
            if self.store and any(each.text is not None for each in attempts):
                self.store.keep(record)
            made += attempt.requests
            parsed, _, reason = self._first_readable([attempt])
            place = len(attempts) - 1
            if parsed is None and (made > self.retries or not again):
                requests = f"{made} request{'s' * (made > 1)}"
                raise AnswerError(f"no answer that can be used in {requests}; the last: {reason}")
            if attempt.text is None:
                pause(wait)
                wait = min(2 * wait, LONGEST_WAIT)
        cost = _cost(attempts[: place + 1], len(parsed.repairs), stored)
        prediction = Prediction("", probabilities=parsed.probabilities, cost=cost)
        kept = {**record, "repairs": list(parsed.repairs), "remaining": self.remaining}
        return Answer(prediction, {ANSWER: lambda path: write_json(path, as_json(kept))})

    def settings(self) -> dict[str, Any]:
        """Return what is asked, and how the animation is drawn."""
        digest = hashlib.sha256(TEXT.encode()).hexdigest()
        return {**self.named, "prompt_sha256": digest, "rendering": RENDERING}

    def _first_readable(self, attempts: Sequence[Attempt]) -> tuple[Parsed | None, int, str | None]:
        """Return the first answer that can be used, its place, and why the last one cannot.

        Where there is none, the place is the number of attempts.
        """
        reason = None
        for place, attempt in enumerate(attempts):
            if attempt.text is None:
                reason = attempt.failure
                continue
            try:
                return parse(attempt.text, self.remaining), place, None
            except AnswerError as error:
                reason = f"{error} (ended by: {attempt.finish})" if attempt.finish else str(error)
        return None, len(attempts), reason

    def _try(self, request: Request, retries: int) -> tuple[Attempt, bool]:
        """Return an attempt, and whether to try again if it was in vain."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        clock, again, made = time.perf_counter(), True, 1
        given: object = None
        try:
            client = self.client
            given = client(request, retries) if isinstance(client, Service) else client(request)
            given = Reply(given) if isinstance(given, str) else given
            failure = ""
        except NoReply as error:
            failure, again, made = str(error), error.again, error.requests
        except (ConnectionError, TimeoutError) as error:
            failure = in_a_line(f"{type(error).__name__}: {error}")
        seconds = round(time.perf_counter() - clock, 3)
        if not isinstance(given, Reply):
            if not failure:
                failure, again = f"the client returned {shown(given)}, expected text", False
            return Attempt(now, seconds, failure=writable(failure), requests=made), again
        parts = dataclasses.asdict(given) | {"text": writable(given.text)}
        for name in ("finish", "model"):
            parts[name] = None if parts[name] is None else in_a_line(parts[name])
        return Attempt(now, seconds, **parts), True

    def _missing(self, determines: Mapping[str, Any], seed: int, reason: str | None) -> str:
        assert self.store is not None
        name = self.store.file_of(determines, seed).name
        if reason is not None:
            return f"{self.store.path / name} has no answer that can be used; the last: {reason}"
        words = f"{self.store.path} has no answer to this request: {name} is missing"
        other = self.store.knows(determines)
        return f"{words}; it has been answered for other seeds only" if other else words


def _cost(attempts: Sequence[Attempt], repairs: int, stored: bool) -> dict[str, Any]:
    """Return what an answer cost when it was given, even if that was long ago."""
    cost = {
        "requests": sum(each.requests for each in attempts),
        "failures": sum(each.requests - (each.text is not None) for each in attempts),
        "refused": sum(each.text is not None for each in attempts[:-1]),
        "repairs": repairs,
        "from_store": stored,
        "answer_seconds": sum(each.seconds for each in attempts),
    }
    for name in ("tokens_in", "tokens_out"):
        counts = [getattr(each, name) for each in attempts]
        known = [count for count in counts if count is not None]
        if known:
            cost[name] = sum(known)
    return cost
