"""People who judge at moments of a film, beside what models say of the film until then."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import phase_ppl as ppl
from phase_ppl.world.event import Observation
from phase_ppl.world.scene import Scene
from tests.evaluation.toys import evaluate, still

MOMENTS = (0.25, 0.5, 1.0)
LABELS = ("friendly", "neutral", "adversarial")
EVENTS = [still(name, 5 + place, shift=0.1 * place) for place, name in enumerate("abcd")]


def grows(scene: Scene, observation: Observation, seed: int) -> Mapping[str, Any]:
    """Believe more with each frame, in what the place of the first body says."""
    sure = 0.5 + 0.05 * (observation.n_frames - 1)
    place = round(10 * (observation.trajectory[0, 0, 0] - 8)) % 3
    shares = np.full(3, (1 - sure) / 2)
    shares[place] = sure
    return {"relation": shares}


def table(events: list[ppl.Event] = EVENTS, raters: int = 6) -> pd.DataFrame:
    """People who answer as the model does, but for noise."""
    rng = np.random.default_rng(0)
    rows = []
    for event in events:
        for at in MOMENTS:
            shares = grows(event.scene, event.observation.until(at), 0)["relation"]
            for who in range(raters):
                rows.append([f"p{who}", event.id, at, *rng.dirichlet(40 * shares)])
    return pd.DataFrame(rows, columns=["participant", "video", "at", *LABELS])


def test_a_model_is_asked_about_the_film_until_each_moment(tmp_path: Path) -> None:
    study = ppl.load_judgments(table(), EVENTS)
    assert "72 of them at 3 moments" in str(study)
    found = evaluate(EVENTS, grows, judgments=study, out=tmp_path / "kept")
    made = found.predictions["a"].moments
    assert {at: float(given["relation"].max()) for at, given in made.items()} == pytest.approx(
        {0.25: 0.55, 0.5: 0.6, 1.0: 0.7}
    )
    metrics = found.metrics["moments"]
    assert metrics["relation_r"]["value"] > 0.95
    assert metrics["goal_r"] is None
    assert metrics["log_score"]["value"] <= metrics["log_score_people"]["value"]
    assert metrics["hindsight"] is False
    each = {of["at"]: of for of in metrics["by_moment"]}
    assert list(each) == list(MOMENTS)
    assert [of["n"] for of in each.values()] == [24, 24, 24]
    # people and model are surer with time: it is known better what others think
    assert each[0.25]["log_score"]["value"] < each[1.0]["log_score"]["value"]
    for of in each.values():
        assert of["split_half_r"]["value"] <= 1
        assert 0 <= of["ece"] < 0.1
    # of the whole film nobody said anything
    assert found.metrics["human"]["relation_r"] is None
    assert found.metrics["people"]["n_events"] == 0
    tidy = found.to_dataframe()
    assert tidy["n"][tidy["at"] == 0.5].unique().tolist() == [6]
    again = ppl.Evaluation.load(tmp_path / "kept")
    assert again.metrics["moments"] == metrics
    # the folder is gone on with for other moments
    other = table().replace({"at": {1.0: 0.75}})
    gone_on = evaluate(EVENTS, grows, judgments=ppl.load_judgments(other, EVENTS),
                       out=tmp_path / "kept", resume=True)  # fmt: skip
    assert [of["at"] for of in gone_on.metrics["moments"]["by_moment"]] == [0.25, 0.5, 0.75]


def test_people_and_models_are_drawn_over_time_and_compared(tmp_path: Path) -> None:
    study = ppl.load_judgments(table(), EVENTS)
    found = {
        name: evaluate(EVENTS, model, judgments=study)
        for name, model in (("grows", grows), ("still", lambda *_: {"relation": [0.4, 0.3, 0.3]}))
    }
    comparison = ppl.compare_models(found)
    assert "at moments of the film" in str(comparison)
    figure = ppl.figures.over_time(comparison, tmp_path / "over.png")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["grows", "still"]
    assert [axes.get_title(loc="left") for axes in figure.axes[:3]] == list(LABELS)
    people, *models = figure.axes[0].lines
    assert people.get_xdata() == pytest.approx(MOMENTS)
    assert len(models) == 2
    assert len(figure.axes[0].collections) == 1, "intervals of people's mean"
    with pytest.raises(ppl.errors.InvalidSettingError, match="nobody judged at a moment"):
        ppl.figures.over_time(evaluate(EVENTS, grows))


@pytest.mark.parametrize("moments", [3, [1], {"at": 1}, [{"at": -1}], [{"relation": {}}]])
def test_moments_of_predictions_that_are_none_are_refused(moments: Any) -> None:
    record = {"event": "a", "probabilities": {}, "answers": {}, "moments": moments}
    with pytest.raises(ppl.errors.PhasePPLError, match=r"moment|at="):
        ppl.Prediction.from_dict(record)


def test_a_posterior_is_read_at_the_frame_of_a_moment(tmp_path: Path) -> None:
    event = ppl.load_event("collaborate")
    event = ppl.Event(event.scene, event.observation.until(2.0), id="begins", truth=event.truth)
    rows = [["p", "begins", at, "friendly"] for at in (0.0, 1.0, 9.0)]
    given = pd.DataFrame(rows, columns=["participant", "video", "at", "relation"])
    study = ppl.load_judgments(given, [event])
    found = ppl.evaluate(
        [event], "closed_loop", judgments=study, out=tmp_path / "out", workers=1, progress=False,
        planner=ppl.PlannerConfig(simulations=10, particles=5, paired=True),
    )  # fmt: skip
    post = found.posterior("begins")
    over, made = post.over_time(), found.predictions["begins"]
    # four frames a second; after the end the last one
    for at, frame in ((0.0, 0), (1.0, 4), (9.0, 8)):
        np.testing.assert_allclose(
            made.at(at).probabilities["relation"], over["relation"].values[frame], atol=1e-9
        )
    assert made.at(9.0).probabilities["relation"] == pytest.approx(made.probabilities["relation"])
