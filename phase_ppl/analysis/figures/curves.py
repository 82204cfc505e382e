"""Kernels over simulations, posteriors over priors, trainings, and sets of events."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.comparison import DISTANCES, Comparison
from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    banded,
    direct_labels,
    figure_of,
    in_shares,
    in_style,
    new_figure,
    titled,
    written,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import check_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLES: Final = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)))
"""Lines of the kernels, for those beyond the colours."""

HEADINGS: Final = {
    "tv_goals": ("Distance from the reference", "total variation of a goal's marginal"),
    "tv_relation": ("Distance of the relation", "total variation of the relation's marginal"),
    "p_goals": ("Belief in the true goals", "probability of an agent's true goal"),
    "p_pair": ("Belief in the true pair", "probability of the true pair of goals"),
    "p_relation": ("Belief in the true relation", "probability of the true relation"),
    "map_goals": ("Accuracy", "share of agents whose leading goal is right"),
    "map_relation": ("Accuracy", "share of runs whose leading relation is right"),
}
"""Measure -> title and label of its axis."""

_POINTS: Final = 200


@figure_of(Comparison)
def comparison(
    c: Comparison,
    path: str | os.PathLike[str] | None = None,
    *,
    measures: tuple[str, ...] = ("tv_goals", "p_goals"),
) -> Figure:
    """Draw measures of accuracy against simulations, a line per kernel; 4.6 inches a panel.

    With a budget of frames the axis is frames. Lines are means over repeats, bands their standard
    errors. A kernel that keeps its last population only is a point with a bar. A dashed line is the
    reference's own probability of the truth. Distances in the grey area at the bottom are smaller
    than the distance between the reference's halves. ``measures`` are of :data:`HEADINGS`, one
    panel each; those without values are left out.

    Raises:
        UnknownNameError: there is no such measure.
    """
    for name in measures:
        check_name("measure", name, HEADINGS)
    drawn = [name for name in measures if c.curve[name].notna().any()]
    repeats = c.runs.groupby("kernel").size()
    words = f"{repeats.min()}" if repeats.min() == repeats.max() else "several"
    note = f"{c.settings['event']}: mean and standard error of {words} runs each"
    figure = new_figure(4.6 * len(drawn), 3.6, note=note)
    for axes, name in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        _compared(axes, c, name)
    return written(figure, path)


def _compared(axes: Axes, c: Comparison, name: str) -> None:
    unit = "frames" if str(c.settings["budget"]).endswith("frames") else "simulations"
    ends: list[tuple[float, str, str]] = []
    furthest = 0.0
    for place, kernel in enumerate(c.kernels):
        colour, style = COLOURS[place % len(COLOURS)], STYLES[place // len(COLOURS) % len(STYLES)]
        x, mean, error = _mean_curve(c.curve[c.curve["kernel"] == kernel], name, unit)
        if len(x) == 1:
            axes.errorbar(x, mean, error, fmt="o", ms=4, color=colour, capsize=2, lw=1.2)
        else:
            banded(axes, x, mean, error, colour, ls=style)
        ends.append((float(mean[-1]), kernel, colour))
        furthest = max(furthest, float(x[-1]))
    own_error = c.reference_error(name) if name in DISTANCES else None
    if own_error is not None:
        axes.axhspan(0, own_error, color="#eeeeee", lw=0, zorder=0)
        note = "within the distance between the reference's halves"
        axes.text(0.015, 0.02, note, transform=axes.transAxes, color=GREY)
    reference = c.settings["reference"].get("truth", {}).get(name)
    if reference is not None:
        axes.axhline(reference, color=GREY, lw=0.9, ls=(0, (4, 3)), zorder=1)
        ends.append((reference, "reference", GREY))
    titled(axes, *HEADINGS[name])
    axes.set_xlabel("simulated frames" if unit == "frames" else unit)
    axes.set_xlim(0, furthest * 1.02)
    axes.set_ylim(0, min(1.02, max(axes.get_ylim()[1], 0.05)))
    axes.grid(axis="y")
    direct_labels(axes, ends)


def _mean_curve(
    rows: pd.DataFrame, name: str, unit: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return simulations or frames, mean and standard error, from where all repeats have begun.

    At each number of simulations every run counts with its latest value.
    """
    repeats = [run for _, run in rows.groupby("repeat")]
    runs = [(run[unit].to_numpy(float), run[name].to_numpy(float)) for run in repeats]
    begin, end = max(x[0] for x, _ in runs), max(x[-1] for x, _ in runs)
    at = np.unique(np.linspace(begin, end, _POINTS)) if end > begin else np.array([end])
    values = np.array([y[np.searchsorted(x, at, side="right") - 1] for x, y in runs])
    spread = values.std(axis=0, ddof=1) / np.sqrt(len(runs)) if len(runs) > 1 else 0.0 * at
    return at, values.mean(axis=0), spread


# --- a posterior under other priors -------------------------------------------------------------

_LINES: Final = 5  # labels that are drawn, those that are ever the most probable first


