"""Figures of people: models against their shares, and over time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import GREY, NORMAL, new_figure, titled
from phase_ppl.evaluation.cells import measure_text
from phase_ppl.evaluation.comparison import PEOPLE_COLOUR
from phase_ppl.evaluation.doubt import label_places, rows_of
from phase_ppl.evaluation.figures.frame import (
    NothingToDrawError,
    PathLike,
    Results,
    drawing,
    fitting,
    opened,
    scenario_colour,
    scenarios_of,
)
from phase_ppl.evaluation.prediction import pairs_of, questions_of
from phase_ppl.evaluation.ratings import moments_of
from phase_ppl.evaluation.table import Answers, responses_of, titles_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# --- doubt

_MARKS: Final = ("o", "s", "^")  # of the relations
_MODELS: Final = 6  # that are drawn
_PARTS: Final = ("relation_r", "relation_r_given_truth")


@drawing("Doubt: models against people")
def people(source: Results, path: PathLike | None = None) -> Figure:
    """Draw models' probabilities of relations against people's shares.

    Each model has a row of two panels. The first shows probabilities against people's shares; in
    the second, both are minus their mean over events of the same true relation. Above a panel is r
    with its interval.

    Raises:
        NothingToDrawError: nobody judged a relation that a model gives probabilities for.
    """
    results = opened(source)
    shown = [o for o in results.sources if o.kind != "people" and o.metrics.get("doubt")][:_MODELS]
    if not shown:
        raise NothingToDrawError(
            "nobody judged the relation of two agents to which a model gives probabilities"
        )
    figure = new_figure(
        *(5.4, 0.7 + 2.3 * len(shown)),
        note="Marks: an answer to a video, circles friendly, squares neutral, triangles "
        "adversarial; colours: true scenario, green collaborative, blue independent, ochre "
        "competing, red opposing. Given the truth: less the mean of the videos with the same true "
        "relation. In brackets: 95 % intervals.",
    )
    grid = figure.subplots(len(shown), 2, squeeze=False)
    scenarios = scenarios_of(results.events)
    for (left, right), answers in zip(grid, shown, strict=True):
        events = [event for event in results.events if event.id in answers.predictions]
        said = Answers.of(events, answers.predictions)
        columns = ("probability", "people", "truth")
        p, shares, true = (said.array("relation", name)[:, 0] for name in columns)
        colours = np.array([scenario_colour(scenarios.get(e.id, "")) for e in events])
        both, truth = ~np.isnan(p[:, 0]) & ~np.isnan(shares[:, 0]), label_places(true)
        _doubts(left, p[both], shares[both], colours[both], (0.0, 1.0))
        left.set_ylabel("people")
        known = both & (truth >= 0)
        x, y = (
            of[known] - pd.DataFrame(of[known]).groupby(truth[known]).transform("mean").to_numpy()
            for of in (p, shares)
        )
        _doubts(right, x, y, colours[known], (-1.0, 1.0))
        r, given_truth = (measure_text(answers.metrics["doubt"][name]) for name in _PARTS)
        style: dict[str, Any] = {"color": answers.colour, "fontweight": "bold"}
        titled(left, answers.label, f"r = {r}", fontsize=fitting([answers.label], 2.0), **style)
        titled(right, "given the truth", f"r = {given_truth}", fontsize=NORMAL, color=GREY)
    for axes in grid[-1]:
        axes.set_xlabel("model")
    return figure


def _doubts(
    axes: Axes, x: FloatArray, y: FloatArray, colours: np.ndarray, ends: tuple[float, float]
) -> None:
    axes.plot(ends, ends, color="#bbbbbb", lw=0.7, zorder=0)
    style: dict[str, Any] = {"s": 13, "alpha": 0.65, "linewidths": 0, "clip_on": False}
    for answer, mark in enumerate(_MARKS):
        axes.scatter(x[:, answer], y[:, answer], c=colours, marker=mark, **style)
    ticks = sorted({*ends, 0.0})
    axes.set(xlim=ends, ylim=ends, xticks=ticks, yticks=ticks)
    axes.set_aspect("equal", adjustable="box")


# --- at moments of a film

_EVENTS: Final = 4  # events that are drawn over time
_COLUMNS: Final = 5  # answers that are
_DRAWN: Final = 1000  # resamples of the people
_TICKS: Final = 5  # moments that the axis names


@drawing("People and models over time")
def over_time(source: Results, path: PathLike | None = None) -> Figure:
    """Draw people and models over the film, for up to four events and five answers each.

    The answers are all relations, if the world has two agents; for every other question, the answer
    that people gave most. Bars are 95 % intervals of people's mean, over resampled people.

    Raises:
        NothingToDrawError: nobody judged at a moment of a film.
    """
    from matplotlib.lines import Line2D

    results = opened(source)
    models = [o for o in results.sources if o.kind != "people" and o.metrics.get("moments")]
    events = [event for event in results.events if moments_of(event)]
    if not events or not models:
        raise NothingToDrawError("nobody judged at a moment of a film")
    shown = events[:_EVENTS]
    some = f"{len(shown)} of {len(events)} events. " if len(shown) < len(events) else ""
    rows = pd.concat(
        Answers.of(shown, one.predictions).rows.dropna(subset="at").assign(source=place)
        for place, one in enumerate(models)
    )
    said = rows[rows["source"] == 0]
    chosen = {event: _asked(said[said["event"] == event.id], event) for event in shown}
    n_columns = max(map(len, chosen.values()))
    figure = new_figure(
        0.7 + 1.75 * n_columns, 0.6 + 1.5 * len(shown),
        note=f"{some}Share or probability of the answer, given the film until then [s]. Black: "
        "people, with the 95 % interval of their mean; coloured: models.",
    )  # fmt: skip
    grid = figure.subplots(len(shown), n_columns, squeeze=False, sharey=True)
    lines: dict[str, Any] = {"marker": "o", "ms": 3, "lw": 1.4}
    named = {}
    for (event, asked), line in zip(chosen.items(), grid, strict=True):
        ticks = moments_of(event)
        for axes in line[len(asked) :]:
            axes.set_visible(False)
        for axes, (question, label) in zip(line, asked, strict=False):
            keys = ("event", event.id), ("question", question), ("label", label)
            of = rows[np.all([rows[name] == value for name, value in keys], axis=0)]
            people = of[of["source"] == 0].dropna(subset="people")
            axes.plot(people["at"], people["people"], color=PEOPLE_COLOUR, **lines)
            within = _of_people(event, people["at"], question, label)
            axes.vlines(people["at"], *within, lw=1.4, color=PEOPLE_COLOUR, alpha=0.5)
            for place, one in enumerate(models):
                answered = of[of["source"] == place].dropna(subset="probability")
                if len(answered):
                    axes.plot(answered["at"], answered["probability"], color=one.colour, **lines)
                    named[one.label] = Line2D([], [], color=one.colour, lw=1.8)
            axes.set(ylim=(-0.02, 1.02), yticks=[0, 1])
            axes.set_xlim(0, (1.08 if len(ticks) > 1 else 1.5) * max(ticks[-1], 0.1))
            if len(ticks) <= _TICKS:
                axes.set_xticks(ticks, [f"{at:g}" for at in ticks])
            titled(axes, "", titles_of(event.scene.world)[question], fontsize=NORMAL)
            axes.set_title(label, pad=15, fontsize=fitting([label], 1.6), fontweight="bold")
        line[0].set_ylabel(event.id, fontsize=fitting([event.id], 1.2))
    where: Any = {"loc": "outside upper right", "ncols": len(named), "frameon": False}
    figure.legend([*named.values()], [*named], **where)
    return figure


def _asked(rows: pd.DataFrame, event: Event) -> list[tuple[str, str]]:
    """Return the questions and answers that are drawn of an event."""
    pairs, found = pairs_of(event.scene.world), []
    for question, labels in questions_of(event.scene.world).items():
        shares = rows[rows["question"] == question].groupby("label", sort=False)["people"].mean()
        if shares.notna().any():
            several = question in pairs and len(pairs) == 1
            found += [(question, one) for one in (labels if several else [shares.idxmax()])]
    return sorted(found, key=lambda one: one[0] not in pairs)[:_COLUMNS]


def _of_people(event: Event, moments: Iterable[float], question: str, label: str) -> FloatArray:
    """Return the interval of people's mean share of an answer, (low and high, moment)."""
    within, labels = [], questions_of(event.scene.world)[question]
    for at in moments:
        given = responses_of([event], at)
        ((_, answers),) = rows_of(given, [event.id], [question], labels).given.values()
        shares = answers[:, labels.index(label)]
        times = np.random.default_rng(0).multinomial(
            len(shares), np.full(len(shares), 1 / len(shares)), size=_DRAWN
        )
        within.append(np.quantile(times @ shares / len(shares), [0.025, 0.975]))
    return np.array(within).T
