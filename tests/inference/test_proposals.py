from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random

from phase_ppl.inference.guide import Guide, bottom_up_guide
from phase_ppl.inference.settings import SimpleSettings
from phase_ppl.inference.tables import (
    BottomUpTables,
    bottom_up_tables,
    goal_features,
    joint_logits,
    window_count,
    window_length,
)
from phase_ppl.models import priors, sites
from phase_ppl.models.density import compiled_quickly, draw, log_density
from phase_ppl.models.model import Model
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import GOALS, N_GOALS, effective_goals, goal_index
from phase_ppl.world.hypothesis import ALPHAS, STRENGTH_LEVELS
from phase_ppl.world.names import AGENTS, LANDMARKS
from phase_ppl.world.scene import Scene
from tests.inference.toy import (
    N_FRAMES,
    SCENE,
    SETTINGS,
    guide_of_logits,
    moving,
    never_called,
)

RED, GREEN = 0, 1
TO_RED = "Get blue item to red lm"


def distances(observation: Observation, **more: Any) -> BottomUpTables:
    return bottom_up_tables(SCENE, observation, SimpleSettings(proposal="paper", **more))


def logit(tables: BottomUpTables, goal: str, window: int = -1, agent: int = RED) -> float:
    return float(np.asarray(tables.goal_logits)[window, agent, goal_index(goal)])


@pytest.mark.parametrize(("n_frames", "length", "count"), [(2, 1, 1), (11, 10, 1), (50, 10, 40)])
def test_windows_cover_all_frames(n_frames: int, length: int, count: int) -> None:
    assert (window_length(n_frames, 10), window_count(n_frames, 10)) == (length, count)
    tables = distances(moving(n_frames, _2=(20.0, 6.0)))
    assert tables.goal_logits.shape == (count + 1, 2, 36)
    assert tables.strength.shape == tables.strength_sd.shape == (count + 1, 2)


def test_goal_that_an_item_comes_to_is_the_likeliest_of_its_own() -> None:
    tables = distances(moving(_2=(23.5, 4.5)))
    mine = [goal for goal in GOALS if goal.startswith("Get blue item")]
    assert max(mine, key=lambda goal: logit(tables, goal)) == TO_RED
    # being far is no reason to believe in getting away
    for landmark in ("blue lm", "green lm", "yellow lm"):
        assert logit(tables, f"Get blue item away from {landmark}") < logit(tables, TO_RED)
    # what names its holder is never proposed
    assert (np.asarray(tables.goal_logits)[:, sites.SELF_REFERRING] < -1e20).all()


def test_goals_about_agents_are_judged_by_where_these_are() -> None:
    tables = distances(moving(_1=(23.5, 4.5)))
    goal = "Get green agent to red lm"
    assert logit(tables, goal, agent=RED) == logit(tables, goal, agent=GREEN)
    assert logit(tables, goal) > logit(tables, "Get red agent to red lm")
    closer, farther = (distances(moving(_0=place)) for place in ((18.0, 8.0), (6.5, 21.0)))
    assert logit(closer, "get to green agent") > logit(farther, "get to green agent")
    away = "get away from green agent"
    assert logit(farther, away) > logit(closer, away)


def test_printed_sign_prefers_far_goals() -> None:
    observation, possible = moving(_2=(23.5, 4.5)), ~sites.SELF_REFERRING
    intended, printed = (
        np.asarray(distances(observation, sign=sign).goal_logits)[:, possible]
        for sign in ("intended", "printed")
    )
    np.testing.assert_allclose(intended, -printed)


WINDOW = 3


@functools.cache
def tables() -> BottomUpTables:
    """Of the learned form, with an estimate of the red strength, none of the green one."""
    found = bottom_up_tables(SCENE, moving(_2=(23.5, 4.5)), SimpleSettings())
    known = np.tile([True, False], (len(found.strength), 1))  # 300 N, give or take 40
    strength, sd = (np.where(known, newtons, np.nan) for newtons in (300.0, 40.0))
    return found._replace(strength=strength, strength_sd=sd)


