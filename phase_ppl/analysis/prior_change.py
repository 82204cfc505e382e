"""A finished run under another prior: nothing is simulated or searched again."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis.estimate import Estimate
from phase_ppl.analysis.tree import (
    HYPOTHESIS,
    SITES,
    log_weight_of_draws,
    simulation_of_draw,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.identity import qualified_name, source_hash

if TYPE_CHECKING:
    from phase_ppl.analysis.event_posterior import EventPosterior
    from phase_ppl.analysis.posterior import Posterior

FEWEST: Final = 10.0
"""Equal draws that a run under another prior must be worth, unless it was worth few before."""

_LEFT: Final = 0.5
"""Share of the worth of a run that another prior may cost where fewer than that are left."""

_TRIED: Final = 0.25
"""Share that what was simulated must hold of the new prior, of its share of the old one."""


def checked_program(prior: Callable[..., object] | str) -> Callable[..., object]:
    """Return a prior, by its name or itself; errors as of a model."""
    from phase_ppl.models import priors
    from phase_ppl.models.model import checked_sites

    program = priors.named(prior) if isinstance(prior, str) else prior
    checked_sites(program)
    return program


def settings_under(settings: str, program: Any, **found: float) -> str:
    """Return a run's settings, JSON, under another prior: which, and instead of which.

    The numbers ``found`` are kept beside it, in ``reweighted``.
    """
    record = json.loads(settings)
    model = dict(record.get("model", {}))
    first = record.get("reweighted", {}).get("from", model.get("prior", "unknown"))
    model |= {"prior": qualified_name(program), "prior_source": source_hash(program)}
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

    Raises:
        InvalidEventError: a draw rests on no simulation of the tree.
    """
    from phase_ppl.models.density import NO_DENSITY
    from phase_ppl.models.effective import (
        drawn_stated,
        log_prior_of_effective,
        log_prior_of_hypotheses,
        prior_of_pairs,
        upstream,
    )

    rows = simulation_of_draw(tree)
    if (rows < 0).any():
        raise InvalidEventError("a draw rests on no completed simulation of the tree")
    simulations, draws = tree["simulations"].to_dataset(), tree["posterior"].to_dataset()
    own = [str(name) for name in draws.data_vars if name not in SITES]
    columns = {
        name.removeprefix("stated_"): simulations[name].values for name in (*HYPOTHESIS, *own)
    }
    goals = np.stack([simulations[name].values for name in SITES[:2]], axis=1).astype(np.int64)
    strengths = {name: columns[name] for name in SITES[-2:]}
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
        for name, codes in zip(HYPOTHESIS[:3], stated.T, strict=True):
            simulations[name] = simulations[name].copy(data=codes.astype(simulations[name].dtype))
            draws[name] = draws[name].copy(data=simulations[name].values[rows])
    simulations["log_prior"] = simulations["log_prior"] + change
    simulations["log_prior_effective"] = "simulation", effective
    stats = tree["sample_stats"].to_dataset()
    stats["log_joint"] = stats["log_joint"] + change[rows]
    stats["log_weight"] = (*stats["log_joint"].dims,), log_weight_of_draws(tree) + change[rows]
    constant = tree["constant_data"].to_dataset()
    constant["prior_of_pairs"] = ("pair_red", "pair_green"), prior_of_pairs(program)
    changed = {
        "simulations": simulations,
        "posterior": draws,
        "sample_stats": stats,
        "constant_data": constant,
    }
    result = tree.copy()
    for name, group in changed.items():
        result[name] = xr.DataTree(group)
    return result


def worth(weights: FloatArray) -> float:
    """Return how many equal draws weighted ones are worth, at most (Kish)."""
    return float(1 / (weights**2).sum())


def check_overlap(post: Posterior, before: Posterior) -> None:
    """Refuse what too little was simulated for.

    Raises:
        InvalidSettingError: the simulations of ``before`` are worth much fewer, and too few, under
            the prior of ``post``, or hold much less of it than of the run's own.
    """
    size, old_size = worth(post.table.weights), worth(before.table.weights)
    tried, old_tried = 1 - post.untried, 1 - before.untried
    if size < FEWEST and size < _LEFT * old_size:
        reason = f"are worth {size:.1f} equal draws under this prior, {old_size:.1f} before"
    elif tried < _TRIED * old_tried:
        reason = f"hold {tried:.1%} of this prior, {old_tried:.1%} of the run's own"
    else:
        return
    raise InvalidSettingError(
        f"the simulations of this run {reason}: too few to tell; infer anew with this prior"
    )


def sensitivity(
    post: EventPosterior,
    question: str,
    prior: Callable[..., object],
    values: Iterable[float],
) -> xr.DataArray:
    """Return the answer to a question under a prior with ever another value of its argument.

    See :meth:`phase_ppl.analysis.event_posterior.EventPosterior.sensitivity`.
    """
    if not callable(prior):
        raise InvalidSettingError(
            f"prior={shown(prior)}: expected a NumPyro program of one argument, the number that "
            "is varied"
        )
    at = [float(value) for value in values]
    answers: list[xr.DataArray | None] = []
    refusals: list[str] = []
    for place, value in enumerate(at):
        program = functools.partial(prior, value)
        try:
            # once is enough for a check that takes a while
            changed = post.under(program) if place else post.with_prior(program)
            answer = changed.query(question)
        except InvalidSettingError as error:
            refusals.append(f"{value:g}: {error}")
            answers.append(None)
            continue
        if isinstance(answer, Estimate):
            answer = xr.DataArray(float(answer), {"error": answer.error})
        if not isinstance(answer, xr.DataArray):
            raise InvalidSettingError(
                f"{question!r} is answered by {type(answer).__name__}, which makes no curve: "
                "expected a question after numbers, such as P(relation)"
            )
        answers.append(answer)
    known = next((answer for answer in answers if answer is not None), None)
    if known is None:
        raise InvalidSettingError(
            f"no value of the prior's argument can be answered for: {'; '.join(refusals[:1])}"
            if refusals
            else "values is empty: expected numbers"
        )
    nothing = (known * np.nan).assign_coords(error=known["error"] * np.nan)
    table = xr.concat([nothing if a is None else a for a in answers], "value", join="override")
    return table.assign_coords(value=at).assign_attrs(
        question=question, prior=qualified_name(prior), refused="\n".join(refusals)
    )
