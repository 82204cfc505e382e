"""Observers: what their parts do to answers, and what they have to go by."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro import handlers

import phase_ppl as ppl
from phase_people import observers
from phase_people.answers import FLOOR, PAIRS, evidence_of
from phase_people.observers import Evidence, Observer, Perception, observer_named
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import RELATIONS
from tests.analysis.readings import BLUE_NOT_TO_RED, BLUE_TO_RED, reading
from tests.world.examples import make_event


def evidence(log_likelihood: list[list[float]], **cues: float) -> Evidence:
    """Return evidence on relations alone, all prior masses alike."""
    logs = np.array(log_likelihood)
    return Evidence(
        tuple(map(str, range(len(logs)))),
        np.stack([logs, logs / 2, 0 * logs])[:, None],
        np.full(logs.shape, -np.log(3)),
        {"relation": np.arange(3)},
        {name: np.full(len(logs), cues.get(name, 0.0)) for name in ppl.cues.CUES},
    )


def answers(observer: observers.Program, given: Evidence, **parameters: float) -> np.ndarray:
    fixed = handlers.substitute(observer, {k: jnp.array(v) for k, v in parameters.items()})
    said = handlers.seed(fixed, jax.random.key(0))(given)
    return np.exp(np.asarray(said["relation"], np.float64))


SURE = evidence([[0.0, -50.0, -60.0]])


def test_without_parts_an_observer_answers_as_the_model_does_and_with_saturation_in_doubt() -> None:
    given = evidence([[0.0, -1.0, -2.0], [-3.0, 0.0, -1.0]])
    logs = given.log_likelihood[0, 0]
    expected = np.exp(logs) / np.exp(logs).sum(axis=1, keepdims=True)
    assert answers(Observer(), given) == pytest.approx(expected, abs=1e-5)
    observer, small = Observer(observers.saturation), evidence([[0.0, -0.01, -0.02]])
    shares = np.exp([0, -2, -2]) / (1 + 2 * np.exp(-2))
    assert answers(observer, SURE, most_evidence=2.0)[0] == pytest.approx(shares, abs=1e-4)
    same = answers(Observer(), small)
    assert answers(observer, small, most_evidence=20.0) == pytest.approx(same, abs=1e-4)


def test_lapses_few_samples_and_a_flat_response_make_answers_alike() -> None:
    lapsing, sampling = Observer(observers.lapse), Observer(observers.samples)
    assert answers(lapsing, SURE, lapse=0.3)[0] == pytest.approx([0.8, 0.1, 0.1])
    assert answers(sampling, SURE, samples=3.0)[0] == pytest.approx([4 / 6, 1 / 6, 1 / 6])
    given = evidence([[0.0, -2.0, -4.0]])
    flat = answers(Observer(observers.inverse_temperature), given, inverse_temperature=0.5)
    half = answers(Observer(observers.weight), given, weight=0.5)
    assert flat == pytest.approx(half, abs=1e-5)


def test_what_is_forgotten_counts_less() -> None:
    given = evidence([[0.0, -4.0, -4.0]])
    shares = [answers(Observer(observers.leak), given, leak=at)[0, 0] for at in (0.0, 1.0, 2.0)]
    assert shares[0] > shares[1] > shares[2] == pytest.approx(1 / 3, abs=1e-5)
    between = answers(Observer(observers.leak), given, leak=0.5)
    assert between == pytest.approx(answers(Observer(), evidence([[0.0, -3.0, -3.0]])), abs=1e-5)


def test_contact_speaks_against_agents_who_want_nothing_of_each_other() -> None:
    part = observers.cues(contact="neutral")
    apart, touching = (evidence([[0.0, 0.0, 0.0]], contact=c) for c in (0.0, 0.5))
    found = {"cue_scale": 1.0, "raw_contact": -4.0}
    assert answers(Observer(part), apart, **found)[0] == pytest.approx([1 / 3] * 3)
    share = answers(Observer(part), touching, **found)[0]
    assert share[1] == pytest.approx(np.exp(-2) / (2 + np.exp(-2)), abs=1e-5)


def test_readings_of_a_video_are_averaged_as_answers() -> None:
    one, other = [0.0, -30.0, -30.0], [-30.0, 0.0, -30.0]
    both = np.repeat(np.array([one, other])[None, :, None], 3, 0)
    given = dataclasses.replace(evidence([one]), log_likelihood=both)
    assert answers(Observer(), given)[0] == pytest.approx([0.5, 0.5, 0.0], abs=1e-5)


def test_relations_and_goals_follow_from_one_belief_about_pairs() -> None:
    event = ppl.load_event("collaborate")
    told = ppl.Prediction(event.id, {"relation": [0.2, 0.3, 0.5]})
    empty = evidence_of([event], {event.id: told})
    assert answers(Observer(), empty)[0] == pytest.approx([0.2, 0.3, 0.5], abs=0.01)
    never = evidence_of([event], {event.id: ppl.Prediction(event.id, {"relation": [0, 0.5, 0.5]})})
    assert answers(Observer(), never)[0, 0] == pytest.approx(FLOOR / 3, rel=1e-3)
    assert set(empty.answers) == {"relation"}
    assert evidence_of([event]).log_likelihood.shape == (3, 1, 1, len(RELATIONS))
    with pytest.raises(InvalidSettingError, match="made nothing of the event 'collaborate'"):
        evidence_of([event], {})


def test_an_observer_knows_no_frame_that_its_evidence_does_not_count() -> None:
    post, event = ClosedLoopPosterior(reading()), make_event(id="a")
    for frame in range(4):
        shares = answers(Observer(), evidence_of([event], {"a": post.at(frame)}))[0]
        assert shares == pytest.approx(post.at(frame).marginal("relation").values, abs=1e-4)


def test_frames_of_the_closed_loop_fade_by_their_age_and_count_as_it_counts_them() -> None:
    event, read = ppl.load_event("collaborate"), ClosedLoopPosterior(reading())
    given = evidence_of([event], {event.id: read})
    logs = given.log_likelihood.reshape(3, N_GOALS, N_GOALS)
    frames = read.by_frame()["log_likelihood"].values  # weighed
    one, other = (BLUE_TO_RED, BLUE_TO_RED), (BLUE_NOT_TO_RED, BLUE_TO_RED)
    for found, half_life in zip(logs, (np.inf, 40.0, 10.0), strict=True):
        assert found.max() == 0
        ages = zip((3, 2, 1, 0), frames, strict=True)
        expected = sum(0.5 ** (age / half_life) * (f[one] - f[other]) for age, f in ages)
        assert found[one] - found[other] == pytest.approx(expected)
    for goals, name in zip(other, ("goal_red", "goal_green"), strict=True):
        assert given.answers[name].reshape(N_GOALS, N_GOALS)[other] == goals


@pytest.mark.parametrize("pair", [(0, 2), (0, 0), (1,), (0, 1.5)])
@pytest.mark.parametrize("name", [name for name in ppl.cues.CUES if name != "unsettled"])
def test_a_cue_is_of_two_agents(name: str, pair: Any) -> None:
    event = ppl.load_event("collaborate")
    with pytest.raises(InvalidSettingError, match="pair"):
        ppl.cues.CUES[name](event.scene, event.observation, pair)


def test_cues_tell_agents_who_work_together_from_those_who_do_not() -> None:
    found = {name: ppl.cues.surface(e.scene, e.observation) for name in ppl.bundled_events()
             for e in [ppl.load_event(name)]}  # fmt: skip
    assert all(tuple(sorted(one)) == tuple(sorted(ppl.cues.CUES)) for one in found.values())
    assert found["collaborate"]["working"] > found["independent"]["working"]
    event = ppl.load_event("independent")
    far = event.observation.trajectory.copy()
    near = far.copy()
    near[:, 1, :2] = near[:, 0, :2] + 0.1
    close = ppl.cues.surface(event.scene, Observation(near))
    assert close["contact"] == 1.0
    assert close["distance"] < ppl.cues.surface(event.scene, Observation(far))["distance"]


def test_a_reading_misses_frames_and_misjudges_positions() -> None:
    event = ppl.load_event("independent")
    seen = Perception(noise=0.2, missed=0.5, percepts=3)
    one, other, _ = seen.readings(event.scene, event.observation, 1)
    off = one.trajectory - event.observation.trajectory
    assert (off[0] == 0).all()
    assert 0.05 < off[1:, :, :2].std() < 0.5
    assert (one.trajectory != other.trajectory).any()
    again = seen.readings(event.scene, event.observation, 1)[0]
    assert (again.trajectory == one.trajectory).all()
    exact = Perception(noise=0.0, percepts=1).readings(event.scene, event.observation, 1)[0]
    assert exact.trajectory == pytest.approx(event.observation.trajectory)


def test_what_is_no_observer_is_refused() -> None:
    wrong: list[tuple[Callable[[], object], type[Exception], str]] = [
        (lambda: observer_named("companie"), UnknownNameError, "observer 'companie'"),
        (lambda: observers.cues(distanze="neutral"), UnknownNameError, "cue 'distanze'"),
        (lambda: observers.cues(distance="hostile"), UnknownNameError, "relation 'hostile'"),
        (
            lambda: Observer(observers.weight, observers.leak),
            InvalidSettingError,
            "leak must be the first part",
        ),
        (lambda: Observer("lapse"), InvalidSettingError, "no function"),  # type: ignore[arg-type]
    ]
    for make, error, message in wrong:
        with pytest.raises(error, match=message):
            make()


def test_few_hypotheses_answer_as_all_pairs_of_goals_do() -> None:
    rng = np.random.default_rng(0)
    n = PAIRS["relation"].size
    logs = -rng.gamma(2.0, 3.0, (3, 1, 5, n))
    given = Evidence(
        tuple("abcde"), logs, np.full((5, n), -np.log(n)), PAIRS,
        {name: np.zeros(5) for name in ppl.cues.CUES},
    )  # fmt: skip
    few = given.condensed()
    assert few.log_prior.shape[1] < 100
    assert np.logaddexp.reduce(few.log_prior, axis=1) == pytest.approx(np.zeros(5))
    for weight in (0.3, 3.0):
        one, other = (answers(Observer(observers.weight), e, weight=weight) for e in (given, few))
        assert other == pytest.approx(one, abs=0.02)
    assert few.condensed() is few
