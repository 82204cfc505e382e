"""From what was read step by step to a table of hypotheses, at every frame.

In PHASE all hypotheses are summed over. In other worlds all are where there are
:data:`MOST_HYPOTHESES` at most; of more, as many are drawn, each agent's goal in proportion to
about what it has of the mass, and weighted by what they were drawn with: then sums are Monte-Carlo
means.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
import xarray as xr

from phase_ppl.agents.standpoints import standpoints
from phase_ppl.analysis.stepwise_hypotheses import (
    STRENGTHS,
    Dimensions,
    GoalRows,
    PhaseTable,
    Table,
    WorldTable,
    check_size,
)
from phase_ppl.analysis.stepwise_own import OwnPhaseTable, OwnWorldTable
from phase_ppl.analysis.tree import kept_world
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import effective_pairs
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import space_of

MOST_HYPOTHESES: Final = 500_000  # hypotheses that are summed over; of more, so many are drawn
_FROM_PRIOR: Final = 0.1  # share of goals that are drawn from the prior

_OF_ACTIONS: Final = {
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "log_peak": ("time",),
}


class PairTable(PhaseTable):
    """Hypotheses about a video of PHASE, by pairs of effective goals."""

    schema = "phase_ppl/stepwise/2"
    dimensions: ClassVar[Dimensions] = {
        "log_likelihood": ("time", "goal_red", "goal_green"),
        "log_likelihood_without": ("planner_seed", "time", "goal_red", "goal_green"),
        "strengths": ("time", *STRENGTHS),
        **_OF_ACTIONS,
        **PhaseTable.dimensions,
    }

    def __init__(self, found: xr.Dataset) -> None:
        super().__init__(found)
        self._pair = effective_pairs().ravel()

    @classmethod
    def check(cls, found: xr.Dataset) -> None:
        super().check(found)
        if found.sizes["planner_seed"] == 1:  # of one set there is nothing without it
            raise InvalidEventError("planner_seed has 1 entry, expected none or several")
        likelihood = found["log_likelihood"].values
        if np.isnan(likelihood).any() or (likelihood == np.inf).any():
            raise InvalidEventError("log_likelihood has values that are no log densities")

    @classmethod
    def labels(cls, world: World) -> dict[str, list[str]]:
        goals = {name: list(GOALS) for name in ("goal_red", "goal_green")}
        return {**super().labels(world), **goals}

    def _of_frame(self, t: int, n_tables: int) -> FloatArray:
        """Return (table, pair) log likelihoods of one frame."""
        found = [self._found["log_likelihood"].values[t]]
        found += list(self._found["log_likelihood_without"].values[: n_tables - 1, t])
        return np.array(found, np.float64).reshape(n_tables, -1)

    def _so_far(self, frame: int) -> FloatArray:
        return self._summed(frame)[:, self._pair]

    def _frame(self, frame: int) -> FloatArray:
        return super()._frame(frame)[self._pair]

    def log_likelihood(self, frame: int) -> FloatArray:
        """Return (row of all, combination) log likelihoods of the frames up to ``frame``."""
        strengths = np.log(self._of_strengths(frame))
        return np.asarray(self._weight * self._so_far(frame)[0][:, None] + strengths)

    def by_pairs(self) -> FloatArray:
        return np.asarray(self._found["log_likelihood"].values.reshape(self.n_frames, -1))


class PolicyTable(WorldTable):
    """Hypotheses about a video of any world: all, or drawn."""

    schema = "phase_ppl/stepwise-roles/1"
    dimensions: ClassVar[Dimensions] = {
        "density": ("time", "joint_action"),
        "policies": ("time", "agent", "policy", "planner_seed", "action"),
        "policy_of": ("time", "agent", "standpoint"),
        "marginals": ("time", "agent", "goal"),
        "strengths": ("time", "combination"),
        **_OF_ACTIONS,
        **WorldTable.dimensions,
    }
    most_rows, least_of_best, least_of_all = 400_000, 1e-9, 0.0

    def __init__(self, found: xr.Dataset) -> None:
        super().__init__(found)
        self.sampled = self.n_hypotheses > MOST_HYPOTHESES

    @classmethod
    def check(cls, found: xr.Dataset) -> None:
        super().check(found)
        check_size(found, "joint_action", N_ACTIONS ** space_of(kept_world(found)).n_agents)
        numbers = found["policy_of"].values
        if (numbers < 0).any() or (numbers >= found.sizes["policy"]).any():
            raise InvalidEventError("policy_of names a policy that there is not")
        for name in ("density", "strengths"):
            values = found[name].values
            if np.isnan(values).any() or (values == np.inf).any():
                raise InvalidEventError(f"{name} has values that cannot be")

    @functools.cached_property
    def hypotheses(self) -> GoalRows:
        return self._drawn() if self.sampled else self._ways.enumerated()

    def _of_frame(self, t: int, n_tables: int) -> FloatArray:
        """Return (table, row) log likelihoods of one frame; of the first, 0."""
        if t == 0:
            return np.zeros((n_tables, len(self.hypotheses.way)))
        n, n_sets = self.space.n_agents, self.n_sets
        density = self._found["density"].values[t]
        relative = np.exp(density - density.max()).reshape((N_ACTIONS,) * n)
        policies = self._found["policies"].values[t].astype(np.float64)
        numbers = self._found["policy_of"].values[t]
        sizes = [int(numbers[agent].max()) + 1 for agent in range(n)]
        place = np.zeros(len(self.hypotheses.way), np.int64)
        for agent in range(n):
            place = place * sizes[agent] + numbers[agent][self._standpoints[agent]]
        found = np.empty((n_tables, len(place)))
        for row, left_out in zip(found, [None, *range(n_sets)], strict=False):
            sets = [one for one in range(n_sets) if one != left_out]
            table = relative
            for agent in range(n):  # the first axis goes, and what it becomes is put last
                mean = policies[agent, : sizes[agent], sets].mean(axis=0)
                table = np.tensordot(table, mean, axes=(0, 1))
            with np.errstate(divide="ignore"):
                row[:] = np.log(table.ravel())[place] + density.max()
        return found

    @functools.cached_property
    def _standpoints(self) -> list[IntArray]:
        """(agent) (row,) the standpoint of each agent."""
        goals, world = self.hypotheses.goals, self.space.world
        return [standpoints(agent, world).of(goals) for agent in range(self.space.n_agents)]

    def _drawn(self) -> GoalRows:
        """Return hypotheses drawn by how probable each agent's goals are at about any frame."""
        marginals = self._found["marginals"].values
        masses = np.exp(marginals - marginals.max(axis=2, keepdims=True))
        likely = (masses / masses.sum(axis=2, keepdims=True)).mean(axis=0)
        ways, rng = self._ways, np.random.default_rng(0)
        every, logs = [], []
        for way, owners, _ in ways.possible:
            # more where more goals are to be chosen
            n = MOST_HYPOTHESES // (2 * len(ways.possible)) + (way == 0) * (MOST_HYPOTHESES // 2)
            picked, log_drawn = np.empty((n, len(owners)), np.int64), np.full(n, np.log(n))
            for column, owner in enumerate(owners):
                own = np.exp(ways.log_goals[owner])
                share = _FROM_PRIOR * own + (1 - _FROM_PRIOR) * likely[owner] * (own > 0)
                share /= share.sum()
                picked[:, column] = rng.choice(len(share), n, p=share)
                log_drawn += np.log(share[picked[:, column]])
            every.append(picked)
            logs.append(log_drawn)
        return ways.put_together(every, logs)


