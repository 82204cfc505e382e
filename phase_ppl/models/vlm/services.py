"""Services that answer requests, through their own libraries: google-genai and openai.

The libraries retry temporary failures, and ask for JSON. A key is read from the environment when a
request is made, goes to the library alone, and is hidden in replies. Redirections are not followed,
since they would take the request along. Answers are limited in size and time.
"""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import importlib
import ipaddress
import os
import re
import time
import urllib.parse
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Final

from phase_ppl.models.vlm.request import NoReply, Reply, Request, in_a_line
from phase_ppl.world.errors import InvalidSettingError, number_or_nan, shown, unknown_name

SERVICES: Final = {"google": "google.genai", "openai": "openai"}  # name -> the module that it needs

MAX_REPLY: Final = 8 * 2**20  # largest answer that is read, bytes; a good one has a few thousand
FIRST_WAIT: Final = 4.0
LONGEST_WAIT: Final = 120.0
"""First and longest wait before a retry, seconds; waits double. For Google's library, which ignores
Retry-After; OpenAI's has its own."""

_USUAL: Final[Mapping[str, Mapping[str, Any]]] = {
    "google": {
        "model": "gemini-2.5-pro",  # the paper's
        "base_url": "https://generativelanguage.googleapis.com",
        "variables": ("GOOGLE_API_KEY", "GEMINI_API_KEY"),
        "show": "video",
    },
    "openai": {
        "base_url": "https://api.openai.com/v1",
        "variables": ("OPENAI_API_KEY",),
        "show": "pictures",
    },
}
_MOST: Final = {"timeout": 86_400.0, "temperature": 2.0, "video_fps": 24.0}
_NO_KEY: Final = "none"  # sent as the key to a server of one's own that asks for none
_SECRET_LENGTH: Final = 12
"""Shorter keys, such as "x" for a user's own server, are no secrets; hiding them would spoil the
answers."""


