"""A live game: somebody steers an agent, and beside it stands what the model believes they want.

One game at a time, for one person, or two: the second one has a page of its own. The reader
(:mod:`phase_study.reader`) is a process apart. It is handed each frame once this was shown.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import functools
import itertools
import math
import tempfile
import traceback
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

import phase_ppl as ppl
from phase_study import plan, reader
from phase_study.room import Message, Room, Seat
from phase_study.server import STATIC, Rates, application, same_origin
from phase_study.settings import Settings, template
from phase_study.sockets import talk
from phase_study.study import Served, names_of

PARTNERS: Final = ("planner", "helper", "hinderer", "player", "nobody")
"""Who the other agents are: the planner with a goal of its own, with mine, or against it; a second
player; or nobody, so that they stand still."""

SECONDS: Final = 120  # longest game
_STAYS: Final = 12  # frames for which a goal must hold, 3 s
_AHEAD: Final = 3.0  # simulated seconds of a what if: 9 s at the speed of the game
_LEVELS: Final = reader.LIKELIHOOD.tracking.strengths


@dataclasses.dataclass
class Wishes:
    """What a game shall be like, as the page asks for it."""

    agent: int = 0
    goal: str = ""  # "": drawn
    partner: str = "planner"
    strengths: tuple[float, float] = (450.0, 450.0)  # of one's own agent, of the others
    sees_all: bool = False
    new_scene: bool = False

    @classmethod
    def of(cls, given: Mapping[str, Any], world: ppl.World) -> Wishes:
        """Return wishes from a browser (ValueError: they are not such)."""
        found = cls(**{**given, "strengths": tuple(map(float, given.get("strengths", ())))})
        ppl.errors.whole_number("agent", found.agent, 0, len(world.agents) - 1)
        ppl.errors.check_name("partner", found.partner, PARTNERS)
        if len(found.strengths) != 2 or not {*found.strengths} <= {*_LEVELS}:
            raise ValueError("no such strengths")
        if found.goal:
            world.goal_index(found.goal)
        return found


def _holds(scene: ppl.Scene, agent: int, goal: str, frame: NDArray[np.float64]) -> bool:
    """Return whether an agent's goal is true in a frame, (entity, [x, y, angle])."""
    return ppl.goals.is_true(ppl.goals.goal_literal(goal, agent, scene.world), frame, scene)


