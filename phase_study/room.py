"""A room: a world whose agents players steer; each sees what its agent sees.

The server keeps the clock. A planner step takes one action of each player. Its five substeps are
drawn while players press the keys of the next step. Nobody is waited for. A late clock stays late
instead of hurrying.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_study.settings import PlaySettings
from phase_study.store import trajectory_sha256

MOVES: Final[Mapping[str, ppl.Action]] = {
    "forward": ppl.Action.UP,
    "backward": ppl.Action.DOWN,
    "left": ppl.Action.LEFT,
    "right": ppl.Action.RIGHT,
    "turn left": ppl.Action.TURN_LEFT,
    "turn right": ppl.Action.TURN_RIGHT,
}
GRAB: Final = "grab"
KEYS: Final = (*MOVES, GRAB)
"""Keys that a player can press (paper, Appendix A.2)."""

NOTHING: Final = -1
"""The held item of an agent that holds nothing."""

Message = dict[str, Any]


class Controls:
    """The keys of one player, between two steps."""

    _MOST_TAPS: Final = 2

    def __init__(self) -> None:
        self._held: list[str] = []
        self._unheeded: set[str] = set()
        self._taps: list[str] = []
        self._grabs = False
        self._pressed = self.heard = 0  # presses ever; as far as they are in an action

    def press(self, key: str, down: bool) -> None:
        """Note that one of :data:`KEYS` went down or up; a repeated message changes nothing."""
        if down and key not in self._held:
            self._held.append(key)
            self._pressed += 1
            self._grabs |= key == GRAB
            self._unheeded.add(key)
        elif not down and key in self._held:
            self._held.remove(key)
            if key in MOVES and key in self._unheeded and len(self._taps) < self._MOST_TAPS:
                self._taps.append(key)
            self._unheeded.discard(key)

    def release(self) -> None:
        """Release all keys."""
        self._held.clear()
        self._taps.clear()

    def pressed(self) -> list[str]:
        """Return the keys tapped and not yet used, the keys held, and whether to grab."""
        held = (key for key in self._held if key != GRAB)
        return [*self._taps, *held, *[GRAB] * self._grabs]

    def action(self, holds: bool) -> ppl.Action:
        """Return the action of the coming step.

        The latest of the held keys wins. Keys that went down and up between two steps come before
        them. "Grab" lets go if the agent holds something.
        """
        self.heard = self._pressed
        if self._grabs:
            self._grabs = False
            return ppl.Action.DETACH if holds else ppl.Action.ATTACH
        if self._taps:
            return MOVES[self._taps.pop(0)]
        held = [key for key in self._held if key != GRAB]
        self._unheeded -= set(held[-1:])
        return MOVES[held[-1]] if held else ppl.Action.NO_FORCE


class Outbox:
    """Messages for one browser; a slow one misses the oldest frames, and nothing else."""

    MOST: Final = 20

    def __init__(self) -> None:
        self._messages: collections.deque[Message] = collections.deque()
        self._waiting = asyncio.Event()

    def put(self, message: Message) -> None:
        """Send a message."""
        frames = [old for old in self._messages if old["t"] == "frame"]
        if message["t"] == "frame" and len(frames) >= self.MOST:
            self._messages.remove(frames[0])
        self._messages.append(message)
        self._waiting.set()

    async def get(self) -> Message:
        """Return the next message, waiting for it."""
        while not self._messages:
            self._waiting.clear()
            await self._waiting.wait()
        return self._messages.popleft()


class Seat:
    """A player's place: its keys, and the messages for its browser.

    ``who`` is None if nobody, or the computer, plays.
    """

    def __init__(self, who: str | None = None) -> None:
        self.who = who
        self.controls = Controls()
        self.outbox: Outbox | None = None
        self.gone_since = -math.inf
        self.is_ready = False
        self.pinged: float | None = None
        self.round_trips: list[float] = []
        self.stage: Callable[[], Sequence[Message]] = list

    @property
    def is_connected(self) -> bool:
        """Whether the player is connected, or no person is expected."""
        return self.who is None or self.outbox is not None

    def tell(self, message: Message) -> None:
        """Send a message if the player is connected."""
        if self.outbox is not None:
            self.outbox.put(message)

    def show(self, stage: Callable[[], Sequence[Message]] | Sequence[Message]) -> None:
        """Send the present stage; a browser that comes back later is sent it, too."""
        self.stage = stage if callable(stage) else lambda: stage
        for message in self.stage():
            self.tell(message)


class Step(NamedTuple):
    """The record of a planner step: the columns of the table."""

    number: int
    actions: Sequence[int]  # of each agent
    keys: Sequence[Sequence[str]]
    lag_ms: float


class Picture(NamedTuple):
    """A moment of the world, and what each agent sees of it."""

    poses: NDArray[np.float64]  # (entity, 3) x, y [units], angle [rad]
    seen: Sequence[Sequence[bool]]  # per agent, whether it observes each entity
    # for each agent the corners of its field of view; None if everything is shown
    sights: Sequence[list[list[float]] | None]
    held: Sequence[int]  # item of each agent, or ``NOTHING``


class Room:
    """A running session.

    Args:
        scene: the scene as played, see :meth:`PlaySettings.scene`.
        goals: effective goals of the agents.
        strengths: of the agents, newtons.
        settings: of the study.
        seats: of the agents.
        computer: a random generator for each seat without a person; None: its agent stands still.
        limit: steps after which the session ends.

    Attributes:
        going: while it is not set, no further step begins.
        hurry: once it is set, the next step begins at once: what is left of the one on show is
            shown without delay.
    """

    def __init__(
        self,
        scene: ppl.Scene,
        goals: Sequence[str],
        strengths: Sequence[float],
        settings: PlaySettings,
        seats: Sequence[Seat],
        *,
        computer: np.random.Generator | None = None,
        limit: int | None = None,
    ) -> None:
        self.scene, self.goals, self.strengths = scene, goals, strengths
        self.settings, self.seats = settings, seats
        self.limit = settings.limit if limit is None else limit
        self.stage = ppl.Stage(scene, strengths)
        self.frames: list[NDArray[np.float64]] = [scene.start.copy()]
        self.steps: list[Step] = []
        self.slip = 0.0
        self.literals = [
            ppl.goals.goal_literal(goal, agent, scene.world) for agent, goal in enumerate(goals)
        ]
        self._true_for = 0
        self.going, self.hurry = asyncio.Event(), asyncio.Event()
        self.going.set()
        self._computers = {
            agent: self.stage.planned(agent, goals, computer.spawn(1)[0])
            for agent, seat in enumerate(seats)
            if computer is not None and seat.who is None
        }
        self.picture = self._picture()

    # --- the world --------------------------------------------------------------------------------

    def _picture(self) -> Picture:
        state, n = self.stage.state, len(self.seats)
        held = state.held.tolist()
        if self.settings.view == "all":
            return Picture(state.pose, [[True] * len(state.pose)] * n, [None] * n, held)
        seen = [self.stage.sees(agent).tolist() for agent in range(n)]
        sights = [outline(self.scene, state.pose, agent) for agent in range(n)]
        return Picture(state.pose, seen, sights, held)

    async def _planned(self) -> dict[int, ppl.Action]:
        """Return the computers' next actions, from what their agents see now."""
        return {
            agent: await asyncio.to_thread(computer.decide)
            for agent, computer in self._computers.items()
        }

    def _advance(self, actions: Sequence[int]) -> list[Picture]:
        """Do one step; return its moments."""
        pictures = [self._picture() for _ in self.stage.substeps(actions)]
        self.frames.append(np.mean([picture.poses for picture in pictures], axis=0))
        reached = [
            ppl.goals.is_true(literal, self.frames[-1], self.scene) for literal in self.literals
        ]
        self._true_for = self._true_for + 1 if all(reached) else 0
        return pictures

    def repeat(self, steps: Sequence[Step]) -> None:
        """Do steps of an earlier room of the same scene again, without showing them."""
        for step in steps:
            for computer in self._computers.values():
                computer.decide()  # it must have seen the same
            self.picture = self._advance(step.actions)[-1]
            self.steps.append(step)

    @property
    def ends_by_goals(self) -> bool:
        """Whether it ends when both goals are true; not so for "away from", true from the start."""
        return all(literal.positive for literal in self.literals)

    def outcome(self) -> str | None:
        """Return how it ended: "goals", "time" or "left"; None: it goes on."""
        now = asyncio.get_running_loop().time()
        if any(
            not seat.is_connected and now - seat.gone_since > self.settings.rejoin_within
            for seat in self.seats
        ):
            return "left"
        if self.ends_by_goals and self._true_for >= self.settings.hold:
            return "goals"
        return "time" if len(self.steps) >= self.limit else None

    def trajectory_sha256(self) -> str:
        """Return the hash of the trajectory, which a replay must reproduce."""
        # a step that was broken off has a frame, but no record
        return trajectory_sha256(np.array(self.frames[: len(self.steps) + 1]))

    # --- the clock --------------------------------------------------------------------------------

    async def run(self, done: Callable[[Room], str | None] | None = None) -> str:
        """Play until it ends, or ``done`` is true after a step; return the outcome."""
        loop = asyncio.get_running_loop()
        interval = 1 / (self.settings.steps_per_second * ppl.Stage.SUBSTEPS)
        due = loop.time()
        planning = asyncio.ensure_future(self._planned())
        try:
            while (outcome := self.outcome() or (done(self) if done else None)) is None:
                if not self.going.is_set():
                    await self.going.wait()
                    due = loop.time()
                planned = await planning
                self.hurry.clear()
                keys = [seat.controls.pressed() for seat in self.seats]
                held = self.stage.state.held.tolist()
                actions = [
                    int(planned.get(agent, seat.controls.action(held[agent] != NOTHING)))
                    for agent, seat in enumerate(self.seats)
                ]
                pictures = self._advance(actions)
                planning = asyncio.ensure_future(self._planned())  # while the step is shown
                lag = 0.0
                for number, self.picture in enumerate(pictures):
                    due += interval
                    # sleeps even when late: other rooms must get their turn
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout_at(due):
                            await self.hurry.wait()
                    late = loop.time() - due
                    lag = max(lag, late)
                    if late > interval:
                        due += late
                    for agent, seat in enumerate(self.seats):
                        seat.tell(self.shown(agent, number))
                if self.hurry.is_set():
                    due = loop.time() - interval  # the first picture is due now
                self.slip = max(self.slip, lag)
                self.steps.append(Step(len(self.steps) + 1, actions, keys, 1000 * lag))
        finally:
            planning.cancel()
        return outcome

    # --- messages for browsers --------------------------------------------------------------------

    def shown(self, agent: int, number: int = 0) -> Message:
        """Return the present moment as an agent sees it, without unseen entities."""
        poses, seen, sights, held = self.picture
        steps = len(self.steps)
        left = self.limit - steps - number / ppl.Stage.SUBSTEPS
        return {
            "t": "frame",
            "poses": [
                np.round(pose, 3).tolist() if known else None
                for pose, known in zip(poses, seen[agent], strict=True)
            ],
            "sight": sights[agent],
            "held": [item if seen[agent][i] else NOTHING for i, item in enumerate(held)],
            "left": round(left / self.settings.steps_per_second, 1),
            "true": self._true_for,
            "step": steps,
            "heard": self.seats[agent].controls.heard,
        }

    def described(self, agent: int) -> Message:
        """Return what everybody knows of the scene, and each player's agent."""
        scene, world = self.scene, self.scene.world
        return {
            "t": "scene",
            "agent": agent,
            "goals": list(self.goals),
            "n_agents": len(world.agents),
            "radius": scene.radius.tolist(),
            "walls": scene.walls.tolist(),
            "arena": list(scene.arena),
            "landmarks": scene.landmark_centres.tolist(),
            "half_widths": scene.half_widths.tolist(),
            "colours": [list(colour) for colour in world.entity_colours],
            "landmark_colours": [list(one.colour) for one in world.landmarks],
            "interval": 1 / (self.settings.steps_per_second * ppl.Stage.SUBSTEPS),
            "ends_by_goals": self.ends_by_goals,
            "partner": "computer" if self._computers else "person",
        }


