"""How the chains went: numbers (R-hat and effective sizes by ArviZ), and a verdict in words."""

from __future__ import annotations

import itertools
import json
import math
import warnings
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
import scipy.special
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.estimate import with_error
from phase_ppl.analysis.quantities import ScenarioFunction, quantities, relation_codes
from phase_ppl.analysis.tree import (
    HYPOTHESIS,
    SITES,
    array,
    kept_scene,
    log_weight_of_draws,
    untried,
)
from phase_ppl.analysis.weights import Rows, aborted_mass_bound
from phase_ppl.dataset.generation.situation import overlaps
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import GOALS, N_GOALS, goal_index, goal_literal, is_self_referring
from phase_ppl.world.names import Predicate
from phase_ppl.world.scene import Scene

MIN_DRAWS: Final = 4
"""Draws per chain below which neither R-hat nor an effective sample size is estimated."""

MIN_DRAWS_WITHIN: Final = 10
"""Draws per chain from which on effective sample sizes are taken from autocorrelations."""

MIN_CHAINS_BETWEEN: Final = 4
"""Chains below which no effective sample size is taken from the spread between them."""

_TAIL: Final = (0.05, 0.95)


def arviz_module() -> Any:
    """Return ArviZ, which is slow to import."""
    with warnings.catch_warnings():
        # announces ArviZ 1, with which this works too
        warnings.simplefilter("ignore", FutureWarning)
        import arviz

        return arviz


def r_hat(values: FloatArray, method: Literal["rank", "split"] = "rank") -> float:
    """Return the split R-hat of (chain, draw) numbers: 1 where chains have mixed.

    Rank-normalised, the larger one of bulk and tail; or by ``"split"`` of the numbers as they
    are, as for indicators. Of a single chain the halves are the chains. Infinite where all
    spread is between halves of chains. NaN where it does not exist: fewer than four draws, a
    value that is not finite, or all values the same.
    """
    if not _varies(values):
        return math.nan
    halves = chain_halves(values)
    if not np.ptp(halves, axis=1).any():  # the variance of equal numbers may be rounded to above 0
        return math.inf if np.ptp(halves) > 0 else math.nan
    chains = values if len(values) > 1 else halves
    if chains.shape[1] < MIN_DRAWS:
        return math.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(arviz_module().rhat(chains, method=method))


def ess(values: FloatArray, method: Literal["bulk", "tail", "mean"]) -> float:
    """Return the effective number of (chain, draw) numbers; NaN as for :func:`r_hat`.

    For the centre (bulk), for the 5 % and 95 % quantiles, the lower (tail), or for the mean. Of
    chains too short for autocorrelations, where the usual estimate hardly depends on the draws,
    it follows from the spread between the chains, if there are enough.
    """
    if not _varies(values):
        return math.nan
    if values.shape[1] >= MIN_DRAWS_WITHIN:
        options = {"prob": _TAIL} if method == "tail" else {}
        return float(arviz_module().ess(values, method=method, **options))
    if method == "tail":
        low, high = (_ess_between((values <= q).astype(float)) for q in np.quantile(values, _TAIL))
        return min(low, high)
    return _ess_between(_normal_ranks(values) if method == "bulk" else values)


def mcse(values: FloatArray) -> float:
    """Return the Monte-Carlo standard error of the mean of (chain, draw) numbers; or NaN."""
    return (
        float(values.std(ddof=1)) / math.sqrt(ess(values, "mean")) if _varies(values) else math.nan
    )


def _varies(values: FloatArray) -> bool:
    if values.shape[1] < MIN_DRAWS or not np.isfinite(values).all():
        return False
    return bool(np.ptp(values) > np.finfo(float).eps * np.abs(values).max())


def chain_halves(values: FloatArray) -> FloatArray:
    """Return (2 chains, draw // 2) the first and second half of every chain."""
    half = values.shape[1] // 2
    return np.concatenate([values[:, :half], values[:, -half:]]).astype(float)


def _normal_ranks(values: FloatArray) -> FloatArray:
    """Return the values' ranks, of equals the mean, as quantiles of the normal distribution."""
    ranks = pd.Series(values.ravel()).rank().to_numpy()
    quantiles: FloatArray = scipy.special.ndtri((ranks - 3 / 8) / (values.size + 1 / 4))
    return quantiles.reshape(values.shape)


