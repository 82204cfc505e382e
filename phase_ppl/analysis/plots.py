"""Figures of a posterior, in the colours of the world; they draw on no global state."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from phase_ppl.analysis.estimate import Estimate
from phase_ppl.analysis.figures.comparison import comparison as comparison
from phase_ppl.analysis.figures.data_card import data_card as data_card
from phase_ppl.analysis.figures.diagnostics import chains as chains
from phase_ppl.analysis.figures.diagnostics import diagnostics as diagnostics
from phase_ppl.analysis.figures.diagnostics import errors as errors
from phase_ppl.analysis.figures.diagnostics import goal_map as goal_map
from phase_ppl.analysis.figures.stepwise import over_time as over_time
from phase_ppl.analysis.figures.stepwise import why as why
from phase_ppl.analysis.figures.style import INK, NORMAL, SMALL, bare, new_figure, written
from phase_ppl.analysis.figures.training import training_curves as training_curves
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.geometry import agent_outline, is_agent
from phase_ppl.world.hypothesis import STRENGTH_RANGE
from phase_ppl.world.names import AGENTS, ENTITIES, LANDMARKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phase_ppl.analysis.hypotheses import Hypotheses
    from phase_ppl.analysis.posterior import Posterior
    from phase_ppl.world.scene import Scene

Colour = tuple[float, float, float]


def _rgb(red: int, green: int, blue: int) -> Colour:
    return red / 255, green / 255, blue / 255


ENTITY_COLOURS: Final = (
    _rgb(255, 0, 0),
    _rgb(0, 255, 0),
    _rgb(117, 216, 230),
    _rgb(255, 153, 153),
)
"""Red agent, green agent, blue item, pink item, as in the paper's animations."""

LANDMARK_COLOURS: Final = (
    _rgb(45, 45, 180),
    _rgb(50, 150, 50),
    _rgb(180, 45, 45),
    _rgb(180, 180, 45),
)
"""Blue, green, red, yellow landmark, as in the paper's animations."""

_GREY: Final = "#8a8a8a"
_SHADE: Final = (0.82, 0.68, 0.72, 0.86)
"""Per entity, how far its colour is kept when a line or bar needs contrast with white."""

_N_GOALS_SHOWN: Final = 6
_MOVED: Final = 0.05
"""Extent of a track, units, from which on it is drawn."""

_ROOM_FOR_NAMES: Final = 1.3
"""Strip above and below the arena that holds the landmarks' names, units."""


