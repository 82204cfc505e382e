"""The figure of a posterior, in the colours of the world."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from phase_ppl.analysis import quantities
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.figures.style import (
    GREY,
    INK,
    NORMAL,
    figure_of,
    new_figure,
    written,
)
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import agent_outline, is_agent
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.picture import trail_colour
from phase_ppl.world.scene import PHASE, World

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.world.scene import Scene

Colour = tuple[float, float, float]

RELATION_COLOUR: Final = "#4c5b76"
_ALONE: Final = ("relation", "scenario")  # need not be named beside their labels
_DASHED: Final = (0, (3.2, 1.8))
_N_GOALS_SHOWN: Final = 6
_MOVED: Final = 0.05  # extent of a track, units, from which on it is drawn
_ROOM_FOR_NAMES: Final = 1.3
"""Strip above and below the arena that holds the landmarks' names, units."""

_ERRORS: Final = {"ecolor": INK, "lw": 0.8, "alpha": 0.7}


@figure_of(Posterior, ClosedLoopPosterior)
def posterior(
    post: Posterior | ClosedLoopPosterior, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw goals, relation, scenario, tracks and strengths on one page.

    Tracks are the observed ones (solid) and, for a sampled posterior, the stored simulation of the
    best hypothesis (dashed; :meth:`phase_ppl.Posterior.replay`). The page is 10 x 6 inches, and
    higher with more than two agents.
    """
    world = post.scene.world
    related = [*post.relations_of, *post.scenarios_of]
    heights = [6.0] * len(world.agents) + ([0.4 + 3.5 * len(related)] if related else [])
    figure = new_figure(10, max(4.0, 6 * sum(heights) / 19.4), post.event_id)
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    panels = list(left.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0])
    for axes, (agent, name) in zip(panels, post.goals_of.items(), strict=False):
        found = [(goal, value) for goal, value in post.top(name, _N_GOALS_SHOWN) if value > 0]
        goals, values = zip(*found, strict=True)
        errors = [value.error for value in values]
        bars(axes, goals, values, errors, line_colour(world, world.agent(agent)))
        axes.set_ylim(_N_GOALS_SHOWN - 0.4, -0.6)
        axes.set_title(titles(post)[name])
    if related:
        _relation_bars(panels[-1], post)
    agents = list(post.strengths_of)
    parts = right.subplot_mosaic([["tracks"] * len(agents), agents], height_ratios=(5.6, 1))
    _tracks(parts["tracks"], post)
    table = post.to_dataframe()
    # usual levels are in the middle of a bin
    bins = np.linspace(STRENGTH_RANGE[0] - 12.5, STRENGTH_RANGE[1] + 12.5, 20)
    for agent, name in post.strengths_of.items():
        axes, mean = parts[agent], post.mean(name)
        axes.hist(
            np.clip(table[name], *STRENGTH_RANGE),
            bins=bins.tolist(),
            weights=table["weight"],
            color=line_colour(world, world.agent(agent)),
        )
        axes.set(xlim=(bins[0], bins[-1]), xticks=[150, 300, 450, 600], yticks=[])
        axes.set_xlabel("strength [N]")
        told = f"{mean:.3g}" if np.isnan(mean.error) else mean
        axes.set_title(f"{agent}: {told} N", fontsize=NORMAL)
        axes.spines["left"].set_visible(False)
    lettered = [panels[0], *panels[len(agents) :], parts["tracks"], parts[agents[0]]]
    for letter, axes in zip("abcd", lettered, strict=False):
        axes.annotate(
            letter, (0, 1), (-14, 5), xycoords="axes fraction", textcoords="offset points",
            fontsize=11, fontweight="bold", annotation_clip=False,
        )  # fmt: skip
    return written(figure, path)


def titles(post: Hypotheses) -> dict[str, str]:
    """Return quantity -> title of what shows it, in a posterior."""
    return quantities.titles(post.goals_of, post.relations_of)


def _relation_bars(axes: Axes, post: Hypotheses) -> None:
    """Draw the probabilities of relations and scenarios as groups of bars."""
    rows: list[Any] = []
    named = {**post.relations_of, **post.scenarios_of}
    for of, name in named.items():
        found = post.marginal(name)
        told = [label if of in _ALONE else f"{of}: {label}" for label in found[name].values]
        rows += zip(told, found.values, found["error"].values, strict=True)
    sizes = [len(post.quantities[name] or ()) for name in named.values()]
    labels, values, errors = map(list, zip(*rows, strict=True))
    bars(axes, labels, values, errors, RELATION_COLOUR, groups=sizes)
    title = "Relation, and scenario" if post.scenarios_of else "Relations"
    axes.set(title=title, xlabel="posterior probability")


def _tracks(axes: Axes, post: Posterior | ClosedLoopPosterior) -> None:
    """Draw the arena with observed tracks (solid) and predicted ones (dashed)."""
    from matplotlib.lines import Line2D

    scene, observed = post.scene, post.observed()
    predicted = post.replay()
    draw_arena(axes, scene)
    world = scene.world
    dot: dict[str, Any] = {"marker": "o", "ms": 5}
    simulated: dict[str, Any] = {"lw": 1.3, "ls": _DASHED}
    for entity in reversed(range(len(world.entities))):
        colour = line_colour(world, entity)
        seen = observed[:, entity, :2]
        guess = seen if predicted is None else predicted[:, entity, :2]
        if np.ptp(np.concatenate([seen, guess]), axis=0).max() > _MOVED:
            axes.plot(*seen.T, color=colour, lw=1.9, zorder=4)
            axes.plot(*seen[-1], mfc=colour, mec=INK, mew=0.7, zorder=6, **dot)
            if predicted is not None:
                dark = _shaded(colour, 0.6)
                axes.plot(*guess.T, color=dark, zorder=5, **simulated)
                axes.plot(*guess[-1], mfc="white", mec=dark, mew=1.2, zorder=6, **dot)
        draw_entity(axes, entity, observed[0, entity], float(scene.radius[entity]), world=world)
    signs = {"observed": Line2D([], [], color=GREY, lw=1.9, mfc=GREY, mec=INK, mew=0.7, **dot)}
    if predicted is not None:
        best = Line2D([], [], color=INK, mfc="white", **simulated, **dot)
        signs["best hypothesis, simulated"] = best
    signs["start"] = Line2D([], [], ls="", marker=(4, 0, 0), ms=7, mfc="#dddddd", mec=INK, mew=0.7)
    axes.legend(
        signs.values(), signs, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3,
        handlelength=2.6, columnspacing=1.4,
    )  # fmt: skip
    axes.set_title("Tracks")


def bars(
    axes: Axes,
    labels: Sequence[str],
    values: ArrayLike,
    errors: ArrayLike,
    colour: Colour | str,
    groups: Sequence[int] = (),
) -> list[Artist]:
    """Draw labelled horizontal bars from the top down, with values and errors at their ends.

    ``groups`` are numbers of bars that stand apart from the next. What depends on the values is
    returned, in the order in which it is drawn.
    """
    values, errors = np.asarray(values, float), np.asarray(errors, float)
    places = np.arange(len(values), dtype=float)
    if groups:
        places += 0.6 * np.repeat(np.arange(len(groups)), groups)
    bars = axes.barh(
        places, values, 0.72, color=colour, xerr=_reach(values, errors), error_kw=_ERRORS
    )
    texts = [
        (f"{value:.2f}" if value else "0") + (f" ± {error:.2f}" if error > 0 else "")
        for value, error in zip(values, errors, strict=True)
    ]
    written = axes.bar_label(bars, texts, padding=3)
    axes.set_yticks(places, labels)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    axes.set(xlim=(0, 1.3), ylim=(places[-1] + 0.6, -0.6))
    axes.tick_params(axis="y", length=0)
    assert bars.errorbar is not None, "errors are given"
    _, caps, lines = bars.errorbar
    return [*bars, *lines, *caps, *written]


def _reach(values: ArrayLike, errors: ArrayLike) -> FloatArray:
    """Return (2, n) errors to either side, as far as probabilities reach; 0 where not known."""
    values = np.asarray(values, float)
    return np.minimum(np.nan_to_num(np.asarray(errors, float)), [values, 1 - values]).clip(0)


def draw_arena(axes: Axes, scene: Scene) -> None:
    """Draw landmarks with their names, and walls."""
    from matplotlib.patches import Rectangle

    x0, x1, y0, y1 = scene.arena
    places = zip(scene.landmark_centres, scene.half_widths.tolist(), strict=True)
    for (centre, half), landmark in zip(places, scene.world.landmarks, strict=True):
        colour = _shaded(landmark.colour, 1 / 255)
        style: dict[str, Any] = {"fc": (*colour, 0.22), "ec": (*colour, 0.6), "zorder": 1}
        axes.add_patch(Rectangle(centre - half, 2 * half, 2 * half, **style))
        above = centre[1] > (y0 + y1) / 2
        y = y1 + _ROOM_FOR_NAMES / 4 if above else y0 - _ROOM_FOR_NAMES / 4
        style = {"ha": "center", "va": "bottom" if above else "top"}
        axes.text(centre[0], y, landmark.name, color=_shaded(colour, 0.6), **style)
    for line in (*scene.border, *scene.walls):
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

    fill = _shaded(world.entity_colours[entity], 1 / 255)
    style: dict[str, Any] = {"fc": fill, "ec": INK, "lw": 0.7, "alpha": alpha}
    if is_agent(entity, len(world.agents)):
        axes.add_patch(Polygon(agent_outline(pose, radius), zorder=3.5, **style))
    else:
        axes.add_patch(Circle((float(pose[0]), float(pose[1])), radius, zorder=3.4, **style))


def line_colour(world: World, entity: int) -> Colour:
    """Return the entity's colour, darkened enough to be read on white."""
    return _shaded(trail_colour(world.entity_colours[entity]), 1 / 255)


def _shaded(colour: Sequence[float], share: float) -> Colour:
    red, green, blue = (share * part for part in colour)
    return red, green, blue
