"""All hypotheses that a simulator can tell apart, with strengths on a grid."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from phase_ppl.models.density import NO_DENSITY, log_density
from phase_ppl.models.effective import (
    log_prior_of_effective,
    log_prior_of_hypotheses,
    stated_hypotheses,
)
from phase_ppl.models.model import Model
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, HYPOTHESIS_SITES, STRENGTH_SITES
from phase_ppl.world.checks import number_or_nan
from phase_ppl.world.errors import InvalidSettingError, shown

NEVER: Final = -60.0
"""Log prior, less the highest, below which a hypothesis is left out; NumPyro gives a probability
of 0 some -87."""

_KEPT = 8


class Grid(NamedTuple):
    """Hypotheses that differ in effective goals or strengths.

    Attributes:
        sites: hypothesis site -> (row,). The stated goals and alpha are drawn from those that
            lead to the row's effective goals, by their prior.
        log_prior: (row,) of effective goals and strengths, normalised over the rows.
    """

    sites: dict[str, NDArray[Any]]
    log_prior: NDArray[np.float32]

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.log_prior)


def hypothesis_grid(model: Model, strengths: Sequence[float]) -> Grid:
    """Return all effective pairs of goals with prior mass, times all pairs of strengths.

    Args:
        model: of which only the prior counts.
        strengths: of either agent, newtons.

    Raises:
        InvalidSettingError: the prior has sites of its own, or no mass on the grid; or a
            strength is no positive number.
    """
    own = [name for name in model.sites if name not in HYPOTHESIS_SITES]
    if own:
        raise InvalidSettingError(
            f"the prior's own sites {own} cannot be enumerated, only goals, alpha and strengths"
        )
    numbers = isinstance(strengths, Sequence) and not isinstance(strengths, str)
    if not numbers or not strengths or not all(_is_strength(value) for value in strengths):
        raise InvalidSettingError(
            f"strengths={shown(strengths)}, expected a few positive numbers, newtons"
        )
    with jax.ensure_compile_time_eval():  # kernels are made inside compiled code
        return _grid(model.prior, tuple(float(value) for value in strengths))


def _is_strength(value: Any) -> bool:
    return 0 < number_or_nan(value) < np.inf


@functools.lru_cache(_KEPT)
def _grid(prior: Any, strengths: tuple[float, ...]) -> Grid:
    pairs = np.array(list(stated_hypotheses()), np.int64)
    forces = np.array([(red, green) for red in strengths for green in strengths], np.float32)
    # strengths vary slowest: a run that is cut short has seen every pair of goals
    which = np.tile(np.arange(len(pairs)), len(forces))
    force = np.repeat(forces, len(pairs), axis=0)
    columns = dict(zip(STRENGTH_SITES, force.T.astype(np.float64), strict=True))
    log_prior = log_prior_of_effective(prior, pairs[which], columns)
    stated = _stated(prior, pairs[which], force)
    sites = dict(zip((*GOAL_SITES, ALPHA_SITE), stated.T.astype(np.int32), strict=True))
    sites |= dict(zip(STRENGTH_SITES, force.T, strict=True))
    density = jax.jit(jax.vmap(functools.partial(log_density, prior)))(sites)
    keep = np.asarray(density) > NO_DENSITY  # looks at the support, as NumPyro's own does not
    keep &= log_prior > np.max(log_prior, initial=-np.inf, where=keep) + NEVER
    if not keep.any():
        raise InvalidSettingError(
            f"the prior has no mass on the strengths {list(strengths)}; give others that it has"
        )
    log_prior = log_prior[keep] - np.logaddexp.reduce(log_prior[keep])
    kept = {name: values[keep] for name, values in sites.items()}
    return Grid(kept, log_prior.astype(np.float32))


def _stated(prior: Any, pairs: NDArray[np.int64], force: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return (row, 3) stated goals and alpha for effective ones, drawn by their prior."""
    options = [stated_hypotheses()[int(red), int(green)] for red, green in pairs]
    lengths = np.array([len(rows) for rows in options])
    stated, row = np.concatenate(options), np.repeat(np.arange(len(pairs)), lengths)
    columns: dict[str, NDArray[Any]] = {
        name: stated[:, i] for i, name in enumerate((*GOAL_SITES, ALPHA_SITE))
    }
    columns |= dict(zip(STRENGTH_SITES, force[row].T.astype(np.float64), strict=True))
    # the largest of Gumbel-perturbed log weights is a draw in proportion to the weights
    log_weight = log_prior_of_hypotheses(prior, columns)
    log_weight += np.random.default_rng(0).gumbel(size=len(log_weight))
    order = np.lexsort((log_weight, row))
    last_of_row = np.cumsum(lengths) - 1
    return stated[order[last_of_row]]
