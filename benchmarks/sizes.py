"""What do a decision and a frame cost, by the agents and goals of a world?

    python benchmarks/sizes.py [--scenes N] [--frames N] [--figure FILE] [--json FILE]

Worlds have 1 to 4 agents, two items and three landmarks, or two agents and 1 to 8 landmarks. Each
random scene gets a hypothesis from ``ppl.roles.draw``. A decision is one step of one agent, by the
fast planner. A frame is read with one set of searches. Figures are CPU milliseconds without each
world's first scene, in which code is compiled. Beside them stands the number of combinations of
goals, with which cost should not grow.
"""

from __future__ import annotations

import time
from typing import Any

import common
import numpy as np
from matplotlib.ticker import NullLocator
from tqdm import tqdm

import phase_ppl as ppl
from phase_ppl.analysis.figures.style import COLOURS, in_style, new_figure, written

AGENTS = ("red agent", "green agent", "purple agent", "orange agent")
PLACES = [(4, 4), (32, 20), (4, 20), (32, 4), (18, 4), (18, 20), (4, 12), (32, 12)]
WALLS = [((12, 0), (12, 7)), ((12, 13), (12, 24)), ((24, 0), (24, 7)), ((24, 13), (24, 24))]
SIZES = [(agents, 3) for agents in (1, 2, 3, 4)] + [(2, landmarks) for landmarks in (1, 5, 8)]


def world_of(agents: int, landmarks: int) -> ppl.World:
    """Return a world of three rooms."""
    places = {f"place {i + 1}": PLACES[i] for i in range(landmarks)}
    return ppl.World(
        AGENTS[:agents], ["ball", "box"], places, arena=(0, 36, 0, 24), walls=WALLS,
        half_width=2.0, name=f"{agents} agents, {landmarks} landmarks",
    )  # fmt: skip


def measure(agents: int, landmarks: int, scenes: int, frames: int) -> dict[str, Any]:
    """Return what one size of world costs, in CPU milliseconds."""
    world = world_of(agents, landmarks)
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1))
    decisions, read, searches = [], [], []
    for seed in range(scenes + 1):
        roles = ppl.roles.draw(world, seed)
        began = time.process_time()
        event = ppl.simulate(world.random_scene(seed), roles, frames=frames, seed=seed)
        simulated = time.process_time()
        post = ppl.infer(event, model, seed=seed, progress=False)
        ended = time.process_time()
        if seed:
            decisions.append((simulated - began) / (agents * (frames - 1)))
            read.append((ended - simulated) / (frames - 1))
            searches.append(post.cost["searches"] / (frames - 1))
    return {
        "agents": agents,
        "landmarks": landmarks,
        "goals": len(world.goals),
        "combinations": float(len(world.goals)) ** agents,
        "decision_ms": 1000 * float(np.median(decisions)),
        "frame_ms": 1000 * float(np.median(read)),
        "searches": float(np.median(searches)),
    }


@in_style
def draw(rows: list[dict[str, Any]], path: str) -> None:
    """Draw cost against agents and against goals."""
    by_agents = [row for row in rows if row["landmarks"] == SIZES[0][1]]
    by_goals = sorted((row for row in rows if row["agents"] == 2), key=lambda row: row["goals"])
    figure = new_figure(7.0, 2.8)
    for axes, of, across, label in zip(
        figure.subplots(1, 2, sharey=True),
        (by_agents, by_goals),
        ("agents", "goals"),
        ("agents (three landmarks)", "goals of an agent (two agents)"),
        strict=True,
    ):
        x = [row[across] for row in of]
        for name, words, colour in (
            ("frame_ms", "a frame of the closed loop, ms", COLOURS[0]),
            ("decision_ms", "a decision, ms", COLOURS[1]),
            ("searches", "searches for a frame", COLOURS[2]),
        ):
            axes.plot(x, [row[name] for row in of], "o-", ms=3, color=colour, label=words)
        axes.plot(
            x, [row["combinations"] for row in of], ":", color="#777777",
            label="combinations of goals",
        )  # fmt: skip
        axes.set(yscale="log", xlabel=label, xticks=x)
        axes.yaxis.set_major_formatter("{x:,g}")
        axes.yaxis.set_minor_locator(NullLocator())
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
    written(figure, path)


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--figure", metavar="FILE")
    options = parser.parse_args()
    rows = []
    for agents, landmarks in tqdm(SIZES, disable=None):
        rows.append(measure(agents, landmarks, options.scenes, options.frames))
        print(
            "{agents} agents, {goals:3d} goals, {combinations:9.3g} combinations: a decision "
            "{decision_ms:5.1f} ms, a frame {frame_ms:6.0f} ms and {searches:4.0f} searches".format(
                **rows[-1]
            ),
            flush=True,
        )
    if options.figure:
        draw(rows, options.figure)
    common.write({"sizes": rows}, options.json)


if __name__ == "__main__":
    main()
