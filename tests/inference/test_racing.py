"""Racing: where its simulations go, and that their posterior is the exact one."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.tree import array
from phase_ppl.models.effective import prior_of_pairs
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import Scene
from tests.inference.toy import few_goals, total_variation, walking_event

EVENT = walking_event()
SEEDS = 4
ASIDE = 6.0 * np.random.default_rng(5).gamma(2.0, 1.0, (N_GOALS, N_GOALS, SEEDS))
"""(goal_red, goal_green, seed) units by which a simulation is off: 4 nats between seeds."""
PAIRS = [tuple(pair) for pair in np.argwhere(prior_of_pairs(few_goals) > 1e-9).tolist()]


def noisy(scene: Scene, hypothesis: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    frames = EVENT.observation.trajectory.copy()
    frames[:, 0, 0] += ASIDE[(*hypothesis.effective_goals, rng.integers(SEEDS))]
    return itertools.cycle(frames)


def exact() -> FloatArray:
    """Return (pair,) the posterior, summed."""
    prior = np.array([prior_of_pairs(few_goals)[pair] for pair in PAIRS])
    rate = 0.05 * EVENT.observation.n_frames
    mass = prior * np.array([np.exp(-rate * ASIDE[pair]).mean() for pair in PAIRS])
    return mass / mass.sum()


def raced(iterations: int, **options: object) -> ppl.Posterior:
    model = ppl.Model(prior=few_goals, simulator=noisy)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # once told, that simulations start aside
        post = ppl.infer(
            EVENT, model, kernel="racing", iterations=iterations, workers=1, progress=False,
            **options,  # type: ignore[arg-type]
        )  # fmt: skip
    assert isinstance(post, ppl.Posterior)
    return post


def pairs_of(post: ppl.Posterior) -> list[tuple[int, int]]:
    columns = [
        array(post.tree, "simulations", name).tolist() for name in ("goal_red", "goal_green")
    ]
    return list(zip(*columns, strict=True))


@pytest.fixture(scope="module")
def long_run() -> ppl.Posterior:
    return raced(120, seed=1)


@pytest.mark.parametrize("weights", ["stratified", "count"])
def test_the_posterior_is_the_enumerated_one(long_run: ppl.Posterior, weights: str) -> None:
    joint = ppl.Posterior(long_run.tree, weights).joint("goal_red", "goal_green").values
    assert total_variation(np.array([joint[pair] for pair in PAIRS]), exact()) < 0.11


def test_the_first_simulations_of_those_that_race_are_of_different_pairs(
    long_run: ppl.Posterior,
) -> None:
    simulated = long_run.tree["simulations"]
    race = (simulated["iteration"].values == 0) & (simulated["chain"].values % 2 == 1)
    tried = [pair for pair, here in zip(pairs_of(long_run), race, strict=True) if here]
    assert len(set(tried)) == len(tried) == 7


def test_what_leads_is_simulated_more_often_than_what_does_not(long_run: ppl.Posterior) -> None:
    order = np.argsort(-exact())
    tried = [pairs_of(long_run).count(PAIRS[place]) for place in order]
    assert min(tried) >= 1
    assert sum(tried[:3]) > 2 * sum(tried[-3:])


def test_it_is_reproducible(long_run: ppl.Posterior) -> None:
    again = pairs_of(raced(2, seed=1))
    assert again == pairs_of(long_run)[: len(again)]


@pytest.mark.slow  # it has to be compiled for one particle
def test_one_particle_suffices() -> None:
    assert len(set(pairs_of(raced(12, chains=1, seed=3)))) > 2


def test_draws_weigh_what_their_simulations_do(long_run: ppl.Posterior) -> None:
    assert long_run.weights == "stratified"
    with pytest.raises(InvalidSettingError, match="unequal weights"):
        _ = long_run.arviz
    with pytest.raises(InvalidSettingError, match="those for it are 'stratified'"):
        ppl.Posterior(long_run.tree, "importance")


def test_sigma_is_checked() -> None:
    with pytest.raises(InvalidSettingError, match="sigma=-1"):
        ppl.infer(EVENT, kernel="racing", sigma=-1.0)
