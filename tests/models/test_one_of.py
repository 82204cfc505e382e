from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import random

from phase_ppl.models.sites import OneOf

VALUES, PROBS = [150.0, 300.0, 620.5], [0.2, 0.5, 0.3]


def test_draws_are_the_values_in_their_proportions() -> None:
    drawn = np.asarray(OneOf(VALUES, PROBS).sample(random.key(0), (20_000,)))
    found = [(drawn == value).mean() for value in VALUES]
    assert found == pytest.approx(PROBS, abs=0.02)
    assert np.isin(drawn, VALUES).all()


def test_density_is_the_probability_of_a_value_and_zero_elsewhere() -> None:
    found = np.exp(OneOf(VALUES, PROBS).log_prob(jnp.array([*VALUES, 151.0, -1.0])))
    np.testing.assert_allclose(found, [*PROBS, 0, 0], rtol=1e-5)


@pytest.mark.parametrize("values", [[300.0], [1.0, 250.5, 1.0], [3.0, 1000.0, 2.0, 2.0]])
def test_mass_of_the_distinct_values_is_one(values: list[float]) -> None:
    logits = np.random.default_rng(0).normal(0, 3, len(values))
    distribution = OneOf(values, logits=logits)
    distinct = np.unique(np.array(values, np.float32))
    assert float(np.exp(distribution.log_prob(distinct)).sum()) == pytest.approx(1, rel=1e-4)


def test_value_of_probability_zero_is_outside_the_support() -> None:
    support = OneOf(VALUES, [0.5, 0.5, 0.0]).support
    np.testing.assert_array_equal(support(jnp.array([150.0, 620.5, 7.0])), [True, False, False])
    assert support.is_discrete


def test_values_may_depend_on_other_sites_inside_compiled_code() -> None:
    def density(mood: jax.Array, value: jax.Array) -> jax.Array:
        return OneOf(jnp.where(mood, jnp.array([1.0, 2.0]), jnp.array([3.0, 4.0]))).log_prob(value)

    found = jax.jit(jax.vmap(density))(jnp.array([True, False]), jnp.array([2.0, 2.0]))
    np.testing.assert_allclose(np.exp(found), [0.5, 0.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"values": []}, "shape"),
        ({"values": 3.0}, "shape"),
        ({"values": [1.0, 2.0], "probs": [1.0]}, "probabilities of shape"),
        ({"values": VALUES, "probs": PROBS, "logits": PROBS}, "not both"),
    ],
)
def test_what_is_no_list_of_values_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OneOf(**arguments)
