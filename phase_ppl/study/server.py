"""The server of a study: starlette routes over the store and the plan."""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from phase_ppl.study import plan
from phase_ppl.study.clips import CLIPS
from phase_ppl.study.store import Participant, Refused
from phase_ppl.study.web import SafeHeaders, Site, hosts, posted

STATIC: Final = Path(__file__).parent / "static"
_MONTH: Final = 30 * 24 * 3600
_NOTES: Final = frozenset(
    ("resume", "hidden", "blur", "video error", "autoplay refused", "retry", "device refused")
)
_TIMES: Final = ("rt_ms", "shown_ms", "plays", "first_end_ms")
_MOST_TIME: Final = 1e13


def create_app(site: Site, names: tuple[str, ...] = ()) -> Starlette:
    """Return the application of a study."""

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
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    if site.settings.kind == "play":
        from phase_ppl.study import play

        routes += play.routes(site)
    app = Starlette(
        routes=routes,
        lifespan=lifespan,
        middleware=[
            Middleware(SafeHeaders),
            Middleware(TrustedHostMiddleware, allowed_hosts=hosts(*names), www_redirect=False),
        ],
        exception_handlers={HTTPException: _refusal},
    )
    app.state.site = site
    return app


async def _refusal(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code)


class Pages:
    """What browsers ask for."""

    def __init__(self, site: Site) -> None:
        self.site = site

    async def start(self, request: Request) -> Response:
        """The one page; its script asks for the state."""
        return FileResponse(STATIC / "study.html", media_type="text/html; charset=utf-8")

    async def state(self, request: Request) -> Response:
        """How far somebody is, and what comes next."""
        site, settings = self.site, self.site.settings
        who = await site.visitor(request)
        if who is None:
            new = {"status": "new", "repeats": settings.refuse_repeats}
            return JSONResponse(new if settings.open else self._over("closed", None))
        who = await self._now(who)
        if who.outcome is not None:
            return JSONResponse(self._over(who.outcome, who))
        pages = [plan.described(settings, who, *page) for page in plan.next_pages(settings, who)]
        done = {answer.page for answer in who.answers if answer.correct is not False}
        n_trials = len(who.trials) if who.trials is not None else settings.trials
        total = 3 + bool(settings.quiz) + n_trials + settings.demographics
        found = {"status": "open", "participant": who.id, "title": settings.title, "pages": pages,
                 "done": len(done), "total": total}  # fmt: skip
        return JSONResponse(found)

    async def _now(self, who: Participant) -> Participant:
        """Return a participant with what is due: too late, or time for the videos to be drawn."""
        site, settings = self.site, self.site.settings
        if who.outcome is not None:
            return who
        # a crash may have come between an answer and what follows from it
        ended = plan.outcome(settings, who)
        if ended is None and time.time() - who.seen > 60 * settings.resume_within:
            ended = "expired"
        if ended is not None:
            await site.ask(site.store.end, who.id, ended)
        elif settings.kind != "play" and who.trials is None and plan.is_prepared(settings, who):
            await site.ask(
                site.store.assign,
                who.id,
                trials=settings.trials,
                checks=tuple(settings.checks),
                place_kept=60 * settings.place_kept,
            )
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
        """Let somebody in, by a cookie."""
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
            _, token = await site.ask(
                site.store.enter,
                settings.sha256,
                person=person if settings.refuse_repeats else "",
                place_kept=60 * settings.place_kept,
                trials=settings.trials,
                raters=settings.raters,
                checks=tuple(settings.checks),
                most=settings.most_entries,
                per_minute=settings.entries_per_minute,
            )
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
        """Keep the answers to a page; a repeated upload changes nothing."""
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
        who = await self._expired(who)
        if any((page, attempt) == (a.page, a.attempt) for a in who.answers):
            return JSONResponse({"saved": True, "new": False, "next": self._next(who)})
        allowed = plan.next_pages(settings, who)
        by_server = page == "practice" or page.startswith("session-")
        if (page, attempt) not in allowed or by_server or who.outcome not in (None, "expired"):
            raise HTTPException(409, f"there is no page {page[:40]!r} to be answered")
        times = {name: given.get(name) for name in _TIMES}
        for name, value in times.items():
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (number and 0 <= value < _MOST_TIME):
                raise HTTPException(400, f"{name}: expected milliseconds, or how often")
        try:
            cleaned, correct = plan.checked(settings, page, answers)
        except plan.Unfit as error:
            raise HTTPException(400, str(error)) from None
        new = await site.ask(
            site.store.answer,
            who.id,
            page,
            attempt,
            cleaned,
            correct=correct,
            times=times,
            outcome=lambda participant: plan.outcome(settings, participant),
        )
        who = await site.ask(site.store.participant, who.id)
        return JSONResponse({"saved": True, "new": new, "next": self._next(who)})

    async def _expired(self, who: Participant) -> Participant:
        """Return a participant; what comes too late is kept, but the study does not go on."""
        late = time.time() - who.seen > 60 * self.site.settings.resume_within
        return await self._now(who) if late else who

    def _next(self, who: Participant) -> str | None:
        """Return the page that comes next, by which a second tab notices that it is behind."""
        if who.outcome is not None:
            return None
        pages = plan.next_pages(self.site.settings, who)
        return "-".join(map(str, pages[0])) if pages else None

    async def note(self, request: Request) -> Response:
        """Keep what happened beside the answers."""
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
        """A film, for the participant for whom it was drawn."""
        who = await self.site.participant(request)
        name = request.path_params["name"]
        file = await self.site.ask(self.site.store.video, who.id, name)
        if file is None:
            raise HTTPException(404, "there is no such film")
        return FileResponse(self.site.folder / "videos" / file, media_type="video/mp4")

    async def clip(self, request: Request) -> Response:
        """A film of the introduction."""
        name = request.path_params["name"]
        if name not in CLIPS:
            raise HTTPException(404, "there is no such film")
        return FileResponse(self.site.folder / "clips" / f"{name}.mp4", media_type="video/mp4")
