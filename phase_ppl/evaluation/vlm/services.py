"""The services that can be asked, through their own libraries: google-genai and openai.

The libraries keep time limits, try again where a failure may pass, and ask for JSON. What they are
not trusted with is added here. A key is read from the environment when a request is made and goes
to the library alone; what comes back is searched for it before anybody gets to see it. No
redirection is followed, which would take the request along; an answer has a largest size and a
latest moment; every failure is one line.
"""

from __future__ import annotations

import base64
import dataclasses
import importlib
import ipaddress
import os
import queue
import re
import threading
import time
import urllib.parse
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Final

from phase_ppl.evaluation.registry import check_installed
from phase_ppl.evaluation.vlm.request import NoReply, Reply, Request, in_a_line
from phase_ppl.world.checks import number_or_nan
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name

SERVICES: Final = {"google": "google.genai", "openai": "openai"}  # name -> the module that it needs
MAX_REPLY: Final = 8 * 2**20  # largest answer that is read, bytes; a good one has a few thousand
LONGEST_WAIT: Final = 120.0  # seconds that a library waits before it makes a request again, at most

_FIRST_WAIT: Final = 4.0
"""Seconds, doubled every time: of Google's library, which does not heed Retry-After."""

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
_NO_KEY: Final = "none"
"""What is sent as the key to a server of one's own that asks for none."""

_SECRET_LENGTH: Final = 12
"""A shorter key, such as the "x" that a server of one's own is content with, is no secret, and
hiding it would spoil the answers."""

_VARIABLE: Final = re.compile(r"[A-Z_][A-Z0-9_]*")
_HEADERS: Final = {"Accept-Encoding": "identity"}  # an answer is as large as what is sent of it


@dataclasses.dataclass(frozen=True)
class Service:
    """A service that is asked over the network through its library."""

    name: str  # one of ``SERVICES``
    model: str  # as of the model ``vlm``; None leaves the last two to the service
    base_url: str
    # the environment variables that may hold the key, the first that does counts
    variables: tuple[str, ...]
    show: str
    timeout: float = 300.0
    temperature: float | None = None
    video_fps: float | None = None
    needs_key: bool = True  # whether it is an error if there is none

    def __call__(self, request: Request, retries: int = 0) -> Reply:
        """Return the answer to a request, made again by the library up to ``retries`` times."""
        guard = _Guard(self._key(), self.timeout)
        _ = request.video if self.show == "video" else request.pictures  # before the clock starts
        box: queue.SimpleQueue[Reply | Exception] = queue.SimpleQueue()

        def ask() -> None:
            through = _google if self.name == "google" else _openai
            try:
                box.put(through(self, request, retries, guard))
            except Exception as error:
                try:
                    box.put(self._failure(error, guard))
                except Exception as odd:  # what leaves a thread is printed, and all that it holds
                    box.put(NoReply(type(odd).__name__))

        # a call that is given up is left to itself, in a thread that does not keep Python from
        # ending: a server that sends a byte of its headers now and then keeps to all other limits
        threading.Thread(target=ask, daemon=True).start()
        longest = (retries + 1) * (self.timeout + LONGEST_WAIT)
        try:
            found = box.get(timeout=longest)
        except queue.Empty:
            found = NoReply(f"no complete answer within {longest:g} s")
        requests = max(1, guard.requests)
        if isinstance(found, Reply):
            parts = dataclasses.asdict(found) | {"requests": requests}
            return Reply(**{name: guard.without_key(value) for name, value in parts.items()})
        if isinstance(found, NoReply):
            found.requests = requests
        # raised here, where no exception that holds the request with its key hangs on to it
        raise found.with_traceback(None)

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

    def _failure(self, error: Exception, guard: _Guard) -> Exception:
        """Return an error of a library, or of what came, as one of ours."""
        status = getattr(error, "status_code", getattr(error, "code", None))  # openai's, Google's
        if isinstance(status, int):
            body = getattr(error, "body", getattr(error, "details", ""))
            return self._refused(status, body, guard)
        cause: Any = error.__cause__ or error
        if isinstance(cause, NoReply):
            return NoReply(guard.line(str(cause)), cause.again)
        kind, words = type(cause).__name__, str(cause)
        if hasattr(cause, "error_count"):  # pydantic's: its words have pieces of what was sent
            wrong = cause.errors(include_url=False, include_input=False, include_context=False)
            words = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in wrong)
        return NoReply(guard.line(words if kind in words else f"{kind}: {words}"), again=True)

    def _refused(self, status: int, body: Any, guard: _Guard) -> Exception:
        """Return the error for an answer of HTTP status 300 or more."""
        where = f"{self.base_url} answers HTTP {status}"
        # the words of such answers like to repeat part of the key
        if status in (401, 403) or "API_KEY_INVALID" in str(body):
            variables = " or ".join(self.variables) or "(none was sent)"
            return InvalidSettingError(f"{where}: the key in {variables} is refused")
        if isinstance(body, list) and len(body) == 1:
            body = body[0]
        for name in ("error", "message"):
            if isinstance(body, Mapping) and body.get(name):
                body = body[name]
        words = guard.line(str(body)) or "without a word"
        if status == 404:
            return InvalidSettingError(f"{where} to name={self.model!r}: {words}")
        return NoReply(f"HTTP {status}: {words}")  # the library has tried again where that helps


