"""A vision-language model that watches the animation (paper, Appendix "Gemini 2.5 Pro").

Its answers can be kept, so that an evaluation can be repeated without asking again. Each request
and seed has a JSON file ``KEY-SEED.json`` with a :class:`Record`; KEY is a hash of the request.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from phase_ppl.data.documents import read_json
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import Answer, check_installed, register_model
from phase_ppl.models.vlm import (
    LIBRARY,
    LONGEST_WAIT,
    MODEL,
    TEXT,
    Client,
    Google,
    NoReply,
    Parsed,
    Reply,
    Request,
    in_a_line,
    parse,
    rendering,
    sha256,
    writable,
)
from phase_ppl.world.errors import (
    AnswerError,
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    check_name,
    instance_of,
    shown,
    whole_number,
)
from phase_ppl.world.event import Observation
from phase_ppl.world.files import writable_folder, write_json
from phase_ppl.world.identity import differences, qualified_name
from phase_ppl.world.scene import Scene

SCHEMA: Final = "phase-ppl-answer-1"

ANSWER: Final = "answer.json"
"""The file in an event's folder that holds the request and all that came of it."""

FIRST_WAIT: Final = 2.0
"""Seconds to wait after a failure that may pass: doubled every time, up to ``LONGEST_WAIT``."""

pause = time.sleep