@dataclasses.dataclass(frozen=True)
class Service:
    """A service that is asked over the network through its library."""

    name: str  # one of ``SERVICES``
    model: str  # as the service calls it
    base_url: str
    # the environment variables that may hold the key, the first that does counts
    variables: tuple[str, ...]
    show: str  # "video" or "pictures"
    timeout: float = 300.0  # seconds from a request to the end of its answer
    temperature: float | None = None  # None: the service decides
    video_fps: float | None = None  # frames of the video that are looked at, per second; likewise
    needs_key: bool = True  # whether it is an error if there is none

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
        ask = _google if self.name == "google" else _openai
        try:
            reply = ask(self, request, retries, key, client)
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
        return {"client": self.name, **given, "answer": "json"}

    def _key(self) -> str:
        for variable in self.variables:
            key = os.environ.get(variable, "").strip()
            if key and not (key.isascii() and key.isprintable()):
                raise InvalidSettingError(
                    f"the key in {variable} has characters that no key can have"
                )
            if key:
                return key
        if not self.needs_key:
            return _NO_KEY
        raise InvalidSettingError(
            f"client {self.name!r} needs its key in the environment variable "
            f"{' or '.join(self.variables)}"
        )

    def _failure(self, error: Exception, key: str) -> NoReply | InvalidSettingError:
        """Return an error of a library, or of what came, as one of ours."""
        status = getattr(error, "status_code", getattr(error, "code", None))  # openai's, Google's
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
            variables = " or ".join(self.variables) or "(none was sent)"
            return InvalidSettingError(f"{where}: the key in {variables} is refused")
        body = getattr(error, "body", None) or getattr(error, "message", None)
        words = _line(str(body.get("message", body) if isinstance(body, Mapping) else body), key)
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
    """Hooks that check what a library's HTTP client (httpx or httpx2) sends and receives.

    They limit the time from a request to the end of its answer. The libraries' own limits are per
    piece of an answer: a server that sends a byte now and then keeps to them.
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


def _google(
    service: Service, request: Request, retries: int, key: str, client: dict[str, Any]
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


def _openai(
    service: Service, request: Request, retries: int, key: str, client: dict[str, Any]
) -> Reply:
    import openai

    chosen = {} if service.temperature is None else {"temperature": service.temperature}
    with openai.OpenAI(
        api_key=key,
        base_url=service.base_url,
        timeout=service.timeout,
        max_retries=retries,
        http_client=openai.DefaultHttpxClient(**client),
    ) as asked:
        found: Any = asked.chat.completions.create(
            model=service.model,
            messages=[{"role": "user", "content": list(_openai_parts(request))}],
            stream=False,
            response_format={"type": "json_object"},
            **chosen,
        )
    if isinstance(found, str):  # the library hands on, unchecked, whatever a server sends
        return Reply(found)
    choice = next(iter(getattr(found, "choices", None) or ()), None)
    said, usage = getattr(choice, "message", None), getattr(found, "usage", None)
    content, refusal = getattr(said, "content", None), getattr(said, "refusal", None)
    finish = f"refusal: {refusal}" if refusal else getattr(choice, "finish_reason", None)
    return Reply(
        text="" if content is None else str(content),
        finish=finish or getattr(found, "error", None),  # some servers send one with status 200
        model=getattr(found, "model", None),
        tokens_in=getattr(usage, "prompt_tokens", None),
        tokens_out=getattr(usage, "completion_tokens", None),
    )


def _openai_parts(request: Request) -> Iterator[dict[str, Any]]:
    for picture in request.pictures:
        yield {"type": "text", "text": f"{picture.seconds:g} s"}
        url = f"data:image/png;base64,{base64.b64encode(picture.png).decode()}"
        yield {"type": "image_url", "image_url": {"url": url}}
    yield {"type": "text", "text": request.prompt}


# --- settings -------------------------------------------------------------------------------------


def make_service(
    name: object, model: str | None, show: str | None, given: Mapping[str, Any], to_be_asked: bool
) -> Service:
    """Return a service, ready to be asked.

    ``given`` has the options ``timeout`` [s], ``temperature``, ``video_fps``, ``key_env`` and
    ``base_url``, where they are not the usual ones.

    Raises:
        UnknownNameError: there is no such service.
        InvalidSettingError: an option is out of range, or does not go with the service.
    """
    if not isinstance(name, str) or name not in SERVICES:
        raise unknown_name("client", name, SERVICES)
    settings: dict[str, Any] = dict(_USUAL[name])
    for option, most in _MOST.items():
        if option in given:
            number, may_be_0 = number_or_nan(given[option]), option == "temperature"
            if not (0 < number <= most or (number == 0 and may_be_0)):
                raise InvalidSettingError(
                    f"{option}={shown(given[option])}, expected a number "
                    f"{'>=' if may_be_0 else '>'} 0 and <= {most:g}"
                )
            settings[option] = number
    if name == "openai" and show == "video":
        raise InvalidSettingError("show='video', but OpenAI's API takes pictures only")
    if "video_fps" in given and (name != "google" or show == "pictures"):
        raise InvalidSettingError("video_fps is for the video that Google gets")
    named = {"model": model, "show": show}
    settings |= {option: value for option, value in named.items() if value is not None}
    if "model" not in settings:
        raise InvalidSettingError("client 'openai' needs name=, what the service calls the model")
    variable = given.get("key_env", "NONE")
    if not isinstance(variable, str) or re.fullmatch("[A-Z_][A-Z0-9_]*", variable) is None:
        raise InvalidSettingError(  # not showing what may be a key
            "key_env is the name of the environment variable that holds the key, such as "
            "OPENAI_API_KEY (capitals, digits, _); what was given is none"
        )
    if "key_env" in given:
        settings["variables"] = (variable,)
    if "base_url" in given:
        address = given["base_url"]
        settings |= {"base_url": address, "needs_key": "key_env" in given}
        if _is_open(address) and to_be_asked:
            words = (
                f"base_url={shown(address)}: plain http:// to another machine; whoever is between"
            )
            if settings["needs_key"]:
                raise InvalidSettingError(
                    f"{words} could read the key: use https://, or a tunnel to localhost"
                )
            settings["variables"] = ()
            warnings.warn(f"{words} can read and change everything; no key is sent", stacklevel=2)
    return Service(name, **settings)


def _is_open(address: object) -> bool:
    """Whether traffic to an address is readable on its way: http to another machine.

    An address with a secret in it is refused: settings are written into files.
    """
    text, host, secret = address if isinstance(address, str) else "", None, None
    with contextlib.suppress(ValueError):
        parts = urllib.parse.urlsplit(text)
        host, secret = parts.hostname, parts.username or parts.password or parts.query
    if secret:
        raise InvalidSettingError(
            "base_url has a user name, a password or a query; it must be an address alone"
        )
    if not host or not text.startswith(("http://", "https://")):
        raise InvalidSettingError(f"base_url={shown(address)}, expected an address (https://...)")
    here = host == "localhost"
    with contextlib.suppress(ValueError):
        here = ipaddress.ip_address(host).is_loopback
    return text.startswith("http://") and not here
