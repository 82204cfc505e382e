"""The figure of a posterior, in the colours of the world."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.estimate import Estimate
from phase_ppl.analysis.figures.style import (
    COLOURS,
    INK,
    NORMAL,
    SMALL,
    bare,
    dressed,
    figure_of,
    new_figure,
    written,
)
from phase_ppl.analysis.hypotheses import GOALS_OF
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.checks import instance_of
from phase_ppl.world.errors import InvalidSettingError, shown
from phase_ppl.world.geometry import agent_outline, is_agent
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.scene import PHASE, World, check_is_phase

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.analysis.event_posterior import EventPosterior
    from phase_ppl.analysis.hypotheses import Hypotheses
    from phase_ppl.world.scene import Scene

Colour = tuple[float, float, float]

_SHADE: Final = (0.82, 0.68, 0.72, 0.86)
"""Per entity of PHASE, how far its colour is kept when a line needs contrast with white."""
_ANY_SHADE: Final = 0.75  # of others

_ALONE: Final = ("relation", "scenario")  # need not be named beside their labels
_DASHED: Final = (0, (3.2, 1.8))
_N_GOALS_SHOWN: Final = 6
_SIDE_BY_SIDE: Final = 3
_MOVED: Final = 0.05
"""Extent of a track, units, from which on it is drawn."""

_ROOM_FOR_NAMES: Final = 1.3
"""Strip above and below the arena that holds the landmarks' names, units."""