def posterior(
    post: Posterior | StepwisePosterior, path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw goals, relation, scenario, tracks and strengths of a posterior on one page.

    Tracks: observed (solid) and, of a posterior by simulation, of the best hypothesis' stored
    simulation (dashed), see :meth:`phase_ppl.analysis.posterior.Posterior.replay`.

    Args:
        post: what to draw.
        path: where to write the figure as well, as .png, .pdf or .svg.

    Returns:
        A matplotlib figure of 10 x 6 inches.

    Raises:
        OutputError: the figure cannot be written there, or the ending is another.
    """
    figure = new_figure(10, 6)
    left = figure.add_gridspec(
        3, 1, left=0.235, right=0.50, top=0.90, bottom=0.075, height_ratios=(6, 6, 7.4), hspace=0.36
    )
    right = figure.add_gridspec(
        2, 2, left=0.57, right=0.985, top=0.90, bottom=0.075, height_ratios=(5.6, 1), hspace=0.36
    )
    for agent, name in enumerate(("goal_red", "goal_green")):
        axes = figure.add_subplot(left[agent])
        goal_bars(axes, post, name, agent)
        if agent == 0:
            _panel_letter(axes, "a", -0.83)
    axes = figure.add_subplot(left[2])
    relation_bars(axes, post)
    _panel_letter(axes, "b", -0.83)
    axes = figure.add_subplot(right[0, :])
    tracks(axes, post)
    _panel_letter(axes, "c", -0.05)
    for agent, name in enumerate(("strength_red", "strength_green")):
        axes = figure.add_subplot(right[1, agent])
        strength_histogram(axes, post, name, agent)
        if agent == 0:
            _panel_letter(axes, "d", -0.11)
    figure.suptitle(post.event_id, x=0.012, y=0.985, ha="left", fontsize=10, color=INK)
    return written(figure, path)


def goal_bars(axes: Axes, post: Hypotheses, name: str, agent: int) -> None:
    """Draw the most probable goals of one agent as bars in its colour."""
    entries = [(goal, value) for goal, value in post.top(name, _N_GOALS_SHOWN) if value > 0]
    _bars(axes, entries, _line_colour(agent))
    axes.set_ylim(_N_GOALS_SHOWN - 0.4, -0.6)
    axes.set_title(f"Goal of the {AGENTS[agent]}", fontsize=NORMAL + 1, loc="left", color=INK)


def relation_bars(axes: Axes, post: Hypotheses) -> None:
    """Draw the relation's and the scenario's probabilities as two groups of bars."""
    marginals = [post.marginal(name) for name in ("relation", "scenario")]
    entries = [
        (label, Estimate(value, error))
        for found in marginals
        for label, value, error in zip(
            found[found.dims[0]].values.tolist(),
            found.values.tolist(),
            found["error"].values.tolist(),
            strict=True,
        )
    ]
    gap = len(marginals[0])
    _bars(axes, entries, "#4c5b76", gap_after=gap)
    axes.set_title("Relation, and scenario", fontsize=NORMAL + 1, loc="left", color=INK)
    axes.set_xlabel("posterior probability", fontsize=NORMAL, color=INK)


def tracks(axes: Axes, post: Posterior | StepwisePosterior) -> None:
    """Draw the arena with observed tracks (solid) and predicted ones (dashed)."""
    from matplotlib.lines import Line2D

    scene, observed = post.scene, post.observed()
    predicted = None if isinstance(post, StepwisePosterior) else post.replay()
    _arena(axes, scene)
    for entity in reversed(range(len(ENTITIES))):
        colour = _line_colour(entity)
        seen = observed[:, entity, :2]
        guess = seen if predicted is None else predicted[:, entity, :2]
        if np.ptp(np.concatenate([seen, guess]), axis=0).max() > _MOVED:
            axes.plot(*seen.T, color=colour, lw=1.9, zorder=4, solid_capstyle="round")
            axes.plot(*seen[-1], "o", ms=5, mfc=colour, mec=INK, mew=0.7, zorder=6)
            if predicted is not None:
                dark = _darker(colour)
                axes.plot(*guess.T, color=dark, lw=1.3, ls=(0, (3.2, 1.8)), zorder=5)
                axes.plot(*guess[-1], "o", ms=5, mfc="white", mec=dark, mew=1.2, zorder=6)
        _entity(axes, entity, observed[0, entity], float(scene.radius[entity]))
    handles = [
        Line2D([], [], color=_GREY, lw=1.9, marker="o", ms=5, mfc=_GREY, mec=INK, mew=0.7),
        Line2D([], [], color=INK, lw=1.3, ls=(0, (3.2, 1.8)), marker="o", ms=5, mfc="white"),
        Line2D([], [], ls="", marker=(4, 0, 0), ms=7, mfc="#dddddd", mec=INK, mew=0.7),
    ]
    labels = ["observed", "best hypothesis, simulated", "start"]
    if predicted is None:
        del handles[1], labels[1]
    axes.legend(
        handles,
        labels,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=3,
        frameon=False,
        fontsize=SMALL + 0.5,
        handlelength=2.6,
        columnspacing=1.4,
    )
    axes.set_title("Tracks", fontsize=NORMAL + 1, loc="left", color=INK)


def strength_histogram(axes: Axes, post: Hypotheses, name: str, agent: int) -> None:
    """Draw the posterior of one agent's strength, its mean, with its error, in the title."""
    table = post.to_dataframe()
    bins = np.linspace(*STRENGTH_RANGE, 19)
    clipped = np.clip(table[name], *STRENGTH_RANGE)
    axes.hist(clipped, bins=bins.tolist(), weights=table["weight"], color=_line_colour(agent))
    axes.set_title(
        f"{AGENTS[agent]}: {post.mean(name)} N",
        fontsize=NORMAL,
        loc="left",
        color=INK,
    )
    axes.set_xlim(*STRENGTH_RANGE)
    axes.set_xticks([150, 300, 450, 600])
    axes.set_yticks([])
    axes.set_xlabel("strength [N]", fontsize=NORMAL, color=INK, labelpad=1)
    bare(axes, "left")


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
        text = f"{float(value):.2f}" if value else "0"
        error = getattr(value, "error", math.nan)
        if error > 0:
            low, high = max(0.0, value - error), min(1.0, value + error)
            axes.plot([low, high], [place, place], color=INK, lw=0.8, alpha=0.7)
            text += f" ± {error:.2f}"
        end = min(1.0, value + error) if error > 0 else value
        axes.text(end + 0.015, place, text, va="center", fontsize=SMALL, color=INK)
    axes.set_yticks(places, [label for label, _ in entries])
    axes.set_ylim(places[-1] + 0.6, -0.6)
    axes.set_xlim(0, 1.3)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    bare(axes)
    axes.tick_params(axis="y", length=0)


def _panel_letter(axes: Axes, letter: str, x: float) -> None:
    axes.annotate(
        letter,
        (x, 1.0),
        xycoords="axes fraction",
        xytext=(0, 5),
        textcoords="offset points",
        fontsize=11,
        fontweight="bold",
        color=INK,
        annotation_clip=False,
    )


def _arena(axes: Axes, scene: Scene) -> None:
    from matplotlib.patches import Rectangle

    half = scene.landmark_half_width
    x0, x1, y0, y1 = scene.arena
    for centre, colour, name in zip(
        scene.landmark_centres, LANDMARK_COLOURS, LANDMARKS, strict=True
    ):
        corner = (centre[0] - half, centre[1] - half)
        axes.add_patch(
            Rectangle(corner, 2 * half, 2 * half, fc=(*colour, 0.22), ec=(*colour, 0.6), zorder=1)
        )
        above = centre[1] > (y0 + y1) / 2
        axes.text(
            centre[0],
            y1 + _ROOM_FOR_NAMES / 4 if above else y0 - _ROOM_FOR_NAMES / 4,
            name,
            ha="center",
            va="bottom" if above else "top",
            fontsize=SMALL,
            color=_darker(colour),
        )
    border = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    for line in [border, *scene.walls]:
        axes.plot(*np.asarray(line).T, color="black", lw=2.5, solid_capstyle="projecting", zorder=3)
    margin = 0.02 * (x1 - x0)
    axes.set_xlim(x0 - margin, x1 + margin)
    axes.set_ylim(y0 - _ROOM_FOR_NAMES, y1 + _ROOM_FOR_NAMES)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _entity(axes: Axes, entity: int, pose: FloatArray, radius: float) -> None:
    from matplotlib.patches import Circle, Patch, Polygon

    style: dict[str, Any] = {"fc": ENTITY_COLOURS[entity], "ec": INK, "lw": 0.7, "alpha": 0.9}
    shape: Patch
    if is_agent(entity):
        shape = Polygon(agent_outline(pose, radius), closed=True, zorder=3.5, **style)
    else:
        shape = Circle((float(pose[0]), float(pose[1])), radius, zorder=3.4, **style)
    axes.add_patch(shape)


def _line_colour(entity: int) -> Colour:
    """Return the entity's colour, darkened enough to be read on white."""
    red, green, blue = (_SHADE[entity] * part for part in ENTITY_COLOURS[entity])
    return red, green, blue


def _darker(colour: Colour) -> Colour:
    return 0.6 * colour[0], 0.6 * colour[1], 0.6 * colour[2]
