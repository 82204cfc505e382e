"""A finished run under another prior: nothing is simulated or searched again."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis.tree import (
    effective_goals,
    log_weight_of_draws,
    simulation_of_draw,
    space_of_tree,
)
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.identity import qualified_name, source_hash

FEWEST: Final = 10.0
"""Equal draws that a run under another prior must be worth, unless it was worth few before."""

_LEFT: Final = 0.5
"""Share of the worth of a run that another prior may cost where fewer than that are left."""

_TRIED: Final = 0.25
"""Share that what was simulated must hold of the new prior, of its share of the old one."""


def settings_under(settings: str, program: Any, **found: float) -> str:
    """Return a run's settings, JSON, under another prior: which, and instead of which.

    The numbers ``found`` are kept beside it, in ``reweighted``.
    """
    from phase_ppl.models.world_prior import as_given

    record = json.loads(settings)
    model = dict(record.get("model", {}))
    first = record.get("reweighted", {}).get("from", model.get("prior", "unknown"))
    given = as_given(program)
    now = {"prior": qualified_name(given), "prior_source": source_hash(given)}
    if now["prior_source"] is not None and now.items() <= model.items():
        return settings  # the run's own, given again
    model |= now
    return json.dumps({**record, "model": model, "reweighted": {"from": first, **found}})


def changed_text(settings: dict[str, Any]) -> str:
    """Return in words that a posterior is under another prior than its run; "" if it is not."""
    if "reweighted" not in settings:
        return ""
    found = settings["reweighted"]
    words = f"{settings['model']['prior']}, taken instead of {found['from']} after the run"
    if "effective_size" in found:
        words += (
            f": what was simulated is worth {found['effective_size']:.1f} equal draws, "
            f"{found['effective_size_before']:.1f} before"
        )
    return words


def reweighted(tree: xr.DataTree, program: Callable[..., object]) -> xr.DataTree:
    """Return a tree of draws with the densities of another prior in place of the run's.

    What is simulated depends on effective goals and strengths only, so these are weighted by the
    ratio of their priors, and stated goals and alpha are drawn anew given them. Sites of a user's
    own, where the other prior has them too, are weighted along with all the rest; else they are
    left out.
    """
    from phase_ppl.models.density import NO_DENSITY
    from phase_ppl.models.effective import log_prior_of_hypotheses, upstream
    from phase_ppl.models.world_prior import drawn_stated, kept_prior, log_prior_of_effective

    rows = simulation_of_draw(tree)
    if (rows < 0).any():
        raise InvalidEventError("a draw rests on no completed simulation of the tree")
    simulations, draws = tree["simulations"].to_dataset(), tree["posterior"].to_dataset()
    space = space_of_tree(tree)
    own = [str(name) for name in draws.data_vars if name not in space.columns]
    columns = {
        name.removeprefix("stated_"): simulations[name].values for name in (*space.given, *own)
    }
    goals = effective_goals(tree, "simulations")
    strengths = {name: columns[name] for name in space.strength_sites}
    effective = log_prior_of_effective(program, goals, strengths)
    effective[effective <= NO_DENSITY] = -np.inf
    if own and set(own) <= upstream(program).keys():
        log_prior = log_prior_of_hypotheses(program, columns)
        log_prior[log_prior <= NO_DENSITY] = -np.inf
        change = log_prior - simulations["log_prior"].values
    else:
        change = effective - simulations["log_prior_effective"].values
        stated = drawn_stated(program, goals, np.stack(list(strengths.values()), axis=1))
        simulations, draws = simulations.drop_vars(own), draws.drop_vars(own)
        for name, codes in zip(space.given, stated.T, strict=False):
            simulations[name] = simulations[name].copy(data=codes.astype(simulations[name].dtype))
            draws[name] = draws[name].copy(data=simulations[name].values[rows])
    simulations["log_prior"] = simulations["log_prior"] + change
    simulations["log_prior_effective"] = "simulation", effective
    stats = tree["sample_stats"].to_dataset()
    stats["log_joint"] = stats["log_joint"] + change[rows]
    stats["log_weight"] = (*stats["log_joint"].dims,), log_weight_of_draws(tree) + change[rows]
    changed = {
        "simulations": simulations,
        "posterior": draws,
        "sample_stats": stats,
        "constant_data": tree["constant_data"].to_dataset().assign(kept_prior(program)),
    }
    return tree.assign({name: xr.DataTree(group) for name, group in changed.items()})


def check_overlap(worths: tuple[float, float], tried: tuple[float, float]) -> None:
    """Refuse what too little was simulated for.

    Args:
        worths: equal draws that the simulations are worth under the other prior, and before.
        tried: shares of the other prior, and of the run's own, that were simulated.
    """
    if worths[0] < FEWEST and worths[0] < _LEFT * worths[1]:
        reason = f"are worth {worths[0]:.1f} equal draws under this prior, {worths[1]:.1f} before"
    elif tried[0] < _TRIED * tried[1]:
        reason = f"hold {tried[0]:.1%} of this prior, {tried[1]:.1%} of the run's own"
    else:
        return
    raise InvalidSettingError(
        f"the simulations of this run {reason}: too few to tell; infer anew with this prior"
    )