@figure_of(Posterior, StepwisePosterior)
def sensitivity(
    post: Posterior | StepwisePosterior,
    question: str,
    prior: Callable[..., object],
    values: Iterable[float],
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the answer to a question as an argument of the prior varies, 5.6 x 3.4 inches.

    Arguments and errors are those of ``post.sensitivity``. Bands are 1.96 errors wide on either
    side; where too little was simulated for a prior there is a gap.
    """
    found = post.sensitivity(question, prior, values)
    lines = found if found.ndim > 1 else found.expand_dims(answer=[question])
    lines = lines.stack(line=[dim for dim in lines.dims if dim != "value"])
    order = np.argsort(-np.nan_to_num(lines.max("value").values), kind="stable")[:_LINES]
    figure = new_figure(5.6, 3.4)
    axes = figure.subplots()
    ends: list[tuple[float, str, str]] = []
    shares = question.lstrip().startswith("P")
    for place, colour in zip(order, COLOURS, strict=False):
        line = lines.isel(line=int(place))
        y, within = line.values, 1.96 * line["error"].values
        banded(axes, found["value"], y, within, colour, shares=shares, marker="o", ms=3)
        name = ", ".join(str(label) for label in line["line"].item())
        if np.isfinite(y).any() and found.ndim > 1:
            ends.append((float(y[np.isfinite(y)][-1]), name, colour))
    titled(axes, post.event_id, question)
    axes.set_xlabel(f"argument of {getattr(prior, '__name__', 'prior')}")
    if shares:
        in_shares(axes)
    direct_labels(axes, ends)
    return written(figure, path)


# --- a training --------------------------------------------------------------------------------

_CURVES: Final = {
    "Loss": {"training": "training events", "validation": "validation events"},
    "Right answers on the validation events": {"relation": "relation", "goals": "goals"},
}
"""Title of a panel -> curve -> its name."""


@in_style
def training_curves(
    report: Mapping[str, Any], path: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw the curves of all networks of a training, 7.5 x 3 inches.

    ``report`` is what :func:`phase_ppl.train_socialgnn` returns.
    """
    members, events = report["members"], report["data"]["events"]
    figure = new_figure(
        *(7.5, 3),
        f"SocialGNN, {report['settings']['variant']}: {len(members)} "
        f"network{'s' * (len(members) != 1)}, {events['train']} training and "
        f"{events['validation']} validation events",
    )
    longest = max(len(member["curves"]["training"]) for member in members)
    colours = iter(COLOURS)
    for axes, (title, lines) in zip(figure.subplots(1, 2), _CURVES.items(), strict=True):
        for (name, label), colour in zip(lines.items(), colours):  # noqa: B905
            for number, member in enumerate(members if name in members[0]["curves"] else ()):
                values = member["curves"][name]
                style: dict[str, Any] = {"color": colour, "label": None if number else label}
                axes.plot(np.arange(1, len(values) + 1), values, lw=0.9, alpha=0.75, **style)
        axes.set(title=title, xlabel="epoch", xlim=(1, max(longest, 2)))
        axes.set_ylim(0, 1.02 if "relation" in lines else None)
        axes.grid(axis="y")
        axes.legend()
    return written(figure, path)


# --- a set of events ------------------------------------------------------------------------------

_PANELS: Final = {
    "Relation, scenario": ("relation", "scenario"),
    "Goals of agents, by type": ("goal_type",),
    "Strength [N], sizes": ("strength", "agent_size", "item_size"),
    "Time, and events": ("agent_rests", "agent_holds", "item_moves", "moves_to_the_end"),
    "How they were made": ("family", "reflection", "split"),
}
_WORDS: Final = {
    ("goal_type", "LMO+"): "item to landmark", ("goal_type", "LMO-"): "item from landmark",
    ("goal_type", "LMA+"): "agent to landmark", ("goal_type", "LMA-"): "agent from landmark",
    ("goal_type", "TE+"): "to other agent", ("goal_type", "TE-"): "from other agent",
    ("agent_rests", "mean"): "agent rests", ("agent_holds", "mean"): "agent holds item",
    ("item_moves", "mean"): "item moves", ("moves_to_the_end", "mean"): "moves to the end",
}  # fmt: skip
_PREFIXES: Final = {"agent_size": "agent ", "item_size": "item "}
_LONGEST: Final = 22  # characters of a label at most


@in_style
def data_card(statistics: pd.DataFrame, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the main shares of :func:`phase_ppl.statistics`, with their errors, as pairs of bars.

    The original events are in grey, where it is known; 12 inches wide.
    """
    of = statistics.index.get_level_values("quantity")
    panels = {title: [n for n in names if n in of] for title, names in _PANELS.items()}
    panels = {title: names for title, names in panels.items() if names}
    events = statistics.attrs.get("events")
    title = "" if events is None else f"{events} event{'s' * (events != 1)}"
    figure = new_figure(12.0, 3.6, title, "bars: standard errors over events; in grey: PHASE")
    drawn = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (heading, names) in zip(drawn, panels.items(), strict=True):
        rows = pd.concat([statistics.loc[[name]] for name in names])
        start = rows.index.get_level_values("quantity")
        # quantities stand apart
        places = np.arange(len(rows)) + 0.7 * np.cumsum(np.r_[False, start[1:] != start[:-1]])
        axes.barh(places - 0.2, rows["value"], 0.4, xerr=rows["error"], color=COLOURS[0],
                  error_kw={"elinewidth": 0.8})  # fmt: skip
        axes.barh(places + 0.2, rows["phase"], 0.4, color="#b4b4b4")
        words = [_WORDS.get(one, _PREFIXES.get(one[0], "") + one[1]) for one in rows.index]
        axes.set_yticks(places, [name[:_LONGEST] for name in words])
        axes.set(title=heading, ylim=(places[-1] + 0.6, -0.6))
        axes.set_xlim(left=0)
        axes.locator_params(axis="x", nbins=4)
        axes.tick_params(axis="y", length=0)
    return written(figure, path)