@functools.cache
def guide_of(prior: Callable[[], Any]) -> Guide:
    model = Model(prior=prior, simulator=never_called)
    return bottom_up_guide(prior, model.sites, tables(), prior_share=0.1)


@functools.cache
def proposed(prior: Callable[[], Any]) -> dict[str, np.ndarray]:
    """20,000 proposals of the guide in one window."""
    guide, keys = guide_of(prior), random.split(random.key(0), 20_000)
    drawn = compiled_quickly(jax.vmap(lambda key: draw(guide, key, jnp.array(WINDOW))))(keys)
    return {name: np.asarray(values) for name, values in drawn.items()}


def densities(program: Any, z: Any, *args: Any) -> np.ndarray:
    return np.asarray(compiled_quickly(jax.vmap(lambda one: log_density(program, one, *args)))(z))


CALM, HELPFUL = np.array([0.8, 0.05, 0.05, 0.05, 0.05]), np.array([0.1, 0.4, 0.4, 0.05, 0.05])


def helpful_moods() -> None:
    """A hierarchy: the mood decides how likely helping is, and how long a memory is."""
    mood = numpyro.sample("mood", dist.Bernoulli(0.3))
    numpyro.sample("alpha", dist.Categorical(probs=jnp.where(mood == 1, HELPFUL, CALM)))
    sites.goals()
    red, _ = sites.strengths()
    numpyro.sample("memory", dist.Normal(red / 600, 0.5).expand([2]).to_event(1))


@pytest.mark.parametrize("prior", [priors.uniform, helpful_moods])
def test_guide_has_the_density_that_it_draws_from(prior: Callable[[], Any]) -> None:
    # then the mean of P / Q over draws of Q is the total mass of P, since Q covers P
    z = proposed(prior)
    ratio = np.exp(densities(prior, z) - densities(guide_of(prior), z, jnp.array(WINDOW)))
    assert ratio.max() < 1 / 0.1 + 1e-3
    assert ratio.mean() == pytest.approx(1, abs=5 * ratio.std() / np.sqrt(len(ratio)))


def test_strength_is_proposed_around_its_estimate_and_otherwise_from_the_prior() -> None:
    z = proposed(priors.uniform)
    red, green = z["strength_red"], z["strength_green"]
    assert (np.abs(red - 300) < 80).mean() == pytest.approx(0.9 * 0.954 + 0.1 * 160 / 450, abs=0.03)
    assert green.mean() == pytest.approx(375, abs=10)
    assert green.std() == pytest.approx(450 / np.sqrt(12), abs=6)


def test_sites_of_the_users_own_come_from_the_prior_and_decide_about_helping() -> None:
    z = proposed(helpful_moods)
    assert z["mood"].mean() == pytest.approx(0.3, abs=0.03)
    for mood, prior in enumerate((CALM, HELPFUL)):
        seen = prior * np.exp(np.asarray(tables().way_logits)[WINDOW])
        expected = 0.9 * seen / seen.sum() + 0.1 * prior
        share = np.bincount(z["alpha"][z["mood"] == mood], minlength=5) / (z["mood"] == mood).sum()
        np.testing.assert_allclose(share, expected, atol=0.03)


def test_guide_proposes_just_the_values_that_the_prior_allows() -> None:
    prior, n_windows = priors.strength_levels, window_count(N_FRAMES, SETTINGS.window)
    guide = guide_of_logits(prior, np.zeros((n_windows + 1, 2, N_GOALS)))

    def density(window: jax.Array, forces: jax.Array) -> jax.Array:
        goals = {name: jnp.array(0) for name in ("goal_red", "goal_green", "alpha")}
        z = goals | {"strength_red": forces[0], "strength_green": forces[1]}
        return log_density(guide, z, window)

    of_all = compiled_quickly(jax.vmap(jax.vmap(density, (None, 0)), (0, None)))
    pairs = jnp.array(list(itertools.product((*STRENGTH_LEVELS, 310.0), repeat=2)))
    densities = np.exp(of_all(jnp.arange(2), pairs)).reshape(2, 5, 5)
    assert (densities[:, :4, :4] > 0).all()
    assert (densities[:, 4] == 0).all()
    assert (densities[:, :, 4] == 0).all()
    # the estimates of window 1 are 300 N and 450 N
    assert np.unravel_index(densities[1].argmax(), (5, 5)) == (1, 2)


