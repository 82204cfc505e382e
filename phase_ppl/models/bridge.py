"""The bridge from a NumPyro program to a simulator on the host.

The simulator is called through ``jax.pure_callback``. All chains of a step arrive as one batch;
the seed is an argument, so that the call is a pure function of its arguments.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import ALPHAS, Hypothesis

Noise = Literal["fresh", "fixed"]


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """One simulation that a program has asked for.

    Attributes:
        batch: number of the callback; row: place in its batch (the chain, if chains are rows).
        requested_seed: seed of the program; with fixed noise the simulation's own differs.
        result: what the runner returned.
    """

    batch: int
    row: int
    requested_seed: int
    result: SimulationResult


class SimulatorBridge:
    """Calls a runner from inside a NumPyro program.

    Args:
        runner: where simulations run.
        noise: "fresh": every request brings its own seed (pseudo-marginal); "fixed": one seed
            per hypothesis, so that the simulator is a deterministic function of it; this is
            another posterior.
    """

    def __init__(self, runner: Runner, noise: Noise = "fresh") -> None:
        self.runner = runner
        self.noise = noise
        self.records: list[Record] = []
        self.error: BaseException | None = None
        self._batch = 0

    def __call__(
        self, sites: dict[str, jax.Array], seed: jax.Array, error_ceiling: jax.Array
    ) -> jax.Array:
        """Return the errors per frame (time,), units; inf where not simulated.

        Args:
            sites: values of the hypothesis sites.
            seed: uint32.
            error_ceiling: summed error beyond which the simulation may stop, units.
        """
        out = jax.ShapeDtypeStruct((self.runner.n_frames,), jnp.float32)
        return jax.pure_callback(
            self._host,
            out,
            sites["goal_red"],
            sites["goal_green"],
            sites["alpha"],
            sites["strength_red"],
            sites["strength_green"],
            seed,
            error_ceiling,
            vmap_method="broadcast_all",
        )

    def _host(self, *arguments: Any) -> NDArray[np.float32]:
        # numpy only: calling jax in a callback can deadlock
        columns = [np.asarray(a) for a in arguments]
        shape = columns[0].shape
        try:
            rows = list(zip(*(c.reshape(-1).tolist() for c in columns), strict=True))
            errors = self._simulate(rows)
        except BaseException as error:
            # jax replaces the exception; the driver raises this one instead
            self.error = error
            raise
        return errors.reshape(*shape, self.runner.n_frames)

    def _simulate(self, rows: list[tuple[Any, ...]]) -> NDArray[np.float32]:
        errors = np.full((len(rows), self.runner.n_frames), np.inf, np.float32)
        batch, self._batch = self._batch, self._batch + 1
        places, hypotheses, seeds, ceilings = [], [], [], []
        for place, (*sites, seed, ceiling) in enumerate(rows):
            hypothesis = _hypothesis(*sites)
            if hypothesis is None or math.isnan(ceiling) or ceiling < 0:
                continue
            places.append(place)
            hypotheses.append(hypothesis)
            seeds.append(int(seed) if self.noise == "fresh" else _seed_of(hypothesis))
            ceilings.append(ceiling)
        results = self.runner.run(hypotheses, seeds, ceilings)
        for place, result in zip(places, results, strict=True):
            errors[place] = result.errors if result.completed else np.inf
            self.records.append(Record(batch, place, int(rows[place][-2]), result))
        return errors


def _hypothesis(
    goal_red: int, goal_green: int, alpha: int, strength_red: float, strength_green: float
) -> Hypothesis | None:
    """Return the hypothesis of one row, or None outside the support: samplers do send such rows."""
    if not 0 <= alpha < len(ALPHAS):
        return None
    try:
        return Hypothesis(
            int(goal_red), int(goal_green), ALPHAS[int(alpha)], strength_red, strength_green
        )
    except (InvalidSettingError, ValueError):
        return None


def _seed_of(hypothesis: Hypothesis) -> int:
    return zlib.crc32(repr(hypothesis.effective()).encode())
