"""A vision-language model that watches the animation (paper, Appendix "Gemini 2.5 Pro")."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import os
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from phase_ppl.evaluation.answer import Answer
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import register_model
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
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import AnswerError, InvalidSettingError, shown, unknown_name
from phase_ppl.world.files import write_json
from phase_ppl.world.identity import qualified_name
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

if TYPE_CHECKING:
    pass
    from phase_ppl.evaluation.vlm.request import Client


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


# --- A vision-language model that watches the animation (paper, Appendix "Gemini 2.5... -----------


@register_model("vlm", parallel=False, extra="vlm")  # one request at a time: services count them
def vlm(
    *,
    client: str | Client | None = None,
    name: str | None = None,
    store: str | os.PathLike[str] | None = None,
    replay: bool = False,
    show: str | None = None,
    frames: int = 24,
    base_url: str | None = None,
    key_env: str | None = None,
    temperature: float | None = None,
    video_fps: float | None = None,
    timeout: float | None = None,
    retries: int = 4,
    remaining: str = "spread",
) -> Vlm:
    """A vision-language model that watches the animation and answers in JSON.

    Args:
        client: "google", "openai" (or whatever speaks the same), or a function that takes a
            :class:`~phase_ppl.evaluation.vlm.request.Request` and returns a text.
        name: of the model, as the service calls it; for Google the paper's, gemini-2.5-pro. For a
            function, the name under which its answers are kept, by default its own.
        store: folder in which answers are kept; one that is there is not asked for again.
        replay: ask nobody; an answer that is not in ``store`` is an error.
        show: "video" or "pictures"; by default the video to Google and to functions, pictures to
            OpenAI's API, which takes no video. A function may look at both; this is what the
            prompt speaks of.
        frames: how many pictures, evenly spaced, the first and the last frame among them.
        base_url: of a service that speaks the same; it may need no key.
        key_env: name of the environment variable with the key; by default GOOGLE_API_KEY or
            GEMINI_API_KEY, and OPENAI_API_KEY.
        temperature: by default the service's, as for the paper.
        video_fps: frames per second of the video that Google looks at; by default Google's, 1.
        timeout: seconds for a request to a service, from its beginning to its end; by default 300.
        retries: how often the same request is made again after a failure that may pass or an
            answer that cannot be used.
        remaining: "spread" or "zero" (:data:`phase_ppl.evaluation.vlm.answers.REMAINING`).

    Raises:
        InvalidSettingError, UnknownNameError: one of them cannot be used, or the client's
            library is not installed.
        OutputError: ``store`` is no folder.
    """
    from phase_ppl.evaluation.vlm.answers import REMAINING, Store

    pass
    from phase_ppl.evaluation.vlm.services import make_service

    if client is None:
        raise InvalidSettingError(
            "model 'vlm' needs client='google', client='openai' or a function of a request"
        )
    if not isinstance(replay, bool):
        raise InvalidSettingError(f"replay={shown(replay)}, expected true or false")
    if remaining not in REMAINING:
        raise unknown_name("remaining", remaining, REMAINING)
    if show not in (None, "video", "pictures"):
        raise unknown_name("show", show, ("video", "pictures"))
    if name is not None and not (isinstance(name, str) and name.strip()):
        raise InvalidSettingError(f"name={shown(name)}, expected a name")
    whole_number("frames", frames, minimum=2)
    whole_number("retries", retries, minimum=0)
    kept = None if store is None else Store(store)
    if replay and (kept is None or not any(kept.path.glob("*.json"))):
        where = "store is not given" if kept is None else f"there are none in {kept.path}"
        raise InvalidSettingError(f"replay needs a store with answers, but {where}")
    of_services = {
        "base_url": base_url,
        "key_env": key_env,
        "temperature": temperature,
        "video_fps": video_fps,
        "timeout": timeout,
    }
    given = {option: value for option, value in of_services.items() if value is not None}
    if callable(client):
        if given:
            raise InvalidSettingError(
                f"{', '.join(given)}: for services, not for a function as client"
            )
        who = qualified_name(client)
        if name is None and (not hasattr(client, "__qualname__") or "<lambda>" in who):
            raise InvalidSettingError(
                f"client {who} has no name of its own: give name=, under which its answers are kept"
            )
        asked: Client = client
        named: dict[str, Any] = {"client": who, "model": name or who, "show": show or "video"}
    else:
        service = make_service(client, name, show, given, to_be_asked=not replay)
        asked, named = service, service.named()
    return Vlm(asked, named, frames, named["show"] == "video", kept, replay, retries, remaining)
