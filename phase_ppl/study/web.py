"""What all pages and sockets of a study's server share: who asks, and what is refused."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import sys
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from phase_ppl.study.settings import Settings
from phase_ppl.study.store import Participant, Store
from phase_ppl.world.event import Event

MOST_BODY: Final = 64 * 1024
MOST_MESSAGE: Final = 4 * 1024
"""Bytes of a request's body, and of a message of a socket."""

HEADERS: Final = {
    # jsPsych sets style attributes; preloaded videos are blobs
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; "
    "media-src 'self' blob:; img-src 'self' data:; object-src 'none'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}

P = ParamSpec("P")
T = TypeVar("T")


class Site:
    """A study that is being served; ``secure``: by TLS, so that cookies are for TLS only."""

    def __init__(
        self, folder: Path, settings: Settings, events: Mapping[str, Event], secure: bool = False
    ) -> None:
        self.folder, self.settings, self.events, self.secure = folder, settings, events, secure
        self._thread = ThreadPoolExecutor(1, "store")
        self._buckets: dict[str, tuple[float, float]] = {}
        self.opening: list[Callable[[], Awaitable[None]]] = []
        self.closing: list[Callable[[], Awaitable[None]]] = []
        self.store: Store
        self.cookie = ""

    async def open(self) -> None:
        """Open the store, in the one thread that uses it."""

        def begin() -> None:
            self.store = Store(self.folder / "study.db")
            self.store.use_settings(self.settings.sha256, self.settings.text)
            # cookies are shared by all ports of a machine
            self.cookie = f"study_{self.store.fact('id')}"

        await asyncio.get_running_loop().run_in_executor(self._thread, begin)
        for what in self.opening:
            await what()

    async def close(self) -> None:
        """Write what is to be written, and close the store."""
        for what in self.closing:
            await what()
        await asyncio.get_running_loop().run_in_executor(self._thread, lambda: self.store.close())
        self._thread.shutdown()

    async def ask(self, method: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a method of the store in its thread, as in ``site.ask(store.end, who, "left")``."""
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(self._thread, lambda: method(*args, **kwargs))
        except sqlite3.OperationalError as error:
            print(f"phase-ppl: the study cannot be saved: {error}", file=sys.stderr)
            raise HTTPException(503, "answers cannot be saved at the moment") from None

    async def visitor(self, connection: HTTPConnection) -> Participant | None:
        """Return whose cookie comes with a request or a socket; None: nobody's."""
        token = connection.cookies.get(self.cookie, "")
        return await self.ask(self.store.by_token, token) if token else None

    async def participant(self, connection: HTTPConnection) -> Participant:
        """Return whose cookie comes with a request or a socket (HTTPException 401: nobody's)."""
        found = await self.visitor(connection)
        if found is None:
            raise HTTPException(401, "you are not known here; please open the study's address anew")
        return found

    def allow(self, what: str, rate: float, burst: float) -> bool:
        """Return whether ``what`` may happen: ``rate`` times a second, ``burst`` at once."""
        now = time.monotonic()
        left, before = self._buckets.pop(what, (burst, now))
        left = min(burst, left + (now - before) * rate)
        allowed = left >= 1
        self._buckets[what] = left - allowed, now
        if len(self._buckets) > 10_000:
            del self._buckets[next(iter(self._buckets))]
        return allowed


def same_origin(connection: HTTPConnection) -> bool:
    """Whether a page of the study asks: the Origin that browsers send is that of the Host."""
    origin = connection.headers.get("origin", "")
    return bool(origin) and urlsplit(origin).netloc == connection.headers.get("host")


async def posted(request: Request) -> dict[str, Any]:
    """Return the JSON object that a page of the study sent."""
    if not same_origin(request):
        raise HTTPException(403, "this does not come from a page of the study")
    if request.headers.get("content-type", "").split(";")[0] != "application/json":
        raise HTTPException(415, "expected application/json")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY:
            raise HTTPException(413, f"larger than {MOST_BODY // 1024} kB")
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise HTTPException(400, "expected a JSON object")
    return found


class SafeHeaders:
    """Puts :data:`HEADERS` onto every answer that does not say otherwise."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, with_headers if scope["type"] == "http" else send)


def hosts(*addresses: str) -> Sequence[str]:
    """Return the names by which a study may be reached, beside those of this machine."""
    return [*dict.fromkeys(("localhost", "127.0.0.1", "[::1]", "::1", *addresses))]
