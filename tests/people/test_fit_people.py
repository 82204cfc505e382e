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
from scipy.special import logsumexp, softmax
from scipy.stats import norm

import phase_ppl as ppl
from phase_people.answers import Answers, people
from phase_people.fit import FittedObserver, PeopleFit, sampled
from phase_people.observers import Evidence, Observer, Program, cues
from phase_ppl.evaluation.prediction import QUESTIONS
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event
from phase_ppl.world.hypothesis import RELATIONS
from tests.test_cli import told

DISTANCE = 3.0
OWN = Observer(cues(distance="neutral"))
RELATION = list(QUESTIONS).index("relation")
TIMELESS = np.zeros((0, 2), int), np.zeros(0)


def world(seed: int = 0, n: int = 12, raters: int = 30) -> tuple[Evidence, Answers]:
    """Return evidence on videos, and raters who take distance for independence."""
    rng = np.random.default_rng(seed)
    logs = rng.normal(0.0, 1.0, (n, 3))
    logs -= logs.max(axis=1, keepdims=True)
    seen = {name: rng.normal(0.0, 0.7, n) for name in ppl.cues.CUES}
    masses = logs + DISTANCE * seen["distance"][:, None] * [0, 1, 0]
    counts = rng.multinomial(raters, softmax(masses, axis=1))
    evidence = Evidence(
        tuple(f"v{i}" for i in range(n)), np.tile(logs, (3, 1, 1, 1)), np.full((n, 3), -np.log(3)),
        {"relation": np.arange(3)}, seen,
    )  # fmt: skip
    return evidence, Answers({"relation": counts}, np.zeros((0, 4), int), (), *TIMELESS)


def sure(law: list[list[float]]) -> Program:
    """Return an observer who goes by nothing but a law."""
    return lambda _: {"relation": jnp.log(jnp.array(law))}


def shares_of(observer: Program, draws: dict[str, FloatArray]) -> FloatArray:
    found = FittedObserver(observer, "", draws, ("relation",), None)
    return found.shares(world(n=3)[0])["relation"]


def fitted(observer: Observer, evidence: Evidence, answers: Answers) -> PeopleFit:
    return sampled(observer, "", evidence, answers, draws=120, warmup=80, chains=1)


@pytest.fixture(scope="module")
def fit() -> PeopleFit:
    return fitted(OWN, *world())


def test_parameters_come_back_and_the_observer_that_made_the_answers_wins(fit: PeopleFit) -> None:
    draws = fit.draws["cue_distance"]
    low, high = np.quantile(draws, [0.005, 0.995])
    assert low < DISTANCE < high
    assert draws.std() < 1.0
    rival = fitted(Observer(), *world())
    assert fit.elpd.sum() > rival.elpd.sum() + 10
    assert set(chosen_inside([rival, fit])[1].values()) == {1}


def test_left_out_videos_are_predicted_as_by_a_fit_without_them(fit: PeopleFit) -> None:
    again = fit.without([3])
    shares = again.predict(fit.evidence)["v3"].probabilities["relation"]
    assert fit.left_out["v3"].probabilities["relation"] == pytest.approx(shares, abs=0.02)
    # as by draws that count the less, the better they explain what is left out; alike they are 0.01
    # away from that
    raw = softmax(-fit.log_likelihood, axis=0)
    weighted = np.einsum("se,sek->ek", raw, fit.shares(fit.evidence)["relation"])
    found = [given.probabilities["relation"] for given in fit.left_out.values()]
    np.testing.assert_allclose(found, weighted, rtol=0, atol=0.002)
    with warnings.catch_warnings():  # of few draws ArviZ doubts more
        warnings.simplefilter("ignore", UserWarning)
        assert az.loo(fit.arviz).elpd_loo == pytest.approx(fit.elpd.sum(), abs=0.1)
    assert "12 videos, ELPD" in str(fit)
    # where reweighting the draws is unreliable, the fit without the video takes their place
    doubtful = dataclasses.replace(fit)
    doubtful.__dict__.update(
        _left_out_weights=(fit._left_out_weights[0], 0.9 * (np.arange(12) == 3)),
        without=lambda places: again,
    )  # fmt: skip
    assert doubtful.left_out["v3"].probabilities["relation"] == pytest.approx(shares, abs=1e-5)
    logs = again.log_likelihood[:, 3]
    assert doubtful.elpd[3] == pytest.approx(np.log(np.exp(logs).mean()))
    assert (doubtful.elpd == fit.elpd).sum() == 11


def test_a_stored_observer_answers_as_the_fit(fit: PeopleFit, tmp_path: Path) -> None:
    file = tmp_path / "people.json"
    fit.save(file)
    read = FittedObserver.load(file, OWN)
    one, other = (each.predict(world()[0])["v1"].probabilities for each in (read, fit))
    assert one["relation"] == pytest.approx(other["relation"], abs=0.03)
    with pytest.raises(InvalidSettingError, match="give its program"):
        FittedObserver.named(file, "anything")
    record = json.loads(file.read_text())
    for broken, message in (
        ({**record, "schema": "other"}, "schema is 'other'"),
        ({**record, "draws": {"spread": [1.0], "lapse": [0.1, 0.2]}}, "unequal"),
        ({**record, "draws": None}, "damaged"),
    ):
        file.write_text(json.dumps(broken))
        with pytest.raises(InvalidEventError, match=message):
            FittedObserver.load(file, OWN)


