"""What an agent believes and where it looks (paper, Appendix C: belief update, value function)."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from phase_ppl.analysis.figures.posterior import draw_arena, draw_entity
from phase_ppl.analysis.figures.style import NORMAL, figure_of, in_style, new_figure, written
from phase_ppl.data.motion import items_held
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.errors import InvalidSettingError, whole_number
from phase_ppl.world.event import FRAMES_PER_SECOND, Event, State
from phase_ppl.world.geometry import heading
from phase_ppl.world.hypothesis import STRENGTH_RANGE, Hypothesis
from phase_ppl.world.names import AGENTS, ENTITIES, NOTHING
from phase_ppl.world.scene import PHASE, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PARTICLES: Final = 10  # K in the figure of the paper
_DARK: Final = 0.35
_FAINT: Final = 0.55
_APART: Final = 4.0  # distance between particles, units, from which a place counts as unknown


class Belief(NamedTuple):
    """What an agent sees and believes in a frame."""

    visible: BoolArray  # (cells,) in view, row after row from the top left
    observed: BoolArray  # (entity,) whether the agent sees or feels it
    particles: FloatArray  # (particle, entity, coord) x, y [units], angle [rad]


def beliefs_of(event: Event, agent: int) -> Iterator[Belief]:
    """Yield an agent's view and belief in each frame of an event.

    It is the belief of the simulator's agents, given the true states as far as the observation
    shows them. Between frames the agent is assumed to coast.
    """
    from phase_ppl.agents.beliefs import Perception
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.agents.world_model import WorldModel
    from phase_ppl.physics.actions import Action
    from phase_ppl.physics.compiled import from_state, to_state

    scene, frames = event.scene, event.observation.trajectory
    config = dataclasses.replace(PlannerConfig.fast(), particles=_PARTICLES)
    strength = float(np.mean(STRENGTH_RANGE))
    model = WorldModel.of(scene, (strength, strength), config)
    perception = Perception(agent, model, config, np.random.default_rng(0))
    moved = np.diff(frames, axis=0, prepend=frames[:1]) * FRAMES_PER_SECOND
    held = items_held(frames, scene.radius)
    for poses, rates, items in zip(frames, moved, held, strict=True):
        state = State(poses, rates[:, :2], rates[:, 2], items, np.zeros((len(AGENTS), 3)))
        perception.observe(*from_state(state, scene.radius))
        perception.acted(Action.NO_FORCE)
        found = perception.beliefs
        poses_of_all = [
            to_state(*one, scene.radius).pose
            for one in zip(found.bodies, found.held, found.weld, strict=True)
        ]
        yield Belief(found.visible.copy(), found.observed.copy(), np.array(poses_of_all))


def discovery(found: Sequence[Belief]) -> int | None:
    """Return the first frame in which an agent sees an entity whose place it did not know.

    The entity was not seen in the frame before, and particles had it in different places. None:
    there is no such frame.
    """
    for frame, (before, after) in enumerate(itertools.pairwise(found), 1):
        spread = np.ptp(before.particles[..., :2], axis=0).max(axis=-1)
        if (after.observed & ~before.observed & (spread > _APART)).any():
            return frame
    return None


@figure_of(Event)
def beliefs(
    event: Event,
    agent: str = "red agent",
    path: str | os.PathLike[str] | None = None,
    *,
    frame: int | None = None,
) -> Figure:
    """Draw an agent's belief before and after a frame: what it sees, all particles, one particle.

    A particle is a possible state of the world that agrees with what the agent has seen. There are
    K = 10 particles, as in the paper's figure. The truth is not used.

    Args:
        event: an event of PHASE.
        agent: name of the agent.
        path: file to write the figure to as well (.png, .pdf, .svg).
        frame: the frame in the lower row; the upper row has the frame before. By default the first
            frame in which the agent sees something new.

    Raises:
        UnknownNameError: there is no such agent.
        InvalidSettingError: there is no such frame, or the agent never sees anything new.
    """
    who = PHASE.agent(agent)
    found = list(beliefs_of(event, who))
    if frame is None:
        frame = discovery(found)
        if frame is None:
            raise InvalidSettingError(f"the {agent} of {event.id} sees nothing new: give a frame")
    whole_number("frame", frame, 1, len(found) - 1)
    observed = found[frame].observed
    new = [f"the {ENTITIES[e]}" for e in np.flatnonzero(observed & ~found[frame - 1].observed)]
    told = f"In the lower row it sees {' and '.join(new)}: " if new else ""
    figure = new_figure(
        *(8.4, 6.4),
        note=f"{told}entities in view have their true properties in all particles; others move on "
        "as they did, or are drawn anew where they contradict what is seen.",
    )
    panels = figure.subplots(2, 3)
    radius, truth = event.scene.radius, event.observation.trajectory
    titles = f"true state, and what the {agent} sees", f"all {_PARTICLES} particles", "one of them"
    for axes, title, letter in zip(panels[0], titles, "ABC", strict=True):
        axes.set_title(f"{letter}  {title}", fontsize=NORMAL)
    # the particle whose unseen entities moved farthest
    moved = np.linalg.norm((found[frame].particles - found[frame - 1].particles)[..., :2], axis=-1)
    one = int(moved[:, ~observed].max(axis=1, initial=0).argmax())
    x0, _, _, y1 = event.scene.arena
    for row, now in zip(panels, (frame - 1, frame), strict=True):
        belief = found[now]
        for axes in row:
            draw_arena(axes, event.scene)
        side = round(len(belief.visible) ** 0.5)
        shade = np.zeros((side, side, 4))  # of the cells that are not in view
        shade[..., 3] = np.where(belief.visible.reshape(side, side), 0.0, _DARK)
        extent = (x0, x0 + side, y1 - side, y1)
        row[0].imshow(shade, extent=extent, zorder=2, interpolation="nearest")
        for entity in range(len(ENTITIES)):
            draw_entity(row[0], entity, truth[now, entity], radius[entity])
            seen = bool(belief.observed[entity])
            for pose in belief.particles[:1] if seen else belief.particles:
                draw_entity(row[1], entity, pose[entity], radius[entity], 0.9 if seen else _FAINT)
            draw_entity(row[2], entity, belief.particles[one, entity], radius[entity])
        name = f"{now / FRAMES_PER_SECOND:.2f} s"
        row[0].text(0.02, 0.5, name, transform=row[0].transAxes, rotation=90, va="center",
                    ha="right", fontsize=NORMAL)  # fmt: skip
    return written(figure, path)


# --- searching for what is not seen ---------------------------------------------------------------

_SEARCH: Final[dict[str, Any]] = {
    "walls": (10.0, 5.0, 0.0, 7.5),
    "start": [[8.5, 19.5, 0.0], [20.0, 10.0, 2.8], [12.0, 20.0, 0.0], [24.0, 4.0, 0.0]],
    "goals": ("Get red agent to blue lm", "Get blue item to red lm"),
}
"""A scene in which green does not see the blue item. The item and most of the unseen area lie on
the left; a room close to green lies above. Walls go up, left, down, right."""

_SIZE: Final = 0.8
_STEPS: Final = 100
_STATIONS: Final = 6
_COST_WEIGHTS: Final = (0.0, 0.05)


@in_style
def search(path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the green agent's search for an item, under the paper's weights lambda of path cost.

    The scene is fixed. ``path``: file to write the figure to as well (.png, .pdf, .svg).
    """
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.data.generation.situation import walls_of_lengths
    from phase_ppl.simulator.joint import simulate

    walls = walls_of_lengths(_SEARCH["walls"])
    scene = Scene(np.array(_SEARCH["start"]), np.full(len(ENTITIES), _SIZE), walls)
    hypothesis = Hypothesis(*_SEARCH["goals"])
    figure = new_figure(
        *(3.6 * len(_COST_WEIGHTS), 3.9),
        note="The green agent wants the blue item, which it does not see. Numbers: moments in "
        "order; arrows: where it looks.",
    )
    green = AGENTS.index("green agent")
    panels = figure.subplots(1, len(_COST_WEIGHTS))
    for axes, weight, letter in zip(panels, _COST_WEIGHTS, "AB", strict=True):
        config = dataclasses.replace(PlannerConfig.fast(), cost_weight=weight)
        event = simulate(scene, hypothesis, frames=_STEPS, seed=0, planner=config)
        frames = event.observation.trajectory
        holds = items_held(frames, scene.radius)[:, green] != NOTHING
        end = int(holds.argmax()) if holds.any() else len(frames) - 1
        draw_arena(axes, scene)
        for entity in range(len(ENTITIES)):
            draw_entity(axes, entity, frames[0, entity], _SIZE)
        axes.plot(*frames[: end + 1, green, :2].T, color="#00a000", lw=2, zorder=4)
        for number, frame in enumerate(np.linspace(0, end, _STATIONS).round().astype(int), 1):
            x, y, angle = frames[frame, green]
            ahead = np.array([x, y]) + 2 * heading(angle)
            axes.annotate("", ahead, (x, y), arrowprops={"arrowstyle": "->"}, zorder=4)
            axes.plot(x, y, "o", ms=10, mfc="white", mec="#00a000", zorder=5)
            axes.text(x, y, str(number), ha="center", va="center", zorder=6)
        axes.set_title(f"{letter}  \N{GREEK SMALL LETTER LAMDA} = {weight:g}", loc="center")
    return written(figure, path)
