"""The figure of a posterior."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from phase_ppl.analysis import Posterior, plots
from phase_ppl.world.errors import OutputError
from phase_ppl.world.goals import GOALS

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


def test_figure_is_written_as_png_and_pdf(tmp_path: Path) -> None:
    post = Posterior(random_tree(3))
    plots.posterior(post, tmp_path / "posterior.png")
    plots.posterior(post, tmp_path / "posterior.pdf")
    assert (tmp_path / "posterior.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "posterior.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("name", ["missing/posterior.png", "posterior.odd"])
def test_a_figure_that_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=name):
        plots.posterior(Posterior(random_tree(3)), tmp_path / name)


def test_importing_the_figures_imports_neither_pyplot_nor_arviz_nor_jax() -> None:
    code = (
        "import sys, phase_ppl.analysis.plots;"
        "print([m for m in ('matplotlib', 'arviz', 'jax', 'numpyro') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