def most_probable(observation: Observation, agent: int) -> str:
    tables = bottom_up_tables(SCENE, observation, SimpleSettings())
    alone = np.asarray(tables.goal_logits)[-1, ALPHAS.index((0, 0)), agent]
    return GOALS[int(alone.argmax())]


def test_one_frame_of_motion_is_enough() -> None:
    short = Observation(moving(_0=(16.0, 12.0)).trajectory[:2])
    tables = bottom_up_tables(SCENE, short, SimpleSettings())
    assert np.isfinite(np.asarray(tables.goal_logits)).all()


def test_features_do_not_depend_on_which_landmark_it_is() -> None:
    # the scene turned by half a circle has landmarks 0 and 2, 1 and 3 exchanged; on the middle
    # line a body is in one room before and after
    off_the_line = np.array([[0], [0], [0], [-1]]) * [0, 1, 0]
    start = SCENE.start + off_the_line
    given, scene = (Scene(s, SCENE.radius) for s in (start, start * [-1, -1, 1] + [32, 24, 0]))
    there = moving(_0=(15.7, 12.6), _2=(12.3, 12.7)).trajectory + off_the_line
    back = there * np.array([-1, -1, 1]) + np.array([32, 24, 0])
    first, last = np.array([0]), np.array([20])
    one = goal_features(given, Observation(there), first, last)
    other = goal_features(scene, Observation(back), first, last)
    landmarks = SCENE.landmark_centres
    partner = [int(np.argmin(np.abs(landmarks - ([32, 24] - c)).sum(axis=1))) for c in landmarks]
    for number, goal in enumerate(GOALS):
        twin = number
        for name, place in zip(LANDMARKS, partner, strict=True):
            if goal.endswith(name):
                twin = goal_index(goal.removesuffix(name) + LANDMARKS[place])
        np.testing.assert_allclose(one[0, :, number], other[0, :, twin], atol=1e-9)


@pytest.mark.parametrize("agent", [RED, GREEN])
def test_an_agent_that_walks_to_a_landmark_and_stays_is_taken_to_want_that(agent: int) -> None:
    place = 23.5, 19.5
    nearest = np.linalg.norm(SCENE.landmark_centres - place, axis=1).argmin()
    wanted = f"Get {AGENTS[agent]} to {LANDMARKS[nearest]}"
    assert most_probable(moving(**{f"_{agent}": place}), agent) == wanted


def test_tables_are_those_of_the_joint_distribution() -> None:
    scores = np.random.default_rng(0).normal(0, 2, (2, N_GOALS))
    goal, alpha = joint_logits(scores)
    expected = np.zeros((N_GOALS, N_GOALS, len(ALPHAS)))
    for red, green, index in np.ndindex(expected.shape):
        if not (sites.SELF_REFERRING[RED, red] or sites.SELF_REFERRING[GREEN, green]):
            goals = effective_goals(red, green, ALPHAS[index])
            together = scores[RED, goals[0]] + scores[GREEN, goals[1]]
            expected[red, green, index] = sites.ALPHA_PROBABILITIES[index] * np.exp(together)
    alpha = np.array(sites.ALPHA_PROBABILITIES) * np.exp(alpha)
    goal = np.exp(goal - goal.max(axis=-1, keepdims=True))
    goal /= goal.sum(axis=-1, keepdims=True)
    found = np.einsum("a,ar,ag->rga", alpha / alpha.sum(), goal[:, RED], goal[:, GREEN])
    np.testing.assert_allclose(found, expected / expected.sum(), atol=1e-12)
