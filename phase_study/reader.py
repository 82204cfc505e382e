"""The reader of a live game: a process of its own that says what the model believes.

It is given a scene, and then what is on show, frame by frame: places and angles of the bodies. It
knows neither keys nor goals. The game never waits for it. It takes in all frames. It says what it
believes when no further frame is waiting; otherwise once a second.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

import numpy as np
from loky.backend import get_context
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_study.room import NOTHING, outline

LIKELIHOOD: Final = ppl.ClosedLoopLikelihood(planner_seeds=1, weight=0.3)
MODEL: Final = ppl.Model(likelihood=LIKELIHOOD)
"""What reads: the closed loop with one set of searches, the fastest.

Bodies move as in the model, so a frame counts more than the usual 0.2, which allows for recordings
whose agents plan otherwise. On videos of the model's own 0.3 is nearly calibrated.
"""

WHY_EVERY: Final = 4  # frames: once a second
_NEAR: Final = 0.05  # how far from a body a ray of sight may end, units
_LIKELY: Final = 0.5
_LATE_EVERY: Final = 1.0  # seconds between readings while it is behind

DID: Final[Mapping[str, str]] = {
    "turnleft": "turned left", "turnright": "turned right", "up": "went forward",
    "down": "went backward", "left": "went left", "right": "went right",
    "upleft": "went forward and left", "upright": "went forward and right",
    "downleft": "went backward and left", "downright": "went backward and right",
    "stop": "stopped", "noforce": "did nothing", "attach": "grabbed", "detach": "let go",
}  # fmt: skip

Said = dict[str, Any]


class Reader:
    """What the model believes of one game."""

    def __init__(self, scene: ppl.Scene) -> None:
        self.scene = scene
        self._watch = ppl.watch(scene, MODEL, event_id="live")
        # by frame and agent, the frame in which it last saw each entity
        self._seen: list[list[list[int | None]]] = []
        self._why: Said | None = None

    def close(self) -> None:
        """End its threads."""
        self._watch.close()

    def take(self, poses: NDArray[np.float64]) -> None:
        """Take in the next frame, (entity, [x, y, angle])."""
        self._watch.take(poses)
        n_agents, frame = len(self.scene.world.agents), len(self._seen)
        before = self._seen[-1] if frame else [[None] * len(poses)] * n_agents
        self._seen.append([list(last) for last in before])
        for agent, last in enumerate(self._seen[-1]):
            sight = ppl.render.field_of_view(self.scene, poses, agent)[1:]
            for entity, (x, y, _) in enumerate(poses):
                reach = np.hypot(*(sight - (x, y)).T).min() if len(sight) else np.inf
                # agents are trapezoids, whose corners are further out than a disc's edge
                size = self.scene.radius[entity] * (1.8 if entity < n_agents else 1.0)
                if entity == agent or reach <= size + _NEAR:
                    last[entity] = frame

    def reading(self, agent: int, frame: int | None = None) -> Said:
        """Return what is believed now, or was after a frame; why, of one agent's goal."""
        post = self._watch.posterior()
        if frame is not None:
            post = post.at(frame)
        rows, weights = post.table, post.table.weights / post.table.weights.sum()

        def shares(name: str) -> list[float]:
            labels = post.quantities[name]
            return np.bincount(rows.values[name], weights, len(labels or ())).round(4).tolist()

        levels = LIKELIHOOD.tracking.strengths
        asked, frame = frame is not None, post.frame
        poses, seen = post.observed()[-1], self._seen[frame]
        held = post.dataset["held"].values[frame].tolist()
        why = self._why
        if asked or frame >= WHY_EVERY + (0 if why is None else why["frame"]):
            why = self._reason(post, agent) if frame else None
            self._why = self._why if asked else why
        return {
            "frame": frame,
            "goals": [shares(name) for name in post.goals_of.values()],
            "relations": {
                " and ".join(pair): shares(name) for pair, name in post.relations_of.items()
            },
            "strengths": [
                [float(weights[rows.values[name] == level].sum().round(4)) for level in levels]
                for name in post.strengths_of.values()
            ],
            "seen": seen,
            "sights": [outline(self.scene, poses, one) for one in range(len(seen))],
            "held": [int(item) if item >= 0 else NOTHING for item in held],
            "why": why,
        }

    def _reason(self, post: ppl.ClosedLoopPosterior, agent: int) -> Said:
        """Return which frames spoke for an agent's likeliest goal over the next one."""
        world = self.scene.world
        name = post.goals_of[world.agents[agent]]
        (goal, _), (other, _) = post.top(name, 2)
        change = post.why(f"{name}={goal}", f"{name}={other}")["change"].values
        deciding = int(change.argmax())
        done = post.dataset["actions"].values[deciding, agent]
        names = post.dataset["action"].values
        return {
            "frame": post.frame,
            "goal": goal,
            "over": other,
            "last": _times(change[-WHY_EVERY:].sum()),
            "deciding": deciding,
            "by": _times(change[deciding]),
            "did": DID[str(names[done.argmax()])] if done.max() > _LIKELY else None,
        }

    def film(self, path: Path) -> str:
        """Write the game with what was believed beside it; return a caption."""
        ppl.watch_film(self._watch.posterior(), path)
        return "The game, and beside it what the model believed at each moment."

    def what_if(self, path: Path, at: int, seconds: float, change: Mapping[str, Any]) -> str:
        """Write a film of what would have happened from a frame on; return that in words.

        Args:
            path: of the film.
            at: frame of the change.
            seconds: simulated time from there.
            change: as of ``do`` of a posterior; none: what comes next, as things are.
        """
        found = self._watch.posterior().do(at=at, seconds=seconds, n=4, workers=1, **change)
        found.film(path)
        return str(found).replace("\n  ", " ")


