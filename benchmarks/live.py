"""Live games: does the model find what a scripted player wants, and how soon does it say so?

A script plays in a real browser: it reads what the page shows of the past, and presses keys. It
turns towards the next place on its way, drives there, grabs and carries.

    python benchmarks/live.py [--plays N] [--json FILE]
"""

from __future__ import annotations

import math
import time
from typing import Any, Final

import common
import numpy as np
from numpy.typing import NDArray
from study_rooms import shares
from tqdm import tqdm

import phase_ppl as ppl
from phase_study.live import Live
from phase_study.simulate import serving
from tests.browser import running_browser
from tests.simulator.toys import wait_until

LOOKS: Final = 24  # directions that a script considers
_STEP: Final = 1.5  # units that it looks ahead
_FACING: Final = 0.5  # rad off its way at which a script still drives


class Script:
    """Somebody who pursues a goal of PHASE by keys, and sees everything."""

    def __init__(self, scene: ppl.Scene, goal: str, agent: int = 0) -> None:
        self.scene, self.agent = scene, agent
        self.literal = ppl.goals.goal_literal(goal, agent, scene.world)
        if not self.literal.positive:
            raise ValueError(f"{goal}: scripts go to something, not away from it")

    def key(self, poses: NDArray[np.float64], held: int) -> str | None:
        """Return the key to hold now; None: none."""
        subject, target = self.literal.subject, self.literal.target
        on_landmark = self.literal.predicate.name == "ON"
        if ppl.goals.is_true(self.literal, poses, self.scene):
            return None
        if subject != self.agent:
            if held != subject:
                apart = np.hypot(*(poses[subject] - poses[self.agent])[:2])
                near = apart < self.scene.radius[[subject, self.agent]].sum() + 0.25
                if near and self._off(poses, poses[subject, :2]) < 0.5:
                    return "grab"
                return self._towards(poses, poses[subject, :2])
            return self._towards(poses, self.scene.landmark_centres[target])
        place = self.scene.landmark_centres[target] if on_landmark else poses[target, :2]
        return self._towards(poses, place)

    def _off(self, poses: NDArray[np.float64], place: NDArray[np.float64]) -> float:
        dx, dy = place - poses[self.agent, :2]
        return abs(_turn(math.atan2(dy, dx) - (poses[self.agent, 2] + math.pi / 2)))

    def _towards(self, poses: NDArray[np.float64], place: NDArray[np.float64]) -> str:
        """Turn to the direction that brings it nearest, walls and bodies in mind; drive there."""
        here, size = poses[self.agent, :2], float(self.scene.radius[self.agent])
        x0, x1, y0, y1 = self.scene.arena
        best, way = math.inf, 0.0
        for look in range(LOOKS):
            angle = 2 * math.pi * look / LOOKS
            there = here + _STEP * np.array([math.cos(angle), math.sin(angle)])
            distance = self.scene.rooms.path_distance  # far, where a wall is between
            length = float(distance(here, there) + distance(there, place))
            clear = min((_from_segment(wall, there) for wall in self.scene.walls), default=9.0)
            edge = min(there[0] - x0, x1 - there[0], there[1] - y0, y1 - there[1])
            for gap in (clear, edge):
                length += 3 * max(0.0, 1.3 * size - gap)
            if length < best:
                best, way = length, angle
        off = _turn(way - (poses[self.agent, 2] + math.pi / 2))
        if abs(off) < _FACING:
            return "forward"
        return "turn left" if off > 0 else "turn right"