class Attempt(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A request that was made, once or again by a service's library: a text came, or a failure.

    What else is known is as of :class:`~phase_ppl.models.vlm.Reply`.
    """

    time: str  # in UTC, ISO 8601
    seconds: float  # that it took, the drawing included
    text: str | None = None
    failure: str | None = None
    finish: str | None = None
    model: str | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None
    requests: int = 1

    def __post_init__(self) -> None:
        if (self.text is None) == (self.failure is None):
            raise ValueError("expected either a text or a failure")


class Record(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A request, and all that came of it."""

    schema: str
    request: dict[str, Any]  # client, model, address, hashes of prompt and film, settings
    seed: int
    prompt: str
    attempts: list[Attempt]
    film: dict[str, Any] = {}  # what was drawn for it: sizes and hashes of the files

    @classmethod
    def read(cls, source: Path, request: Mapping[str, Any], seed: int) -> Record:
        """Return the record of a request in a file; InvalidEventError: it is of another."""
        try:
            found = msgspec.convert(read_json(source), cls)
        except msgspec.ValidationError as error:
            raise InvalidEventError(f"{source}: {error}") from None
        was = {"schema": found.schema, **found.request, "seed": found.seed}
        if apart := differences(was, {"schema": SCHEMA, **request, "seed": seed}):
            words = "; ".join(apart)
            raise InvalidEventError(f"{source}: is the answer to another request: {words}")
        return found


@dataclasses.dataclass(frozen=True)
class Vlm:
    """A vision-language model, ready to be asked."""

    client: Client  # answers
    # what of the client determines its answers: ``client``, ``model`` and settings
    named: Mapping[str, Any]
    pictures: int  # how many frames there are to see, at most
    store: Path | None  # folder that keeps the answers, if they are to be kept
    replay: bool  # whether stored answers are all there is
    retries: int  # how often an event is asked about again, at most
    text: str = TEXT  # of the question, see ``TEXT``

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return what the model answers, or has answered to the same request and seed before."""
        as_video = self.named["show"] == "video"
        request = Request(
            scene, observation, str(self.named["model"]), self.pictures, as_video, self.text
        )
        hashes = {"prompt_sha256": sha256(request.prompt), "film_sha256": request.digest}
        determines = {**self.named, **hashes}
        key = sha256(json.dumps(determines, sort_keys=True))[:20]
        file = None if self.store is None else self.store / f"{key}-{seed}.json"
        if file is not None and file.exists():
            record = Record.read(file, determines, seed)
        else:
            record = Record(
                schema=SCHEMA, request=determines, seed=seed, prompt=request.prompt, attempts=[]
            )
        place, parsed, reason = self._first_readable(record.attempts)
        from_store = parsed is not None
        if self.replay and parsed is None and file is not None:
            if reason is not None:
                raise AnswerError(f"{file} has no answer that can be used; the last: {reason}")
            words = f"{file.parent} has no answer to this request: {file.name} is missing"
            others = any(file.parent.glob(f"{key}-*.json"))
            raise AnswerError(words + "; it has been answered for other seeds only" * others)
        made, wait = 0, FIRST_WAIT
        while parsed is None:
            # the same request, as if for the first time: an answer never knows of another
            attempt, again = self._try(request, self.retries - made)
            record.attempts.append(attempt)
            record.film = request.drawn()
            if file is not None and any(each.text is not None for each in record.attempts):
                writable_folder(file.parent)
                write_json(file, msgspec.to_builtins(record))
            made += attempt.requests
            place, parsed, reason = self._first_readable(record.attempts)
            if parsed is None and (made > self.retries or not again):
                requests = f"{made} request{'s' * (made > 1)}"
                raise AnswerError(f"no answer that can be used in {requests}; the last: {reason}")
            if attempt.text is None:
                pause(wait)
                wait = min(2 * wait, LONGEST_WAIT)
        cost = _cost(record.attempts[: place + 1], len(parsed.repairs), from_store)
        prediction = Prediction("", probabilities=parsed.probabilities, cost=cost)
        kept = {**msgspec.to_builtins(record), "repairs": list(parsed.repairs)}
        return Answer(prediction, {ANSWER: lambda path: write_json(path, kept)})

    def settings(self) -> dict[str, Any]:
        """Return what is asked, and how the animation is drawn."""
        return {**self.named, "prompt_sha256": sha256(self.text), "rendering": rendering()}

    def _first_readable(self, attempts: Sequence[Attempt]) -> tuple[int, Parsed | None, str | None]:
        """Return the place of the first answer that can be used, it, and why the last cannot."""
        reason = None
        for place, attempt in enumerate(attempts):
            reason = attempt.failure
            if attempt.text is not None:
                try:
                    return place, parse(attempt.text), None
                except AnswerError as error:
                    ended = f" (ended by: {attempt.finish})" if attempt.finish else ""
                    reason = f"{error}{ended}"
        return len(attempts), None, reason

    def _try(self, request: Request, retries: int) -> tuple[Attempt, bool]:
        """Return an attempt, and whether to try again if it was in vain."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        clock, again = time.perf_counter(), True
        found: dict[str, Any]
        try:
            client = self.client
            given = client(request, retries) if isinstance(client, Google) else client(request)
            reply = Reply(given) if isinstance(given, str) else given
            if not isinstance(reply, Reply):
                raise NoReply(f"the client returned {shown(reply)}, expected text")
            words = {name: getattr(reply, name) for name in ("finish", "model")}
            found = {name: word and in_a_line(word) for name, word in words.items()}
            found = {**vars(reply), **found, "text": writable(reply.text)}
        except NoReply as error:
            found = {"failure": writable(str(error)), "requests": error.requests}
            again = error.again
        except (ConnectionError, TimeoutError) as error:
            found = {"failure": in_a_line(f"{type(error).__name__}: {error}")}
        seconds = round(time.perf_counter() - clock, 3)
        return Attempt(time=now, seconds=seconds, **found), again


def _cost(attempts: Sequence[Attempt], repairs: int, from_store: bool) -> dict[str, Any]:
    """Return what an answer cost when it was given, even if that was long ago."""
    cost = {
        "requests": sum(each.requests for each in attempts),
        "failures": sum(each.requests - (each.text is not None) for each in attempts),
        "refused": sum(each.text is not None for each in attempts[:-1]),
        "repairs": repairs,
        "from_store": from_store,
        "answer_seconds": sum(each.seconds for each in attempts),
    }
    for name in ("tokens_in", "tokens_out"):
        known = [count for each in attempts if (count := getattr(each, name)) is not None]
        if known:
            cost[name] = sum(known)
    return cost


@register_model("vlm", parallel=False, extra="vlm")  # one request at a time: services count them
def vlm(
    *,
    client: str | Client | None = None,
    name: str | None = None,
    store: str | os.PathLike[str] | None = None,
    replay: bool = False,
    show: str = "video",
    frames: int = 24,
    temperature: float | None = None,
    video_fps: float | None = None,
    timeout: float | None = None,
    retries: int = 4,
    prompt: str | os.PathLike[str] | None = None,
) -> Vlm:
    """A vision-language model that watches the animation and answers in JSON.

    Args:
        client: "google", whose key is in the environment variable GOOGLE_API_KEY or
            GEMINI_API_KEY; or a function that takes a
            :class:`~phase_ppl.models.vlm.Request` and returns a text.
        name: of the model, as Google calls it, by default the paper's, gemini-2.5-pro. For a
            function, the name under which its answers are kept, by default its own.
        store: folder in which answers are kept; one that is there is not asked for again.
        replay: ask nobody; an answer that is not in ``store`` is an error.
        show: "video" or "pictures"; by default the video. A function may look at both; this is
            what the prompt speaks of.
        frames: how many pictures, evenly spaced, the first and the last frame among them.
        temperature: by default the service's, as for the paper.
        video_fps: frames per second of the video that Google looks at; by default Google's, 1.
        timeout: seconds that a service may take for an answer; by default 300.
        retries: how often the same request is made again after a failure that may pass or an
            answer that cannot be used.
        prompt: a text file with a prompt of one's own, in which ``{goals}`` stands for the names of
            the goals; by default :data:`phase_ppl.models.vlm.TEXT`.
    """
    if client is None:
        raise InvalidSettingError("model 'vlm' needs client='google' or a function of a request")
    instance_of("replay", replay, bool, "true or false")
    check_name("show", show, ("video", "pictures"))
    if name is not None and not (isinstance(name, str) and name.strip()):
        raise InvalidSettingError(f"name={shown(name)}, expected a name")
    whole_number("frames", frames, minimum=2)
    whole_number("retries", retries, minimum=0)
    kept = None if store is None else Path(store)
    if kept is not None and kept.exists() and not kept.is_dir():
        raise OutputError(f"{kept} is a file, expected a folder for answers")
    if replay and (kept is None or not any(kept.glob("*.json"))):
        where = "store is not given" if kept is None else f"there are none in {kept}"
        raise InvalidSettingError(f"replay needs a store with answers, but {where}")
    of_service = {"timeout": timeout, "temperature": temperature, "video_fps": video_fps}
    given: dict[str, Any] = {name: value for name, value in of_service.items() if value is not None}
    if callable(client):
        if given:
            raise InvalidSettingError(
                f"{', '.join(given)}: for Google, not for a function as client"
            )
        who = qualified_name(client)
        if name is None and (not hasattr(client, "__qualname__") or "<lambda>" in who):
            raise InvalidSettingError(
                f"client {who} has no name of its own: give name=, under which its answers are kept"
            )
        asked: Client = client
        named: dict[str, Any] = {"client": who, "model": name or who, "show": show}
    else:
        check_name("client", client, ["google"])
        service = Google(name or MODEL, show, **given)
        if not replay:
            check_installed("client 'google'", [LIBRARY], "vlm")
        asked, named = service, service.named()
    text = TEXT if prompt is None else _users_prompt(prompt)
    return Vlm(asked, named, frames, kept, replay, retries, text)


def _users_prompt(path: object) -> str:
    """Return the text of a file; InvalidSettingError: it is none that can be asked."""
    if not isinstance(path, str | os.PathLike):
        raise InvalidSettingError(f"prompt={shown(path)}, expected the name of a text file")
    try:
        text = Path(path).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no UTF-8 text"
        raise InvalidSettingError(f"prompt={path}: {reason}") from None
    if not ("{goals}" in text or "{goals_str}" in text):
        raise InvalidSettingError(
            f"prompt={path} has no {{goals}}, in whose place the names of the goals are put"
        )
    return text
