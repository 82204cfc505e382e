"""The services that can be asked, by one POST of JSON each: Google's and OpenAI's.

A key is read from the environment when a request is made, and is hidden in whatever comes back. No
redirection is followed, which would take the request along; an answer has a largest size and a
latest moment.
"""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import http.client
import ipaddress
import json
import os
import re
import time
import urllib.parse
import warnings
from collections.abc import Mapping
from typing import Any, Final

from phase_ppl.models.vlm.request import NoReply, Reply, Request, in_a_line
from phase_ppl.world.errors import InvalidSettingError, check_name, number_or_nan, shown

MAX_REPLY: Final = 8 * 2**20  # largest answer that is read, bytes; a good one has a few thousand

SERVICES: Final[Mapping[str, Mapping[str, Any]]] = {
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
"""Name of a service -> its usual settings."""

_MOST: Final = {"timeout": 86_400.0, "temperature": 2.0, "video_fps": 24.0}
_NO_KEY: Final = "none"  # sent as the key to a server of one's own that asks for none
_SECRET_LENGTH: Final = 12
"""A shorter key, such as the "x" that a server of one's own is content with, is no secret, and
hiding it would spoil the answers."""


@dataclasses.dataclass(frozen=True)
class Service:
    """A service that is asked over the network."""

    name: str  # one of ``SERVICES``
    model: str  # as of the model ``vlm``; None leaves the last two to the service
    base_url: str
    # the environment variables that may hold the key, the first that does counts
    variables: tuple[str, ...]
    show: str
    timeout: float = 300.0  # seconds for a whole answer
    temperature: float | None = None
    video_fps: float | None = None
    needs_key: bool = True  # whether it is an error if there is none

    def __call__(self, request: Request) -> Reply:
        """Return the answer to a request, which is made once."""
        key, ask = self._key(), _google if self.name == "google" else _openai
        path, headers, body, read = ask(self, request, key)
        try:
            status, content, wait = self._answer(path, headers, body)
        except (OSError, http.client.HTTPException) as error:
            words = in_a_line(f"{type(error).__name__}: {getattr(error, 'reason', error)}")
            raise NoReply(words, again=True) from None
        if len(key) >= _SECRET_LENGTH:
            content = content.replace(key.encode(), b"[key]")
        if status != 200:
            raise self._failure(status, content.decode(errors="replace"), wait)
        with contextlib.suppress(ValueError, RecursionError):
            found = json.loads(content)
            if isinstance(found, dict):
                return read(found)
        raise NoReply(f"{self.base_url} sends no JSON object", again=True)

    def _answer(
        self, path: str, headers: Mapping[str, str], body: Mapping[str, Any]
    ) -> tuple[int, bytes, float]:
        """Return status and content of an answer, and for how long it asks to wait, seconds."""
        import urllib.error
        import urllib.request

        class Stays(urllib.request.HTTPRedirectHandler):
            def redirect_request(self, *given: Any) -> None:
                return None

        asked = urllib.request.Request(
            f"{self.base_url.rstrip('/')}/{path}",
            json.dumps(body).encode(),
            {"Content-Type": "application/json", **headers},
        )
        end, content = time.monotonic() + self.timeout, bytearray()
        try:
            answer = urllib.request.build_opener(Stays).open(asked, timeout=self.timeout)
        except urllib.error.HTTPError as error:
            answer = error
        with answer:
            while piece := answer.read1(2**16):
                content += piece
                if len(content) > MAX_REPLY:
                    most = MAX_REPLY // 2**20
                    raise NoReply(f"the answer is larger than the {most} MB that are read")
                if time.monotonic() > end:
                    raise TimeoutError(f"no complete answer within {self.timeout:g} s")
        wait = answer.headers.get("retry-after", "")
        return answer.status, bytes(content), float(wait) if wait.isdecimal() else 0.0

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

    def _failure(self, status: int, words: str, wait: float) -> NoReply | InvalidSettingError:
        """Return an answer that is none as an error of ours."""
        where = f"{self.base_url} answers HTTP {status}"
        # the words of such answers like to repeat part of the key
        if status in (401, 403) or "API_KEY_INVALID" in words:
            variables = " or ".join(self.variables) or "(none was sent)"
            return InvalidSettingError(f"{where}: the key in {variables} is refused")
        with contextlib.suppress(ValueError, KeyError, TypeError):
            words = str(json.loads(words)["error"]["message"])
        if status == 404:
            return InvalidSettingError(f"{where} to name={self.model!r}: {in_a_line(words)}")
        again = status in (408, 409, 429) or status >= 500
        return NoReply(f"HTTP {status}: {in_a_line(words)}", again, wait)


def _at(found: Any, *path: str | int) -> Any:
    """Return a part of an answer; None where it is not there, or the whole is of another form."""
    for step in path:
        try:
            found = found[step]
        except (KeyError, IndexError, TypeError):
            return None
    return found


def _google(service: Service, request: Request, key: str) -> tuple[Any, ...]:
    """Return path, headers and body of what Google is asked, and what reads the answer."""
    parts: list[dict[str, Any]] = []
    if service.show == "video":
        parts.append(_inline("video/mp4", request.video))
        if service.video_fps:
            parts[0]["videoMetadata"] = {"fps": service.video_fps}
    else:
        for picture in request.pictures:
            parts += [{"text": f"{picture.seconds:g} s"}, _inline("image/png", picture.png)]
    config: dict[str, Any] = {"responseMimeType": "application/json"}
    if service.temperature is not None:
        config |= {"temperature": service.temperature}
    body = {
        "contents": [{"role": "user", "parts": [*parts, {"text": request.prompt}]}],
        "generationConfig": config,
    }
    path = f"v1beta/models/{urllib.parse.quote(service.model)}:generateContent"
    return path, {"x-goog-api-key": key}, body, _from_google


def _inline(kind: str, content: bytes) -> dict[str, Any]:
    return {"inlineData": {"mimeType": kind, "data": base64.b64encode(content).decode()}}


def _from_google(found: dict[str, Any]) -> Reply:
    said = _at(found, "candidates", 0, "content", "parts")
    texts = [_at(part, "text") for part in said or () if not _at(part, "thought")]
    finish = _at(found, "candidates", 0, "finishReason")
    if blocked := _at(found, "promptFeedback", "blockReason"):
        finish = f"blocked: {blocked}"
    # what it thought is paid for too, also where it thought until the limit
    counts = (
        _at(found, "usageMetadata", f"{name}TokenCount") for name in ("candidates", "thoughts")
    )
    written = [count for count in counts if isinstance(count, int)]
    return Reply(
        text="".join(text for text in texts if isinstance(text, str)),
        finish=finish,
        model=found.get("modelVersion"),
        tokens_in=_at(found, "usageMetadata", "promptTokenCount"),
        tokens_out=sum(written) if written else None,
    )


def _openai(service: Service, request: Request, key: str) -> tuple[Any, ...]:
    """Return path, headers and body of what OpenAI is asked, and what reads the answer."""
    parts: list[dict[str, Any]] = []
    for picture in request.pictures:
        url = f"data:image/png;base64,{base64.b64encode(picture.png).decode()}"
        parts.append({"type": "text", "text": f"{picture.seconds:g} s"})
        parts.append({"type": "image_url", "image_url": {"url": url}})
    parts.append({"type": "text", "text": request.prompt})
    body: dict[str, Any] = {
        "model": service.model,
        "messages": [{"role": "user", "content": parts}],
        "response_format": {"type": "json_object"},
    }
    if service.temperature is not None:
        body["temperature"] = service.temperature
    return "chat/completions", {"Authorization": f"Bearer {key}"}, body, _from_openai


def _from_openai(found: dict[str, Any]) -> Reply:
    said = _at(found, "choices", 0, "message")
    content, refusal = _at(said, "content"), _at(said, "refusal")
    finish = f"refusal: {refusal}" if refusal else _at(found, "choices", 0, "finish_reason")
    return Reply(
        text="" if content is None else str(content),
        finish=finish or found.get("error"),  # some servers send one with status 200
        model=found.get("model"),
        tokens_in=_at(found, "usage", "prompt_tokens"),
        tokens_out=_at(found, "usage", "completion_tokens"),
    )


# --- settings -------------------------------------------------------------------------------------


def make_service(
    name: str, model: str | None, show: str | None, given: Mapping[str, Any], to_be_asked: bool
) -> Service:
    """Return a service, ready to be asked."""
    check_name("client", name, SERVICES)
    settings: dict[str, Any] = dict(SERVICES[name])
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
    """Whether what is sent to an address can be read on its way: by http, to another machine.

    No part of it may be a secret: settings are written into files.
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
