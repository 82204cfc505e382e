from __future__ import annotations

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random

from phase_ppl.models import priors, sites
from phase_ppl.models.density import draw, log_density
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import ALPHAS

VALID = {
    "goal_red": 0,
    "goal_green": 0,
    "alpha": 0,
    "strength_red": 300.0,
    "strength_green": 450.0,
}


# compiled, as in use: NumPyro warns of values outside the support where it sees them
compiled_density = jax.jit(jax.vmap(lambda z: log_density(priors.uniform, z)))


def density(**changes: float) -> float:
    values = {name: jnp.asarray([value]) for name, value in {**VALID, **changes}.items()}
    return float(compiled_density(values)[0])


def test_uniform_prior_has_the_papers_density() -> None:
    assert density() == pytest.approx(math.log(1 / 34**2 / 3 / 450**2), abs=1e-4)
    assert density(alpha=3) == pytest.approx(math.log(1 / 34**2 / 6 / 450**2), abs=1e-4)


def test_uniform_prior_sums_to_one_over_goals_and_alphas() -> None:
    codes = np.array(list(itertools.product(range(36), range(36), range(5))))
    grid = {name: jnp.asarray(codes[:, i]) for i, name in enumerate(("goal_red", "goal_green"))}
    grid["alpha"] = jnp.asarray(codes[:, 2])
    for name in sites.STRENGTH_SITES:
        grid[name] = jnp.full(len(codes), 400.0)
    log_densities = compiled_density(grid)
    assert np.exp(log_densities).sum() * 450**2 == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize(
    "changes",
    [
        {"goal_red": GOALS.index("get to red agent")},
        {"goal_green": GOALS.index("get away from green agent")},
    ],
)
def test_goal_that_names_its_holder_has_no_mass(changes: dict[str, float]) -> None:
    assert density(**changes) < -1e20


@pytest.mark.parametrize(
    "changes",
    [
        {"strength_red": 149.0},
        {"strength_green": 601.0},
        {"strength_red": math.nan},
        {"goal_red": 36},
        {"goal_green": -1},
        {"alpha": len(ALPHAS)},
    ],
)
def test_density_is_zero_outside_the_support(changes: dict[str, float]) -> None:
    assert density(**changes) == -np.inf


def test_draws_lie_in_the_support() -> None:
    drawn = jax.jit(jax.vmap(lambda key: draw(priors.uniform, key)))(
        random.split(random.key(0), 500)
    )
    assert set(drawn) == set(sites.HYPOTHESIS_SITES)
    for holder, name in enumerate(sites.GOAL_SITES):
        assert not sites.SELF_REFERRING[holder][np.asarray(drawn[name])].any()
    assert (np.asarray(compiled_density(drawn)) > -30).all()


def test_density_of_a_program_counts_every_site_given_those_before_it() -> None:
    def program() -> None:
        mood = numpyro.sample("mood", dist.Bernoulli(0.25))
        numpyro.sample("x", dist.Normal(jnp.where(mood == 1, 5.0, 0.0), 1.0))

    found = log_density(program, {"mood": jnp.array(1), "x": jnp.array(5.0)})
    assert float(found) == pytest.approx(math.log(0.25) - 0.5 * math.log(2 * math.pi))