def _times(nats: float) -> float:
    """Return how many times as probable that is; JSON knows no infinity."""
    return float(np.exp(np.clip(nats, -20.0, 20.0)))


def _made(
    reader: Reader | None, number: int, what: str, given: Mapping[str, Any]
) -> tuple[str, int, str]:
    """Return the answer to "make"; a film that fails ends nothing else."""
    try:
        if reader is None:
            raise ppl.errors.SimulationError("the model cannot read this game")
        return "made", number, getattr(reader, what)(**given)
    except ppl.PhasePPLError as error:
        return "failed", number, str(error)
    except Exception as error:
        traceback.print_exc()
        return "failed", number, f"the film cannot be made: {error}"


def serve(pipe: Connection) -> None:
    """Read what comes through a pipe until it is closed.

    Messages to it: ("begin", game, scene, agent), ("frame", game, poses), ("look", game, frame),
    ("make", number, name of a method, arguments), ("warm up", scene). Messages from it:
    ("reading", game, what is believed), ("broken", game, text), ("made" or "failed", number, text).
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it ends it
    reader, game, agent, said = None, -1, 0, 0.0
    while True:
        try:
            match pipe.recv():
                case ("begin", game, scene, agent):
                    if reader is not None:
                        reader.close()
                    reader = Reader(scene)
                case ("frame", of, poses) if of == game and reader is not None:
                    reader.take(poses)
                    if not pipe.poll() or time.monotonic() - said > _LATE_EVERY:
                        said = time.monotonic()
                        pipe.send(("reading", game, reader.reading(agent)))
                case ("look", of, frame) if of == game and reader is not None:
                    pipe.send(("reading", game, reader.reading(agent, frame)))
                case ("make", number, what, given):
                    pipe.send(_made(reader, number, what, given))
                case ("warm up", scene):
                    with ppl.watch(scene, MODEL) as watch:
                        for _ in range(2):
                            watch.update(scene.start)
        except ppl.PhasePPLError as error:
            if reader is not None:
                reader.close()
            reader = None
            pipe.send(("broken", game, str(error)))
        except (EOFError, OSError):  # the other side has ended
            return


def started() -> tuple[Connection, multiprocessing.process.BaseProcess]:
    """Start a reader; return the other end of its pipe, and the process."""
    # unlike "spawn" it does not run the caller's script again, which needs no guard then
    context = get_context("loky")
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(there,), daemon=True, name="reader")
    process.start()
    there.close()
    return here, process
