"""What becomes of a simulation that fails."""

from __future__ import annotations

from typing import Final

import numpy as np

from phase_ppl.simulator.contract import SimulationResult
from phase_ppl.world.checks import whole_number
from phase_ppl.world.errors import InvalidSettingError, SimulationError, shown, unknown_name

POLICIES: Final = ("reject", "raise", "retry")
"""A failed simulation is a result without likelihood; ends the run; is run again."""

RETRIES: Final = 3
"""How often "retry" runs a simulation again unless it is told a number."""

_STREAM: Final = 0xFA11
"""Keeps fresh seeds apart from other numbers that are drawn from the same seed."""


def n_retries(policy: str, retries: int | None) -> int:
    """Return how often a failed simulation is run again under a policy, one of ``POLICIES``.

    Raises:
        UnknownNameError: there is no such policy.
        InvalidSettingError: ``retries`` is no whole number >= 1, or the policy has no use for it.
    """
    if policy not in POLICIES:
        raise unknown_name("on_failure", policy, POLICIES)
    if policy != "retry":
        if retries is not None:
            raise InvalidSettingError(
                f"retries={shown(retries)} goes with on_failure='retry', not with {policy!r}"
            )
        return 0
    return RETRIES if retries is None else whole_number("retries", retries)


def fresh_seed(seed: int, attempt: int) -> int:
    """Return the seed of the n-th further attempt (n >= 1) at a simulation; below 2**31.

    A function of the two numbers alone, so that whoever simulates, wherever, gets the same.
    """
    words = np.random.SeedSequence([int(seed) & 0xFFFFFFFF, attempt, _STREAM]).generate_state(1)
    return int(words[0]) >> 1


def failure_error(result: SimulationResult) -> SimulationError:
    """Return the error that a failed simulation is where it may not fail."""
    return SimulationError(
        f"simulation of [{result.hypothesis}] with seed {result.seed} failed: {result.failure}"
    )