_BEND: Final = 0.01  # sine of the smallest turn of an outline that counts as a corner


def outline(scene: ppl.Scene, poses: NDArray[np.float64], agent: int) -> list[list[float]]:
    """Return the corners of an agent's field of view within the arena."""
    points = ppl.render.field_of_view(scene, poses, agent)
    eye, rays = points[0], points[1:] - points[0]
    x0, x1, y0, y1 = scene.arena
    border = np.where(rays > 0, [x1, y1], [x0, y0])
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(rays == 0, np.inf, (border - eye) / rays)  # of the distance to the border
    ends = eye + shares.min(axis=1).clip(0.0, 1.0)[:, None] * rays
    sides = np.diff(ends, axis=0)
    lengths = np.hypot(*sides.T)
    apart = lengths > 1e-3  # rays on both sides of an edge
    ends = np.concatenate([ends[:1], ends[1:][apart]])
    ahead = sides[apart] / lengths[apart, None]
    bends = np.abs(ahead[:-1, 0] * ahead[1:, 1] - ahead[:-1, 1] * ahead[1:, 0]) > _BEND
    corners = np.concatenate([ends[:1], ends[1:-1][bends], ends[-1:]])
    return [[round(x, 2), round(y, 2)] for x, y in [eye.tolist(), *corners.tolist()]]


