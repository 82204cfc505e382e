"""What a notebook shows: pictures of scenes and events, tables of posteriors, figures, films."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

import phase_ppl as ppl
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.world.errors import InvalidSettingError
from tests.analysis.factory import random_tree
from tests.analysis.readings import reading

EVENT = ppl.load_event("collaborate")


def test_events_and_scenes_are_drawn() -> None:
    for shown in (EVENT, EVENT.scene):
        drawing, _, caption = shown._repr_html_().partition("<div>")
        parts = [part.tag.split("}")[-1] for part in ElementTree.fromstring(drawing).iter()]
        assert parts.count("circle") == parts.count("polygon") == 2
        assert parts.count("rect") == 4
        assert (EVENT.truth.goal_red in caption) is (shown is EVENT)  # type: ignore[union-attr]
    assert "simulated" in repr(EVENT)
    assert "array" not in repr(EVENT)


def test_hypotheses_say_what_is_wanted() -> None:
    hypothesis = ppl.Hypothesis("Get blue item to red lm", "get to red agent", (1, 0))
    assert repr(hypothesis).startswith("Hypothesis(goal_red='Get blue item to red lm', ")
    record = eval(repr(hypothesis), {"Hypothesis": ppl.Hypothesis})
    assert record == hypothesis
    assert "get to red agent" in hypothesis._repr_html_()


def test_posteriors_are_tables_and_figures_show_themselves() -> None:
    post = StepwisePosterior(reading())
    assert post._repr_html_().startswith("<pre")
    assert "verdict" in post._repr_html_()
    assert "simulated s" in str(post)
    assert ppl.plot.over_time(post)._repr_png_().startswith(b"\x89PNG")


def test_posteriors_side_by_side() -> None:
    posts = {"by steps": StepwisePosterior(reading()), "sampled": ppl.Posterior(random_tree(3))}
    figure = ppl.plot.posteriors(posts)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(posts)
    labels = [label.get_text() for label in figure.axes[2].get_yticklabels()]
    bars = figure.axes[2].patches[: len(labels)]  # those of the first
    shares = dict(zip(labels, (bar.get_width() for bar in bars), strict=True))
    marginal = posts["by steps"].marginal("relation")
    assert shares == {name: pytest.approx(float(marginal.sel(relation=name))) for name in labels}
    with pytest.raises(InvalidSettingError, match="posterior"):
        ppl.plot.posteriors({"event": EVENT})
