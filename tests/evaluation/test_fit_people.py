"""Observers are fitted to people: parameters come back, and held-out videos are predicted."""

from __future__ import annotations

import dataclasses
import functools
import json
import warnings
from pathlib import Path
from typing import Any

import arviz as az
import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import Array
from numpyro import handlers
from people import chosen_inside
from scipy.special import logsumexp
from scipy.stats import norm

import phase_ppl as ppl
from phase_ppl.evaluation.observers.answers import Answers, expected, people
from phase_ppl.evaluation.observers.fit import FittedObserver, PeopleFit, observer_of, sampled
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.models.observers import CUES, Evidence, Program, observer_named
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS
from tests.test_cli import told

N = 25
DISTANCE = 3.0
RELATION = list(QUESTIONS).index("relation")
TIMELESS = np.zeros((0, 2), int), np.zeros(0)


def world(seed: int = 0, n: int = N, raters: int = 30) -> tuple[Evidence, Answers]:
    """Return evidence on videos, and raters who take distance for independence."""
    rng = np.random.default_rng(seed)
    logs = rng.normal(0.0, 2.0, (n, 3))
    logs -= logs.max(axis=1, keepdims=True)
    cues = {name: rng.normal(0.0, 0.7, n) for name in CUES}
    masses = 3.0 * np.expm1(logs / 3.0)
    masses[:, 1] += DISTANCE * cues["distance"]
    p = np.exp(masses) / np.exp(masses).sum(axis=1, keepdims=True)
    counts = rng.multinomial(raters, p)
    evidence = Evidence(
        tuple(f"v{i}" for i in range(n)), np.tile(logs, (3, 1, 1, 1)), np.full((n, 3), -np.log(3)),
        {"relation": np.arange(3)}, cues,
    )  # fmt: skip
    return evidence, Answers({"relation": counts}, np.zeros((0, 4), int), (), *TIMELESS)


def sure(law: list[list[float]]) -> Program:
    """Return an observer who goes by nothing but a law."""
    return lambda _: {"relation": jnp.log(jnp.array(law))}


def shares_of(observer: Program, draws: dict[str, FloatArray]) -> FloatArray:
    found = FittedObserver(observer, "", draws, ("relation",), None)
    return found.shares(world(n=3)[0])["relation"]


def fitted(name: str, evidence: Evidence, answers: Answers) -> PeopleFit:
    return sampled(observer_named(name), name, evidence, answers, draws=120, warmup=80, chains=1)


@pytest.fixture(scope="module")
def fits() -> dict[str, PeopleFit]:
    return {name: fitted(name, *world()) for name in ("distance", "saturating")}


def test_left_out_videos_are_predicted_as_by_a_fit_without_them(fits: dict[str, PeopleFit]) -> None:
    fit = fits["distance"]
    again = fit.without([3]).predict(fit.evidence)["v3"].probabilities["relation"]
    assert fit.left_out["v3"].probabilities["relation"] == pytest.approx(again, abs=0.05)
    with warnings.catch_warnings():  # of few draws ArviZ doubts more
        warnings.simplefilter("ignore", UserWarning)
        assert az.loo(fit.arviz).elpd_loo == pytest.approx(fit.elpd.sum(), abs=2.0)
    assert "distance" in str(fit)


def test_parameters_come_back_and_the_observer_that_made_the_answers_wins(
    fits: dict[str, PeopleFit],
) -> None:
    draws = fits["distance"].draws["cue_distance"]
    low, high = np.quantile(draws, [0.005, 0.995])
    assert low < DISTANCE < high
    assert draws.std() < 1.0
    assert fits["distance"].elpd.sum() > fits["saturating"].elpd.sum() + 10
    _, chosen = chosen_inside([fits["saturating"], fits["distance"]])
    assert set(chosen.values()) == {1}


def test_a_stored_observer_answers_as_the_fit(fits: dict[str, PeopleFit], tmp_path: Path) -> None:
    file = tmp_path / "people.json"
    fits["distance"].save(file)
    read = observer_of(file, "anything")
    one, other = (fit.predict(world()[0])["v1"].probabilities for fit in (read, fits["distance"]))
    assert one["relation"] == pytest.approx(other["relation"], abs=0.03)
    record = json.loads(file.read_text())
    for broken, message in (
        ({**record, "schema": "other"}, "schema is 'other'"),
        ({**record, "draws": {"spread": [1.0], "lapse": [0.1, 0.2]}}, "unequal"),
        ({**record, "draws": None}, "damaged"),
    ):
        file.write_text(json.dumps(broken))
        with pytest.raises(InvalidEventError, match=message):
            observer_of(file, "anything")


