"""The posterior of the closed-loop likelihood in any world, at every frame."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.analysis.prior_change import settings_under
from phase_ppl.analysis.quantities import quantities, relations_of
from phase_ppl.analysis.roles_table import (
    DIMENSIONS,
    MOST_HYPOTHESES,
    SCHEMA,
    RoleRows,
    RolesTable,
    check,
)
from phase_ppl.analysis.stepwise_posterior import FILTERING, StepwisePosterior, frame_of
from phase_ppl.analysis.summary import wrapped
from phase_ppl.dataset.hdf5 import root_attribute
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import Roles, company


class RolesPosterior(StepwisePosterior):
    """Posterior over all agents' goals, whom they help or hinder, and strengths, in any world.

    As :class:`~phase_ppl.analysis.stepwise_posterior.StepwisePosterior`, with the quantities
    :func:`quantities`. Goals, company and strengths are independent of each other a priori.
    Where more than :data:`~phase_ppl.analysis.roles_table.MOST_HYPOTHESES` are possible, sums are
    over so many that were drawn.

    Args:
        found: what was read (:mod:`phase_ppl.analysis.roles_table`).
        frame: the posterior given the frames up to this one; by default all.
        table: of ``found``, if there is one.

    Raises:
        InvalidEventError: ``found`` lacks something; the message names it.
        InvalidSettingError: there is no such frame.
    """

    _table: Any
    _schema = SCHEMA

    def __init__(
        self, found: xr.Dataset, frame: int | None = None, *, table: RolesTable | None = None
    ) -> None:
        if table is None:
            check(found)
            table = RolesTable(found)
        self._found, self._table, self._scenario = found, table, None
        self._prior, self._of_sites = None, {}  # further sites are for PHASE
        self._frame = frame_of(frame, table.n_frames)
        rows, self._without = table.rows(self._frame)
        world = table.world
        keys = dict(zip(world.agents, world.keys, strict=True))
        self.goals_of = {agent: f"goal_{key}" for agent, key in keys.items()}
        self.strengths_of = {agent: f"strength_{key}" for agent, key in keys.items()}
        self.relations_of = relations_of(world)
        self.scenarios_of = MappingProxyType({})
        self._attrs, self._constant = found.attrs, found
        EventPosterior.__init__(self, quantities(world), rows)
        self._define_kept(found.attrs)

    def _weights_without(self) -> FloatArray:
        return self._without

    def at(self, frame: int) -> RolesPosterior:
        at = RolesPosterior(self._found, frame, table=self._table)
        return at._defining(self.definitions)

    def _checked(self, prior: Callable[..., object] | str) -> Callable[..., object]:
        from phase_ppl.models import priors

        return priors.named(prior) if isinstance(prior, str) else prior

    def under(self, prior: Callable[..., object]) -> RolesPosterior:
        from phase_ppl.models.roles import factors

        levels = tuple(np.unique(self._found["combinations"].values).tolist())
        masses = factors(prior, self.world, levels)
        found = self._found.assign(
            {
                f"log_prior_{name}": (DIMENSIONS[f"log_prior_{name}"], values)
                for name, values in masses._asdict().items()
            }
        )
        found.attrs["settings"] = settings_under(found.attrs["settings"], prior)
        return RolesPosterior(found, self._frame)._defining(self.definitions)

    @property
    def log_evidence(self) -> float:
        return self._table.log_evidence(self._frame)  # type: ignore[no-any-return]

    def map(self) -> Roles:  # type: ignore[override]  # of another world
        """Return the most probable roles of all agents."""
        hypotheses: RoleRows = self._table.hypotheses
        best = self._table.most_probable(self._frame)
        way = company(len(self.world.agents))[hypotheses.way[best]]
        goals = hypotheses.goals[best].tolist()
        stated = tuple(None if one else goal for goal, one in zip(goals, way, strict=True))
        strengths = self._found["combinations"].values[self._table.strengths(self._frame).argmax()]
        return Roles(self.world, stated, way, tuple(strengths.tolist()))

    def map_record(self) -> dict[str, Any]:
        return self.map().to_dict()

    def over_time(self) -> xr.Dataset:
        """Return the marginals at every frame, given the frames until then.

        Returns:
            ``goal_<agent>`` and ``relation_<one>_<other>``: probabilities (time, label), labels in
            ``goal_<agent>_is`` and so on; ``goal_<agent>_error`` and so on: their standard errors,
            NaN where there is a single set of searches; ``time`` in seconds. The attribute
            ``filtering`` says what it is.
        """
        codes = self._table.codes(self._table.hypotheses.goals)
        known, n = quantities(self.world), self._frame + 1
        sizes = {name: len(known[name].categories()) for name in codes}
        masses = {name: np.empty((self._table.n_tables, n, size)) for name, size in sizes.items()}
        for t in range(n):
            weights = self._table.weights(t)
            for name, size in sizes.items():
                for row, own in enumerate(weights):
                    masses[name][row, t] = np.bincount(codes[name], own, size)
        time = self._found["time"].values[:n]
        result = xr.Dataset(coords={"time": ("time", time, {"units": "s"})})
        for name, (first, *without) in masses.items():
            result[name] = (("time", f"{name}_is"), first)
            error = self._error_over_sets(np.array(without).reshape(-1, *first.shape), first)
            result[f"{name}_error"] = (("time", f"{name}_is"), error)
            result = result.assign_coords({f"{name}_is": list(known[name].categories())})
        return result.assign_attrs(filtering=FILTERING)

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self._table.columns()  # type: ignore[no-any-return]

    def _log_masses(self, frame: int) -> Iterator[FloatArray]:
        yield from self._table.log_masses(frame)

    def _notes(self) -> list[str]:
        if not self._table.sampled:
            return []
        n = self._table.n_effective(self._frame)
        words = (
            f"of {self._table.n_hypotheses:.2g} hypotheses {MOST_HYPOTHESES} were drawn, worth "
            f"{n:.0f} of equal weight: probabilities are Monte-Carlo means with standard errors of "
            f"up to {0.5 / n**0.5:.1g}, beside those shown"
        )
        return wrapped("hypotheses", words)


def is_of_roles(path: str | os.PathLike[str]) -> bool:
    """Whether a file holds a posterior that was read step by step in a world of its own."""
    return root_attribute(path, "schema") == SCHEMA
