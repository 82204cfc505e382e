"""From what was read step by step to the table of all hypotheses, at every frame."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.weights import Rows, log_sum_exp
from phase_ppl.world.arrays import FloatArray, IntArray
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import ALPHAS, effective_pairs

SCHEMA: Final = "phase_ppl/stepwise/2"

SITES: Final = "sites"
"""Attribute that names the further sites of the prior, JSON."""

STATED: Final = ("stated_goal_red", "stated_goal_green", "alpha")
STRENGTHS: Final = ("strength_red", "strength_green")

DIMENSIONS: Final = {
    "log_likelihood": ("time", "goal_red", "goal_green"),
    "log_likelihood_without": ("planner_seed", "time", "goal_red", "goal_green"),
    "strengths": ("time", *STRENGTHS),
    "log_prior": (*STATED, *STRENGTHS),
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "unexplained": ("time",),
    "log_peak": ("time",),
    "trajectory": ("time", "entity", "coord"),
}
"""Variable -> dimensions.

``log_likelihood`` of each frame given those before it and a pair of effective goals, 0 for the
first; ``log_likelihood_without`` likewise without each set of searches, none where there is only
one; ``strengths`` their probabilities, whatever the goals, given the frames so far and equal
ones before; ``actions`` those of what each agent did to come to a frame; ``unexplained`` by how
many nats the best pair of actions leaves the frame less probable than one that is exactly where an
action puts it, whose log density is ``log_peak``."""

REQUIRED_ATTRS: Final = ("event_id", "settings", "cost", "weight", "schema")
_LEAST: Final = 1e-12  # rows with less of the mass than this are left out of tables


def check(found: xr.Dataset) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, if ``found`` is no such table."""
    check_variables(found, SCHEMA, DIMENSIONS, REQUIRED_ATTRS)
    sizes = {"goal_red": N_GOALS, "goal_green": N_GOALS, "alpha": len(ALPHAS)}
    check_sizes(found, {**sizes, **dict.fromkeys(STATED[:2], N_GOALS)})
    likelihood = found["log_likelihood"].values
    if np.isnan(likelihood).any() or (likelihood == np.inf).any():
        raise InvalidEventError("log_likelihood has values that are no log densities")


def check_variables(
    found: xr.Dataset,
    schema: str,
    dimensions: Mapping[str, tuple[str, ...]],
    attrs: Sequence[str],
) -> None:
    """Raise InvalidEventError unless there are these variables and attributes."""
    if found.attrs.get("schema") != schema:
        raise InvalidEventError(
            f"this was not read step by step: its schema is {found.attrs.get('schema')!r}, "
            f"expected {schema!r}"
        )
    missing = [name for name in attrs if name not in found.attrs]
    missing += [name for name in dimensions if name not in found.variables]
    if missing:
        raise InvalidEventError(f"it lacks {', '.join(missing)}")
    for name, dims in dimensions.items():
        if found[name].dims != dims:
            raise InvalidEventError(f"{name} has dimensions {found[name].dims}, expected {dims}")


def check_sizes(found: xr.Dataset, sizes: Mapping[str, int]) -> None:
    """Raise InvalidEventError unless dimensions have these sizes."""
    for name, size in sizes.items():
        if found.sizes[name] != size:
            raise InvalidEventError(f"{name} has {found.sizes[name]} entries, expected {size}")


