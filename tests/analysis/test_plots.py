"""The figure of a posterior."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import phase_ppl as ppl
from phase_ppl.analysis import plots
from phase_ppl.analysis.figures.beliefs import beliefs_of, discovery
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import InvalidSettingError, OutputError, UnknownNameError
from phase_ppl.world.goals import GOALS
from tests.evaluation.toys import still

from .factory import BLUE_TO_RED, PINK_TO_BLUE, Simulation, hypothesis, make_tree, random_tree
from .pages import texts_apart


@pytest.fixture(scope="module")
def figure() -> Figure:
    return plots.posterior(Posterior(random_tree(3, n_frames=12)))


def test_figure_has_its_six_panels_on_one_page(figure: Figure) -> None:
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[:4] == [
        "Goal of the red agent",
        "Goal of the green agent",
        "Relation, and scenario",
        "Tracks",
    ]
    assert [title.split(":")[0] for title in titles[4:]] == ["red agent", "green agent"]
    assert tuple(figure.get_size_inches()) == (10, 6)


def test_goal_bars_are_the_marginal() -> None:
    simulations = [Simulation(hypothesis(g), i) for i, g in enumerate((BLUE_TO_RED, PINK_TO_BLUE))]
    axes = plots.posterior(Posterior(make_tree(simulations, [[0, 0, 0, 1]]))).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == [BLUE_TO_RED, PINK_TO_BLUE]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([0.75, 0.25])  # type: ignore[attr-defined]


def test_no_text_leaves_the_page_or_covers_another() -> None:
    longest = max(GOALS, key=len)
    red: list[str | int] = [longest, 1, 2, 3, 4, 5]
    green: list[str | int] = [0, longest, 8, 9, 10, 11]
    simulations = [
        Simulation(hypothesis(*goals), i) for i, goals in enumerate(zip(red, green, strict=True))
    ]
    assert texts_apart(plots.posterior(Posterior(make_tree(simulations, [list(range(6))])))) > 50


def test_figures_are_written_and_bad_paths_are_named(tmp_path: Path) -> None:
    plots.training_curves(report(), tmp_path / "a b.png")
    plots.training_curves(report(), tmp_path / "a b.pdf")
    assert (tmp_path / "a b.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a b.pdf").read_bytes().startswith(b"%PDF")
    for name in ("missing/curves.png", "curves.odd"):
        with pytest.raises(OutputError, match=name):
            plots.training_curves(report(), tmp_path / name)


def test_importing_the_figures_imports_neither_pyplot_nor_arviz_nor_jax() -> None:
    code = (
        "import sys, phase_ppl.analysis.plots;"
        "print([m for m in ('matplotlib', 'arviz', 'jax', 'numpyro') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


# --- beliefs and search ---------------------------------------------------------------------------

EVENT = ppl.load_event("collaborate")


def test_what_is_seen_is_as_it_is_in_all_particles_and_the_rest_differs() -> None:
    for frame, belief in enumerate(beliefs_of(EVENT, 0, 10)):
        truth = EVENT.observation.trajectory[frame]
        assert belief.observed[0], "an agent knows itself"
        seen = belief.particles[:, belief.observed, :2]
        np.testing.assert_allclose(seen, np.broadcast_to(truth[belief.observed, :2], seen.shape))
        for entity in np.flatnonzero(~belief.observed):
            assert np.ptp(belief.particles[:, entity, :2], axis=0).max() > 1
        if frame == 12:
            return


def test_it_shows_the_frame_in_which_something_new_is_seen(tmp_path: Path) -> None:
    file = tmp_path / "beliefs.png"
    figure = ppl.plot.beliefs(EVENT, path=file)
    assert file.stat().st_size > 20_000
    assert len(figure.axes) == 6
    said = figure.get_supxlabel()
    found = list(beliefs_of(EVENT, 0, 10))
    first = discovery(found)
    assert first is not None
    new = np.flatnonzero(found[first].observed & ~found[first - 1].observed)
    before = found[first - 1].particles[:, new, :2]
    assert np.ptp(before, axis=0).max() > 4, "it did not know where to look"
    assert discovery(found[:first]) is None, "it is the first"
    names = ("red agent", "green agent", "blue item", "pink item")
    assert all(names[entity] in said for entity in new)
    assert f"{first / 12:.2f} s" in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="agent 'red'"):
        ppl.plot.beliefs(EVENT, "red")
    with pytest.raises(InvalidSettingError, match="frame=0"):
        ppl.plot.beliefs(EVENT, frame=0)
    with pytest.raises(InvalidSettingError, match="sees nothing new"):
        ppl.plot.beliefs(still(n_frames=3))
    with pytest.raises(InvalidSettingError, match=r"expected a phase_ppl\.Event"):
        ppl.plot.beliefs("collaborate")  # type: ignore[arg-type]


# --- a training -----------------------------------------------------------------------------------


def report(variant: str = "extended", networks: int = 2) -> dict[str, Any]:
    """Return a report with curves that end at different epochs."""
    names = ["training", "validation", "relation"] + ["goals"] * (variant == "extended")
    return {
        "settings": {"variant": variant},
        "data": {"events": {"train": 320, "validation": 80, "test": 100}},
        "members": [
            {
                "best_epoch": 2,
                "curves": {name: [0.3 + 0.1 * i, 0.5, 0.4][: 2 + i] for name in names},
            }
            for i in range(networks)
        ],
    }


@pytest.mark.parametrize(("variant", "lines"), [("extended", 4), ("original", 3)])
def test_every_network_has_its_curves_and_the_epoch_that_was_kept(variant: str, lines: int) -> None:
    figure = ppl.plot.training_curves(report(variant))
    drawn = [line for axes in figure.axes for line in axes.lines]
    assert len([line for line in drawn if line.get_marker() == "None"]) == 2 * lines
    kept = [line for line in drawn if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in kept] == [2] * 2 * (lines - 1)
    assert [line.get_ydata()[0] for line in kept] == [0.5] * 2 * (lines - 1)
    labels = [text.get_text() for axes in figure.axes for text in axes.get_legend().get_texts()]
    assert len(labels) == lines


def test_it_says_what_was_trained_on_what() -> None:
    title = ppl.plot.training_curves(report(networks=1)).get_suptitle()
    assert title == "SocialGNN, extended: 1 network, 320 training and 80 validation events"