@pytest.mark.parametrize("spread", [0.1, 0.67, 1.5])
@pytest.mark.parametrize("sharp", [0.0, 0.5])
def test_what_people_share_is_summed_out(spread: float, sharp: float) -> None:
    """Against a fine grid of the two log odds that matter, whether or not people have names."""
    counts = np.array([[20, 0, 0], [0, 20, 0], [7, 7, 6], [0, 10, 10], [0, 0, 0]])
    law = [[0.9, 0.05, 0.05]] * 5
    raters = [(e, a) for e, row in enumerate(counts) for a in np.repeat(range(3), row).tolist()]
    rows = np.array([(RELATION, event, place, a) for place, (event, a) in enumerate(raters)])
    own = sharp * np.random.default_rng(0).standard_normal(len(rows))
    names = tuple(map(str, range(len(rows))))
    axis, step = np.linspace(-8, 8, 161, retstep=True)
    x, y = (one.ravel() for one in np.meshgrid(axis, axis))
    shared = np.outer(x, [1, -1, 0]) / 2**0.5 + np.outer(y, [1, 1, -2]) / 6**0.5
    log_mass = np.log(norm.pdf(x) * norm.pdf(y) * step**2)

    def found(*of_raters: Any) -> Array:
        given = {"spread": spread, "diversity": 1.0, "rater": jnp.asarray(own)}
        program = handlers.seed(handlers.substitute(people, given), 0)
        answers = Answers({"relation": counts}, *of_raters, *TIMELESS)
        sites = handlers.trace(program).get_trace(sure(law), world(n=5)[0], answers, np.ones(5))
        return sites["log_likelihood"]["value"]

    moved = np.log(law)[:, None] + spread * shared
    moved -= logsumexp(moved, axis=-1, keepdims=True)
    alike = logsumexp(np.einsum("ega,ea->eg", moved, counts) + log_mass, axis=1)
    np.testing.assert_allclose(found(np.zeros((0, 4), int), ()), alike, atol=0.05)
    by_name = np.tile(log_mass, (5, 1))
    for (event, answer), power in zip(raters, np.exp(own), strict=True):
        logs = power * moved[event]
        by_name[event] += logs[:, answer] - logsumexp(logs, axis=-1)
    np.testing.assert_allclose(found(rows, names), logsumexp(by_name, axis=1), atol=0.1)


@pytest.mark.parametrize("diversity", [0.5, 1.0, 1.5])
def test_shares_are_those_of_raters_who_differ_in_how_sharply_they_answer(diversity: float) -> None:
    """Not of the median one, who is surer than they are together."""
    law = np.array([[0.9, 0.05, 0.05], [0.7, 0.2, 0.1], [0.98, 0.01, 0.01]])
    observer, draws = sure(law.tolist()), {"spread": np.zeros(2)}
    diverse = {**draws, "diversity": np.full(2, diversity)}
    places, steps = np.linspace(-8, 8, 4001, retstep=True)
    powers = (law / law.max(axis=1, keepdims=True)) ** np.exp(diversity * places)[:, None, None]
    raters = powers / powers.sum(axis=-1, keepdims=True)
    exact = np.einsum("r,rea->ea", norm.pdf(places) * steps, raters)
    np.testing.assert_allclose(shares_of(observer, diverse), [exact, exact], atol=1e-3)
    fit = FittedObserver(observer, "", diverse, ("relation",), None)
    predicted = fit.predict(world(n=3)[0])["v0"].probabilities["relation"]
    assert predicted[0] == pytest.approx({0.5: 0.869, 1.0: 0.827, 1.5: 0.795}[diversity], abs=1e-3)
    # of people without names it is not known
    np.testing.assert_allclose(shares_of(observer, draws), [law, law], atol=1e-5)


def test_a_parameter_of_ones_own_is_not_taken_for_the_raters() -> None:
    def own(given: Evidence) -> dict[str, Array]:
        times = numpyro.sample("diversity", dist.LogNormal(0.0, 1.0))
        return {"relation": jax.nn.log_softmax(times * jnp.log(jnp.array([[0.8, 0.1, 0.1]])))}

    found = shares_of(own, {"spread": np.zeros(1), "diversity": np.ones(1)})
    np.testing.assert_allclose(found, [[[0.8, 0.1, 0.1]]], atol=1e-5)


