"""Live games: does the model find what a player wants, and how soon does it say so?

The planner plays in a real browser: it decides from what its agent sees, and presses keys.

    python benchmarks/live.py [--plays N] [--json FILE]
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Final

import common
import numpy as np
from study_rooms import shares
from tqdm import tqdm

import phase_ppl as ppl
from phase_study.live import Live
from phase_study.simulate import serving
from tests.browser import running_browser
from tests.simulator.toys import wait_until

KEYS: Final[Mapping[ppl.Action, str]] = {
    ppl.Action.UP: "w", ppl.Action.UP_LEFT: "w", ppl.Action.UP_RIGHT: "w",
    ppl.Action.DOWN: "s", ppl.Action.DOWN_LEFT: "s", ppl.Action.DOWN_RIGHT: "s",
    ppl.Action.LEFT: "a", ppl.Action.RIGHT: "d",
    ppl.Action.TURN_LEFT: "q", ppl.Action.TURN_RIGHT: "e",
    ppl.Action.ATTACH: " ", ppl.Action.DETACH: " ",
}  # fmt: skip
"""Keys that come nearest to the planner's actions; for the others none is pressed."""


def wait(page: Any, script: str, seconds: float) -> None:
    """Wait until a script is true in the page (AssertionError: it was not in time)."""
    wait_until(lambda: page.evaluate(f"Boolean({script})"), seconds)


def goal_for(scene: ppl.Scene, rng: np.random.Generator) -> str:
    """Return a goal to bring somebody to a landmark, who is not near it yet."""
    goals = []
    for entity in (0, 2, 3):
        for landmark, place in zip(scene.world.landmarks, scene.landmark_centres, strict=True):
            if np.hypot(*(scene.start[entity, :2] - place)) > 8:
                goals.append(f"Get {scene.world.entities[entity]} to {landmark.name}")
    return str(rng.choice(goals))


def played(live: Live, page: Any, rng: np.random.Generator, seconds: float = 75) -> dict[str, Any]:
    """Play a game; return how it went."""
    ways = "live.begin({{ {} }})"
    game = page.evaluate("live.games")
    page.evaluate(ways.format("new_scene: true"))
    wait(page, f"live.games > {game} && live.view.frames.length && live.state === 'waiting'", 20)
    goal = goal_for(live.room.scene, rng)
    page.evaluate(ways.format(f"goal: {goal!r}"))
    wait(
        page, f"live.games > {game} + 1 && live.view.frames.length && live.state === 'waiting'", 20
    )
    room, down, frame = live.room, "", 0
    player = room.stage.planned(0, room.goals, rng.spawn(1)[0])
    until = time.monotonic() + seconds
    while time.monotonic() < until and not page.evaluate("live.state === 'paused'"):
        if (now := page.evaluate("live.reads.length")) == frame:
            time.sleep(0.02)
            continue
        frame, key = now, KEYS.get(player.decide(), "")
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
    live = Live("PHASE", given.seed)
    with serving(live) as address, running_browser() as browser:
        page = browser.new_page()
        page.goto(address)
        wait(page, "window.live?.readings.length", 180)
        for _ in tqdm(range(given.plays), "plays", disable=None):
            rows.append(played(live, page, rng))
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
