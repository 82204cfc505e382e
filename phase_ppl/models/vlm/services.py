"""Google's service, which answers requests through its own library, google-genai.

The library retries temporary failures, and asks for JSON. The key is read from the environment when
a request is made, goes to the library alone, and is hidden in replies. Redirections are not
followed, since they would take the request along. Answers are limited in size and time.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import time
from typing import Any, Final

from phase_ppl.models.vlm.request import NoReply, Reply, Request, in_a_line
from phase_ppl.world.errors import InvalidSettingError, number_or_nan, shown

LIBRARY: Final = "google.genai"  # the module that is needed
MODEL: Final = "gemini-2.5-pro"  # the paper's
BASE_URL: Final = "https://generativelanguage.googleapis.com"
VARIABLES: Final = ("GOOGLE_API_KEY", "GEMINI_API_KEY")
"""Environment variables that may hold the key; the first that does counts."""

MAX_REPLY: Final = 8 * 2**20  # largest answer that is read, bytes; a good one has a few thousand
FIRST_WAIT: Final = 4.0
LONGEST_WAIT: Final = 120.0
"""First and longest wait before a retry, seconds; waits double."""

_MOST: Final = {"timeout": 86_400.0, "temperature": 2.0, "video_fps": 24.0}
_SECRET_LENGTH: Final = 12
"""Shorter keys are no secrets; hiding them would spoil the answers."""


@dataclasses.dataclass(frozen=True)
class Google:
    """Google's service.

    Raises:
        InvalidSettingError: an option is out of range, or does not go with what is shown.
    """

    model: str = MODEL  # as the service calls it
    show: str = "video"  # or "pictures"
    timeout: float = 300.0  # seconds from a request to the end of its answer
    temperature: float | None = None  # None: the service decides
    video_fps: float | None = None  # frames of the video that are looked at, per second; likewise
    base_url: str = BASE_URL

    def __post_init__(self) -> None:
        for option, most in _MOST.items():
            number, may_be_0 = getattr(self, option), option == "temperature"
            if number is None:
                continue
            value = number_or_nan(number)
            if not (0 < value <= most or (value == 0 and may_be_0)):
                raise InvalidSettingError(
                    f"{option}={shown(number)}, expected a number "
                    f"{'>=' if may_be_0 else '>'} 0 and <= {most:g}"
                )
            object.__setattr__(self, option, value)
        if self.video_fps is not None and self.show == "pictures":
            raise InvalidSettingError("video_fps is for the video, but show='pictures'")

    def __call__(self, request: Request, retries: int = 0) -> Reply:
        """Return the answer to a request, made again by the library up to ``retries`` times.

        Raises:
            NoReply: there is no answer.
            InvalidSettingError: there is no key, or it is refused; or there is no such model.
        """
        key = self._key()
        _ = request.video if self.show == "video" else request.pictures  # that fails by itself
        failure: NoReply | InvalidSettingError
        guard = _Guard(key, self.timeout)
        client = {"follow_redirects": False, "event_hooks": guard.hooks}
        try:
            reply = _asked(self, request, retries, key, client)
        except Exception as error:
            try:
                failure = self._failure(error, key)
            except Exception:  # a library's error that has no words
                failure = NoReply(type(error).__name__)
        else:
            parts = {name: _hidden(value, key) for name, value in vars(reply).items()}
            return Reply(**parts | {"requests": guard.requests})
        if isinstance(failure, NoReply):
            failure.requests = max(1, guard.requests)
        raise failure  # from here it has no context, which would hold the request with its key

    def named(self) -> dict[str, Any]:
        """Return what determines the answers, as plain data."""
        fields = ("model", "base_url", "show", "temperature", "video_fps")
        given = {field: getattr(self, field) for field in fields}
        return {"client": "google", **given, "answer": "json"}

    def _key(self) -> str:
        for variable in VARIABLES:
            key = os.environ.get(variable, "").strip()
            if key and not (key.isascii() and key.isprintable()):
                raise InvalidSettingError(
                    f"the key in {variable} has characters that no key can have"
                )
            if key:
                return key
        raise InvalidSettingError(
            f"client 'google' needs its key in the environment variable {' or '.join(VARIABLES)}"
        )

    def _failure(self, error: Exception, key: str) -> NoReply | InvalidSettingError:
        """Return an error of the library, or of what came, as one of ours."""
        status = getattr(error, "code", None)
        if not isinstance(status, int):
            cause = error.__cause__ or error
            if isinstance(cause, NoReply):
                return NoReply(_line(str(cause), key), cause.again)
            # pydantic's words have pieces of what was sent
            words = "an answer of another form" if hasattr(cause, "error_count") else str(cause)
            return NoReply(_line(f"{type(cause).__name__}: {words}", key), again=True)
        where = f"{self.base_url} answers HTTP {status}"
        # the words of such answers like to repeat part of the key
        if status in (401, 403) or "API_KEY_INVALID" in str(getattr(error, "details", "")):
            return InvalidSettingError(f"{where}: the key in {' or '.join(VARIABLES)} is refused")
        words = _line(str(getattr(error, "message", None)), key)
        if status == 404:
            return InvalidSettingError(f"{where} to name={self.model!r}: {words}")
        return NoReply(f"HTTP {status}: {words}")  # the library has tried again where that helps


def _hidden(given: Any, key: str) -> Any:
    """Return ``given``, if it is a text, without the key."""
    secret = isinstance(given, str) and len(key) >= _SECRET_LENGTH
    return given.replace(key, "[key]") if secret else given


def _line(words: str, key: str) -> str:
    # hidden before shortening, which could leave half of the key
    return in_a_line(_hidden(words, key))


class _Guard:
    """Hooks that check what the library's HTTP client (httpx or httpx2) sends and receives.

    They limit the time from a request to the end of its answer. The library's own limit is per
    piece of an answer: a server that sends a byte now and then keeps to it.
    """

    def __init__(self, key: str, timeout: float) -> None:
        self.requests = 0
        self.hooks = {"request": [self._sent], "response": [self._answered]}
        self._key, self._timeout, self._end = key, timeout, 0.0
        self._refusal: NoReply | None = None

    def _sent(self, request: Any) -> None:
        if self._refusal is not None:  # the library retries after any error
            raise self._refusal
        self.requests += 1
        self._end = time.monotonic() + self._timeout
        request.headers["Accept-Encoding"] = "identity"  # an answer is as large as what is sent

    def _answered(self, response: Any) -> None:
        """Read the answer, and hand it to the library without the key."""
        if response.headers.get("content-encoding", "identity").lower() != "identity":
            raise self._refused("the answer is compressed, which was not asked for")
        content = bytearray()
        for piece in response.stream:
            content += piece
            if len(content) > MAX_REPLY:
                most = MAX_REPLY // 2**20
                raise self._refused(f"the answer is larger than the {most} MB that are read")
            if time.monotonic() > self._end:
                raise NoReply(f"no complete answer within {self._timeout:g} s", again=True)
        response.stream.close()
        if len(self._key) >= _SECRET_LENGTH:  # libraries write what they get into logs
            content = content.replace(self._key.encode(), b"[key]")
        library = importlib.import_module(type(response).__module__.partition(".")[0])
        response.stream = library.ByteStream(bytes(content))

    def _refused(self, words: str) -> NoReply:
        self._refusal = NoReply(words)
        return self._refusal


def _asked(
    service: Google, request: Request, retries: int, key: str, client: dict[str, Any]
) -> Reply:
    from google import genai
    from google.genai import types

    options = types.HttpOptions(
        base_url=service.base_url,
        timeout=round(1000 * service.timeout),
        retry_options=types.HttpRetryOptions(
            attempts=retries + 1, initial_delay=FIRST_WAIT, max_delay=LONGEST_WAIT
        ),
        client_args=client,
    )
    config = types.GenerateContentConfig(
        temperature=service.temperature, response_mime_type="application/json"
    )
    parts: list[Any] = []
    if service.show == "video":
        chosen = types.VideoMetadata(fps=service.video_fps) if service.video_fps else None
        blob = types.Blob(data=request.video, mime_type="video/mp4")
        parts.append(types.Part(inline_data=blob, video_metadata=chosen))
    else:
        for picture in request.pictures:
            parts.append(types.Part.from_text(text=f"{picture.seconds:g} s"))
            parts.append(types.Part.from_bytes(data=picture.png, mime_type="image/png"))
    parts.append(types.Part.from_text(text=request.prompt))
    with genai.Client(api_key=key, vertexai=False, http_options=options) as asked:
        found = asked.models.generate_content(model=service.model, contents=parts, config=config)
    usage, finish = found.usage_metadata, None
    if found.candidates:
        finish = getattr(found.candidates[0].finish_reason, "value", None)
    elif found.prompt_feedback:
        finish = f"blocked: {getattr(found.prompt_feedback.block_reason, 'value', None)}"
    # thinking is paid for too, even if it used up the limit
    counts = (usage.candidates_token_count, usage.thoughts_token_count) if usage else ()
    written = [count for count in counts if count is not None]
    return Reply(
        text=found.text or "",
        finish=finish,
        model=found.model_version,
        tokens_in=usage.prompt_token_count if usage else None,
        tokens_out=sum(written) if written else None,
    )
