"""The server of a study: identity of visitors, refusals, and routes over store and plan."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sqlite3
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import phase_ppl as ppl
from phase_study import plan
from phase_study.clips import clips_of
from phase_study.settings import Settings
from phase_study.store import Participant, Refused, Store

STATIC: Final = Path(__file__).parent / "static"
MOST_BODY: Final = 64 * 1024
MOST_MESSAGE: Final = 4 * 1024
"""Most bytes of a request's body, and of a socket's message."""

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

_MONTH: Final = 30 * 24 * 3600
_NOTES: Final = frozenset(
    ("resume", "hidden", "blur", "video error", "autoplay refused", "retry", "device refused")
)
_TIMES: Final = ("rt_ms", "shown_ms", "plays", "first_end_ms")
_MOST_TIME: Final = 1e13

P = ParamSpec("P")
T = TypeVar("T")


class Rates:
    """How often what may happen."""

    def __init__(self) -> None:
        self._buckets: dict[str, tuple[float, float]] = {}

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


class Site(Rates):
    """A study that is being served; ``secure``: over TLS, so that cookies are for TLS only."""

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        events: Mapping[str, ppl.Event],
        secure: bool = False,
    ) -> None:
        super().__init__()
        self.folder, self.settings, self.events, self.secure = folder, settings, events, secure
        self._thread = ThreadPoolExecutor(1, "store")
        self.opening: list[Callable[[], Awaitable[None]]] = []
        self.closing: list[Callable[[], Awaitable[None]]] = []
        self.store: Store
        self.cookie = ""

    async def open(self) -> None:
        """Open the store, in the only thread that uses it."""

        def begin() -> None:
            self.store = Store(self.folder / "study.db")
            self.store.use_settings(self.settings)
            # all ports of a machine share cookies
            self.cookie = f"study_{self.store.fact('id')}"

        await asyncio.get_running_loop().run_in_executor(self._thread, begin)
        for what in self.opening:
            await what()

    async def close(self) -> None:
        """Write what is pending, and close the store."""
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

    async def answer(
        self, who: str, page: str, answers: Mapping[str, Any], attempt: int = 1, **more: Any
    ) -> bool:
        """Store an answer, as :meth:`Store.answer` does, and how the study ends with it."""
        return await self.ask(
            self.store.answer, who, page, attempt, answers,
            outcome=lambda participant: plan.outcome(self.settings, participant), **more,
        )  # fmt: skip

    async def visitor(self, connection: HTTPConnection) -> Participant | None:
        """Return the participant of a request's or socket's cookie; None: nobody's."""
        token = connection.cookies.get(self.cookie, "")
        return await self.ask(self.store.by_token, token) if token else None

    async def participant(self, connection: HTTPConnection) -> Participant:
        """Return the participant of a request's or socket's cookie (HTTPException 401: none)."""
        found = await self.visitor(connection)
        if found is None:
            raise HTTPException(401, "you are not known here; please open the study's address anew")
        return found


def same_origin(connection: HTTPConnection) -> bool:
    """Whether the request comes from a page of the study: its Origin is that of the Host."""
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
    """Adds :data:`HEADERS` to every response that does not set them itself."""

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


def create_app(site: Site, names: Sequence[str] = (), more: Sequence[BaseRoute] = ()) -> Starlette:
    """Return the application of a study, which accepts ``names`` beside those of this machine.

    ``more`` are routes beside those of the pages.
    """

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        await site.open()
        yield
        await site.close()

    pages = Pages(site)
    routes: list[BaseRoute] = [
        Route("/", pages.start),
        Route("/api/state", pages.state),
        Route("/api/enter", pages.enter, methods=["POST"]),
        Route("/api/answer", pages.answer, methods=["POST"]),
        Route("/api/note", pages.note, methods=["POST"]),
        Route("/video/{name}.mp4", pages.video),
        Route("/clip/{name}.mp4", pages.clip),
    ]
    app = application([*routes, *more], lifespan, names)
    app.state.site, app.state.opening = site, site.opening
    return app


def application(
    routes: Sequence[BaseRoute], lifespan: Callable[[Starlette], Any], names: Sequence[str] = ()
) -> Starlette:
    """Return an application with :data:`STATIC`, which answers to this machine's names and more."""
    hosts = ["localhost", "127.0.0.1", "[::1]", "::1", *names]
    return Starlette(
        routes=[*routes, Mount("/static", StaticFiles(directory=STATIC))],
        lifespan=lifespan,
        middleware=[
            Middleware(SafeHeaders),
            Middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False),
        ],
        exception_handlers={HTTPException: _refusal},
    )


async def _refusal(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code)