# --- feasibility of a scene -----------------------------------------------------------------------


def warnings(events: Iterable[ppl.Event], settings: PlaySettings) -> list[str]:
    """Return in words which agents cannot reach their goals in time."""
    found = []
    for event in events:
        truth, scene = event.truth, settings.scene(event.scene)
        goals = truth.goal_red, truth.goal_green
        literals = [ppl.goals.goal_literal(goal, agent) for agent, goal in enumerate(goals)]
        if all(one.positive and ppl.goals.is_true(one, scene.start, scene) for one in literals):
            found.append(f"{event.id}: both goals are reached before anybody moves")
        for agent, strength in enumerate((truth.strength_red, truth.strength_green)):
            name, size = scene.world.entities[agent], float(scene.radius[agent])
            who = f"{event.id}: the {name} (size {size:g}, {strength:g} N)"
            needed = _needed(literals[agent], agent, scene, strength) * settings.step
            width = scene.arena[1] - scene.arena[0]
            crossing = driving(size, strength, width, settings.resets_velocity) * settings.step
            if needed == np.inf:
                item = scene.world.entities[literals[agent].subject]
                found.append(f"{who} cannot move the {item} alone, which its goal is about")
            elif needed > settings.seconds:
                found.append(f"{who} needs {_said(needed)} for its goal, {_of(settings)}")
            elif crossing > settings.seconds:
                found.append(f"{who} needs {_said(crossing)} across the arena, {_of(settings)}")
    return found


