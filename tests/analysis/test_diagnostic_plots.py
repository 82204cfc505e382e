"""The figures of how chains went: what they draw, and that it can be read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from phase_ppl.analysis import plots
from phase_ppl.analysis.figures.style import MANY_COLOURS, OTHER
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.goals import GOALS

from .factory import Simulation, hypothesis, make_tree, random_tree
from .pages import texts_apart


def many_goals(n_chains: int, n_draws: int, n_goals: int = 20) -> Posterior:
    """Return draws that go through goals, those with low numbers most often."""
    simulations = [Simulation(hypothesis(g, (g + 1) % n_goals), g) for g in range(n_goals)]
    rng = np.random.default_rng(0)
    share = np.arange(n_goals, 0, -1) / np.arange(n_goals, 0, -1).sum()
    draws = rng.choice(n_goals, size=(n_chains, n_draws), p=share)
    return Posterior(make_tree(simulations, draws.tolist()))


@pytest.mark.parametrize("shape", [(15, 6), (4, 500), (1, 1)])
@pytest.mark.parametrize(
    "draw",
    [plots.diagnostics, plots.goal_map, plots.chains, plots.errors],
    ids=lambda d: d.__name__,
)
def test_no_text_leaves_the_page_or_covers_another(
    shape: tuple[int, int], draw: Callable[[Posterior], Figure]
) -> None:
    assert texts_apart(draw(many_goals(*shape))) > 5


def image(axes: Axes) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.asarray(axes.images[0].get_array(), float)


def test_goal_map_gives_each_goal_its_colour_in_both_panels() -> None:
    post = many_goals(3, 4, n_goals=5)
    figure = plots.goal_map(post)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    colours = dict(zip(labels, MANY_COLOURS, strict=False))
    for axes, name in zip(figure.axes, ("goal_red", "goal_green"), strict=True):
        codes = post.tree["posterior"][name].values
        for place in np.ndindex(codes.shape):
            expected = to_rgb(colours[GOALS[codes[place]]])
            np.testing.assert_allclose(image(axes)[place], expected)


def test_rare_goals_beyond_the_colours_are_grey_and_counted() -> None:
    figure = plots.goal_map(many_goals(15, 20))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(labels) == len(MANY_COLOURS)
    assert labels[-1] == "9 other goals"
    assert (image(figure.axes[0]) == to_rgb(OTHER)).all(axis=-1).any()


def test_ranks_are_counts_over_what_is_expected() -> None:
    tree = random_tree(0, n_chains=2, n_draws=4)
    # the first chain has the four lowest of eight
    tree["sample_stats"]["log_joint"][:] = [[1, 2, 3, 4], [5, 6, 7, 8]]
    figure = plots.chains(Posterior(tree))
    np.testing.assert_allclose(image(figure.axes[1]), [[2, 0], [0, 2]])


def test_windows_are_shaded_where_proposals_came_from() -> None:
    simulations = [Simulation(hypothesis(), 0)]
    tree = make_tree(simulations, [[0, 0], [0, 0]], n_frames=6, window=[[0, 3], [3, -1]])
    tree.attrs["settings"] = '{"simple": {"window": 1}}'
    shaded = image(plots.errors(Posterior(tree)).axes[0])[0]
    np.testing.assert_allclose(shaded * 3, [1, 1, 0, 2, 2, 0])
    none = make_tree(simulations, [[0, 0]])
    assert not plots.errors(Posterior(none)).axes[0].images


def test_acceptance_of_many_iterations_is_drawn_in_stretches() -> None:
    post = many_goals(4, 100)
    axes = plots.diagnostics(post).axes[-1]
    rates = np.array(post.diagnostics()["acceptance_by_iteration"])
    heights = [bar.get_height() for bar in axes.patches]  # type: ignore[attr-defined]
    np.testing.assert_allclose(heights, rates.reshape(20, 5).mean(axis=1))


def test_a_users_real_site_has_a_trace() -> None:
    simulations = [Simulation(hypothesis(), i) for i in range(4)]
    tree = make_tree(simulations, [[0, 1, 2, 3]], own_site=[3, 1, 2, 2])
    for group in ("posterior", "simulations"):
        tree[group]["mood"] = tree[group]["mood"].astype(float)
    titles = [axes.get_title(loc="left") for axes in plots.chains(Posterior(tree)).axes]
    assert "mood" in titles