_ALL: Final[tuple[type[Table], ...]] = (PairTable, PolicyTable, OwnPhaseTable, OwnWorldTable)
_KINDS: Final[Mapping[str, type[Table]]] = {one.schema: one for one in _ALL}

SCHEMAS: Final = tuple(_KINDS)
"""Of files of what was read step by step: in PHASE, and in other worlds; by own simulators."""


def kind_of_table(world: World, own: bool = False) -> type[Table]:
    """Return the class of tables of a world, read by a simulator of one's own or the joint one."""
    if world == PHASE:
        return OwnPhaseTable if own else PairTable
    return OwnWorldTable if own else PolicyTable


def table_of(found: xr.Dataset) -> Table:
    """Return the hypotheses about a video that was read step by step.

    Raises:
        InvalidEventError: ``found`` lacks something; the message names it.
    """
    kind = _KINDS.get(str(found.attrs.get("schema")))
    if kind is None:
        raise InvalidEventError(
            f"this was not read step by step: its schema is {found.attrs.get('schema')!r}, "
            f"expected {' or '.join(map(repr, SCHEMAS))}"
        )
    try:
        world = kept_world(found)
    except (ValueError, LookupError, TypeError, PhasePPLError) as error:
        raise InvalidEventError(f"its world cannot be read: {error}") from None
    if issubclass(kind, PhaseTable) != (world == PHASE):
        raise InvalidEventError(f"its schema {kind.schema!r} is not that of {world.name!r}")
    kind.check(found)
    return kind(found)