@pytest.mark.slow
def test_raters_of_one_mind_are_told_from_independent_ones() -> None:
    evidence, answers = world()
    agreed = dataclasses.replace(
        answers,
        counts={"relation": np.eye(3, dtype=int)[answers.counts["relation"].argmax(1)] * 15},
    )
    spread = fitted("distance", evidence, agreed).draws["spread"].mean()
    assert spread > 3 * fitted("distance", evidence, answers).draws["spread"].mean()
    logs = np.log(np.array([[0.8, 0.1, 0.1]]))
    moved = np.asarray(expected({"relation": logs}, 1.0)["relation"])[0]
    assert moved[0] < 0.8
    assert moved.argmax() == 0
    assert moved.sum() == pytest.approx(1.0, abs=1e-4)


def study(path: Path, events: list[Event]) -> None:
    """Write single answers of people with names, who take longer where they doubt."""
    rng = np.random.default_rng(0)
    rows = ["participant,video,relation,goal_red,response_time"]
    for event in events:
        unsure = float(int(event.id[1:]) % 2)
        for rater in range(6):
            p = [0.34, 0.33, 0.33] if unsure else [0.94, 0.03, 0.03]
            answer = RELATIONS[int(rng.choice(3, p=p))]
            time = np.exp(1.0 + 1.5 * unsure + rng.normal(0, 0.2))
            rows.append(f"p{rater},{event.id},{answer},get to green agent,{time:.2f}")
    path.write_text("\n".join(rows) + "\n")


@pytest.mark.slow
def test_answers_of_a_study_with_names_and_times_go_through_the_same_call(tmp_path: Path) -> None:
    event = ppl.load_event("collaborate")
    events = [dataclasses.replace(event, id=f"v{i}", judgments=None) for i in range(16)]
    study(tmp_path / "study.csv", events)
    model = {
        e.id: ppl.Prediction(e.id, {"relation": [1 / 3] * 3 if i % 2 else [0.96, 0.02, 0.02]})
        for i, e in enumerate(events)
    }
    fit = ppl.fit_people(
        events, tmp_path / "study.csv", "saturating", source=model, draws=60, warmup=100, chains=1
    )
    assert {"diversity", "slowing", "pace", "time_noise"} <= set(fit.draws)
    assert np.quantile(fit.draws["slowing"], 0.05) > 0
    assert fit.answers.raters == tuple(f"p{i}" for i in range(6))
    assert fit.questions == ("relation",)


def test_fits_without_people_or_by_nobody_are_refused() -> None:
    event = ppl.load_event("collaborate")
    model = {event.id: ppl.Prediction(event.id, {"relation": [1 / 3] * 3})}
    nobody = [dataclasses.replace(event, judgments=None)]
    with pytest.raises(InvalidEventError, match="nobody judged"):
        ppl.fit_people(nobody, None, "saturating", source=model)
    with pytest.raises(UnknownNameError, match="observer 'nobody'"):
        ppl.fit_people([event], None, "nobody", source=model)


def test_people_who_come_with_the_package_see_what_a_model_makes_of_a_video(tmp_path: Path) -> None:
    event = ppl.load_event("independent")
    alone = ppl.evaluate([event], "chance", progress=False)
    seen = ppl.evaluate([event], "chance", observer="people", progress=False)
    shares = seen.predictions[event.id].probabilities["relation"]
    assert shares.sum() == pytest.approx(1)
    assert shares[1] > 1 / 3  # they keep apart
    assert alone.predictions[event.id].probabilities["relation"] == pytest.approx([1 / 3] * 3)
    assert seen.settings["observer"]
    assert "observer" not in alone.settings
    with pytest.raises(InvalidSettingError, match="comes for the models"):
        ppl.evaluate([event], "majority", observer="people")


def test_commands_fit_and_ask_an_observer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    event = ppl.load_event("independent")
    counts = {"friendly": 1, "neutral": 12, "adversarial": 2}
    events = [
        dataclasses.replace(event, id=f"v{i}", judgments={"relation_counts": counts})
        for i in range(4)
    ]
    out, videos = tmp_path / "observer.json", tmp_path / "videos.json"
    ppl.save_events(events, videos)
    brief = functools.partial(ppl.fit_people, draws=60, warmup=60, chains=1)
    monkeypatch.setattr(ppl, "fit_people", brief)
    given = ["--source", "cues", "--observer", "lapsing", "--out", out]
    assert "ELPD" in told(capsys, "fit-people", videos, *given)
    given = ["--model", "chance", "--observer", out, "--no-figures", "--out", tmp_path / "results"]
    told(capsys, "evaluate", videos, *given)
    metrics = json.loads((tmp_path / "results" / "metrics.json").read_text())
    assert metrics["doubt"]["ceiling"]["spearman_brown"] is not None
    assert metrics["doubt"]["log_score_gap"]["value"] < 0.2