def _ess_between(chains: FloatArray) -> float:
    """Return the effective sample size that the spread between the chains' means tells."""
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    if len(chains) < MIN_CHAINS_BETWEEN:
        return math.nan
    squared_error = chains.mean(axis=1).var(ddof=1) / len(chains)
    variance = chains.var(ddof=1)
    return float(variance / max(squared_error, variance / (chains.size * math.log10(chains.size))))


# --- in words, whether a posterior can be trusted --------------------------------------------

AGREED: Final = 0.8
"""Share of particles with the same leading goal from which on they are said to agree."""

STUCK: Final = 0.05  # acceptance rate below which the particles are said to have hardly moved
FEW: Final = 0.1  # effective share of weighted draws below which a few of them are said to decide

FEW_DRAWS: Final = 5.0
"""Independent draws that the answers are worth below which so few are said to decide."""

MIXED: Final = 1.1  # R-hat above which draws are said to depend on where their chain began

UNTRIED: Final = 0.05
"""Prior mass of pairs of goals without a simulation from which on it is a sign."""

_CONSISTENT: Final = ("stratified", "importance")
"""Weightings that do not depend on the law that a kernel's draws follow."""

_NAMES: Final = {"goal_red": "red", "goal_green": "green"}
_ASKED: Final = {"goal_red": "red's goal", "goal_green": "green's goal", "relation": "the relation"}
_NAMED: Final = 2
"""Goals that are named where particles disagree."""


def verdict(found: Mapping[str, Any]) -> str:
    """Return in a few sentences whether a posterior with these diagnostics can be trusted.

    What speaks most against it comes first. Only where nothing does, this is said.
    """
    weighted = found["weighted_draws_ess"] is not None
    signs = [overlap_sign(found["overlapping_frames"])] if found["overlapping_frames"] else []
    signs += _biased(found) + undecided(found["leaders"]) + _by_prior(found["leaders"])
    signs += _untried_rivals(found["untried_rivals"])
    if not weighted:
        signs += _acceptance(found["acceptance_rate"])
    size = found["effective_size"]
    if size is not None and size < FEW_DRAWS:
        signs.append(
            f"The goals are no surer than by {size:.1f} independent draws: single simulations "
            "decide, and another run may well differ."
        )
    if weighted:
        signs += _weighted(found)
    else:
        signs += _disagreement(found) + _mixing(found) + _other_leaders(found["categories"])
    untried = found["untried"]
    if untried is not None and untried >= UNTRIED:
        signs.append(
            f"Pairs of goals with {untried:.2f} of the prior's mass were never simulated, and "
            "count as impossible."
        )
    simulations = found["simulations"]
    if simulations["failed"]:
        signs.append(f"{simulations['failed']} of {simulations['total']} simulations failed.")
    if weighted and found["decided"]:
        signs.append("Both goals and the relation are decided, by more than their errors.")
    sentences = [*signs, *([] if weighted else _notes(found))]
    if not weighted and found["particles"] > 1 and not _split(found):
        agreed = f"The {found['particles']} particles agree on both agents' goals {_margin(found)}"
        none = ": nothing speaks against the leading goals."
        sentences.append(agreed + ("." if signs else none))
    return " ".join(sentences)


def _biased(found: Mapping[str, Any]) -> list[str]:
    """Return what makes the probabilities wrong however long the run is."""
    sentences = []
    if found["weights"] == "visited":
        sentences.append(
            "The weights 'visited' are not the posterior: what is proposed often counts more. "
            f"Simulations stopped early hide at most {found['aborted_mass_bound']:.1%} of their "
            "mass."
        )
    elif found["weights"] == "likelihood":
        sentences.append("The weights 'likelihood' make every probability too extreme.")
    if found["validity"] == "approximate" and found["weights"] not in _CONSISTENT:
        sentences.append(
            f"The kernel {found['kernel']} is approximate: its probabilities are biased however "
            "long it runs."
        )
    return sentences


def _margin(found: Mapping[str, Any]) -> str:
    errors = [error for error in found["monte_carlo_error"].values() if error is not None]
    if not errors:
        return ""
    return f"(Monte-Carlo error of a leading goal's probability: {max(errors):.2f})"