class Table:
    """All hypotheses of a video and their log masses at any frame.

    Attributes:
        log_prior: log masses before the video, dimensions as in :data:`DIMENSIONS`.
        levels: of strength, newtons, ascending.
    """

    def __init__(self, found: xr.Dataset) -> None:
        self._weight = float(found.attrs["weight"])
        self._levels = found[STRENGTHS[0]].values, found[STRENGTHS[1]].values
        self.levels = self._levels[0]
        self.log_prior = found["log_prior"].values
        self._likelihood = found["log_likelihood"].values
        self._without = found["log_likelihood_without"].values
        so_far = np.cumsum(self._likelihood, axis=0)
        self._so_far = so_far.reshape(len(so_far), -1)
        with np.errstate(divide="ignore"):
            self._log_strengths = np.log(found["strengths"].values)

    @property
    def n_frames(self) -> int:
        """Frames that were read."""
        return len(self._so_far)

    @property
    def n_seeds(self) -> int:
        """Sets of searches."""
        return max(1, len(self._without))

    def log_mass(self, frame: int, weight: float | None = None) -> FloatArray:
        """Return the log masses, shaped as ``log_prior``, given the frames up to ``frame``.

        Each counts by ``weight``, by default the likelihood's.
        """
        weight = self._weight if weight is None else weight
        return self._masses(frame, weight * self._so_far[frame])

    def log_likelihood(self, frame: int) -> FloatArray:
        """Return log likelihoods, shaped as ``log_prior``, of the frames up to ``frame``."""
        return self._of_hypotheses(frame, self._weight * self._so_far[frame])

    def _masses(self, frame: int, of_pairs: FloatArray) -> FloatArray:
        return np.asarray(self.log_prior + self._of_hypotheses(frame, of_pairs))

    def _of_hypotheses(self, frame: int, of_pairs: FloatArray) -> FloatArray:
        # over the equal probabilities that they began with: the prior has its own of strengths
        strengths = self._log_strengths[frame] + np.log(self._log_strengths[frame].size)
        return np.asarray(of_pairs[effective_pairs()][..., None, None] + strengths)

    def _kept(self, frame: int) -> tuple[tuple[IntArray, ...], FloatArray]:
        """Return the places of the rows, and their weights."""
        log_mass = self.log_mass(frame)
        weights = np.exp(log_mass - log_sum_exp(log_mass.ravel()))
        kept = np.nonzero(weights > _LEAST)
        return kept, weights[kept] / weights[kept].sum()

    def rows(self, frame: int) -> Rows:
        """Return the hypotheses that have any mass to speak of, at a frame."""
        kept, weights = self._kept(frame)
        return Rows(self.columns(kept), weights, {"hypothesis": np.arange(len(weights))})

    def columns(self, places: tuple[IntArray, ...] | None = None) -> dict[str, NDArray[Any]]:
        """Return codes and strengths of the hypotheses at some places of ``log_prior``, or all."""
        if places is None:
            places = tuple(column.ravel() for column in np.indices(self.log_prior.shape))
        red, green = np.unravel_index(effective_pairs()[places[:3]], (N_GOALS, N_GOALS))
        values: dict[str, NDArray[Any]] = dict(zip(STATED, places[:3], strict=True))
        values |= {"goal_red": red, "goal_green": green}
        for name, levels, codes in zip(STRENGTHS, self._levels, places[3:], strict=True):
            values[name] = levels[codes]
        return values

    def weights_without(self, frame: int) -> FloatArray:
        """Return (planner_seed, row) weights of :meth:`rows` without each set of searches."""
        kept, _ = self._kept(frame)
        masses = (log_mass[kept] for log_mass in self.log_masses_without(frame))
        return np.array([np.exp(mass - log_sum_exp(mass)) for mass in masses])

    def log_masses_without(self, frame: int) -> Iterator[FloatArray]:
        """Yield :meth:`log_mass` without each set of searches; nothing where there is one set."""
        for one in self._without:
            so_far = one[: frame + 1].sum(axis=0, dtype=np.float64).ravel()
            yield self._masses(frame, self._weight * so_far)

    def pair_masses(self) -> FloatArray:
        """Return (time, goal_red, goal_green) probabilities, given the frames so far."""
        return self._pair_masses(self._so_far)

    def pair_masses_without(self) -> FloatArray:
        """Return (planner_seed, time, goal_red, goal_green) likewise without each set."""
        so_far = self._without.cumsum(axis=1, dtype=np.float64)
        masses = [self._pair_masses(one.reshape(len(one), -1)) for one in so_far]
        return np.array(masses).reshape(so_far.shape)

    def _pair_masses(self, so_far: FloatArray) -> FloatArray:
        size = N_GOALS**2
        flat = effective_pairs().ravel()
        n = self._levels[0].size * self._levels[1].size
        by_strength = np.full((size, n), -np.inf)
        np.logaddexp.at(by_strength, flat, self.log_prior.reshape(-1, n))
        found = np.empty((self.n_frames, size))
        for frame in range(self.n_frames):
            log_strengths = self._log_strengths[frame].ravel()
            log_mass = np.logaddexp.reduce(by_strength + log_strengths, axis=1)
            log_mass += self._weight * so_far[frame]
            found[frame] = np.exp(log_mass - log_sum_exp(log_mass))
        return found.reshape(self.n_frames, N_GOALS, N_GOALS)

    @functools.cached_property
    def log_predictive(self) -> FloatArray:
        """Return (time,) log density of each frame given those before it; 0 for the first."""
        with np.errstate(divide="ignore"):
            before = np.log(self.pair_masses()[:-1])
        found = np.logaddexp.reduce(before + self._likelihood[1:], axis=(1, 2))
        return np.concatenate([[0.0], found])


def log_prior_of_pairs(log_prior: FloatArray) -> FloatArray:
    """Return (goal_red, goal_green) log prior masses of pairs of effective goals."""
    found = np.full(N_GOALS**2, -np.inf)
    of_stated = np.logaddexp.reduce(log_prior.reshape(*log_prior.shape[:3], -1), axis=-1)
    np.logaddexp.at(found, effective_pairs().ravel(), of_stated.ravel())
    return found.reshape(N_GOALS, N_GOALS)
