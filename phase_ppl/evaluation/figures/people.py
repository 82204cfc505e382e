"""Figures of people: models against their shares and over time, their labels and ratings."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from phase_ppl.analysis.figures.style import (
    COLOURS,
    GREY,
    INK,
    NORMAL,
    SMALL,
    in_style,
    new_figure,
    titled,
    warned,
    written,
)
from phase_ppl.evaluation.cells import measure_text, number
from phase_ppl.evaluation.comparison import PEOPLE_COLOUR, Source
from phase_ppl.evaluation.doubt import label_places, rows_of
from phase_ppl.evaluation.experiments import (
    MARGIN,
    RATINGS,
    Likeness,
    Tags,
    load_likeness,
    load_tags,
)
from phase_ppl.evaluation.figures.frame import (
    NothingToDrawError,
    PathLike,
    Results,
    drawing,
    fitting,
    opened,
    scenario_colour,
    scenarios_of,
    width_of,
)
from phase_ppl.evaluation.metrics import at as metric_at
from phase_ppl.evaluation.prediction import pairs_of, questions_of
from phase_ppl.evaluation.ratings import REHEARSAL, Judgments, moments_of
from phase_ppl.evaluation.table import Answers, parts_of, responses_of, titles_of, world_of
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# --- probabilities against shares


@drawing("Goals: models against people")
def scatter_goals(source: Results, path: PathLike | None = None) -> Figure:
    """Draw models' probabilities of goals against people's, by true scenario.

    In other worlds than PHASE points are by agent.

    Raises:
        NothingToDrawError: nobody judged a goal that a model gives probabilities for.
    """
    results = opened(source)
    clouds: dict[Source, pd.DataFrame] = {}
    for o in results.sources:
        rows = Answers.of(results.events, o.predictions).whole
        rows = rows[rows["kind"] == "goal"].dropna(subset=["people", "probability"])
        if len(rows):
            clouds[o] = rows
    people = next((clouds.pop(o) for o in [*clouds] if o.kind == "people"), None)
    if people is None or not clouds:
        raise NothingToDrawError("people judged no goal that a model gives probabilities for")
    parts = [name for _, name in parts_of(world_of(results.events), "goal")]
    present = {name for rows in clouds.values() for name in rows["part"]}
    columns = [name for name in (*parts, "") if name in present]
    figure = new_figure(
        width_of(clouds) + 0.3 + 1.4 * max(len(columns), 2),
        1.0 + 1.4 * len(clouds),
        note="Probabilities of the agents' goals; n: events.",
    )
    grid = figure.subplots(len(clouds), len(columns), squeeze=False, sharex=True, sharey=True)
    for line, (answers, rows) in zip(grid, clouds.items(), strict=True):
        for axes, name in zip(line, columns, strict=True):
            axes.plot([0, 1], [0, 1], color="#c4c4c4", lw=0.8, zorder=1)
            axes.scatter(
                "people", "probability", s=9, alpha=0.4, lw=0, color=scenario_colour(name),
                clip_on=False, data=rows[rows["part"] == name],
            )  # fmt: skip
            axes.set(xlim=(-0.09, 1.09), ylim=(-0.09, 1.09), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
        r = metric_at(answers.metrics, ("human", "goal_r"))
        label = answers.label if r is None else f"{answers.label}\nr = {number(r['value'])}"
        line[0].set_ylabel(
            label, rotation=0, ha="right", va="center", fontsize=fitting([answers.label]),
            color=answers.colour,
        )  # fmt: skip
    for top, bottom, name in zip(grid[0], grid[-1], columns, strict=True):
        n = people.loc[people["part"] == name, "event"].nunique()
        style = {"color": scenario_colour(name), "fontweight": "bold"}
        titled(top, name or "scenario not known", f"n = {n}", fontsize=NORMAL, **style)
        bottom.set_xlabel("people", fontsize=SMALL)
    return figure


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


# --- labels and ratings of videos (:mod:`phase_ppl.evaluation.experiments`)


def _warn_of_scripted(figure: Figure, table: pd.DataFrame) -> None:
    if table["participant"].str.startswith(Judgments.SCRIPTED).any():
        warned(figure, REHEARSAL)


@in_style
def tags(source: Tags | PathLike, path: PathLike | None = None) -> Figure:
    """Draw the share of videos in each category, as the paper does for its 23 labels.

    ``source`` holds the labels, or is the CSV file that :func:`phase_ppl.load_tags` reads. A video
    has a category if at least half of its viewers chose the label.

    Raises:
        InvalidEventError: the file holds no labels; the message names file and line.
    """
    given = source if isinstance(source, Tags) else load_tags(source)
    found = given.summary()[::-1]
    figure = new_figure(
        *(6.4, 0.9 + 0.19 * len(found)),
        note=f"Percentage of the {len(given.viewers)} videos for which at least half of their "
        "viewers chose the label. Hollow: chosen by somebody, in no video by that many.",
    )
    axes = figure.subplots()
    bars = axes.barh(found.index, found["percent"], 0.68, color=COLOURS[0])
    axes.bar_label(bars, fmt="%.0f", padding=5, color=GREY)
    for label in found.index[(found["percent"] == 0) & found["used"]]:
        axes.plot(0, label, "o", ms=3.5, mfc="white", mec=COLOURS[0], clip_on=False, zorder=3)
    axes.set(xlim=(0, max(10.0, 1.12 * found["percent"].max())), ylim=(-0.6, len(found) - 0.4))
    axes.set_xlabel("videos, %")
    axes.grid(axis="x")
    _warn_of_scripted(figure, given.table)
    return written(figure, path)


@in_style
def likeness(source: Likeness | PathLike, path: PathLike | None = None) -> Figure:
    """Draw people's ratings of how likely the behaviour is, in two groups of videos.

    ``source`` holds the ratings, or is the CSV file that :func:`phase_ppl.load_likeness` reads. The
    note below the figure has the test of equivalence.

    Raises:
        InvalidEventError: the file holds no ratings; the message names file and line.
    """
    given = source if isinstance(source, Likeness) else load_likeness(source)
    test = given.equivalence()
    told = f"Difference of participants' means: {test['difference']:.2f}"
    if test["p"] is not None:
        told += f" [{test['ci_low']:.2f}, {test['ci_high']:.2f}] (90 %)"
    shown = "shown" if test["equivalent"] else "not shown"
    figure = new_figure(
        *(5.4, 2.9),
        note="Left: share of each rating. Right: mean rating of each video, and mean over videos. "
        f"{told}; equivalence within {MARGIN} is {shown} (two one-sided tests).",
    )
    shares, means = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
    for index, (group, values) in enumerate(given.means("videos").items()):
        ratings = given.table.loc[given.table["group"] == group, "rating"]
        share = [float((ratings == rating).mean()) for rating in RATINGS]
        places = np.array(RATINGS) + 0.4 * (index - 0.5)
        shares.bar(places, share, width=0.38, color=COLOURS[index], label=group)
        means.plot([index] * len(values), values, "o", ms=3, color=COLOURS[index], alpha=0.5, mew=0)
        means.plot([index - 0.25, index + 0.25], [values.mean()] * 2, color=INK, lw=1.5)
    shares.set(xticks=RATINGS, xlabel="rating", ylabel="share")
    shares.legend(loc="upper left")
    found = given.summary()
    labels = [f"{g}\n{r['mean']:.2f} ± {r['sd_videos']:.2f}" for g, r in found.iterrows()]
    means.set_xticks([0, 1], labels)
    means.set(xlim=(-0.5, 1.5), ylim=(0.9, 5.1), yticks=RATINGS)
    _warn_of_scripted(figure, given.table)
    return written(figure, path)