def _split(found: Mapping[str, Any]) -> list[str]:
    return [name for name, share in found["agreement"].items() if share < AGREED]


def _disagreement(found: Mapping[str, Any]) -> list[str]:
    particles, split = found["particles"], _split(found)
    if particles == 1:
        return ["With one particle nothing shows whether another would agree: use more."]
    if not split:
        return []
    camps = {name: _camps(found["leading_goals"][name]) for name in split}
    if len(split) == 1:
        agreed = next(name for name in _NAMES if name not in split)
        text = f"agree on {_NAMES[agreed]}'s goal but not on {_NAMES[split[0]]}'s"
        text += f", where {camps[split[0]]}"
    else:
        text = "agree on neither agent's goal: " + "; ".join(
            f"for {_NAMES[name]}, {camp}" for name, camp in camps.items()
        )
    return [
        f"The {particles} particles {text} {_margin(found)}. More iterations would tell real "
        "uncertainty from chains that have not mixed."
    ]


def _camps(leading: Mapping[str, int]) -> str:
    """Return which goals the particles favour, as "7 favour 'A', 5 'B' and 3 something else"."""
    named = [(goal, n) for goal, n in list(leading.items())[:_NAMED] if n > 1]
    rest = sum(leading.values()) - sum(n for _, n in named)
    if not named:
        return f"all {rest} favour different ones"
    (first, most), *others = named
    parts = [f"{most} favour '{first}'", *(f"{n} '{goal}'" for goal, n in others)]
    parts += [f"{rest} something else"] if rest else []
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _acceptance(rate: float) -> list[str]:
    if rate == 0:
        return ["No proposal was accepted: this is still the bottom-up guess, not a posterior."]
    if rate < STUCK:
        return [
            f"Only {rate:.0%} of the proposals were accepted: the particles have hardly left "
            "the bottom-up guess."
        ]
    return []


def _mixing(found: Mapping[str, Any]) -> list[str]:
    """Return which quantities have chains that differ more than draws of one law do."""
    worst = {"the log joint": found["scalars"]["log_joint"]["r_hat"]}
    for name, labels in found["categories"].items():
        known = [entry["r_hat"] for entry in labels.values() if entry["r_hat"] is not None]
        worst[name.replace("_", " of ")] = max(known, default=None)
    apart = {name: r for name, r in worst.items() if r is not None and r > MIXED}
    if not apart:
        return []
    listed = ", ".join(f"{name} {r:.2f}" for name, r in apart.items())
    return [
        f"The chains still depend on where they began: R-hat (1 where they have mixed) is {listed}."
    ]


def _notes(found: Mapping[str, Any]) -> list[str]:
    """Return what could not be looked at."""
    draws = found["iterations"]
    if draws < MIN_DRAWS:
        return [
            f"R-hat and effective sample sizes need {MIN_DRAWS} draws per particle; "
            f"there {'is' if draws == 1 else 'are'} {draws}."
        ]
    if draws < MIN_DRAWS_WITHIN and found["particles"] < MIN_CHAINS_BETWEEN:
        return [
            f"Effective sample sizes need {MIN_DRAWS_WITHIN} draws per particle, or "
            f"{MIN_CHAINS_BETWEEN} particles."
        ]
    return []


def _other_leaders(categories: Mapping[str, Any]) -> list[str]:
    """Return for which agent the weighting puts another goal first than the draws do."""
    sentences = []
    for name, agent in _NAMES.items():
        goals = categories[name]
        first = max(goals, key=lambda goal: goals[goal]["probability"])
        if goals[first]["share"] < max(entry["share"] for entry in goals.values()):
            sentences.append(f"The weights put another goal of {agent} first, '{first}'.")
    return sentences


