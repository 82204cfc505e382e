"""Playing: practice, the waiting room, and sessions of two people, or of one and the computer.

Everybody who is ready attends (:meth:`Lobby._attend`): they practise alone, wait, and play their
sessions with the partner they meet. Their browser shows this through a socket, which may be lost
and come back. If somebody leaves, the session ends after ``rejoin_within`` seconds and is kept but
marked. The study is then over for both, each with an outcome of its own. Somebody who does not
begin is out; their partner goes back to the waiting room.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import functools
import random
import secrets
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute, WebSocketRoute
from starlette.websockets import WebSocket

import phase_ppl as ppl
from phase_study import plan
from phase_study.room import NOTHING, Controls, Message, Room, Seat
from phase_study.server import Site, same_origin
from phase_study.sockets import TOO_MANY, talk
from phase_study.store import COMPLETE, Participant

COUNTDOWN: Final = 3  # seconds before a session begins
_SAVED_EVERY: Final = 1.0
_RETRY: Final = 5.0

_UNKNOWN: Final = 4401  # closes a socket; see ``talk``


def routes(site: Site) -> list[BaseRoute]:
    """Return the socket of a study of play."""
    lobby = Lobby(site)
    site.opening.append(lobby.open)
    site.closing.append(lobby.close)
    return [WebSocketRoute("/play/socket", lobby.socket)]


# --- practice -------------------------------------------------------------------------------------

_BLUE_ITEM: Final = 2

PRACTICE: Final = ppl.Scene(
    start=np.array([[13.0, 7.0, 0.0], [23.0, 19.0, 2.5], [13.0, 14.0, 0.0], [20.0, 7.0, 0.0]]),
    radius=np.array([0.8, 0.8, 0.8, 1.2]),
    walls=np.array([[[16.0, 12.0], [16.0, 22.0]]]),
)
_STRENGTH: Final = 600.0
_GOALS: Final = ("Get blue item to red lm", "Get green agent away from red lm")
"""Goals of nobody; practice has :data:`TASKS` instead."""


def _moved(room: Room) -> float:
    return float(np.abs(room.frames[-1][0, :2] - room.frames[0][0, :2]).sum())


def _carried(room: Room) -> bool:
    way = np.abs(room.frames[-1][_BLUE_ITEM, :2] - room.frames[0][_BLUE_ITEM, :2]).sum()
    return bool(room.picture.held[0] == _BLUE_ITEM and way > 2)


TASKS: Final[dict[str, Callable[[Room], bool]]] = {
    "Drive forward: W or arrow up": lambda room: _moved(room) > 1,
    "Turn: Q and E, or the arrows left and right": lambda room: (
        abs(room.frames[-1][0, 2] - room.frames[0][0, 2]) > 0.5
    ),
    "Touch the blue circle and grab it: space": lambda room: room.picture.held[0] == _BLUE_ITEM,
    "Take it with you": _carried,
    "Let go of it: space": lambda room: (
        room.picture.held[0] == NOTHING
        and bool(np.ptp([frame[_BLUE_ITEM, :2] for frame in room.frames], axis=0).sum() > 2)
    ),
}
"""Tasks of practice, in this order -> whether they are done."""


class Lobby:
    """All people who practise, wait or play."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.settings = site.settings.play
        self._seats: dict[str, Seat] = {}
        self._attending: dict[str, asyncio.Task[None]] = {}
        self._waiting: dict[str, asyncio.Future[asyncio.Task[None]]] = {}
        self._matches: set[asyncio.Task[None]] = set()
        self._rooms = asyncio.Semaphore(self.settings.rooms)

    async def open(self) -> None:
        """Compile what playing needs, and mark sessions that a crash broke off."""
        store = self.site.store
        for session in await self.site.ask(store.sessions):
            if session["ended"] is None:
                await self.site.ask(store.end_session, session["id"], "stopped")
        scene, seats = self.settings.scene(PRACTICE), [Seat(), Seat()]
        strengths = (_STRENGTH, _STRENGTH)

        def warm_up() -> None:
            one_step = Room(
                scene, _GOALS, strengths, self.settings, seats,
                computer=np.random.default_rng(0), limit=1,
            )  # fmt: skip
            asyncio.run(one_step.run())

        await asyncio.to_thread(warm_up)

    async def close(self) -> None:
        """Break off all sessions; what was played is kept."""
        tasks = [*self._matches, *self._attending.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for seat in self._seats.values():
            seat.tell({"t": "error", "text": "the study is being stopped"})

    # --- browsers ---------------------------------------------------------------------------------

    def _page(self, who: Participant) -> str | None:
        """Return "practice" or the next session; None: neither."""
        if who.outcome is not None:
            return None
        pages = plan.next_pages(self.site.settings, who)
        page = pages[0][0] if pages else ""
        return page if page == "practice" or page.startswith("session-") else None

    async def socket(self, socket: WebSocket) -> None:
        """A browser's connection to what its player is doing."""
        if not same_origin(socket):
            await socket.close(4403)
            return
        who = await self.site.visitor(socket)
        await socket.accept()
        if who is None:
            await socket.close(_UNKNOWN)
            return
        if not self.site.allow(f"socket {who.id}", 1, 10):
            await socket.close(TOO_MANY)
            return
        seat = self._seats.setdefault(who.id, Seat(who.id))
        attending = self._attending.get(who.id)
        if attending is None or attending.done():
            self._attending[who.id] = asyncio.create_task(self._attend(seat, who.id))
        await talk(socket, seat, lambda: self.site.allow(f"message {who.id}", 60, 60))

    # --- a participant's way through --------------------------------------------------------------

    async def _attend(self, seat: Seat, who: str) -> None:
        """Practise, wait, and play, until no session or no player is left."""
        try:
            while True:
                page = self._page(await self.site.ask(self.site.store.participant, who))
                if page is None:
                    break
                if page == "practice":
                    here = await self._practise(seat)
                else:
                    here = await self._meet(seat)
                if not here:
                    return
            seat.show([{"t": "go"}])
        except HTTPException as error:
            seat.show([{"t": "error", "text": str(error.detail)}])
        except Exception:  # nobody must be left with a frozen picture
            traceback.print_exc()
            seat.show([{"t": "error", "text": "the server has a problem"}])
        finally:
            seat.stage = list

    async def _practise(self, seat: Seat) -> bool:
        """Play alone until all tasks are done and the player is ready; return if they stayed."""
        seat.show([{"t": "full"}])
        async with self._rooms:
            room = Room(
                self.settings.scene(PRACTICE), _GOALS, (_STRENGTH, _STRENGTH), self.settings,
                [seat, Seat()],
                limit=self.settings.practice_at_most * self.settings.steps_per_second,
            )  # fmt: skip
            done: list[str] = []
            scene = {**room.described(0), "practice": list(TASKS), "goals": []}
            seat.is_ready = False
            seat.show(lambda: [scene, {"t": "tasks", "done": len(done)}, room.shown(0)])

            def progress(room: Room) -> str | None:
                if len(done) < len(TASKS):
                    task = list(TASKS)[len(done)]
                    if TASKS[task](room):
                        done.append(task)
                        seat.tell({"t": "tasks", "done": len(done)})
                    seat.is_ready = False
                return "ready" if seat.is_ready else None

            outcome = await room.run(progress)
        if outcome == "left":
            return False
        answers = {"done": len(done), "of": len(TASKS), "steps": len(room.steps)}
        await self.site.answer(str(seat.who), "practice", answers)
        return True

    async def _meet(self, seat: Seat) -> bool:
        """Wait for a partner, and play with them; return whether the player is still there."""
        match: asyncio.Task[None] | None = None
        if self.settings.partner == "computer":
            match = self._begin([seat, Seat()])
        else:
            for other, found in list(self._waiting.items()):
                if self._seats[other].is_connected and not found.done():
                    match = self._begin([self._seats[other], seat])
                    found.set_result(match)
                    break
        if match is None:
            match = await self._wait(seat)
        if match is None:
            return False
        await asyncio.wait([match])
        return not match.cancelled() and match.result() is None

    async def _wait(self, seat: Seat) -> asyncio.Task[None] | None:
        """Return the match that another player began, or one with the computer, or None."""
        loop, who = asyncio.get_running_loop(), str(seat.who)
        until = loop.time() + self.settings.wait_at_most
        computer_comes = self.settings.partner == "either"
        seat.show(lambda: [{"t": "wait", "left": until - loop.time(), "computer": computer_comes}])
        found: asyncio.Future[asyncio.Task[None]] = loop.create_future()
        self._waiting[who] = found
        try:
            return await asyncio.wait_for(found, self.settings.wait_at_most)
        except TimeoutError:
            if not seat.is_connected:
                return None
            if computer_comes:
                return self._begin([seat, Seat()])
            await self.site.ask(self.site.store.end, who, "waited")
            seat.show([{"t": "go"}])
            return None
        finally:
            del self._waiting[who]

    def _begin(self, seats: list[Seat]) -> asyncio.Task[None]:
        random.SystemRandom().shuffle(seats)
        task = asyncio.create_task(self._match(seats))
        self._matches.add(task)
        task.add_done_callback(self._matches.discard)
        return task

    # --- sessions of two --------------------------------------------------------------------------

    async def _match(self, seats: list[Seat]) -> None:
        """Play session after session, exchanging the agents, while both players have any left."""
        store, last = self.site.store, ""
        for seat in seats:
            seat.show([{"t": "full"}])
        try:
            async with self._rooms:
                while True:
                    people = [
                        await self.site.ask(store.participant, seat.who)
                        for seat in seats
                        if seat.who is not None
                    ]
                    if not all(map(self._page, people)):
                        break
                    last = await self._session(seats, people, last)
                    if last not in COMPLETE:
                        break
                    seats.reverse()
        except HTTPException as error:
            for seat in seats:
                seat.tell({"t": "error", "text": str(error.detail)})
            await asyncio.sleep(_RETRY)

    async def _session(self, seats: list[Seat], people: Sequence[Participant], last: str) -> str:
        """Play one session, keep it, and return its outcome."""
        site, settings, store = self.site, self.settings, self.site.store
        pages = {person.id: str(self._page(person)) for person in people}
        since = time.time() - 2 * settings.seconds
        event = site.events[await site.ask(store.least_played, since, tuple(pages))]
        truth, scene, seed = event.truth, settings.scene(event.scene), secrets.randbits(32)
        goals = truth.goal_red, truth.goal_green
        strengths = truth.strength_red, truth.strength_green
        room = Room(scene, goals, strengths, settings, seats, computer=np.random.default_rng(seed))
        count: list[Message] = []
        for agent, seat in enumerate(seats):
            seat.is_ready = seat.who is None
            seat.round_trips.clear()
            number = int(pages.get(str(seat.who), "session-0").partition("-")[2])
            described = {**room.described(agent), "session": number, "last": last,
                         "of": site.settings.trials}  # fmt: skip
            seat.show(functools.partial(_stage, room, agent, described, count))
        if not await self._ready(seats, room):
            # a player who stayed goes back to the waiting room
            for seat in seats:
                if seat.who is not None and not (seat.is_connected and seat.is_ready):
                    await site.ask(store.end, seat.who, "left")
                    seat.show([{"t": "go"}])
            return "left"
        await self._count_down(seats, count)
        record = {**dataclasses.asdict(settings), "turning": scene.turning, "computer_seed": seed}
        session = await site.ask(
            store.open_session, event.id, goals, strengths, record, [s.who for s in seats]
        )
        outcome = await self._played(room, session)
        for seat in seats:
            if seat.who is not None and outcome in COMPLETE:
                answers = {"session": session, "outcome": outcome}
                await site.answer(seat.who, pages[seat.who], answers)
            elif seat.who is not None:
                how = "partner_left" if seat.is_connected else "left"
                await site.ask(store.end, seat.who, how)
            seat.tell({"t": "end", "outcome": outcome})
        return outcome

    async def _count_down(self, seats: Sequence[Seat], count: list[Message]) -> None:
        """Begin together; earlier key presses are dropped."""
        for left in range(COUNTDOWN, 0, -1):
            count[:] = [{"t": "count", "left": left}]
            for seat in seats:
                seat.tell(count[0])
            await asyncio.sleep(1)
        count[:] = [{"t": "begun"}]
        for seat in seats:
            seat.controls = Controls()
            seat.tell(count[0])

    async def _ready(self, seats: Sequence[Seat], room: Room) -> bool:
        """Wait until both are ready; return whether they were in time."""
        loop, told = asyncio.get_running_loop(), list[bool]()
        begun = loop.time()
        while not all(ready := [seat.is_ready for seat in seats]):
            if room.outcome() == "left" or loop.time() - begun > self.settings.ready_within:
                return False
            if ready != told:
                told = ready
                for seat in seats:
                    seat.tell({"t": "ready", "players": ready})
            await asyncio.sleep(0.1)
        return True

    async def _played(self, room: Room, session: str) -> str:
        """Run a session, and store its steps as they come."""
        saving = asyncio.create_task(self._saving(room, session))
        outcome = "stopped"
        try:
            outcome = await room.run()
        finally:
            saving.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await saving
            await self._end(room, session, outcome)
        return outcome

    async def _saving(self, room: Room, session: str) -> None:
        saved = 0
        while True:
            await asyncio.sleep(_SAVED_EVERY)
            steps = room.steps[saved:]
            with contextlib.suppress(HTTPException):  # tried again at the end
                await self.site.ask(self.site.store.add_steps, session, steps)
                saved += len(steps)

    async def _end(self, room: Room, session: str, outcome: str) -> None:
        store = self.site.store
        trips = [
            float(np.median(seat.round_trips)) if seat.round_trips else None for seat in room.seats
        ]
        for more in range(9, -1, -1):  # times to try again
            try:
                await self.site.ask(store.add_steps, session, room.steps)
                await self.site.ask(
                    store.end_session, session, outcome,
                    slip_ms=1000 * room.slip, rtt_ms=trips, sha256=room.trajectory_sha256(),
                )  # fmt: skip
                return
            except HTTPException:
                if not more:
                    print(f"phase-ppl: session {session} was not saved", file=sys.stderr)
                    raise
                await asyncio.sleep(1)


def _stage(room: Room, agent: int, described: Message, count: Sequence[Message]) -> list[Message]:
    """Return the messages for a player who comes back into a session."""
    ready = {"t": "ready", "players": [seat.is_ready for seat in room.seats]}
    return [described, ready, *count, room.shown(agent)]