def _turn(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


def _from_segment(wall: NDArray[np.float64], place: NDArray[np.float64]) -> float:
    start, way = wall[0], wall[1] - wall[0]
    along = np.clip(np.dot(place - start, way) / np.dot(way, way), 0, 1)
    return float(np.hypot(*(place - start - along * way)))


NAMES: Final = {"forward": "w", "turn left": "q", "turn right": "e", "grab": " "}


def wait(page: Any, script: str, seconds: float) -> None:
    """Wait until a script is true in the page (AssertionError: it was not in time)."""
    wait_until(lambda: page.evaluate(f"Boolean({script})"), seconds)


def scene_of(page: Any) -> ppl.Scene:
    """Return the scene of the game on show."""
    told = page.evaluate("({ ...live.scene, start: live.reads[0] })")
    return ppl.Scene(np.array(told["start"]), np.array(told["radius"]), np.array(told["walls"]))


def goal_for(scene: ppl.Scene, rng: np.random.Generator) -> str:
    """Return a goal to bring somebody to a landmark, who is not near it yet."""
    goals = []
    for entity in (0, 2, 3):
        for landmark, place in zip(scene.world.landmarks, scene.landmark_centres, strict=True):
            if np.hypot(*(scene.start[entity, :2] - place)) > 8:
                goals.append(f"Get {scene.world.entities[entity]} to {landmark.name}")
    return str(rng.choice(goals))


def played(page: Any, rng: np.random.Generator, seconds: float = 75) -> dict[str, Any]:
    """Play a game; return how it went."""
    ways = "live.begin({{ {} }})"
    game = page.evaluate("live.games")
    page.evaluate(ways.format("new_scene: true"))
    wait(page, f"live.games > {game} && live.view.frames.length && live.state === 'waiting'", 20)
    scene = scene_of(page)
    goal = goal_for(scene, rng)
    page.evaluate(ways.format(f"goal: {goal!r}"))
    wait(
        page, f"live.games > {game} + 1 && live.view.frames.length && live.state === 'waiting'", 20
    )
    script, down, frame = Script(scene, goal), "", -1
    until = time.monotonic() + seconds
    while time.monotonic() < until and not page.evaluate("live.state === 'paused'"):
        poses, held, now = page.evaluate(
            "[live.reads.at(-1), live.view.frames.at(-1).held[0], live.reads.length]"
        )
        if now == frame:
            time.sleep(0.02)
            continue
        frame, key = now, NAMES.get(script.key(np.array(poses), held) or "", "")
        if frame == 1:
            key = key or "q"  # some key begins
        if (down and key != down) or down == " ":
            page.keyboard.up(down)
            down = ""
        if key and key != down:
            page.keyboard.down(key)
            down = key
    if down:
        page.keyboard.up(down)
    reached = page.evaluate("live.state === 'paused'")
    if not reached:
        page.evaluate("live.toggle()")
    wait(page, "live.readings.length === live.reads.length", 60)
    place = page.evaluate(f"live.choices.goals.indexOf({goal!r})")
    found = page.evaluate(f"live.readings.at(-1).goals[0][{place}]")
    lags = page.evaluate("[live.reads.length, live.readings.filter(Boolean).length]")
    return {"goal": goal, "reached": reached, "p": found, "frames": lags[0], "read": lags[1]}


def main() -> None:
    """Play, and say what was found."""
    options = common.parser(__doc__, "json")
    options.add_argument("--plays", type=int, default=10, metavar="N", help="default 10")
    options.add_argument("--seed", type=int, default=0, metavar="N", help="default 0")
    given = options.parse_args()
    rng, rows = np.random.default_rng(given.seed), []
    with serving(Live("PHASE", given.seed)) as address, running_browser() as browser:
        page = browser.new_page()
        page.goto(address)
        wait(page, "window.live?.readings.length", 180)
        for _ in tqdm(range(given.plays), "plays", disable=None):
            rows.append(played(page, rng))
            print(rows[-1], flush=True)
        times = page.evaluate("live.latency")
    report = {
        "plays": rows,
        "found": sum(row["p"] >= 0.9 for row in rows),
        "milliseconds": {name: shares(some, 1.0) for name, some in times.items() if some},
    }
    print(f"P >= 0.9 in {report['found']} of {len(rows)}; {report['milliseconds']}")
    common.write(report, given.json)


if __name__ == "__main__":
    main()
