"""How an agent's belief changes with what it sees (paper, Appendix C, figure of belief update)."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from phase_ppl.analysis.figures.posterior import draw_arena, draw_entity
from phase_ppl.analysis.figures.style import GREY, NORMAL, SMALL, figure_of, new_figure, written
from phase_ppl.dataset.motion import items_held
from phase_ppl.world.arrays import BoolArray, FloatArray
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, unknown_name
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.names import AGENTS, ENTITIES
from phase_ppl.world.observation import FRAMES_PER_SECOND, State

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PAPERS_PARTICLES: Final = 10
_DARK: Final = 0.35
_FAINT: Final = 0.55
_MOST_PARTICLES: Final = 1000


class Belief(NamedTuple):
    """What an agent sees and believes in a frame.

    Attributes:
        visible: (cells,) in view, row after row from the top left.
        observed: (entity,) whether the agent sees or feels it.
        particles: (particle, entity, coord) x, y [units], angle [rad].
    """

    visible: BoolArray
    observed: BoolArray
    particles: FloatArray


def beliefs_of(event: Event, agent: int, particles: int, seed: int = 0) -> Iterator[Belief]:
    """Yield what an agent sees and believes in each frame of an event.

    It is what the simulator's agents believe, given the true states as far as they can be read
    off the observation; in between the agent is taken to coast.

    Args:
        event: what happens.
        agent: 0 red, 1 green.
        particles: K.
        seed: of the particles.
    """
    from phase_ppl.agents.beliefs import Perception
    from phase_ppl.agents.config import PlannerConfig
    from phase_ppl.agents.world_model import WorldModel
    from phase_ppl.physics.actions import Action
    from phase_ppl.physics.compiled import from_state, to_state

    scene, frames = event.scene, event.observation.trajectory
    config = dataclasses.replace(PlannerConfig.fast(), particles=particles)
    strength = float(np.mean(STRENGTH_RANGE))
    model = WorldModel.of(scene, (strength, strength), config)
    perception = Perception(agent, model, config, np.random.default_rng(seed))
    moved = np.diff(frames, axis=0, prepend=frames[:1]) * FRAMES_PER_SECOND
    held = items_held(frames, scene.radius)
    for poses, rates, items in zip(frames, moved, held, strict=True):
        state = State(poses, rates[:, :2], rates[:, 2], items, np.zeros((len(AGENTS), 3)))
        perception.observe(*from_state(state, scene.radius))
        perception.done(Action.NO_FORCE)
        found = perception.beliefs
        poses_of_all = [
            to_state(*one, scene.radius).pose
            for one in zip(found.bodies, found.held, found.weld, strict=True)
        ]
        yield Belief(found.visible.copy(), found.observed.copy(), np.array(poses_of_all))


def _discovery(found: list[Belief]) -> int | None:
    """Return the first frame after the start in which something is seen that was not before."""
    for frame in range(1, len(found)):
        if (found[frame].observed & ~found[frame - 1].observed).any():
            return frame
    return None


@figure_of(Event)
def beliefs(
    event: Event,
    agent: str = "red agent",
    path: str | os.PathLike[str] | None = None,
    *,
    frame: int | None = None,
    particles: int = _PAPERS_PARTICLES,
    seed: int = 0,
) -> Figure:
    """Draw an agent's belief before and after a frame: what it sees, all particles, one of them.

    Args:
        event: what happens; the truth is not used.
        agent: whose belief.
        path: where to write the figure as well.
        frame: the second of the two; by default the first in which it sees something new.
        particles: K; 10 in the paper's figure.
        seed: of the particles.

    Raises:
        UnknownNameError: there is no such agent.
        InvalidSettingError: there is no such frame, or nothing new is ever seen.
    """
    if agent not in AGENTS:
        raise unknown_name("agent", agent, AGENTS)
    whole_number("particles", particles, maximum=_MOST_PARTICLES)
    whole_number("seed", seed, 0)
    who = AGENTS.index(agent)
    found = list(beliefs_of(event, who, particles, seed))
    if frame is None:
        frame = _discovery(found)
        if frame is None:
            raise InvalidSettingError(f"the {agent} of {event.id} sees nothing new: give a frame")
    whole_number("frame", frame, 1, len(found) - 1)
    figure = new_figure(8.4, 6.4, "constrained")
    panels = figure.subplots(2, 3)
    radius, truth = event.scene.radius, event.observation.trajectory
    titles = f"true state, and what the {agent} sees", f"all {particles} particles", "one of them"
    for axes, title, letter in zip(panels[0], titles, "ABC", strict=True):
        axes.set_title(f"{letter}  {title}", fontsize=NORMAL, loc="left")
    one = _resampled(found[frame - 1], found[frame])
    for row, now in zip(panels, (frame - 1, frame), strict=True):
        belief = found[now]
        for axes in row:
            draw_arena(axes, event.scene)
        _darken(row[0], event, belief.visible)
        for entity in range(len(ENTITIES)):
            draw_entity(row[0], entity, truth[now, entity], radius[entity])
            seen = bool(belief.observed[entity])
            for pose in belief.particles[:1] if seen else belief.particles:
                draw_entity(row[1], entity, pose[entity], radius[entity], 0.9 if seen else _FAINT)
            draw_entity(row[2], entity, belief.particles[one, entity], radius[entity])
        name = f"{now / FRAMES_PER_SECOND:.2f} s"
        row[0].text(0.02, 0.5, name, transform=row[0].transAxes, rotation=90, va="center",
                    ha="right", fontsize=NORMAL)  # fmt: skip
    new = [ENTITIES[e] for e in np.flatnonzero(found[frame].observed & ~found[frame - 1].observed)]
    seen = (
        f"In the lower row it sees {' and '.join(f'the {name}' for name in new)}: " if new else ""
    )
    figure.supxlabel(
        f"{seen}entities in view have their true properties in all particles; others move on as "
        "they did, or are drawn anew where they contradict what is seen.",
        fontsize=SMALL, color=GREY, wrap=True,
    )  # fmt: skip
    return written(figure, path)


def _resampled(before: Belief, after: Belief) -> int:
    """Return the particle whose unseen entities moved farthest."""
    moved = np.linalg.norm((after.particles - before.particles)[..., :2], axis=-1)
    return int(moved[:, ~after.observed].max(axis=1, initial=0).argmax())


def _darken(axes: Axes, event: Event, visible: BoolArray) -> None:
    """Darken the cells that are not in view."""
    x0, _, _, y1 = event.scene.arena
    side = round(len(visible) ** 0.5)
    shade = np.zeros((side, side, 4))
    shade[..., 3] = np.where(visible.reshape(side, side), 0.0, _DARK)
    axes.imshow(shade, extent=(x0, x0 + side, y1 - side, y1), zorder=2, interpolation="nearest")
