"""Figures, and what a notebook shows: what they draw, and that it can be read."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

import phase_ppl as ppl
from phase_ppl.analysis import figures as plots
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.figures.beliefs import beliefs_of, discovery
from phase_ppl.analysis.figures.style import MANY_COLOURS, OTHER
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import InvalidSettingError, OutputError, UnknownNameError
from phase_ppl.world.goals import GOALS
from phase_ppl.world.names import ENTITIES
from tests.evaluation.toys import still

from .factory import BLUE_TO_RED, PINK_TO_BLUE, hypothesis, posterior_of
from .pages import texts_apart
from .readings import reading


def test_goal_bars_are_the_marginal_in_a_page_of_six_panels() -> None:
    figure = plots.posterior(posterior_of((BLUE_TO_RED, PINK_TO_BLUE), [[0, 0, 0, 1]]))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    agents = ["Goal of the red agent", "Goal of the green agent"]
    assert titles[:4] == [*agents, "Relation, and scenario", "Tracks"]
    assert [title.split(":")[0] for title in titles[4:]] == ["red agent", "green agent"]
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == [BLUE_TO_RED, PINK_TO_BLUE]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([0.75, 0.25])  # type: ignore[attr-defined]


def test_no_text_leaves_the_page_or_covers_another() -> None:
    longest = max(GOALS, key=len)
    pairs: list[tuple[str | int, str | int]] = [(longest, 0), (1, longest)]
    pairs += [(goal, goal + 6) for goal in range(2, 6)]
    post = posterior_of([hypothesis(*goals) for goals in pairs], [list(range(6))])
    assert texts_apart(plots.posterior(post)) > 50


EVENT = ppl.load_event("collaborate")


def test_what_is_seen_is_as_it_is_in_all_particles_and_the_rest_differs() -> None:
    for frame, belief in enumerate(beliefs_of(EVENT, 0)):
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
    found = list(beliefs_of(EVENT, 0))
    first = discovery(found)
    assert first is not None
    new = np.flatnonzero(found[first].observed & ~found[first - 1].observed)
    before = found[first - 1].particles[:, new, :2]
    assert np.ptp(before, axis=0).max() > 4, "it did not know where to look"
    assert discovery(found[:first]) is None, "it is the first"
    assert all(ENTITIES[entity] in figure.get_supxlabel() for entity in new)
    assert f"{first / 12:.2f} s" in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_what_cannot_be_drawn_is_refused() -> None:
    cases: tuple[tuple[Any, dict[str, Any], str], ...] = (
        (EVENT, {"agent": "red"}, "agent 'red'"),
        (EVENT, {"frame": 0}, "frame=0"),
        (still(n_frames=3), {}, "sees nothing new"),
        ("collaborate", {}, r"expected a phase_ppl\.Event"),
    )
    for event, options, said in cases:
        with pytest.raises((InvalidSettingError, UnknownNameError), match=said):
            ppl.plot.beliefs(event, **options)


@functools.cache
def many_goals(n_chains: int, n_draws: int, n_goals: int = 20) -> Posterior:
    """Return draws that go through goals, those with low numbers most often."""
    hypotheses = [hypothesis(g, (g + 1) % n_goals) for g in range(n_goals)]
    share = np.arange(n_goals, 0, -1) / np.arange(n_goals, 0, -1).sum()
    draws = np.random.default_rng(0).choice(n_goals, size=(n_chains, n_draws), p=share)
    return posterior_of(hypotheses, draws.tolist())


@pytest.mark.parametrize("shape", [(15, 6), (1, 1)])
def test_no_text_about_chains_leaves_the_page_or_covers_another(shape: tuple[int, int]) -> None:
    for draw in (plots.diagnostics, plots.goal_map, plots.errors):
        assert texts_apart(draw(many_goals(*shape))) > 5


def image(axes: Axes) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.asarray(axes.images[0].get_array(), float)


def test_goal_map_gives_each_goal_its_colour_in_both_panels() -> None:
    post = many_goals(3, 4, n_goals=5)
    figure = plots.goal_map(post)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    colours = {label: to_rgb(one) for label, one in zip(labels, MANY_COLOURS, strict=False)}
    for axes, name in zip(figure.axes, ("goal_red", "goal_green"), strict=True):
        expected = [
            [colours[GOALS[code]] for code in row] for row in post.tree["posterior"][name].values
        ]
        np.testing.assert_allclose(image(axes), expected)
    # rare ones beyond the colours are grey and counted
    figure = plots.goal_map(many_goals(15, 20))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(labels) == len(MANY_COLOURS)
    assert labels[-1] == "9 other goals"
    assert (image(figure.axes[0]) == to_rgb(OTHER)).all(axis=-1).any()


def test_windows_are_shaded_where_proposals_came_from() -> None:
    given: dict[str, Any] = {"n_frames": 6, "window": [[0, 3], [3, -1]]}
    tree = posterior_of([hypothesis()], [[0, 0], [0, 0]], **given).tree
    tree.attrs["settings"] = '{"simple": {"window": 1}}'
    shaded = image(plots.errors(Posterior(tree)).axes[0])[0]
    np.testing.assert_allclose(shaded * 3, [1, 1, 0, 2, 2, 0])
    assert not plots.errors(posterior_of([hypothesis()], [[0, 0]])).axes[0].images


def test_events_and_scenes_are_drawn() -> None:
    for shown in (EVENT, EVENT.scene):
        drawing, _, caption = shown._repr_html_().partition("<div>")
        parts = [part.tag.split("}")[-1] for part in ElementTree.fromstring(drawing).iter()]
        assert parts.count("circle") == parts.count("polygon") == 2
        assert parts.count("rect") == 4
        assert (EVENT.truth.goal_red in caption) is (shown is EVENT)  # type: ignore[union-attr]
    assert "simulated" in repr(EVENT)
    assert "array" not in repr(EVENT)
    wanted = ppl.Hypothesis("Get blue item to red lm", "get to red agent", (1, 0))
    assert repr(wanted).startswith("Hypothesis(goal_red='Get blue item to red lm', ")
    assert eval(repr(wanted), {"Hypothesis": ppl.Hypothesis}) == wanted
    assert "get to red agent" in wanted._repr_html_()


def test_posteriors_are_tables_and_figures_show_themselves(tmp_path: Path) -> None:
    post = ClosedLoopPosterior(reading())
    shown, found = post._repr_html_(), post.diagnostics()
    assert found["answer"] in shown
    assert all(f"<strong>{one['name']}</strong>" in shown for one in found["checks"])
    assert "<pre" in shown
    assert "(the film: 0.8 s)" in str(post)
    for name in ("missing/a.png", "a.odd"):
        with pytest.raises(OutputError, match=name):
            ppl.plot.over_time(post, tmp_path / name)
    assert ppl.plot.over_time(post)._repr_png_().startswith(b"\x89PNG")