def _google(service: Service, request: Request, retries: int, guard: _Guard) -> Reply:
    from google import genai
    from google.genai import types

    options = types.HttpOptions(
        base_url=service.base_url,
        timeout=round(1000 * service.timeout),
        headers=_HEADERS,
        retry_options=types.HttpRetryOptions(
            attempts=retries + 1, initial_delay=_FIRST_WAIT, max_delay=LONGEST_WAIT
        ),
        client_args=guard.client_options(),
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
    with genai.Client(api_key=guard.key, vertexai=False, http_options=options) as client:
        found = client.models.generate_content(model=service.model, contents=parts, config=config)
    usage = found.usage_metadata
    candidate = found.candidates[0] if found.candidates else None
    if candidate is None and not found.prompt_feedback:
        raise NoReply("the service sent no candidates", again=True)
    reason = candidate.finish_reason if candidate else found.prompt_feedback.block_reason
    finish = None if reason is None else str(getattr(reason, "value", reason))
    # what it thought is paid for too, also where it thought until the limit
    counts = (usage.candidates_token_count, usage.thoughts_token_count) if usage else ()
    written = [count for count in counts if count is not None]
    return Reply(
        text=found.text or "",
        finish=finish if candidate else f"blocked: {finish}",
        model=found.model_version,
        tokens_in=usage.prompt_token_count if usage else None,
        tokens_out=sum(written) if written else None,
    )


def _openai(service: Service, request: Request, retries: int, guard: _Guard) -> Reply:
    import openai

    chosen = {} if service.temperature is None else {"temperature": service.temperature}
    with openai.OpenAI(
        api_key=guard.key,
        base_url=service.base_url,
        timeout=service.timeout,
        max_retries=retries,
        default_headers=_HEADERS,
        http_client=openai.DefaultHttpxClient(**guard.client_options()),
    ) as client:
        found = client.chat.completions.create(
            model=service.model,
            messages=[{"role": "user", "content": list(_openai_parts(request))}],
            stream=False,
            response_format={"type": "json_object"},
            **chosen,
        )
    # the library hands on, unchecked, whatever else a server sends
    choices = getattr(found, "choices", None)
    choice: Any = choices[0] if isinstance(choices, list) and choices else None
    if not hasattr(choice, "message"):
        what = "text that is no chat completion" if isinstance(found, str) else "no choices"
        error = getattr(found, "error", None)  # some servers send one with status 200
        beside = f", but {error}" if error else ""
        raise NoReply(f"the service sent {what}{beside}", again=True)
    said, usage = choice.message, getattr(found, "usage", None)
    refusal = getattr(said, "refusal", None)
    content = getattr(said, "content", None)
    return Reply(
        text="" if content is None else content,
        finish=f"refusal: {refusal}" if refusal else getattr(choice, "finish_reason", None),
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


class _Guard:
    """Sees what a library's HTTP client (httpx or httpx2) sends and gets before the library does.

    It hides the key in what comes back, and keeps the time from a request to the end of its answer:
    the libraries' own limits are for each piece of an answer, and a server that sends a byte now
    and then keeps to them.
    """

    def __init__(self, key: str, timeout: float) -> None:
        self.key, self.requests = key, 0
        self._secret = len(key) >= _SECRET_LENGTH
        self._timeout, self._end = timeout, 0.0
        self._refusal: NoReply | None = None

    def client_options(self) -> dict[str, Any]:
        hooks = {"request": [self._sent], "response": [self._answered]}
        return {"follow_redirects": False, "event_hooks": hooks}

    def without_key(self, given: Any) -> Any:
        """Return ``given``, a text with the key hidden."""
        hidden = self._secret and isinstance(given, str)
        return given.replace(self.key, "[key]") if hidden else given

    def line(self, words: str) -> str:
        """Return what an answer says, or its beginning, in one line."""
        # hidden before the cut, which could leave half of it
        return in_a_line(self.without_key(words))

    def _sent(self, request: Any) -> None:
        if self._refusal is not None:  # by a library that tries again after whatever was raised
            raise self._refusal
        self.requests += 1
        self._end = time.monotonic() + self._timeout

    def _answered(self, response: Any) -> None:
        """Take the answer in, and give the library what was taken."""
        if response.headers.get("content-encoding", "identity").lower() != "identity":
            raise self._refused("the answer is compressed, which was not asked for")
        content = bytearray()
        stream = response.stream
        for piece in stream:
            content += piece
            if len(content) > MAX_REPLY:
                most = MAX_REPLY // 2**20
                raise self._refused(f"the answer is larger than the {most} MB that are read")
            if time.monotonic() > self._end:
                raise NoReply(f"no complete answer within {self._timeout:g} s", again=True)
        stream.close()
        if self._secret:  # libraries write what they get into logs
            content = content.replace(self.key.encode(), b"[key]")
        library = importlib.import_module(type(response).__module__.partition(".")[0])
        response.stream = library.ByteStream(bytes(content))

    def _refused(self, words: str) -> NoReply:
        self._refusal = NoReply(words)
        return self._refusal


# --- settings -------------------------------------------------------------------------------------


def make_service(
    name: object, model: str | None, show: str | None, given: Mapping[str, Any], to_be_asked: bool
) -> Service:
    """Return a service, ready to be asked."""
    if not isinstance(name, str) or name not in SERVICES:
        raise unknown_name("client", name, SERVICES)
    settings: dict[str, Any] = dict(_USUAL[name])
    for option, most in _MOST.items():
        if option in given:
            settings[option] = _number(option, given[option], most)
    if name == "openai" and show == "video":
        raise InvalidSettingError("show='video', but OpenAI's API takes pictures only")
    if "video_fps" in given and (name != "google" or show == "pictures"):
        raise InvalidSettingError("video_fps is for the video that Google gets")
    named = {"model": model, "show": show}
    settings |= {option: value for option, value in named.items() if value is not None}
    if "model" not in settings:
        raise InvalidSettingError("client 'openai' needs name=, what the service calls the model")
    if to_be_asked:
        check_installed(f"client {name!r}", [SERVICES[name]], "vlm")
    if "key_env" in given:
        settings["variables"] = (_variable(given["key_env"]),)
    if "base_url" in given:
        settings["base_url"] = address = _address(given["base_url"])
        settings["needs_key"] = needs_key = "key_env" in given
        if to_be_asked and _is_open(address):
            words = (
                f"base_url={shown(address)}: plain http:// to another machine; whoever is between"
            )
            if needs_key:
                raise InvalidSettingError(
                    f"{words} could read the key: use https://, or a tunnel to localhost"
                )
            settings["variables"] = ()
            warnings.warn(f"{words} can read and change everything; no key is sent", stacklevel=2)
    return Service(name, **settings)


def _number(name: str, value: object, most: float) -> float:
    number = number_or_nan(value)
    if 0 < number <= most or (number == 0 and name == "temperature"):
        return number
    least = ">= 0" if name == "temperature" else "> 0"
    raise InvalidSettingError(f"{name}={shown(value)}, expected a number {least} and <= {most:g}")


def _variable(given: object) -> str:
    if not isinstance(given, str) or _VARIABLE.fullmatch(given) is None:
        raise InvalidSettingError(  # not showing what may be a key
            "key_env is the name of the environment variable that holds the key, such as "
            "OPENAI_API_KEY (capitals, digits, _); what was given is none"
        )
    return given


def _address(given: object) -> str:
    """Return an address without a part that could be a secret: settings are written into files."""
    text = given if isinstance(given, str) else ""
    try:
        parts = urllib.parse.urlsplit(text)
        host, secret = parts.hostname, parts.username or parts.password or parts.query
    except ValueError:
        host, secret = None, None
    if secret:
        raise InvalidSettingError(
            "base_url has a user name, a password or a query; it must be an address alone"
        )
    if not host or not text.startswith(("http://", "https://")):
        raise InvalidSettingError(f"base_url={shown(given)}, expected an address (https://...)")
    return text


def _is_open(address: str) -> bool:
    """Whether what is sent there can be read on its way: by http, to another machine."""
    parts = urllib.parse.urlsplit(address)
    host = parts.hostname or ""
    try:
        here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        here = host == "localhost"
    return parts.scheme == "http" and not here
