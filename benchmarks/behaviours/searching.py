"""Search for an unseen item, with and without the cost of the way (figure of the paper)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from behaviours.battery import Behaviour, Trial, episodes
from behaviours.episode import BLUE, BOTTOM_RIGHT, GREEN, TOP_RIGHT, Episode
from behaviours.layouts import scene
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.world.geometry import agent_outline, heading, is_agent
from phase_ppl.world.hypothesis import Hypothesis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER, NONE = 0.05, 0.0
"""Values of lambda, the weight of the cost."""


def hidden(rng: np.random.Generator, cost_weight: float) -> tuple[Trial]:
    """Return green beside a near room; more of what is unseen lies left, and so does the item."""
    headings = (0.0, rng.uniform(2.6, 3.0))
    where = scene("near room", (8.5, 19.5), (20, 10), (12, 20), (24, 4), rng, headings=headings)
    hypothesis = Hypothesis("Get red agent to blue lm", "Get blue item to red lm")
    return (Trial(where, hypothesis, {"cost_weight": cost_weight}),)


def first_room(episode: Episode) -> int:
    """Return the room that green goes to first."""
    rooms = episode.rooms(GREEN)
    others = rooms[rooms != BOTTOM_RIGHT]
    return int(others[0]) if len(others) else BOTTOM_RIGHT


def near_first(episode: Episode) -> bool:
    return first_room(episode) == TOP_RIGHT


def far_first(episode: Episode) -> bool:
    return first_room(episode) not in (TOP_RIGHT, BOTTOM_RIGHT)


def near_first_then_found(episode: Episode) -> bool:
    return near_first(episode) and bool(episode.holding(GREEN, BLUE).any())


BEHAVIOURS = (
    Behaviour(
        "search_near_first",
        "lambda 0.05: the near room before the far ones",
        lambda rng: hidden(rng, PAPER),
        near_first,
    ),
    Behaviour(
        "search_far_first_without_cost",
        "lambda 0: the larger unseen part before the near room",
        lambda rng: hidden(rng, NONE),
        far_first,
    ),
    Behaviour(
        "search_finds",
        "lambda 0.05: the near room first, then the item is found",
        lambda rng: hidden(rng, PAPER),
        near_first_then_found,
        160,
    ),
)


def figure(path: str, planner: PlannerConfig, seeds: int) -> None:
    """Draw the ways of green for both settings, of the first seed that shows both."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    for seed in range(seeds):
        (with_cost,) = episodes(BEHAVIOURS[2], planner, seed)
        (without,) = episodes(BEHAVIOURS[1]._replace(steps=BEHAVIOURS[2].steps), planner, seed)
        if near_first_then_found(with_cost) and far_first(without):
            break
    picture, axes = plt.subplots(1, 2, figsize=(10, 5.2), layout="constrained")
    runs = ((without, "A", NONE), (with_cost, "B", PAPER))
    for axis, (episode, letter, weight) in zip(axes, runs, strict=True):
        _draw(axis, episode)
        axis.set_title(f"{letter}   $\\lambda = {weight:g}$")
    picture.suptitle("Green wants the blue item on the red landmark, and does not see it at first")
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    picture.savefig(path, dpi=150)
    plt.close(picture)
    print(f"{path}: seed {seed}")


_COLOURS = ("red", "#00b000", "#75d8e6", "#ff9999")
_LANDMARKS = ("#2d2db4", "#329632", "#b42d2d", "#b4b42d")


def _draw(axis: Axes, episode: Episode) -> None:
    """Draw the arena and the ways until the item is delivered; those with it are thin."""
    from matplotlib.patches import Circle, Polygon, Rectangle

    where = episode.scene
    half = where.landmark_half_width
    for centre, colour in zip(where.landmark_centres, _LANDMARKS, strict=True):
        axis.add_patch(Rectangle(centre - half, 2 * half, 2 * half, color=colour, alpha=0.35, lw=0))
    for start, end in [*where.walls, *where.border]:
        axis.plot(*np.transpose([start, end]), color="black", lw=3)
    for entity, (pose, radius) in enumerate(zip(where.start, where.radius, strict=True)):
        outline = agent_outline(pose, radius) if is_agent(entity) else None
        shape = Circle(pose[:2], radius) if outline is None else Polygon(outline)
        shape.set_color(_COLOURS[entity])
        axis.add_patch(shape)
    grabbed = _first(episode.holding(GREEN, BLUE))
    delivered = _first(episode.is_on(BLUE, BOTTOM_RIGHT))
    track = episode.frames[:, GREEN]
    axis.plot(*track[: grabbed + 1, :2].T, color=_COLOURS[GREEN], lw=2.5)
    axis.plot(*track[grabbed : delivered + 1, :2].T, color=_COLOURS[GREEN], lw=1, ls=":")
    for number, frame in enumerate(np.linspace(0, grabbed, 6).round().astype(int), 1):
        x, y, angle = track[frame]
        axis.plot(x, y, "o", ms=13, mfc="white", mec=_COLOURS[GREEN])
        axis.text(x, y, str(number), ha="center", va="center", fontsize=8)
        axis.annotate(
            "",
            (x, y) + 2.2 * heading(angle),
            (x, y),
            arrowprops={"arrowstyle": "->", "color": _COLOURS[GREEN]},
            zorder=1,
        )
    x0, x1, y0, y1 = where.arena
    axis.set(xlim=(x0 - 0.2, x1 + 0.2), ylim=(y0 - 0.2, y1 + 0.2), aspect="equal")
    axis.axis("off")


def _first(when: NDArray[np.bool_]) -> int:
    """Return the first step of which something is true, or the last step."""
    return int(np.argmax(when)) if when.any() else len(when) - 1