@figure_of(Posterior, StepwisePosterior)
def posterior(
    post: Posterior | StepwisePosterior, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw goals, relation, scenario, tracks and strengths on one page.

    10 x 6 inches; higher where there are more agents than two.

    Tracks: observed (solid) and, of a posterior by simulation, of the best hypothesis' stored
    simulation (dashed), see :meth:`phase_ppl.analysis.posterior.Posterior.replay`.
    """
    world = post.scene.world
    related = [*post.relations_of, *post.scenarios_of]
    heights = [6.0] * len(world.agents) + ([0.4 + 3.5 * len(related)] if related else [])
    figure = new_figure(10, max(4.0, 6 * sum(heights) / 19.4), "constrained")
    figure.suptitle(post.event_id, x=0.012, ha="left", fontsize=10, color=INK)
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1, 1))[0]
    panels = list(left.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0])
    for axes, (agent, name) in zip(panels, post.goals_of.items(), strict=False):
        entries = [(goal, value) for goal, value in post.top(name, _N_GOALS_SHOWN) if value > 0]
        _bars(axes, entries, _line_colour(world, world.agent(agent)))
        axes.set_ylim(_N_GOALS_SHOWN - 0.4, -0.6)
        axes.set_title(f"Goal of the {agent}", fontsize=NORMAL + 1, loc="left", color=INK)
    if related:
        _relation_bars(panels[-1], post)
    agents = list(post.strengths_of)
    parts = right.subplot_mosaic([["tracks"] * len(agents), agents], height_ratios=(5.6, 1))
    _tracks(parts["tracks"], post)
    for agent, name in post.strengths_of.items():
        _strength_histogram(parts[agent], post, name, agent)
    lettered = [panels[0], *panels[len(agents) :], parts["tracks"], parts[agents[0]]]
    for letter, axes in zip("abcd", lettered, strict=False):
        axes.annotate(
            letter, (0, 1), (-14, 5), xycoords="axes fraction", textcoords="offset points",
            fontsize=11, fontweight="bold", color=INK, annotation_clip=False,
        )  # fmt: skip
    return written(figure, path)


def posteriors(
    posts: Mapping[str, Posterior | StepwisePosterior], path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw goals and relation of several posteriors side by side, 7.5 inches wide.

    ``posts`` has what each is called, such as the name of its prior or likelihood.

    Raises:
        InvalidSettingError: there is none, something else among them, or one of another world.
    """
    if not isinstance(posts, Mapping) or not posts:
        raise InvalidSettingError(f"posteriors of {shown(posts)}, expected names -> posteriors")
    for name, post in posts.items():
        instance_of(f"posteriors[{name!r}]", post, (Posterior, StepwisePosterior), "a posterior")
        check_is_phase(post.scene.world, "posteriors side by side")
    tops = {q: [label for p in posts.values() for label, share in p.top(q, _SIDE_BY_SIDE) if share]
            for q in (*GOALS_OF.values(), "relation")}  # fmt: skip
    labels = {quantity: list(dict.fromkeys(found)) for quantity, found in tops.items()}
    rows = [len(found) for found in labels.values()]
    figure = new_figure(7.5, 1.2 + sum(rows) * (0.12 + 0.11 * len(posts)), "constrained")
    titles = (*(f"Goal of the {agent}" for agent in GOALS_OF), "Relation")
    panels = figure.subplots(3, 1, height_ratios=[n + 1 for n in rows])
    for axes, (quantity, found), title in zip(panels, labels.items(), titles, strict=True):
        height = 0.8 / len(posts)
        for number, (name, post) in enumerate(posts.items()):
            table = post.marginal(quantity).sel({quantity: found})
            at = np.arange(len(found)) + (number - (len(posts) - 1) / 2) * height
            colour = COLOURS[number % len(COLOURS)]
            error = np.nan_to_num(table["error"].values)
            reach = [np.minimum(error, table.values), np.minimum(error, 1 - table.values)]
            axes.barh(at, table.values, height, color=colour, label=name)
            axes.errorbar(table.values, at, xerr=reach, fmt="none", ecolor=INK, lw=0.8, alpha=0.7)
        axes.set_yticks(np.arange(len(found)), found)
        axes.set_ylim(len(found) - 0.4, -0.6)
        axes.set_xlim(0, 1)
        bare(axes)
        axes.set_title(title, fontsize=NORMAL + 1, loc="left", color=INK)
    handles, names = panels[0].get_legend_handles_labels()
    style: dict[str, Any] = {"frameon": False, "fontsize": SMALL + 0.5, "ncols": 3}
    figure.legend(handles, names, loc="outside upper right", **style)
    panels[-1].set_xlabel("posterior probability, and its error", fontsize=NORMAL, color=INK)
    return written(figure, path)


def _relation_bars(axes: Axes, post: Hypotheses) -> None:
    """Draw the probabilities of relations and scenarios as groups of bars."""
    named = {**post.relations_of, **post.scenarios_of}
    marginals = [post.marginal(name) for name in named.values()]
    entries = [
        (str(label) if of in _ALONE else f"{of}: {label}", Estimate(value, error))
        for of, found in zip(named, marginals, strict=True)
        for label, value, error in zip(
            found[found.dims[0]].values, found.values, found["error"].values, strict=True
        )
    ]
    _bars(axes, entries, "#4c5b76", gap_after=len(marginals[0]))
    title = "Relation, and scenario" if post.scenarios_of else "Relations"
    axes.set_title(title, fontsize=NORMAL + 1, loc="left", color=INK)
    axes.set_xlabel("posterior probability", fontsize=NORMAL, color=INK)


def _tracks(axes: Axes, post: Posterior | StepwisePosterior) -> None:
    """Draw the arena with observed tracks (solid) and predicted ones (dashed)."""
    from matplotlib.lines import Line2D

    scene, observed = post.scene, post.observed()
    predicted = None if isinstance(post, StepwisePosterior) else post.replay()
    draw_arena(axes, scene)
    world = scene.world
    for entity in reversed(range(len(world.entities))):
        colour = _line_colour(world, entity)
        seen = observed[:, entity, :2]
        guess = seen if predicted is None else predicted[:, entity, :2]
        if np.ptp(np.concatenate([seen, guess]), axis=0).max() > _MOVED:
            axes.plot(*seen.T, color=colour, lw=1.9, zorder=4, solid_capstyle="round")
            axes.plot(*seen[-1], "o", ms=5, mfc=colour, mec=INK, mew=0.7, zorder=6)
            if predicted is not None:
                dark = _darker(colour)
                axes.plot(*guess.T, color=dark, lw=1.3, ls=_DASHED, zorder=5)
                axes.plot(*guess[-1], "o", ms=5, mfc="white", mec=dark, mew=1.2, zorder=6)
        draw_entity(axes, entity, observed[0, entity], float(scene.radius[entity]), world=world)
    dot: dict[str, Any] = {"marker": "o", "ms": 5}
    grey = "#8a8a8a"
    signs = {"observed": Line2D([], [], color=grey, lw=1.9, mfc=grey, mec=INK, mew=0.7, **dot)}
    if predicted is not None:
        line = Line2D([], [], color=INK, lw=1.3, ls=_DASHED, mfc="white", **dot)
        signs["best hypothesis, simulated"] = line
    signs["start"] = Line2D([], [], ls="", marker=(4, 0, 0), ms=7, mfc="#dddddd", mec=INK, mew=0.7)
    axes.legend(
        signs.values(), signs, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3,
        frameon=False, fontsize=SMALL + 0.5, handlelength=2.6, columnspacing=1.4,
    )  # fmt: skip
    axes.set_title("Tracks", fontsize=NORMAL + 1, loc="left", color=INK)


def _strength_histogram(axes: Axes, post: EventPosterior, name: str, agent: str) -> None:
    """Draw the posterior of one agent's strength, its mean, with its error, in the title."""
    table = post.to_dataframe()
    axes.hist(
        np.clip(table[name], *STRENGTH_RANGE),
        bins=np.linspace(*STRENGTH_RANGE, 19).tolist(),
        weights=table["weight"],
        color=_line_colour(post.scene.world, post.scene.world.agent(agent)),
    )
    axes.set_xlim(*STRENGTH_RANGE)
    axes.set_xticks([150, 300, 450, 600])
    axes.set_yticks([])
    dressed(axes, "", x="strength [N]")
    axes.set_title(f"{agent}: {post.mean(name)} N", fontsize=NORMAL, loc="left", color=INK)
    axes.spines["left"].set_visible(False)


def _bars(
    axes: Axes,
    entries: Sequence[tuple[str, float]],
    colour: Colour | str,
    gap_after: int | None = None,
) -> None:
    """Draw labelled horizontal bars from the top down, with values and errors at their ends.

    Errors that are known are drawn as whiskers too, as far as probabilities reach.
    """
    places = np.arange(len(entries), dtype=float)
    if gap_after is not None:
        places[gap_after:] += 0.6
    values = [value for _, value in entries]
    axes.barh(places, values, height=0.72, color=colour)
    for place, value in zip(places, values, strict=True):
        text, end = f"{float(value):.2f}" if value else "0", value
        error = getattr(value, "error", math.nan)
        if error > 0:
            end = min(1.0, value + error)
            axes.plot([max(0.0, value - error), end], [place, place], color=INK, lw=0.8, alpha=0.7)
            text += f" ± {error:.2f}"
        axes.text(end + 0.015, place, text, va="center", fontsize=SMALL, color=INK)
    axes.set_yticks(places, [label for label, _ in entries])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(0, 1.3)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    bare(axes)
    axes.tick_params(axis="y", length=0)


def draw_arena(axes: Axes, scene: Scene) -> None:
    """Draw landmarks with their names, and walls."""
    from matplotlib.patches import Rectangle

    x0, x1, y0, y1 = scene.arena
    places = zip(scene.landmark_centres, scene.half_widths.tolist(), strict=True)
    for (centre, half), landmark in zip(places, scene.world.landmarks, strict=True):
        name, colour = landmark.name, _share(landmark.colour)
        corner = (centre[0] - half, centre[1] - half)
        axes.add_patch(
            Rectangle(corner, 2 * half, 2 * half, fc=(*colour, 0.22), ec=(*colour, 0.6), zorder=1)
        )
        above = centre[1] > (y0 + y1) / 2
        y = y1 + _ROOM_FOR_NAMES / 4 if above else y0 - _ROOM_FOR_NAMES / 4
        style: dict[str, Any] = {"ha": "center", "va": "bottom" if above else "top"}
        axes.text(centre[0], y, name, fontsize=SMALL, color=_darker(colour), **style)
    border = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    for line in [border, *scene.walls]:
        axes.plot(*np.asarray(line).T, color="black", lw=2.5, solid_capstyle="projecting", zorder=3)
    margin = 0.02 * (x1 - x0)
    axes.set_xlim(x0 - margin, x1 + margin)
    axes.set_ylim(y0 - _ROOM_FOR_NAMES, y1 + _ROOM_FOR_NAMES)
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_entity(
    axes: Axes,
    entity: int,
    pose: FloatArray,
    radius: float,
    alpha: float = 0.9,
    world: World = PHASE,
) -> None:
    """Draw an entity at a pose x, y, angle."""
    from matplotlib.patches import Circle, Polygon

    style: dict[str, Any] = {"fc": _share(world.entity_colours[entity]), "ec": INK, "lw": 0.7}
    if is_agent(entity, len(world.agents)):
        outline = agent_outline(pose, radius)
        axes.add_patch(Polygon(outline, closed=True, zorder=3.5, alpha=alpha, **style))
    else:
        centre = (float(pose[0]), float(pose[1]))
        axes.add_patch(Circle(centre, radius, zorder=3.4, alpha=alpha, **style))


def _share(colour: tuple[int, int, int]) -> Colour:
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


def _line_colour(world: World, entity: int) -> Colour:
    """Return the entity's colour, darkened enough to be read on white."""
    shade = _SHADE[entity] if world == PHASE else _ANY_SHADE
    red, green, blue = (shade * part for part in _share(world.entity_colours[entity]))
    return red, green, blue


def _darker(colour: Colour) -> Colour:
    return 0.6 * colour[0], 0.6 * colour[1], 0.6 * colour[2]
