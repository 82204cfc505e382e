"""From what was read step by step to the table of all hypotheses, at every frame."""

from __future__ import annotations

import functools
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.goals import N_GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SCHEMA: Final = "phase_ppl/stepwise/1"

STATED: Final = ("stated_goal_red", "stated_goal_green", "alpha")
STRENGTHS: Final = ("strength_red", "strength_green")

DIMENSIONS: Final = {
    "log_likelihood": ("time", "goal_red", "goal_green"),
    "strengths": ("time", *STRENGTHS),
    "log_prior": (*STATED, *STRENGTHS),
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "trajectory": ("time", "entity", "coord"),
}
"""Variable -> dimensions.

``log_likelihood`` of each frame given those before it and a pair of effective goals, 0 for the
first; ``strengths`` their probabilities, whatever the goals, given the frames so far and equal
ones before; ``actions`` those of what each agent did to come to a frame."""

REQUIRED_ATTRS: Final = ("event_id", "settings", "cost", "weight", "schema")

_LEAST: Final = 1e-12
"""Rows with less of the mass than this are left out of tables."""


def check(found: xr.Dataset) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, if ``found`` is no such reading."""
    schema = found.attrs.get("schema")
    if schema != SCHEMA:
        raise InvalidEventError(f"this was not read step by step: its schema is {schema!r}")
    missing = [name for name in REQUIRED_ATTRS if name not in found.attrs]
    missing += [name for name in DIMENSIONS if name not in found.variables]
    if missing:
        raise InvalidEventError(f"the reading lacks {', '.join(missing)}")
    for name, dims in DIMENSIONS.items():
        if found[name].dims != dims:
            raise InvalidEventError(f"{name} has dimensions {found[name].dims}, expected {dims}")
    sizes = {"goal_red": N_GOALS, "goal_green": N_GOALS, "alpha": len(ALPHAS)}
    sizes |= dict.fromkeys(STATED[:2], N_GOALS)
    for name, size in sizes.items():
        if found.sizes[name] != size:
            raise InvalidEventError(f"{name} has {found.sizes[name]} entries, expected {size}")
    likelihood = found["log_likelihood"].values
    if np.isnan(likelihood).any() or (likelihood == np.inf).any():
        raise InvalidEventError("log_likelihood has values that are no log densities")


@functools.cache
def effective_pairs() -> IntArray:
    """Return (stated_goal_red, stated_goal_green, alpha) -> goal_red * 36 + goal_green."""
    pairs = [
        np.ravel_multi_index(effective_goals(red, green, alpha), (N_GOALS, N_GOALS))
        for red in range(N_GOALS)
        for green in range(N_GOALS)
        for alpha in ALPHAS
    ]
    return np.array(pairs, np.int64).reshape(N_GOALS, N_GOALS, len(ALPHAS))


class Table:
    """All hypotheses of a reading and their log masses at any frame.

    Args:
        found: the reading.
    """

    def __init__(self, found: xr.Dataset) -> None:
        self._weight = float(found.attrs["weight"])
        self._levels = found[STRENGTHS[0]].values, found[STRENGTHS[1]].values
        self._log_prior = found["log_prior"].values
        so_far = np.cumsum(found["log_likelihood"].values, axis=0)
        self._so_far = so_far.reshape(len(so_far), -1)
        with np.errstate(divide="ignore"):
            self._log_strengths = np.log(found["strengths"].values)

    @property
    def n_frames(self) -> int:
        """Frames that were read."""
        return len(self._so_far)

    def log_mass(self, frame: int) -> FloatArray:
        """Return the log masses, shaped as ``log_prior``, given the frames up to ``frame``."""
        of_pairs = self._weight * self._so_far[frame][effective_pairs()]
        strengths = self._log_strengths[frame] + np.log(self._log_strengths[frame].size)
        return np.asarray(self._log_prior + of_pairs[..., None, None] + strengths)

    def rows(self, frame: int) -> Rows:
        """Return the hypotheses that have any mass to speak of, at a frame."""
        log_mass = self.log_mass(frame)
        weights = np.exp(log_mass - log_sum_exp(log_mass.ravel()))
        kept = np.nonzero(weights > _LEAST)
        pairs = effective_pairs()[kept[:3]]
        red, green = np.unravel_index(pairs, (N_GOALS, N_GOALS))
        values = dict(zip(STATED, kept[:3], strict=True))
        values |= {"goal_red": red, "goal_green": green}
        values |= {
            name: levels[codes]
            for name, levels, codes in zip(STRENGTHS, self._levels, kept[3:], strict=True)
        }
        found = weights[kept]
        return Rows(values, found / found.sum(), {"hypothesis": np.arange(len(found))})

    def pair_masses(self) -> FloatArray:
        """Return (time, goal_red, goal_green) probabilities, given the frames so far."""
        size = N_GOALS**2
        flat = effective_pairs().ravel()
        n = self._levels[0].size * self._levels[1].size
        by_strength = np.full((size, n), -np.inf)
        np.logaddexp.at(by_strength, flat, self._log_prior.reshape(-1, n))
        found = np.empty((self.n_frames, size))
        for frame in range(self.n_frames):
            log_strengths = self._log_strengths[frame].ravel()
            log_mass = np.logaddexp.reduce(by_strength + log_strengths, axis=1)
            log_mass += self._weight * self._so_far[frame]
            found[frame] = np.exp(log_mass - log_sum_exp(log_mass))
        return found.reshape(self.n_frames, N_GOALS, N_GOALS)
