"""What the clients of services have in common: keys, time limits, and failures in one line.

A key is read from the environment when a request is made and handed to the service's library,
nowhere else. Whatever comes back, errors too, is searched for it before anybody gets to see it.
"""

from __future__ import annotations

import abc
import dataclasses
import datetime
import email.utils
import os
import queue
import re
import threading
import urllib.parse
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

from phase_ppl.evaluation.vlm.request import NoReply, Reply, Request, in_a_line
from phase_ppl.world.errors import InvalidSettingError, shown

_HIDDEN: Final = "[key]"
_NO_KEY: Final = "none"
"""What is sent as the key to a server of one's own that asks for none."""

_SECRET_LENGTH: Final = 12
"""A shorter key, such as the "x" that a server of one's own is content with, is no secret, and
hiding it would spoil the answers."""

_VARIABLE: Final = re.compile(r"[A-Z_][A-Z0-9_]*")
_PASSING: Final = (408, 409, 425, 429)
"""Failures, beside 5xx, after which the same request may succeed."""


@dataclasses.dataclass(frozen=True)
class Service(abc.ABC):
    """A service that is asked over the network through its library.

    Attributes:
        model: as the service calls it.
        base_url: address of the service.
        variables: the environment variables that may hold the key, the first that does counts.
        show: "video" or "pictures".
        timeout: seconds from the request to the end of the answer.
        temperature: None leaves it to the service, as for the paper.
        video_fps: frames per second of a video that the service is to look at; None leaves it
            to the service.
        needs_key: whether it is an error if there is none.
    """

    name: ClassVar[str]

    model: str
    base_url: str
    variables: tuple[str, ...]
    show: str
    timeout: float
    temperature: float | None = None
    video_fps: float | None = None
    needs_key: bool = True

    def __call__(self, request: Request) -> Reply:
        """Return the answer to a request.

        Raises:
            NoReply: none came; its ``again`` says whether to try again.
            InvalidSettingError: there is no key, it is refused, or there is no such model.
        """
        key = self._key()
        # drawn before the clock starts
        _ = request.video if self.show == "video" else request.pictures
        found = within(self.timeout, lambda: self._reply_or_error(request, key))
        if isinstance(found, Reply):
            parts = dataclasses.asdict(found)
            return Reply(**{name: _without(key, value) for name, value in parts.items()})
        # raised here, where no exception that holds the request with its key hangs on to it
        raise found.with_traceback(None)

    def named(self) -> dict[str, Any]:
        """Return what determines the answers, as plain data."""
        fields = ("model", "base_url", "show", "temperature", "video_fps")
        return {"client": self.name, **{field: getattr(self, field) for field in fields}}

    @abc.abstractmethod
    def _ask(self, request: Request, key: str) -> Reply:
        """Ask by the service's library, which is not to try again by itself."""

    @abc.abstractmethod
    def _error(self, error: Exception, key: str) -> Exception:
        """Return an error of the library as one of ours."""

    def _reply_or_error(self, request: Request, key: str) -> Reply | Exception:
        try:
            return self._ask(request, key)
        except NoReply as error:
            return NoReply(_excerpt(str(error), key), error.again, error.wait)
        except Exception as error:
            # nothing may leave the thread, which would print it, and all that it holds
            try:
                return self._error(error, key)
            except Exception as odd:
                return self._broken(odd, key)

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

    def _refused(
        self, status: int, body: object, headers: Mapping[str, str], key: str
    ) -> Exception:
        """Return the error for an answer of HTTP status 300 or more."""
        where = f"{self.base_url} answers HTTP {status}"
        if status in (401, 403):  # such answers like to repeat part of the key
            variables = " or ".join(self.variables)
            return InvalidSettingError(f"{where}: the key in {variables} is refused")
        words = _excerpt(body, key)
        if status == 404:
            return InvalidSettingError(f"{where} to name={self.model!r}: {words}")
        passing = status in _PASSING or status >= 500
        wait = seconds_to_wait(headers) if passing else None
        return NoReply(f"HTTP {status}: {words}", again=passing, wait=wait)

    def _broken(self, error: Exception, key: str) -> Exception:
        """Return the error for a connection that broke, or an answer that is none."""
        kind = type(error).__name__
        words = _excerpt(str(error) or kind, key)
        return NoReply(words if kind in words else f"{kind}: {words}", again=True)


def within(seconds: float, call: Callable[[], Reply | Exception]) -> Reply | Exception:
    """Return what ``call`` returns if it does so in time, else a failure that may pass.

    The libraries' own limits are for each piece of an answer, and a server that sends a byte now
    and then can keep them waiting for ever. A call that is given up is left to itself, in a
    thread that does not keep Python from ending.
    """
    box: queue.SimpleQueue[Reply | Exception] = queue.SimpleQueue()
    threading.Thread(target=lambda: box.put(call()), daemon=True).start()
    try:
        return box.get(timeout=seconds)
    except queue.Empty:
        return NoReply(f"no complete answer within {seconds:g} s", again=True)


def seconds_to_wait(headers: Mapping[str, str]) -> float | None:
    """Return how long the header Retry-After asks to wait, in seconds or until a date."""
    given = headers.get("retry-after", "").strip()
    if re.fullmatch(r"\d{1,9}(\.\d+)?", given):
        return float(given)
    try:
        moment = email.utils.parsedate_to_datetime(given)
    except (ValueError, OverflowError):
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    return max(0.0, (moment - datetime.datetime.now(datetime.UTC)).total_seconds())


def checked_address(given: object) -> str:
    """Return the address of a service.

    Raises:
        InvalidSettingError: it is none, or has a part that could be a secret; settings are
            written into files.
    """
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


def checked_variable(given: object) -> str:
    """Return the name of an environment variable.

    Raises:
        InvalidSettingError: it is none; the message does not show it, since it may be a key.
    """
    if not isinstance(given, str) or _VARIABLE.fullmatch(given) is None:
        raise InvalidSettingError(
            "key_env is the name of the environment variable that holds the key, such as "
            "OPENAI_API_KEY (capitals, digits, _); what was given is none"
        )
    return given


def _without(key: str, given: Any) -> Any:
    """Return ``given``, a text with the key hidden."""
    if isinstance(given, str) and len(key) >= _SECRET_LENGTH:
        return given.replace(key, _HIDDEN)
    return given


def _excerpt(body: object, key: str) -> str:
    """Return what an answer says, or its beginning, in one line and without the key."""
    if isinstance(body, list) and len(body) == 1:
        body = body[0]
    for name in ("error", "message"):
        if isinstance(body, Mapping) and body.get(name):
            body = body[name]
    # hidden before the cut, which could leave half of it
    return in_a_line(_without(key, str(body))) or "without a word"