def _said(seconds: float) -> str:
    return "forever" if seconds == np.inf else f"some {seconds:.0f} s"


def _of(settings: PlaySettings) -> str:
    return f"of the {settings.seconds:g} s that a session takes (limit in [play])"


def _needed(literal: ppl.goals.Literal, agent: int, scene: ppl.Scene, strength: float) -> float:
    """Return the planner steps for an agent's goal, alone and straight; inf: impossible."""
    places, distance, resets = scene.start[:, :2], scene.rooms.path_distance, scene.resets_velocity
    size, subject = float(scene.radius[agent]), literal.subject
    if not literal.positive or subject == 1 - agent:
        return 0.0
    if literal.predicate.name == "TOUCH":
        return driving(size, strength, distance(places[agent], places[literal.target]), resets)
    goal = scene.landmark_centres[literal.target]
    carried = max(0.0, float(distance(places[subject], goal)) - scene.landmark_half_width)
    if subject == agent:
        return driving(size, strength, carried, resets)
    there = driving(size, strength, float(distance(places[agent], places[subject])), resets)
    item = float(scene.radius[subject])
    return there + driving(size, strength, carried, resets, item)


_STEADY: Final = 24  # steps after which an agent that is reset keeps its speed
_MOST_STEPS: Final = 5000  # of a session
_CREEPS: Final = 2e-3  # units per step that do not count as motion


@functools.lru_cache(maxsize=1024)
def driving(
    size: float, strength: float, way: float, resets_velocity: bool, item: float | None = None
) -> float:
    """Return the planner steps that an agent takes straight ahead from rest; inf: it cannot move.

    The agent has a size [units] and a strength [N], a distance to go [units], and may carry an
    item of a size in front.
    """
    if way <= 0:
        return 0.0
    room = 10 * max(way, 20.0)
    start = np.array([[0.5, 0.1], [0.1, 0.9], [0.9, 0.9], [0.9, 0.1]]) * room
    if item is not None:
        start[2] = start[0] + [0.0, size + item]
    corners = np.array([[0.1, 0.9], [0.9, 0.9], [0.9, 0.1], [0.1, 0.1]]) * room
    scene = ppl.Scene(
        start=np.column_stack([start, np.zeros(4)]),
        radius=np.array([size, 0.8, item or 0.8, 0.8]),
        arena=(0.0, room, 0.0, room),
        landmark_centres=corners,
        resets_velocity=resets_velocity,
    )
    stage, rest = ppl.Stage(scene, (strength, strength)), ppl.Action.NO_FORCE
    if item is not None:
        stage.step((ppl.Action.ATTACH, rest))
        if stage.state.held[0] == NOTHING:
            return np.inf
    gone = before = 0.0
    for step in range(1, _MOST_STEPS + 1):
        stage.step((ppl.Action.UP, rest))
        before, gone = gone, float(stage.state.pose[0, 1]) - start[0, 1]
        if gone >= way:
            return float(step)
        if step >= _STEADY and (resets_velocity or gone - before <= _CREEPS):
            break
    return step + (way - gone) / (gone - before) if gone - before > _CREEPS else np.inf
