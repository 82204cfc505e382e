"""Events that tell models apart: information by hand, and people who are told by few answers."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.stats import binom

import phase_ppl as ppl
from phase_people.answers import evidence_of
from phase_people.information import checked
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import RELATIONS
from tests.analysis.readings import reading
from tests.world.examples import make_event


def table(values: Any, errors: Any = None) -> xr.DataArray:
    values = np.array(values, float)
    errors = np.zeros_like(values) if errors is None else np.array(errors, float)
    dims = ("model", "event", "answer")
    coords: dict[str, Any] = {
        "model": [f"m{i}" for i in range(values.shape[0])],
        "event": [f"e{i}" for i in range(values.shape[1])],
        "answer": [f"a{i}" for i in range(values.shape[2])],
        "error": (dims, errors),
    }
    return xr.DataArray(values, coords, dims=dims)


TWO = table([[[1, 0], [0.5, 0.5], [0.9, 0.1]], [[0, 1], [0.5, 0.5], [0.4, 0.6]]])


def jensen_shannon(p: float, q: float) -> float:
    def entropy(x: float) -> float:
        return -sum(v * math.log(v) for v in (x, 1 - x) if v > 0)

    return entropy((p + q) / 2) - (entropy(p) + entropy(q)) / 2


def test_information_of_an_answer_is_the_jensen_shannon_divergence() -> None:
    found = checked(TWO, "relation", lapse=0.0)
    expected = [math.log(2), 0.0, jensen_shannon(0.9, 0.4)]
    np.testing.assert_allclose(found.information.values, expected, atol=1e-12)
    assert found.most == pytest.approx(math.log(2))
    assert list(found.table.index) == ["e0", "e2", "e1"]
    lapsing = checked(TWO, "relation", lapse=0.2).information.values
    assert lapsing[0] == pytest.approx(jensen_shannon(0.9, 0.1))


def test_several_answers_say_what_all_their_counts_say() -> None:
    n, k = 3, np.arange(4)
    shares = np.array([binom.pmf(k, n, x) for x in (0.9, 0.4)])
    for share in (0.5, 0.8):  # of the first model beforehand
        prior = {"m0": share, "m1": 1 - share}
        weights = np.array([*prior.values()])[:, None]
        by_hand = (weights * shares * np.log(shares / (weights * shares).sum(axis=0))).sum()
        found = checked(TWO, "relation", lapse=0.0, answers=n, prior=prior)
        assert found.information.values[2] == pytest.approx(by_hand)
        drawn = found.joint(["e2"])
        assert abs(drawn - by_hand) < 4 * drawn.error < 0.05
        assert found.attributed({}) == pytest.approx(prior)
    # too many outcomes to be summed are drawn
    many = np.random.default_rng(0).dirichlet(np.ones(36), (2, 1))
    three = checked(table(many), "goal_red", answers=3)
    single = checked(table(many), "goal_red").information.values[0]
    assert single < three.information.values[0] < 3 * single + 0.05


def test_errors_of_the_models_are_errors_of_the_information() -> None:
    errors = np.zeros(TWO.shape)
    errors[:, 2], errors[0, 1, 0] = 0.05, np.nan
    found = checked(table(TWO.values, errors), "relation").information
    assert found["error"].values[0] < 1e-9
    assert math.isnan(found["error"].values[1])
    assert 0.01 < found["error"].values[2] < 0.1
    # of more answers than can be summed over they are taken to add up
    many = table(np.random.default_rng(0).dirichlet(np.ones(36), (2, 1)), np.full((2, 1, 36), 1e-3))
    one, some = (checked(many, "goal_red", answers=n).information["error"].values for n in (1, 3))
    assert some == pytest.approx(3 * one)


def test_the_best_events_are_chosen_for_what_they_say_together() -> None:
    # e0 and e1 say the same, that it is not m2; e2 alone says less, but tells m0 from m1
    sure, not_sure = [0.95, 0.05], [0.05, 0.95]
    values = [[sure, sure, [0.8, 0.2]], [sure, sure, [0.2, 0.8]], [not_sure, not_sure, [0.5, 0.5]]]
    found = checked(table(values), "relation", lapse=0.0)
    assert list(found.table.index)[:2] == ["e0", "e1"]
    best = found.best(3)
    assert {*best.index[:2]} in ({"e0", "e2"}, {"e1", "e2"})
    assert (np.diff(best["information"]) > -0.02).all()
    assert best["information"].iloc[-1] < found.most == pytest.approx(math.log(3))
    given = found.attributed({"e0": "a0", "e2": ["a1", "a1"]})
    assert max(given, key=lambda name: given[name]) == "m1"
    counted = found.attributed({"e0": {"a0": 1}, "e2": {"a1": 2}})
    assert counted == pytest.approx(given)
    # of events that are all alike the best are not said to be better
    alike = checked(table([[[0.7, 0.3]] * 60, [[0.5, 0.5]] * 60]), "relation")
    chosen, any_five = alike.best(5).iloc[-1], alike.joint(alike.events[:5])
    assert abs(chosen["information"] - any_five) < 3 * chosen["error"]
    assert found.joint(["e0", "e0"]) == found.joint(["e0"])


def test_an_answer_that_cannot_be_says_nothing_where_nobody_gave_it() -> None:
    never = checked(table([[[0.8, 0.2, 0]], [[0.4, 0.6, 0]]]), "relation", lapse=0.0)
    given = never.attributed({"e0": {"a0": 1, "a2": 0}})
    assert given == pytest.approx({"m0": 2 / 3, "m1": 1 / 3})
    with pytest.raises(InvalidSettingError, match="no model can give these answers"):
        never.attributed({"e0": "a2"})


Videos = tuple[list[ppl.Event], dict[str, ClosedLoopPosterior]]


@pytest.fixture(scope="module")
def videos() -> Videos:
    """Return 16 videos with likelihoods made by hand, of which most leave priors nothing to say."""
    rng = np.random.default_rng(1)
    events, read = [], {}
    for i in range(16):
        likelihood = np.zeros((4, N_GOALS, N_GOALS))
        red, green = rng.integers(0, N_GOALS, 2)
        likelihood[1:, red] += rng.choice([0.2, 9.0], p=[0.15, 0.85])
        likelihood[1:, :, green] += rng.choice([0.2, 9.0], p=[0.15, 0.85])
        found = reading(columns={"log_likelihood": likelihood})
        event = dataclasses.replace(make_event(), id=f"video {i}", predictions=None, judgments=None)
        events.append(event)
        read[event.id] = ClosedLoopPosterior(found.assign_attrs(event_id=event.id))
    return events, read


def test_people_are_told_by_fewer_answers_about_chosen_events(videos: Videos) -> None:
    events, read = videos
    models = ["uniform", "sparse_social", "relation_first"]
    found = ppl.design(events, models, source=read, answers=4, progress=False)
    assert found.models == models
    for place, name in enumerate(models):
        expected = read["video 3"].with_prior(name).marginal("relation").values
        np.testing.assert_allclose(found.probabilities.values[place, 3], expected)
    n = 4
    chosen = list(found.best(n).index)
    rng = np.random.default_rng(7)
    shares = np.exp(found._log_shares)
    right = {"chosen": 0, "by chance": 0}
    for person in range(600):  # each answers as one of the models does
        model = person % len(models)
        by_chance = [found.events[i] for i in rng.permutation(len(events))[:n]]
        for how, asked in (("chosen", chosen), ("by chance", by_chance)):
            answers = {}
            for event in asked:
                said = rng.multinomial(4, shares[model, found.events.index(event)])
                answers[event] = dict(zip(RELATIONS, said.tolist(), strict=True))
            told = found.attributed(answers)
            right[how] += max(told, key=lambda name: told[name]) == models[model]
    assert right["chosen"] > right["by chance"] + 25
    assert found.best(n)["right"].iloc[-1] == pytest.approx(right["chosen"] / 600, abs=0.06)
    random = found.at_random(n)
    assert (found.best(n)["information"].values >= random["information"].values).all()
    assert random["right"].iloc[-1] == pytest.approx(right["by chance"] / 600, abs=0.06)


@pytest.mark.usefixtures("unpainted")
def test_it_prints_draws_and_is_saved(videos: Videos, tmp_path: Path) -> None:
    events, read = videos
    given = {"all alike": "uniform", "by hand": {event.id: read[event.id] for event in events}}
    found = ppl.design(events[:6], given, "goal_kind_red", source=read, progress=False)
    assert "goal_kind_red of 6 events, one answer about each" in str(found)
    found.save(tmp_path / "design.json")
    again = ppl.Design.load(tmp_path / "design.json")
    assert str(again) == str(found)
    assert again.best(3).equals(found.best(3))
    found.plot(tmp_path / "design.png", n=4)
    assert (tmp_path / "design.png").exists()
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InvalidEventError, match="schema"):
        ppl.Design.load(tmp_path / "other.json")


def test_a_function_or_people_can_be_told_from_a_prior(videos: Videos) -> None:
    events, read = videos

    def friendly(scene: Any, observation: Any, seed: int) -> dict[str, Any]:
        return {"relation": {"friendly": 0.8, "neutral": 0.1, "adversarial": 0.1}}

    people = ppl.FittedObserver.named("people", "closed_loop")
    models = {"kind": friendly, "people": people, "ideal": "uniform"}
    found = ppl.design(events[:3], models, source=read, workers=1, progress=False)
    kind, of_people, _ = found.probabilities.values
    np.testing.assert_allclose(kind, [[0.8, 0.1, 0.1]] * 3)
    expected = people.predict(evidence_of(events[:3], read))["video 2"].probabilities["relation"]
    np.testing.assert_allclose(of_people[2], expected)
    assert (found.information.values >= 0).all()


def test_errors_that_are_unknown_are_not_taken_for_none(tmp_path: Path) -> None:
    event = dataclasses.replace(make_event(), id="video", predictions=None, judgments=None)
    given = {"one": [0.8, 0.1, 0.1], "other": [0.3, 0.4, 0.3]}
    silent, exact = (
        {n: {"video": ppl.Prediction("video", {"relation": p}, errors=e)} for n, p in given.items()}
        for e in ({}, {"relation": [0.0] * 3})
    )
    found = ppl.design([event], silent, progress=False)
    assert np.isnan(found.probabilities["error"].values).all()
    assert np.isnan(found.information["error"].values).all()
    assert math.isnan(silent["one"]["video"].estimate("relation", "friendly").error)
    assert "unknown" in str(found).splitlines()[-1]
    assert found.plot() is not None
    found.save(tmp_path / "design.json")
    assert str(ppl.Design.load(tmp_path / "design.json")) == str(found)
    known = ppl.design([event], exact, progress=False)
    assert known.information.values == found.information.values
    assert known.information["error"].values == 0


def test_what_cannot_be_is_refused(videos: Videos) -> None:
    events, read = videos
    priors, one = ["uniform", "sparse_social"], {"video 0": read["video 0"]}
    bad: list[tuple[list[str], Any, str, str]] = [
        (["uniform"], read, "relation", "at least two to compare"),
        (["uniform", "unifrom"], read, "relation", "did you mean 'uniform'"),
        (priors, "uniform", "relation", "expected a source of posteriors"),
        (priors, one, "relation", "must have a posterior of 'video 1'"),
        (priors, read, "relatoin", "unknown quantity 'relatoin'"),
    ]
    for models, source, question, said in bad:
        with pytest.raises((InvalidSettingError, UnknownNameError), match=said):
            ppl.design(events[:2], models, question, source=source)
    for wrong, said in (
        ({"lapse": 1.0}, "lapse=1.0"),
        ({"answers": 0}, "answers=0"),
        ({"prior": {"m0": 1.0}}, "a positive number for every model"),
        ({"prior": {"m7": 1.0}}, "unknown model in prior 'm7'"),
    ):
        with pytest.raises(ValueError, match=said):
            checked(TWO, "relation", **wrong)
