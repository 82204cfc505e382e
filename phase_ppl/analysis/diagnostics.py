"""How the chains went, and in words whether their posterior can be trusted."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis.tree import HYPOTHESIS, log_weight_of_draws
from phase_ppl.analysis.weights import aborted_mass_bound
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.names import AGENTS

AGREED = 0.8
"""Share of particles with the same leading goal from which on they are said to agree."""

STUCK = 0.05
"""Acceptance rate below which the particles are said to have hardly moved."""

FEW = 0.1
"""Effective share of weighted draws below which a few of them are said to decide."""

FloatArray = NDArray[np.float64]


def diagnostics(tree: xr.DataTree, weights: str, row_weights: FloatArray) -> dict[str, Any]:
    """Return the diagnostics of a tree of draws as plain numbers, lists and text.

    Keys, beside ``weights``, ``kernel`` and ``validity``:

    * ``particles``, ``iterations``: chains M and draws L.
    * ``acceptance_by_iteration``, ``acceptance_rate``: share of particles that accepted.
    * ``move_rate``: share of iterations in which a particle's pair of effective goals changed,
      None with a single draw.
    * ``distinct_hypotheses``, ``distinct_goal_pairs``: among the draws.
    * ``effective_rows``: 1 / sum of squared weights, of the weighting in use.
    * ``weighted_draws_ess``: for kernels that weigh their draws, the effective share of them,
      1 / (n * sum of squared weights); None for others. The next three count the draws' weights.
    * ``agreement``: per goal, the share of particles whose own leading goal leads overall.
    * ``between_chain_tv``: per goal, mean and max over pairs of particles of the total
      variation between their marginals; None with one particle.
    * ``monte_carlo_error``: per goal, the standard error of the leading goal's probability
      from the spread between particles; None with one particle.
    * ``simulations``: total, completed, aborted (stopped early), failed.
    * ``frames_saved``, ``frames_saved_share``: by stopping early.
    * ``aborted_mass_bound``: see :func:`phase_ppl.analysis.weights.aborted_mass_bound`.
    * ``best_error_per_frame``: smallest mean error of a draw, units: the norm over x, y of all
      four entities.
    * ``verdict``: a sentence or two.

    R-hat and effective sample size of goal codes mean nothing and are not given.
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
        "distinct_hypotheses": _n_distinct([posterior[name].values for name in HYPOTHESIS]),
        "distinct_goal_pairs": len(np.unique(pair)),
        "effective_rows": float(1 / (row_weights**2).sum()),
        "weighted_draws_ess": (
            float(1 / (draw_weights.size * (draw_weights**2).sum())) if weighted else None
        ),
        "agreement": {name: _agreement(p, shares) for name, p in by_chain.items()},
        "between_chain_tv": {name: _between_chain_tv(p, shares) for name, p in by_chain.items()},
        "monte_carlo_error": {name: _monte_carlo_error(p, shares) for name, p in by_chain.items()},
        **_simulation_costs(tree, n_frames),
        "aborted_mass_bound": aborted_mass_bound(tree),
        "best_error_per_frame": float(stats["total_error"].min()) / n_frames,
    }
    result["verdict"] = verdict(result)
    return result


def _chain_marginals(codes: NDArray[Any], weights: FloatArray) -> FloatArray:
    """Return (chain, goal): each chain's share of its draws' weight per goal; 0 without weight."""
    mass = np.stack(
        [np.bincount(c, w, minlength=N_GOALS) for c, w in zip(codes, weights, strict=True)]
    )
    return mass / np.maximum(mass.sum(axis=1, keepdims=True), np.finfo(float).tiny)


def _agreement(by_chain: FloatArray, shares: FloatArray) -> float:
    leading = (shares @ by_chain).argmax()
    return float((by_chain.argmax(axis=1) == leading)[shares > 0].mean())


def _between_chain_tv(by_chain: FloatArray, shares: FloatArray) -> dict[str, float] | None:
    distances = [
        0.5 * float(np.abs(one - other).sum())
        for one, other in itertools.combinations(by_chain[shares > 0], 2)
    ]
    if not distances:
        return None
    return {"mean": float(np.mean(distances)), "max": max(distances)}


def _monte_carlo_error(by_chain: FloatArray, shares: FloatArray) -> float | None:
    """Return the error of a ratio of sums over particles; with equal shares sd / sqrt(M)."""
    n = len(by_chain)
    if n < 2:
        return None
    overall = shares @ by_chain
    deviation = by_chain[:, overall.argmax()] - overall.max()
    return float(np.sqrt(n / (n - 1) * ((shares * deviation) ** 2).sum()))


def _n_distinct(columns: list[NDArray[Any]]) -> int:
    return len(set(zip(*(column.reshape(-1).tolist() for column in columns), strict=True)))


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


def verdict(found: dict[str, Any]) -> str:
    """Return in a few sentences whether the posterior with these diagnostics can be trusted."""
    if found["weighted_draws_ess"] is None:
        sentences = [_agreement_in_words(found), *_acceptance_in_words(found["acceptance_rate"])]
    else:
        sentences = [_weighted_in_words(found)]
    if found["weights"] == "visited":
        sentences.append(
            "The weights 'visited' are an approximation; simulations stopped early hide at most "
            f"{found['aborted_mass_bound']:.1%} of their mass."
        )
    elif found["weights"] == "likelihood":
        sentences.append("The weights 'likelihood' make every probability too extreme.")
    if found["validity"] == "approximate":
        sentences.append(
            f"The kernel {found['kernel']} is approximate: its probabilities are biased however "
            "long it runs."
        )
    simulations = found["simulations"]
    if simulations["failed"]:
        sentences.append(f"{simulations['failed']} of {simulations['total']} simulations failed.")
    return " ".join(sentences)


def _acceptance_in_words(rate: float) -> list[str]:
    if rate == 0:
        return ["No proposal was accepted: this is still the bottom-up guess, not a posterior."]
    if rate < STUCK:
        return [
            f"Only {rate:.0%} of the proposals were accepted: the particles have hardly left "
            "the bottom-up guess."
        ]
    return []


def _weighted_in_words(found: dict[str, Any]) -> str:
    ess, draws = found["weighted_draws_ess"], found["particles"] * found["iterations"]
    text = f"The {draws} weighted draws are worth {ess * draws:.1f} equal ones"
    if found["particles"] > 1:
        error = max(found["monte_carlo_error"].values())
        text += f" (Monte-Carlo error of a leading goal's probability: {error:.2f})"
    return f"{text}: so few decide that another run may well differ." if ess < FEW else f"{text}."


def _agreement_in_words(found: dict[str, Any]) -> str:
    particles = found["particles"]
    if particles == 1:
        return "With one particle nothing shows whether another would agree: use more."
    error = max(found["monte_carlo_error"].values())
    margin = f" (Monte-Carlo error of a leading goal's probability: {error:.2f})"
    agreed = [share >= AGREED for share in found["agreement"].values()]
    if all(agreed):
        return (
            f"The {particles} particles agree on both agents' goals{margin}: "
            "nothing speaks against the leading goals."
        )
    if any(agreed):
        yes, no = (AGENTS[0], AGENTS[1]) if agreed[0] else (AGENTS[1], AGENTS[0])
        on_what = f"agree on the {yes}'s goal but not on the {no}'s"
    else:
        on_what = "agree on neither agent's goal"
    return (
        f"The {particles} particles {on_what}{margin}: more iterations would tell real "
        "uncertainty from chains that have not mixed."
    )
