from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from jax import random
from numpyro.infer.util import log_density as numpyro_log_density

from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram, event_salt
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import ALPHAS
from tests.inference.toy import (
    N_FRAMES,
    TableRunner,
    never_called,
    table_errors,
    table_program,
    walking_event,
)

Z = {"goal_red": 0, "goal_green": 3, "alpha": 0, "strength_red": 300.0, "strength_green": 200.0}
SITES = {name: jnp.asarray(value) for name, value in Z.items()}


def test_program_is_prior_times_likelihood() -> None:
    errors = table_errors()
    program, _bridge = table_program(TableRunner(errors))
    found, trace = numpyro_log_density(program, (jnp.array(4),), {}, SITES)
    np.testing.assert_allclose(trace["step_error"]["value"], errors[0, 3, 1], rtol=1e-5)
    expected = program.log_prior(SITES) + program.log_likelihood(errors[0, 3, 1]).sum()
    assert float(found) == pytest.approx(float(expected), rel=1e-5)


def seed_of(program: EventProgram, key: int = 0, **changes: float) -> int:
    sites = {name: jnp.asarray(value) for name, value in {**Z, **changes}.items()}
    return int(program.simulator_seed(random.key(key), sites))


def test_fresh_noise_takes_a_new_seed_each_time() -> None:
    program, _bridge = table_program(TableRunner(table_errors()))
    assert seed_of(program, key=1) != seed_of(program, key=2)
    assert seed_of(program, key=1) == seed_of(program, key=1)


def test_fixed_noise_follows_what_the_simulator_is_told() -> None:
    model = Model(simulator=never_called, noise="fixed")
    program, other = (EventProgram(model, 0, N_FRAMES, salt) for salt in (5, 6))
    seed = seed_of(program, key=1)
    assert seed == seed_of(program, key=2)
    assert seed != seed_of(other)
    assert seed != seed_of(program, goal_red=1)
    assert seed != seed_of(program, strength_green=200.5)
    # a helper's own stated goal changes nothing
    helping = ALPHAS.index((1, 0))
    ways = [seed_of(program, alpha=helping, goal_red=goal) for goal in (0, 7)]
    assert ways[0] == ways[1] == seed_of(program, goal_red=3)
    assert GOALS[3] != GOALS[0]


def test_salt_stands_for_scene_and_observation_only() -> None:
    event = walking_event()
    salt = event_salt(event.scene, event.observation)
    again = walking_event()
    assert salt == event_salt(again.scene, again.observation)
    moved = np.array(event.observation.trajectory)
    moved[3, 2, 0] += 1e-9
    assert salt != event_salt(event.scene, Observation(moved))
    assert salt != event_salt(dataclasses.replace(event.scene, turning="cw"), event.observation)