def undecided(leaders: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return what is not decided, and between what; see ``Hypotheses.leaders``."""
    open_ones = []
    for name, one in leaders.items():
        if not one["sure"]:
            error = math.nan if one["error"] is None else one["error"]
            first = f"'{one['label']}' ({with_error(one['probability'], error)})"
            second = f"'{one['next']}' ({one['next_probability']:.2f})"
            open_ones.append(f"{_ASKED.get(name, name)} {first} or {second}")
    return [f"Not decided: {'; '.join(open_ones)}."] if open_ones else []


def _by_prior(leaders: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return what is sure by the prior only."""
    names = [
        f"{_ASKED[name]} '{one['label']}' {one['without_prior']:.2f}"
        for name, one in leaders.items()
        if one["sure"] and one["without_prior"] is not None and one["without_prior"] <= 0.5
    ]
    if not names:
        return []
    return [
        "The prior decides, not the video: with all pairs of goals alike beforehand, "
        f"{' and '.join(names)} would have no more."
    ]


def _untried_rivals(n: int) -> list[str]:
    if not n:
        return []
    rivals, were = ("rival", "was") if n == 1 else ("rivals", "were")
    return [
        f"Not ruled out: {n} {rivals} of the leading goals, with which one agent wants the same "
        f"thing at another landmark, {were} never simulated."
    ]


def _weighted(found: Mapping[str, Any]) -> list[str]:
    if found["weights"] != "count":  # all simulations count, not the draws alone
        return []
    ess, draws = found["weighted_draws_ess"], found["particles"] * found["iterations"]
    text = f"The {draws} weighted draws are worth {ess * draws:.1f} equal ones"
    margin = _margin(found)
    text += f" {margin}" if margin else ""
    few = ": so few decide that another run may well differ." if ess < FEW else "."
    return [text + few]


# --- in numbers ------------------------------------------------------------------------------

MASS: Final = 0.02  # share of the draws, or probability, from which on a category is reported

CATEGORICAL: Final = ("goal_red", "goal_green", "relation", "scenario")
"""Quantities whose categories are reported."""


def diagnostics(
    tree: xr.DataTree,
    weights: str,
    rows: Rows,
    leaders: Mapping[str, dict[str, Any]],
    effective_size: float,
    scenario: ScenarioFunction | None = None,
) -> dict[str, Any]:
    """Return the diagnostics of a tree of draws as plain numbers, lists and text.

    Keys, beside ``weights``, ``kernel`` and ``validity``:

    * ``particles``, ``iterations``: chains M and draws L.
    * ``acceptance_by_iteration``, ``acceptance_rate``: share of particles that accepted.
    * ``move_rate``: share of iterations in which a particle's pair of effective goals changed,
      None with a single draw.
    * ``distinct_hypotheses``, ``distinct_goal_pairs``: among the draws.
    * ``effective_rows``: 1 / sum of squared weights, of the weighting in use.
    * ``weighted_draws_ess``: for kernels that weigh their draws, the effective share of them,
      1 / (n * sum of squared weights); None for others. The next four count the draws' weights.
    * ``agreement``: per goal, the share of particles whose own leading goal leads overall.
    * ``leading_goals``: per goal, how many particles each goal leads in, most first.
    * ``between_chain_tv``: per goal, mean and max over pairs of particles of the total
      variation between their marginals; None with one particle.
    * ``leaders``: the most probable goals and relation, with errors, the next ones, and what they
      would have ``without_prior``: with all pairs of goals that were simulated equally probable
      beforehand; None where the file does not hold the prior of pairs.
    * ``untried_rivals``: how many pairs that differ from the leading one in nothing but one
      agent's landmark were never simulated, though the prior allows them.
    * ``decided``: whether all three leaders are sure, with the prior and without it, by
      ``FEW_DRAWS`` independent draws or more, and all rivals were tried.
    * ``monte_carlo_error``: per goal, the error of the leading goal's probability under the
      weighting in use; None with one particle.
    * ``effective_size``: how many independent draws would be as sure of the goals as the
      weighting in use; None with one particle.
    * ``untried``: prior mass of the pairs of effective goals without a completed simulation; None
      where the file does not hold the prior of pairs.
    * ``scalars``: of the log joint, total error, strengths and real sites of the user's own,
      ``r_hat``, ``ess_bulk`` and ``ess_tail``.
    * ``categories``: of goals, relation and scenario, each category whose ``probability`` under
      the weighting or ``share`` of the draws exceeds 2 %, most probable first, with ``ess``,
      ``mcse`` (standard error of the share) and split ``r_hat`` of its indicator.
    * ``windows``: of the proposals, how many came from a window (``proposals``) and from none
      (``without``); the first frames that occur (``starts``) and how often each (``counts``);
      ``frames`` of a window, None where the run has no such setting.
    * ``simulations``: total, completed, aborted (stopped early), failed.
    * ``frames_saved``, ``frames_saved_share``: by stopping early.
    * ``aborted_mass_bound``: see :func:`phase_ppl.analysis.weights.aborted_mass_bound`.
    * ``best_error_per_frame``: smallest mean error of a draw, units: the norm over x, y of all
      four entities.
    * ``overlapping_frames``: in which bodies lie on each other or in a wall.
    * ``verdict``: a few sentences.

    R-hat and effective sizes are None where they do not exist: for fewer than four draws per
    chain, weighted draws, or what never changes (R-hat: within half a chain). Of goal codes they
    mean nothing and are not given.
    """
    posterior, stats = tree["posterior"].dataset, tree["sample_stats"].dataset
    n_chains, n_draws = posterior["goal_red"].shape
    accepted = stats["accepted"].values.astype(float)
    goals = {name: posterior[name].values for name in ("goal_red", "goal_green")}
    log_weight = log_weight_of_draws(tree)
    if not np.isfinite(log_weight).any():  # under other weights than the draws' own
        log_weight = np.zeros_like(log_weight)
    draw_weights = np.exp(log_weight - log_weight.max())
    draw_weights /= draw_weights.sum()
    shares = draw_weights.sum(axis=1)
    by_chain = {name: _chain_marginals(codes, draw_weights) for name, codes in goals.items()}
    weighted = "log_evidence" in stats or bool(np.ptp(log_weight) > 0)
    pair = goals["goal_red"].astype(np.int64) * N_GOALS + goals["goal_green"]
    n_frames = tree["observed_data"].sizes["time"]
    result: dict[str, Any] = {
        "weights": weights,
        "kernel": str(tree.attrs["kernel"]),
        "validity": str(tree.attrs["validity"]),
        "particles": n_chains,
        "iterations": n_draws,
        "acceptance_by_iteration": [float(rate) for rate in accepted.mean(axis=0)],
        "acceptance_rate": float(accepted.mean()),
        "move_rate": float((pair[:, 1:] != pair[:, :-1]).mean()) if n_draws > 1 else None,
        "distinct_hypotheses": len(
            set(zip(*(posterior[name].values.ravel().tolist() for name in HYPOTHESIS), strict=True))
        ),
        "distinct_goal_pairs": len(np.unique(pair)),
        "effective_rows": float(1 / (rows.weights**2).sum()),
        "weighted_draws_ess": (
            float(1 / (draw_weights.size * (draw_weights**2).sum())) if weighted else None
        ),
        "agreement": {name: _agreement(p, shares) for name, p in by_chain.items()},
        "leading_goals": {name: _leading_goals(p, shares) for name, p in by_chain.items()},
        "between_chain_tv": {name: _between_chain_tv(p, shares) for name, p in by_chain.items()},
        "leaders": (answers := _without_prior(tree, rows, leaders)),
        "untried_rivals": (n_untried := untried_rivals(tree, leaders)),
        "decided": effective_size >= FEW_DRAWS
        and not n_untried
        and all(
            one["sure"] and one["without_prior"] is not None and one["without_prior"] > 0.5
            for one in answers.values()
        ),
        "monte_carlo_error": {name: _finite(leaders[name]["error"]) for name in goals},
        "effective_size": _finite(effective_size),
        "untried": _finite(untried(tree)),
        "scalars": {
            name: {
                "r_hat": None if weighted else _finite(r_hat(values)),
                "ess_bulk": None if weighted else _finite(ess(values, "bulk")),
                "ess_tail": None if weighted else _finite(ess(values, "tail")),
            }
            for name, values in scalars(tree).items()
        },
        "categories": {
            name: _categories(name, codes, draw_weights, rows, weighted)
            for name, codes in categorical_draws(tree, scenario).items()
        },
        "windows": _windows(stats["window"].values, tree.attrs["settings"], n_frames),
        **_simulation_costs(tree, n_frames),
        "aborted_mass_bound": aborted_mass_bound(tree),
        "best_error_per_frame": float(stats["total_error"].min()) / n_frames,
        "overlapping_frames": overlapping_frames(
            array(tree, "observed_data", "trajectory"), kept_scene(tree["constant_data"].dataset)
        ),
    }
    result["verdict"] = verdict(result)
    return result


def _without_prior(
    tree: xr.DataTree, rows: Rows, leaders: Mapping[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return the leaders with what they would have, were all pairs of goals alike beforehand."""
    constant, share = tree["constant_data"].dataset, dict.fromkeys(leaders)
    if "prior_of_pairs" in constant:
        prior = constant["prior_of_pairs"].values[
            rows.values["goal_red"], rows.values["goal_green"]
        ]
        weights = np.divide(rows.weights, prior, out=np.zeros(len(prior)), where=prior > 0)
        for name, one in leaders.items():
            code = quantities()[name].categories().index(one["label"])
            share[name] = float(weights[rows.values[name] == code].sum() / weights.sum())
    return {
        name: {**one, "error": _finite(one["error"]), "without_prior": share[name]}
        for name, one in leaders.items()
    }


def untried_rivals(tree: xr.DataTree, leaders: Mapping[str, Mapping[str, Any]]) -> int:
    """Return how many rivals of the leading goals were never simulated; 0 where no prior is kept.

    A rival differs in the landmark of one agent's goal, about the same entity and of the same sign.
    """
    constant, simulations = tree["constant_data"].dataset, tree["simulations"].dataset
    if "prior_of_pairs" not in constant:
        return 0
    tried = ~simulations["failed"].values
    done = set(zip(*(simulations[g].values[tried].tolist() for g in _NAMES), strict=True))
    leading = tuple(goal_index(leaders[name]["label"]) for name in _NAMES)
    rivals = [
        tuple(other if place == agent else goal for place, goal in enumerate(leading))
        for agent in range(len(leading))
        for other in range(N_GOALS)
        if _elsewhere(other, leading[agent], agent)
    ]
    prior = constant["prior_of_pairs"].values
    return sum(prior[pair] > 0 and pair not in done for pair in rivals)


def _elsewhere(goal: int, other: int, agent: int) -> bool:
    """Whether two goals of an agent differ in the landmark alone."""
    if is_self_referring(goal, agent) or is_self_referring(other, agent):
        return False
    one, two = goal_literal(goal, agent), goal_literal(other, agent)
    return (
        one.predicate is Predicate.ON is two.predicate
        and (one.subject, one.positive) == (two.subject, two.positive)
        and one.target != two.target
    )


def scalars(tree: xr.DataTree) -> dict[str, FloatArray]:
    """Return the real quantities of the draws, (chain, draw), a user's own sites last."""
    posterior, stats = tree["posterior"].dataset, tree["sample_stats"].dataset
    own = [
        str(name)
        for name, variable in posterior.data_vars.items()
        if name not in SITES and variable.ndim == 2 and variable.dtype.kind == "f"
    ]
    return {
        **{name: stats[name].values.astype(float) for name in ("log_joint", "total_error")},
        **{n: posterior[n].values.astype(float) for n in ("strength_red", "strength_green", *own)},
    }


def categorical_draws(
    tree: xr.DataTree, scenario: ScenarioFunction | None = None
) -> dict[str, NDArray[np.int64]]:
    """Return the codes (chain, draw) of :data:`CATEGORICAL` quantities of the draws."""
    posterior = tree["posterior"].dataset
    red, green = (posterior[name].values.astype(np.int64) for name in CATEGORICAL[:2])
    derived = relation_codes(red.ravel(), green.ravel(), scenario)
    shaped = {name: codes.reshape(red.shape) for name, codes in derived.items()}
    return {"goal_red": red, "goal_green": green, **shaped}


def _categories(
    name: str, codes: NDArray[np.int64], draw_weights: FloatArray, rows: Rows, weighted: bool
) -> dict[str, dict[str, float | None]]:
    labels = quantities()[name].categories()
    probability = np.bincount(rows.values[name], rows.weights, minlength=len(labels))
    share = np.bincount(codes.ravel(), draw_weights.ravel(), minlength=len(labels))
    found: dict[str, dict[str, float | None]] = {}
    for code in np.lexsort((-share, -probability)).tolist():
        if max(probability[code], share[code]) <= MASS:
            continue
        indicator = (codes == code).astype(float)
        found[labels[code]] = {
            "probability": float(probability[code]),
            "share": float(share[code]),
            "ess": None if weighted else _finite(ess(indicator, "mean")),
            "mcse": None if weighted else _finite(mcse(indicator)),
            "r_hat": None if weighted else _finite(r_hat(indicator, "split")),
        }
    return found


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _windows(window: NDArray[Any], settings: str, n_frames: int) -> dict[str, Any]:
    chosen = window[window >= 0].astype(np.int64)  # -1, or not a number: none
    starts, counts = np.unique(chosen, return_counts=True)
    length = (json.loads(settings).get("simple") or {}).get("window")
    return {
        "proposals": int(chosen.size),
        "without": int(window.size - chosen.size),
        "frames": None if length is None else min(int(length), n_frames - 1) + 1,
        "starts": starts.tolist(),
        "counts": counts.tolist(),
    }


def _chain_marginals(codes: NDArray[Any], weights: FloatArray) -> FloatArray:
    """Return (chain, goal): each chain's share of its draws' weight per goal; 0 without weight."""
    mass = np.stack(
        [np.bincount(c, w, minlength=N_GOALS) for c, w in zip(codes, weights, strict=True)]
    )
    return mass / np.maximum(mass.sum(axis=1, keepdims=True), np.finfo(float).tiny)


def _agreement(by_chain: FloatArray, shares: FloatArray) -> float:
    leading = (shares @ by_chain).argmax()
    return float((by_chain.argmax(axis=1) == leading)[shares > 0].mean())


def _leading_goals(by_chain: FloatArray, shares: FloatArray) -> Mapping[str, int]:
    leading = by_chain.argmax(axis=1)[shares > 0]
    particles = np.bincount(leading, minlength=N_GOALS)
    order = np.argsort(-particles, kind="stable")
    return {GOALS[code]: int(particles[code]) for code in order if particles[code]}


def _between_chain_tv(by_chain: FloatArray, shares: FloatArray) -> dict[str, float] | None:
    distances = [
        0.5 * float(np.abs(one - other).sum())
        for one, other in itertools.combinations(by_chain[shares > 0], 2)
    ]
    if not distances:
        return None
    return {"mean": float(np.mean(distances)), "max": max(distances)}


def _simulation_costs(tree: xr.DataTree, n_frames: int) -> dict[str, Any]:
    simulations = tree["simulations"].dataset
    failed = simulations["failed"].values.astype(bool)
    completed = simulations["completed"].values.astype(bool) & ~failed
    aborted = ~completed & ~failed
    saved = int((n_frames - simulations["frames_simulated"].values[aborted]).sum())
    wanted = n_frames * int((~failed).sum())
    return {
        "simulations": {
            "total": len(failed),
            "completed": int(completed.sum()),
            "aborted": int(aborted.sum()),
            "failed": int(failed.sum()),
        },
        "frames_saved": saved,
        "frames_saved_share": saved / wanted if wanted else 0.0,
    }


# --- a video that this world cannot show --------------------------------------------------------

_SHRUNK: Final = 0.8
"""Part of their size with which bodies must meet to be said to lie on each other: in contact they
press into each other a little."""

_FRAMES_NAMED: Final = 3  # frames that a verdict names


def overlapping_frames(trajectory: FloatArray, scene: Scene) -> list[int]:
    """Return the frames in which bodies lie on each other, or in a wall."""
    radius, walls, n_agents = scene.radius, scene.walls, len(scene.world.agents)
    small = _SHRUNK * radius
    near = np.full(len(trajectory), len(walls) > 0)
    for one, other in itertools.combinations(range(trajectory.shape[1]), 2):
        apart = np.hypot(*(trajectory[:, one, :2] - trajectory[:, other, :2]).T)
        # an agent reaches 3 radii from its origin at most
        near |= apart < 3 * (radius[one] + radius[other])
    return [
        t for t in np.flatnonzero(near).tolist() if overlaps(trajectory[t], small, walls, n_agents)
    ]


def overlap_sign(frames: list[int]) -> str:
    """Return what the frames in which bodies lie on each other say of a posterior."""
    return (
        f"Bodies lie on each other or in a wall in {frames_text(frames)}, which bodies of this "
        "world cannot: what they do there says little of goals."
    )


def frames_text(frames: list[int]) -> str:
    """Return frames by number, the first few if they are many."""
    named = ", ".join(map(str, frames[:_FRAMES_NAMED]))
    if len(frames) > _FRAMES_NAMED:
        return f"{len(frames)} frames ({named}, ...)"
    return f"frame{'s' if len(frames) > 1 else ''} {named}"