class Pages:
    """The handlers of browsers' requests."""

    def __init__(self, site: Site) -> None:
        self.site = site

    async def start(self, request: Request) -> Response:
        """The only page; its script asks for the state."""
        return FileResponse(STATIC / "study.html", media_type="text/html; charset=utf-8")

    async def state(self, request: Request) -> Response:
        """How far a participant is, and the next pages."""
        site, settings = self.site, self.site.settings
        who = await site.visitor(request)
        if who is None:
            new = {"status": "new", "repeats": settings.refuse_repeats}
            return JSONResponse(new if settings.open else self._over("closed", None))
        who = await self._now(who)
        if who.outcome is not None:
            return JSONResponse(self._over(who.outcome, who))
        pages = [plan.described(settings, who, *page) for page in plan.next_pages(settings, who)]
        n_trials = len(who.trials) if who.trials is not None else settings.trials
        total = 3 + bool(settings.quiz) + n_trials + settings.demographics
        found = {"status": "open", "participant": who.id, "title": settings.title, "pages": pages,
                 "done": len(who.passed), "total": total}  # fmt: skip
        return JSONResponse(found)

    async def _now(self, who: Participant) -> Participant:
        """Return a participant after pending changes: an end for lateness, or drawn videos."""
        site, settings = self.site, self.site.settings
        if who.outcome is not None:
            return who
        # a crash may have come between an answer and its consequences
        ended = plan.outcome(settings, who)
        if ended is None and self._is_late(who):
            ended = "expired"
        if ended is not None:
            await site.ask(site.store.end, who.id, ended)
        elif settings.kind != "play" and who.trials is None and plan.is_prepared(settings, who):
            await site.ask(site.store.assign, who.id, settings)
        else:
            return who
        return await site.ask(site.store.participant, who.id)

    def _over(self, outcome: str, who: Participant | None) -> dict[str, Any]:
        settings = self.site.settings
        code = settings.codes.get(outcome, "")
        number = "" if who is None else who.id
        text = settings.texts.get(outcome, settings.texts["finished"])
        found = {"status": "over", "outcome": outcome, "title": settings.title, "code": code,
                 "html": plan.html(text.replace("{participant}", number))}  # fmt: skip
        if settings.return_url and code:
            found["return_url"] = settings.return_url.replace("{code}", code)
        return found

    async def enter(self, request: Request) -> Response:
        """Admit somebody, and set a cookie."""
        site, settings = self.site, self.site.settings
        given = await posted(request)
        if await site.visitor(request) is not None:
            return JSONResponse({"entered": True})
        if not settings.open:
            return JSONResponse(self._over("closed", None))
        person = given.get("person", "")
        if not isinstance(person, str) or len(person) > 200:
            raise HTTPException(400, "person: expected text")
        try:
            person = person if settings.refuse_repeats else ""
            _, token = await site.ask(site.store.enter, settings, person)
        except Refused as reason:
            if str(reason) == "busy":
                raise HTTPException(503, "many people come at once; please wait a moment") from None
            return JSONResponse(self._over(str(reason), None))
        answer = JSONResponse({"entered": True})
        answer.set_cookie(
            site.cookie, token, max_age=_MONTH, httponly=True, samesite="strict", secure=site.secure
        )
        return answer

    async def answer(self, request: Request) -> Response:
        """Store the answers to a page; a repeated upload changes nothing."""
        site, settings = self.site, self.site.settings
        given = await posted(request)
        who = await site.participant(request)
        if not site.allow(f"answer {who.id}", 5, 5):
            raise HTTPException(429, "too many answers at once")
        if given.get("participant", who.id) != who.id:
            raise HTTPException(409, "this is an answer of somebody else")
        page, attempt, answers = (given.get(name) for name in ("page", "attempt", "answers"))
        if not (isinstance(page, str) and type(attempt) is int and isinstance(answers, dict)):
            raise HTTPException(400, "expected page, attempt and answers")
        if self._is_late(who):  # late answers are kept, but the study does not go on
            who = await self._now(who)
        if any((page, attempt) == (a.page, a.attempt) for a in who.answers):
            return JSONResponse({"saved": True, "new": False, "next": self._next(who)})
        allowed = plan.next_pages(settings, who)
        by_server = page == "practice" or page.startswith("session-")
        if (page, attempt) not in allowed or by_server or who.outcome not in (None, "expired"):
            raise HTTPException(409, f"there is no page {page[:40]!r} to be answered")
        times = {name: given.get(name) for name in _TIMES}
        for name, value in times.items():
            if value is not None and not plan.is_number(value, _MOST_TIME):
                raise HTTPException(400, f"{name}: expected milliseconds, or how often")
        try:
            cleaned, correct = plan.checked(settings, page, answers)
        except plan.Unfit as error:
            raise HTTPException(400, str(error)) from None
        new = await site.answer(who.id, page, cleaned, attempt, correct=correct, times=times)
        who = await site.ask(site.store.participant, who.id)
        return JSONResponse({"saved": True, "new": new, "next": self._next(who)})

    def _is_late(self, who: Participant) -> bool:
        return time.time() - who.seen > 60 * self.site.settings.resume_within

    def _next(self, who: Participant) -> str | None:
        """Return the next page, by which a second tab notices that it is behind."""
        if who.outcome is not None:
            return None
        pages = plan.next_pages(self.site.settings, who)
        return "-".join(map(str, pages[0])) if pages else None

    async def note(self, request: Request) -> Response:
        """Store a note on events beside the answers."""
        given = await posted(request)
        who = await self.site.participant(request)
        what, page, detail = (given.get(name) for name in ("what", "page", "detail"))
        fits = isinstance(detail, int | float | None) and isinstance(page, str | None)
        if not isinstance(what, str) or what not in _NOTES or not fits or len(page or "") > 40:
            raise HTTPException(400, "no such note")
        if self.site.allow(f"note {who.id}", 2, 20):
            await self.site.ask(self.site.store.note, who.id, what, page, detail)
        return JSONResponse({"saved": True})

    async def video(self, request: Request) -> Response:
        """A film, for the participant to whom it was assigned."""
        who = await self.site.participant(request)
        name = request.path_params["name"]
        file = await self.site.ask(self.site.store.video, who.id, name)
        if file is None:
            raise HTTPException(404, "there is no such film")
        return FileResponse(self.site.folder / "videos" / file, media_type="video/mp4")

    async def clip(self, request: Request) -> Response:
        """A film of the introduction."""
        name = request.path_params["name"]
        if name not in clips_of(self.site.settings.world):
            raise HTTPException(404, "there is no such film")
        return FileResponse(self.site.folder / "clips" / f"{name}.mp4", media_type="video/mp4")
