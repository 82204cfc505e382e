"""Short runs on the toy world, all with the same compiled programs, and ways to disturb them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

import phase_ppl as ppl
from phase_ppl.simulator.contract import Cancelled
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.hypothesis import Hypothesis
from tests.inference.toy import walkers, walking_event

EVENT = walking_event()
MODEL = ppl.Model(simulator=walkers)
OPTIONS: dict[str, Any] = {
    "kernel": "prior_mh",
    "chains": 4,
    "iterations": 4,
    "seed": 3,
    "workers": 1,
    "progress": False,
}


def infer(**options: Any) -> ppl.Posterior:
    return ppl.infer(EVENT, MODEL, **{**OPTIONS, **options})


def assert_same_draws(one: xr.DataTree, other: xr.DataTree) -> None:
    assert set(one.children) == set(other.children)
    for group in one.children:
        for name, values in one[group].dataset.variables.items():
            again = other[group].dataset.variables[name]
            assert values.dtype == again.dtype
            np.testing.assert_array_equal(values, again, f"{group}/{name}")


class Watched(Runner):
    """Calls ``before`` before it runs anything, with the number of the call from 0 on."""

    calls = -1

    def before(self, call: int, requests: int) -> None:
        """May raise, or count the requests."""

    def run(self, hypotheses: Sequence[Hypothesis], *given: Any, **more: Any) -> Any:
        self.calls += 1
        self.before(self.calls, len(hypotheses))
        return super().run(hypotheses, *given, **more)


def stops_at(call: int) -> type[Runner]:
    """Return a runner that is cancelled, as by Ctrl-C, at its n-th call, counted from 0."""

    class Stops(Watched):
        def before(self, number: int, requests: int) -> None:
            if number == call:
                raise Cancelled("the run was cancelled")

    return Stops