@pytest.mark.parametrize(("spread", "sharp"), [(0.1, 0.5), (0.67, 0.0), (1.5, 0.5)])
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


def test_shares_are_those_of_raters_who_differ_in_how_sharply_they_answer() -> None:
    """Not of the median one, who is surer than they are together."""
    law = np.array([[0.9, 0.05, 0.05], [0.7, 0.2, 0.1], [0.98, 0.01, 0.01]])
    observer, alike = sure(law.tolist()), {"spread": np.zeros(2)}
    places, steps = np.linspace(-8, 8, 4001, retstep=True)
    exact = []
    for diversity in (0.5, 1.5):
        powers = (law / law.max(axis=1, keepdims=True)) ** np.exp(diversity * places)[:, None, None]
        raters = powers / powers.sum(axis=-1, keepdims=True)
        exact.append(np.einsum("r,rea->ea", norm.pdf(places) * steps, raters))
    diverse = {**alike, "diversity": np.array([0.5, 1.5])}
    np.testing.assert_allclose(shares_of(observer, diverse), exact, atol=1e-3)
    # what raters share about a video makes them answer less sharply together too
    (moved, _, _), _ = shares_of(observer, {"spread": np.array([1.0, 0.0])})
    assert moved.argmax() == 0
    assert 0.8 < moved[0] < 0.88
    assert moved.sum() == pytest.approx(1, abs=1e-4)
    # of people without names it is not known
    np.testing.assert_allclose(shares_of(observer, alike), [law, law], atol=1e-5)


def test_a_parameter_of_ones_own_is_not_taken_for_the_raters() -> None:
    def own(given: Evidence) -> dict[str, Array]:
        times = numpyro.sample("diversity", dist.LogNormal(0.0, 1.0))
        return {"relation": jax.nn.log_softmax(times * jnp.log(jnp.array([[0.8, 0.1, 0.1]])))}

    found = shares_of(own, {"spread": np.zeros(1), "diversity": np.ones(1)})
    np.testing.assert_allclose(found, [[[0.8, 0.1, 0.1]]], atol=1e-5)


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


def test_judgments_at_moments_are_fitted_as_films_that_end_there() -> None:
    """People agree with the model early and doubt later; graded answers count by their shares."""
    event = ppl.load_event("collaborate")
    surely = np.array([0.8, 0.1, 0.1])
    made = ppl.Prediction(
        event.id, {"relation": surely}, moments={at: {"relation": surely} for at in (1.0, 3.0)}
    )
    rows = [
        {"participant": f"p{who}", "at": at, "relation": {"friendly": p, "neutral": 1 - p}}
        for who in range(5)
        for at, p in ((1.0, 0.8), (3.0, 0.4))
    ]
    judged = dataclasses.replace(event, judgments={"responses": rows})
    given: Any = {"source": {event.id: made}, "draws": 20, "warmup": 20, "chains": 1}
    with pytest.raises(InvalidEventError, match="at moments of the films: moments=True"):
        ppl.fit_people([judged], **given)
    fit = ppl.fit_people([judged], moments=True, **given)
    assert fit.evidence.events == ("collaborate until 1 s", "collaborate until 3 s")
    np.testing.assert_allclose(fit.answers.counts["relation"], [[4, 1, 0], [2, 3, 0]])
    assert fit.answers.raters == tuple(f"p{who}" for who in range(5))
    plain = {event.id: ppl.Prediction(event.id, {"relation": surely})}
    with pytest.raises(InvalidSettingError, match="what the model said at 1 s is not known"):
        ppl.fit_people([judged], moments=True, **{**given, "source": plain})


def test_people_who_come_with_the_package_see_what_a_model_makes_of_a_video() -> None:
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


def test_all_readings_of_a_video_are_paid_for() -> None:
    event = ppl.load_event("independent")
    asked = []

    def counting(scene: ppl.Scene, observation: ppl.Observation, seed: int) -> ppl.Prediction:
        asked.append(len(asked) + 1)
        shares = {"relation": [1 / 3] * 3}
        return ppl.Prediction("", shares, cost={"searches": asked[-1], "cached": True})

    people = dataclasses.replace(
        FittedObserver.named("people", "chance"), perception=ppl.Perception(percepts=4)
    )
    seen = ppl.evaluate([event], counting, observer=people, progress=False)
    cost = seen.predictions[event.id].cost
    assert (cost["searches"], cost["cached"]) == (sum(asked), True) == (10, True)


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
    brief = functools.partial(ppl.fit_people, draws=30, warmup=40, chains=1)
    monkeypatch.setattr(ppl, "fit_people", brief)
    given = ["--source", "cues", "--observer", "lapsing", "--out", out]
    assert "ELPD" in told(capsys, "fit-people", videos, *given)
    given = ["--model", "chance", "--observer", out, "--out", tmp_path / "results"]
    told(capsys, "evaluate", videos, *given)
    metrics = json.loads((tmp_path / "results" / "metrics.json").read_text())
    assert metrics["doubt"]["ceiling"]["spearman_brown"] is not None
    assert metrics["doubt"]["log_score_gap"]["value"] < 0.2