class Live(Served):
    """A live game: steer an agent in the browser, and see what the model believes you want.

    Example:
        ``ppl.study.Live("trio").run()``

    Args:
        scenes: a scene to play in; or a world, or the name of a ready-made one, in which scenes are
            drawn.
        seed: seed of scenes, goals and the planner.

    Raises:
        UnknownNameError: there is no ready-made world of that name.
    """

    def __init__(self, scenes: ppl.Scene | ppl.World | str = "PHASE", seed: int = 0) -> None:
        if not isinstance(scenes, ppl.Scene):
            scenes = ppl.worlds.named(scenes)
        self.world = scenes if isinstance(scenes, ppl.World) else scenes.world
        self._scenes = scenes
        self._changes = {f"{of}_{key}" for of in ("goal", "strength") for key in self.world.keys}
        self._changes.add("remove")
        self._rng = np.random.default_rng(ppl.errors.whole_number("seed", seed, minimum=0))
        usual = Settings.parse(template("play", "")).play
        limit = SECONDS * usual.steps_per_second
        # neither both goals nor a lost connection end it; agents glide, as in PHASE's videos
        self._settings = dataclasses.replace(
            usual, limit=limit, hold=limit + 1, rejoin_within=math.inf, resets_velocity=False
        )
        self.seats = Seat("first"), Seat("second")
        self.opening: list[Callable[[], Any]] = []
        self._rates = Rates()
        self._wishes = Wishes()
        self._numbers = itertools.count()
        self._game = -1
        self._tasks: set[asyncio.Task[Any]] = set()
        self._playing: asyncio.Task[None] | None = None
        self._reached = False
        self._making: dict[int, Path] = {}  # films that are not complete
        self._films: dict[int, Path] = {}
        self._unread = ""  # why this game is read no further

    # --- its beginning and end --------------------------------------------------------------------

    def app(self, url: str = "", host: str = "127.0.0.1") -> Starlette:
        """Return the application; it answers to this machine's names, ``url`` and ``host``."""

        @contextlib.asynccontextmanager
        async def lifespan(app: Starlette) -> AsyncIterator[None]:
            with tempfile.TemporaryDirectory(prefix="phase-ppl-live-") as folder:
                self._folder = Path(folder)
                self._open()
                for what in self.opening:
                    await what()
                yield
                await self._close()

        routes = [
            Route("/", self._page),
            Route("/second", self._page),
            Route("/event.json", self._event),
            Route("/film/{number:int}.mp4", self._film),
            WebSocketRoute("/socket/{seat:int}", self._socket),
        ]
        app = application(routes, lifespan, names_of(url, host)[0])
        app.state.opening = self.opening
        return app

    def _open(self) -> None:
        # a full pipe keeps this thread waiting, not the game
        self._sender = ThreadPoolExecutor(1, "to the reader")
        self._start_reader()
        self._tell("warm up", self._drawn())
        self._begin(self._wishes, self._drawn())

    async def _close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if not self._has_ended:
            self._end_reader()
        self._sender.shutdown(cancel_futures=True)
        self._pipe.close()

    def _later(self, doing: Any) -> asyncio.Task[Any]:
        task = asyncio.create_task(doing)
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            traceback.print_exception(error)
            self._say({"t": "refused", "text": "the server has a problem; start over"})

    # --- the game ---------------------------------------------------------------------------------

    def _drawn(self) -> ppl.Scene:
        """Return a scene to play in."""
        if isinstance(self._scenes, ppl.Scene):
            scene = self._scenes
        else:
            scene = self._scenes.random_scene(self._rng)
        return self._settings.scene(scene)

    def _goal(self, scene: ppl.Scene, agent: int, besides: Sequence[str] = ()) -> str:
        """Draw a goal that takes doing: its agent has not reached it yet."""
        goals = [goal for goal, _ in plan.goal_question(self.world, agent, False)["options"]]
        away = [
            goal for goal in goals
            if goal not in besides and not _holds(scene, agent, goal, scene.start)
        ]  # fmt: skip
        return str(self._rng.choice(away or goals))

    def _begin(self, wishes: Wishes, scene: ppl.Scene) -> None:
        """Begin a game, which waits for the first key (errors as of ``Hypothesis.of``)."""
        me, agents = wishes.agent, self.world.agents
        own, others = wishes.strengths
        goals = {agents[me]: wishes.goal or self._goal(scene, me)}
        relation = {}
        for other, name in enumerate(agents):
            if other == me:
                continue
            if wishes.partner in ("helper", "hinderer"):
                relation[name, agents[me]] = wishes.partner.removesuffix("er")
            else:
                goals[name] = self._goal(scene, other, tuple(goals.values()))
        strength = {name: own if agent == me else others for agent, name in enumerate(agents)}
        roles = ppl.Hypothesis.of(self.world, goals, relation, strength)
        seed = int(self._rng.integers(2**31))
        self._wishes, self._roles, self._seed = wishes, roles, seed
        self._enter(self._made(scene))

    def _made(self, scene: ppl.Scene) -> Room:
        """Return a new room for the game."""
        wishes, n = self._wishes, len(self.world.agents)
        seats = [Seat() for _ in range(n)]
        seats[wishes.agent] = self.seats[0]
        if wishes.partner == "player" and n > 1:
            seats[(wishes.agent + 1) % n] = self.seats[1]
        plays = wishes.partner not in ("player", "nobody")
        settings = dataclasses.replace(self._settings, view="all" if wishes.sees_all else "own")
        goals = [self.world.goals[goal] for goal in self._roles.effective_goals]
        return Room(
            scene, goals, self._roles.strengths, settings, seats,
            computer=np.random.default_rng(self._seed) if plays else None,
        )  # fmt: skip

    def _enter(self, room: Room) -> None:
        """Go on in a room, which waits for the first key; the reader reads what it has so far."""
        if self._playing is not None:
            self._playing.cancel()
        self.room, self._game, self._reached = room, next(self._numbers), False
        self._unread = ""
        if self._has_ended:
            self._start_reader()
        room.going.clear()
        for seat in self.seats:
            seat.controls.release()
            seat.show(lambda seat=seat: self._stage(seat))  # type: ignore[misc]
        self._tell("begin", self._game, room.scene, self._wishes.agent)
        for number in range(len(room.frames)):
            self._show(number)
        self._playing = self._later(self._play(room))

    def _show(self, number: int) -> None:
        """Tell page and reader what a frame showed."""
        poses = self.room.frames[number]
        self._tell("frame", self._game, poses)
        self.seats[0].tell({"t": "read", "frame": number, "poses": poses.round(3).tolist()})

    async def _play(self, room: Room) -> None:
        shown = len(room.frames)

        def after_step(room: Room) -> None:
            nonlocal shown
            for number in range(shown, len(room.frames)):
                self._show(number)
            shown = len(room.frames)
            self._look(room)

        outcome = await room.run(after_step)
        self._say({"t": "over", "outcome": outcome})

    def _look(self, room: Room) -> None:
        """Pause once the player's goal was reached and stays so."""
        me, frames = self._wishes.agent, room.frames
        holds = functools.partial(_holds, room.scene, me, room.goals[me])
        if self._reached or len(frames) <= _STAYS or holds(room.scene.start):
            return
        if all(map(holds, frames[-_STAYS:])):
            self._reached = True
            self._pause("reached")

    def _pause(self, why: str) -> None:
        if self.room.going.is_set():
            self.room.going.clear()
            self._say({"t": "paused", "why": why})

    def _go(self) -> None:
        if not self.room.going.is_set():
            self.room.going.set()
            self._say({"t": "going"})

    async def _back(self, frame: int) -> None:
        """Go back to a frame, and wait there: what was done until then is done again."""
        game, steps = self._game, self.room.steps[:frame]
        if self._playing is not None:
            self._playing.cancel()
        again = self._made(self.room.scene)
        await asyncio.to_thread(again.repeat, steps)
        if self._game == game:  # no other game has begun meanwhile
            self._enter(again)

    # --- players ----------------------------------------------------------------------------------

    def _say(self, message: Message) -> None:
        for seat in self.seats:
            seat.tell(message)

    def _stage(self, seat: Seat) -> list[Message]:
        """Return the messages for a browser that comes into the game."""
        room, first = self.room, seat is self.seats[0]
        agent = room.seats.index(seat) if seat in room.seats else None
        told: list[Message] = [self._setup()] if first else []
        if agent is None:
            return [{"t": "nobody"}]
        goal = self._words(agent, room.goals[agent])
        told.append({**room.described(agent), "goal": goal})
        if first:
            told += [
                {"t": "read", "frame": number, "poses": poses.round(3).tolist()}
                for number, poses in enumerate(room.frames[: len(room.steps) + 1])
            ]
            if self._unread:
                told.append({"t": "unread", "text": self._unread})
        return [*told, room.shown(agent), {"t": "going" if room.going.is_set() else "waiting"}]

    def _words(self, agent: int, goal: str) -> str:
        words = dict(plan.goal_question(self.world, agent, False)["options"])
        return str(words.get(goal, goal))

    def _setup(self) -> Message:
        """Return what can be chosen."""
        agents = self.world.agents
        words = [plan.goal_question(self.world, a, True)["options"] for a in range(len(agents))]
        possible = [plan.allowed_goals(agent, False, self.world) for agent in range(len(agents))]
        return {
            "t": "setup",
            "world": self.world.name,
            "agents": [plan.the(name) for name in agents],
            "entities": [plan.the(name) for name in self.world.entities],
            "names": list(self.world.entities),
            "goals": list(self.world.goals),
            "keys": list(self.world.keys),
            "words": [dict(options) for options in words],
            "possible": possible,
            "levels": list(_LEVELS),
            "partners": list(PARTNERS) if len(agents) > 1 else ["nobody"],
            "draws": not isinstance(self._scenes, ppl.Scene),
            "wishes": dataclasses.asdict(self._wishes),
        }

    def _heed(self, given: Message) -> bool:
        """Do what the page of the first player asks for; return whether that is possible."""
        match given:
            case {"t": "begin", "wishes": dict(asked)}:
                try:
                    wishes = Wishes.of(asked, self.world)
                    self._begin(wishes, self._drawn() if wishes.new_scene else self.room.scene)
                except ppl.errors.InvalidSettingError as error:
                    self.seats[0].tell({"t": "refused", "text": str(error)})
                except (ValueError, TypeError, LookupError):
                    return False
            case {"t": "go"}:
                self._go()
            case {"t": "pause"}:
                self._pause("asked")
            case {"t": "back", "frame": int(frame)} if 0 <= frame <= len(self.room.steps):
                self._later(self._back(frame))
            case {"t": "look", "frame": int(frame)} if 0 <= frame <= len(self.room.steps):
                self._tell("look", self._game, frame)
            case {"t": "view", "all": bool(everything)}:
                self._wishes.sees_all = everything
                self.room.settings = dataclasses.replace(
                    self.room.settings, view="all" if everything else "own"
                )
            case {"t": "film"} if len(self.room.frames) > 1:
                self._make("film", {})
            case {"t": "what if", "frame": int(frame), "change": dict(change)} if (
                0 <= frame <= len(self.room.steps) and {*change} <= self._changes
            ):
                self._make("what_if", {"at": frame, "seconds": _AHEAD, "change": change})
            case _:
                return False
        return True

    async def _socket(self, socket: WebSocket) -> None:
        number = socket.path_params["seat"]
        if not same_origin(socket) or number not in range(len(self.seats)):
            await socket.close(4403)
            return
        await socket.accept()
        seat = self.seats[number]

        def allow() -> bool:
            return self._rates.allow(f"message {number}", 60, 60)

        def heed(given: Message) -> bool:
            # a key begins the game, and the next step at once
            match given:
                case {"t": "hurry"}:
                    self._go()
                    self.room.hurry.set()
                    return True
            return number == 0 and self._heed(given)

        await talk(socket, seat, allow, heed)
        if seat.outbox is None and seat in self.room.seats:
            self._pause("gone")

    # --- the reader -------------------------------------------------------------------------------

    def _start_reader(self) -> None:
        self._pipe, self._process = reader.started()
        self._has_ended = False
        asyncio.get_running_loop().add_reader(self._pipe.fileno(), self._hear)

    def _end_reader(self) -> None:
        self._has_ended = True
        asyncio.get_running_loop().remove_reader(self._pipe.fileno())
        self._process.terminate()
        self._process.join()

    def _tell(self, *message: Any) -> None:
        self._sender.submit(self._pipe.send, message)

    def _cannot_read(self, why: str) -> None:
        """Say so, now and to a page that comes later; the game goes on."""
        self._unread = why
        self.seats[0].tell({"t": "unread", "text": why})

    def _hear(self) -> None:
        """Hand on what the reader says."""
        try:
            while self._pipe.poll():
                self._heard(self._pipe.recv())
        except (EOFError, OSError):
            self._end_reader()
            why = "its process has ended; start over"
            for number in [*self._making]:
                self._heard(("failed", number, why))
            self._cannot_read(why)

    def _heard(self, message: tuple[Any, ...]) -> None:
        page = self.seats[0]
        match message:
            case ("reading", game, found) if game == self._game:
                page.tell({"t": "reading", **found})
            case ("broken", game, text) if game == self._game:
                self._cannot_read(text)
            case ("made" | "failed" as how, number, text):
                path = self._making.pop(number)
                if how == "made":
                    self._films[number] = path
                page.tell({"t": how, "number": number, "text": text})

    def _make(self, what: str, given: Mapping[str, Any]) -> None:
        why = f"the model cannot read: {self._unread}" if self._unread else ""
        if self._making:
            why = "another film is being made; wait for it"
        if why:
            self.seats[0].tell({"t": "refused", "text": why})
            return
        number = next(self._numbers)
        self._making[number] = path = self._folder / f"{number}.mp4"
        self._tell("make", number, what, {"path": path, **given})
        self.seats[0].tell({"t": "making", "number": number, "what": what})

    # --- pages and files --------------------------------------------------------------------------

    async def _page(self, request: Request) -> Response:
        return FileResponse(STATIC / "live.html", media_type="text/html; charset=utf-8")

    async def _event(self, request: Request) -> Response:
        """Return the game so far as an event, for ``load_event``."""
        if len(self.room.frames) < 2:
            raise HTTPException(409, "nothing has happened yet")
        path = self._folder / "event.json"
        ppl.save_event(self.event(), path)
        # all of it at once: the next one that asks has the same file
        said = {"Content-Disposition": 'attachment; filename="live.json"'}
        return Response(path.read_bytes(), headers=said, media_type="application/json")

    def event(self) -> ppl.Event:
        """Return the game so far as an event; it has no truth if some agent has no goal."""
        players = {"nobody": 1, "player": 2}.get(self._wishes.partner, len(self.world.agents))
        is_known = players >= len(self.world.agents)
        truth = ppl.Truth.of(self._roles) if is_known else None
        frames = np.array(self.room.frames)
        return ppl.Event(self.room.scene, ppl.Observation(frames), id="live", truth=truth)

    async def _film(self, request: Request) -> Response:
        path = self._films.get(request.path_params["number"])
        if path is None:
            raise HTTPException(404, "there is no such film")
        return FileResponse(path, media_type="video/mp4", filename="live.mp4",
                            content_disposition_type="inline")  # fmt: skip
