from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from phase_ppl.models.bridge import Request, SimulatorBridge
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis

N_FRAMES = 4
MODEL = Model()


class Counting:
    """Gives every simulation its seed as the error of each frame."""

    def __init__(self) -> None:
        self.batches: list[list[Hypothesis]] = []
        self.ceilings: list[float] = []

    def run(self, hypotheses: Any, seeds: Any, ceilings: Any) -> list[SimulationResult]:
        self.batches.append(list(hypotheses))
        self.ceilings += ceilings
        asked, trajectory = list(zip(hypotheses, seeds, strict=True)), np.zeros((N_FRAMES, 4, 3))
        done = {
            (h, seed): SimulationResult(
                h, seed, trajectory, np.full(N_FRAMES, float(seed)), N_FRAMES, True
            )
            for h, seed in asked
        }
        return [done[key] for key in asked]


class Stopping(Counting):
    """Stops what exceeds its ceiling."""

    def run(self, hypotheses: Any, seeds: Any, ceilings: Any) -> list[SimulationResult]:
        stopped = {"errors": np.full(N_FRAMES, np.inf), "completed": False}
        return [
            dataclasses.replace(one, **(stopped if one.errors.sum() > ceiling else {}))
            for one, ceiling in zip(super().run(hypotheses, seeds, ceilings), ceilings, strict=True)
        ]


def sites_of(n: int, **changes: Any) -> dict[str, jax.Array]:
    values = {"goal_red": 0, "goal_green": 1, "alpha": 0, "strength_red": 300.0}
    values |= {"strength_green": 450.0, **changes}
    return {name: jnp.broadcast_to(jnp.asarray(value), (n,)) for name, value in values.items()}


def ask(bridge: Any, sites: Any, seeds: Any, log_prior: Any = -1.0, ceiling: Any = np.inf) -> Any:
    limits = (jnp.full(seeds.shape, v, jnp.float32) for v in map(np.asarray, (log_prior, ceiling)))
    return np.asarray(requested(bridge.handle, sites, seeds, *limits))


@jax.jit  # the handle is an argument, so that all tests share the compiled program
def requested(handle: Any, sites: Any, seeds: Any, log_prior: Any, ceiling: Any) -> jax.Array:
    def one(z: Any, seed: Any, prior: Any, limit: Any) -> jax.Array:
        return EventProgram(MODEL, handle, N_FRAMES).simulate(z, prior, seed, limit)

    return jax.vmap(one)(sites, seeds, log_prior, ceiling)


IMPOSSIBLE = [
    ("goal_red", 36),
    ("goal_red", GOALS.index("get to red agent")),
    ("alpha", len(ALPHAS)),
    ("strength_red", 0.0),
    ("strength_green", np.inf),
    ("strength_red", 2e6),  # no simulator takes it
]


def test_what_is_no_hypothesis_or_has_no_prior_mass_is_answered_without_a_simulation() -> None:
    n = len(IMPOSSIBLE)
    runner = Counting()
    bridge = SimulatorBridge(runner, N_FRAMES)
    sites = sites_of(n + 4)
    for row, (site, value) in enumerate(IMPOSSIBLE):
        sites[site] = sites[site].at[row].set(value)
    log_prior = np.full(n + 4, -1.0)
    log_prior[n : n + 3] = -np.inf, -1e30, np.nan
    errors = ask(bridge, sites, jnp.arange(n + 4), log_prior)
    assert np.isinf(errors[:-1]).all()
    assert np.isfinite(errors[-1]).all()
    assert [record.chain for record in bridge.records] == [n + 3]
    assert [len(batch) for batch in runner.batches] == [1]


def test_identical_requests_of_one_batch_or_a_later_one_are_paid_for_once() -> None:
    bridge = SimulatorBridge(Counting(), N_FRAMES)
    ask(bridge, sites_of(4), jnp.array([5, 5, 6, 5]))
    assert [record.result.seed for record in bridge.records] == [5, 6]
    bridge = SimulatorBridge(Counting(), N_FRAMES)
    seeds = jnp.array([3, 4], jnp.int32)
    first = ask(bridge, sites_of(2), seeds)
    again = ask(bridge, sites_of(2), seeds[::-1], ceiling=1.0)
    np.testing.assert_array_equal(again, first[::-1])
    assert len(bridge.records) == 2
    ask(bridge, sites_of(2, strength_red=301.0), seeds)
    assert len(bridge.records) == 4


@pytest.mark.parametrize(
    ("ceilings", "bound", "again"),
    [([5.0, np.inf, 20.0], 2.0, [3.0]), ([5.0, 9.0, 20.0], 3.0, []), ([5.0, 9.0], 2.0, [1.0])],
)
def test_of_equal_requests_in_a_batch_the_longest_is_run_and_the_first_that_ends_is_kept(
    ceilings: list[float], bound: float, again: list[float]
) -> None:
    # 4 frames of error 3: what bears 5 or 9 is stopped
    bridge, n = SimulatorBridge(Stopping(), N_FRAMES), len(ceilings)
    sites = {name: np.asarray(values) for name, values in sites_of(n).items()}
    number = np.arange(1, n + 1, dtype=np.float32)
    zero, three = np.zeros(n, np.float32), np.full(n, 3)
    errors = bridge.answer(Request(sites, zero, three, np.float32(ceilings), -number, number))
    assert np.isfinite(errors).all() == (max(ceilings) > 12)
    (record,) = bridge.records
    assert record.log_bound == bound
    assert record.n_again == len(again)
    assert record.log_again == pytest.approx(np.logaddexp.reduce(again) if again else -np.inf)


def test_what_exceeds_its_ceiling_in_the_last_frame_is_not_complete() -> None:
    # 4 frames of error 3 and of error 4: the last frame of the first is beyond its ceiling
    asked, n = Counting(), 2
    bridge = SimulatorBridge(asked, N_FRAMES)
    z = {name: np.asarray(values) for name, values in sites_of(n).items()}
    columns = np.array([[0, 3, 9, 0, 1], [0, 4, 16, 0, 2]], np.float32).T
    bridge.answer(Request(z, *columns))
    assert [one.result.completed for one in bridge.records] == [False, True]
    assert [one.log_bound for one in bridge.records] == [1, 2]
    assert asked.ceilings == [9, 16]
