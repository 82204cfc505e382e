"""Diagnostics of chains."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from phase_ppl.analysis import tree as trees
from phase_ppl.analysis.estimate import kish_size, total_variation
from phase_ppl.analysis.quantities import Vocabulary
from phase_ppl.analysis.verdict import ALONE, of_draws, of_tracks, verdict_lines
from phase_ppl.analysis.weights import Rows
from phase_ppl.analysis.with_arviz import MASS, ess, mcse, r_hat
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import PredicateKind
from phase_ppl.world.picture import Printed, plain, wrapped
from phase_ppl.world.space import HypothesisSpace


def diagnostics(
    tree: xr.DataTree,
    weights: str,
    rows: Rows,
    leaders: Mapping[str, dict[str, Any]],
    effective_size: float,
    needed: float,
    words: Vocabulary,
) -> dict[str, Any]:
    """Return the diagnostics of a tree of draws as plain data.

    Keys, beside ``weights``, ``kernel`` and ``validity``:

    * ``particles``, ``iterations``: chains M and draws L.
    * ``acceptance_by_iteration``, ``acceptance_rate``: share of particles that accepted.
    * ``move_rate``: share of iterations that changed a particle's pair of effective goals.
    * ``distinct_hypotheses``, ``distinct_goal_pairs``: among the draws.
    * ``effective_rows``: Kish's 1 / sum of squared weights, of the weighting in use.
    * ``weighted_draws_ess``: the same for draws that the kernel weighs, as a share of their number;
      None for others. The next three count the draws' weights.
    * ``agreement``: per goal, the share of particles whose own leading goal leads overall.
    * ``leading_goals``: per goal, how many particles each goal leads in, most first.
    * ``between_chain_tv``: per goal, mean and max over pairs of particles of the total
      variation between their marginals; None with one particle.
    * ``leaders``: :meth:`~phase_ppl.analysis.hypotheses.Hypotheses.leaders`, and the probability
      ``without_prior``: under a uniform prior over the simulated pairs of goals. A pair holds the
      goals of all agents. None: the file does not hold the prior of pairs.
    * ``untried_rivals``: number of rivals of the leading pair that were never simulated, though the
      prior allows them.
    * ``decided``: whether all leaders are sure, have more than ``ALONE`` without the prior, by
      ``effective_size_needed`` independent draws or more, and all rivals were tried.
    * ``monte_carlo_error``: per goal, the error of the leading goal's probability.
    * ``effective_size``: how many independent draws would be as sure of the goals;
      ``effective_size_needed``: how many an answer needs to be sure. None: no number is enough,
      since most goals were not simulated and suggested goals fit no better.
    * ``untried``: prior mass of the pairs of effective goals without a completed simulation.
    * ``scalars``: of the log joint, total error, strengths and real sites of the user's own,
      ``r_hat``, ``ess_bulk`` and ``ess_tail``.
    * ``categories``: for goals, relation and scenario, each category whose ``probability`` under
      the weighting or ``share`` of the draws exceeds 2 %, most probable first, with ``ess``,
      ``mcse`` (standard error of the share) and split ``r_hat`` of its indicator.
    * ``windows``: how many proposals came from a window (``proposals``) and from none
      (``without``); the windows' first frames (``starts``) and how often each occurs
      (``counts``); ``frames`` of a window, None: the run has no such setting.
    * ``simulations``: total, completed, aborted (stopped early), failed; ``simulations_of``: how
      many were at the ``start``, in ``iterations`` and of ``rivals``; ``first_failure``: which
      failed first, why and where, "": none, or an older file; ``frames_saved`` and
      ``frames_saved_share`` by stopping early.
    * ``best_error_per_frame``: smallest mean error of a draw, units: the norm over x, y of all
      entities.
    * ``n_frames``, ``overlapping_frames``, ``odd_pace``, ``unseen_frames``, ``sealed_agents``: see
      :func:`phase_ppl.analysis.verdict.of_tracks`.
    * ``trust``, ``answer``, ``checks``, ``next``, ``verdict``: see
      :func:`phase_ppl.analysis.verdict.judged`.

    Undefined values are None: errors and effective sizes of one particle; R-hat and ESS of fewer
    than four draws per chain, of weighted draws, and of constants (R-hat: constant within half a
    chain). They mean nothing for goal codes and are not given.
    """
    posterior, stats = tree["posterior"].dataset, tree["sample_stats"].dataset
    space, labels = words.space, words.space.world.goals
    accepted, log_weight = stats["accepted"].values.astype(float), trees.log_weight_of_draws(tree)
    n_chains, n_draws = accepted.shape
    n_frames = tree["observed_data"].sizes["time"]
    draw_weights = np.exp(log_weight - log_weight.max())
    draw_weights /= draw_weights.sum()
    weighted = trees.are_weighted(tree)
    goals = trees.effective_goals(tree, "posterior")
    by_goal = {
        name: _by_particle(goals[..., agent], draw_weights, labels)
        for agent, name in enumerate(space.goal_sites)
    }
    hypotheses = pd.DataFrame({name: posterior[name].values.ravel() for name in space.kept_columns})
    leaders, n_untried = (
        _without_prior(tree, rows, leaders, words),
        len(untried_rivals(tree, leaders)),
    )
    codes = {name: goals[..., agent] for agent, name in enumerate(space.goal_sites)}
    derived = words.relation_codes({name: one.ravel() for name, one in codes.items()})
    codes |= {name: one.reshape(accepted.shape) for name, one in derived.items()}

    def known(statistic: Callable[..., float], *given: Any) -> float | None:
        return None if weighted else statistic(*given)

    def category(name: str, code: int, probability: float, share: float) -> dict[str, Any]:
        indicator = (codes[name] == code).astype(float)
        return {
            "probability": probability,
            "share": share,
            "ess": known(ess, indicator, "mean"),
            "mcse": known(mcse, indicator),
            "r_hat": known(r_hat, indicator, "split"),
        }

    categories: dict[str, dict[str, Any]] = {}
    for name, drawn in codes.items():
        options = words.quantities[name].categories()
        mass = np.bincount(rows.values[name], rows.weights, len(options))
        share = np.bincount(drawn.ravel(), draw_weights.ravel(), len(options))
        order = [c for c in np.lexsort((-share, -mass)).tolist() if max(mass[c], share[c]) > MASS]
        categories[name] = {options[c]: category(name, c, mass[c], share[c]) for c in order}
    record = {
        "weights": weights,
        "kernel": str(tree.attrs["kernel"]),
        "validity": str(tree.attrs["validity"]),
        "particles": n_chains,
        "iterations": n_draws,
        "acceptance_by_iteration": accepted.mean(axis=0),
        "acceptance_rate": accepted.mean(),
        "move_rate": np.diff(goals, axis=1).any(axis=-1).mean() if n_draws > 1 else None,
        "distinct_hypotheses": len(hypotheses.drop_duplicates()),
        "distinct_goal_pairs": len(np.unique(goals.reshape(-1, space.n_agents), axis=0)),
        "effective_rows": kish_size(rows.weights),
        "weighted_draws_ess": kish_size(draw_weights) / draw_weights.size if weighted else None,
        **{
            key: {name: one[key] for name, one in by_goal.items()}
            for key in ("agreement", "leading_goals", "between_chain_tv")
        },
        "leaders": leaders,
        "untried_rivals": n_untried,
        "decided": effective_size >= needed
        and not n_untried
        and all(one["sure"] and (one["without_prior"] or 0) > ALONE for one in leaders.values()),
        "monte_carlo_error": {name: leaders[name]["error"] for name in space.goal_sites},
        "effective_size": effective_size,
        "effective_size_needed": needed if np.isfinite(needed) else None,
        "untried": trees.untried(tree),
        "scalars": {
            name: {
                "r_hat": known(r_hat, values),
                "ess_bulk": known(ess, values, "bulk"),
                "ess_tail": known(ess, values, "tail"),
            }
            for name, values in scalars(tree).items()
        },
        "categories": categories,
        "windows": _windows(stats["window"].values, tree.attrs["settings"], n_frames),
        **_simulation_costs(tree, n_frames),
        "best_error_per_frame": float(stats["total_error"].min()) / n_frames,
        **of_tracks(
            trees.array(tree, "observed_data", "trajectory"),
            trees.kept_scene(tree["constant_data"].dataset),
            json.loads(tree.attrs["settings"]).get("model", {}).get("simulator") == "joint",
        ),
    }
    result: dict[str, Any] = plain(record)
    return {**result, **of_draws(result)}


def _without_prior(
    tree: xr.DataTree, rows: Rows, leaders: Mapping[str, dict[str, Any]], words: Vocabulary
) -> dict[str, dict[str, Any]]:
    """Return the leaders with their probability under a uniform prior over pairs of goals."""
    goals = np.stack([rows.values[name] for name in words.space.goal_sites], axis=1)
    prior = trees.prior_of_goals(tree, goals.astype(np.int64))
    if prior is None:
        return {name: {**one, "without_prior": None} for name, one in leaders.items()}
    weights = np.divide(rows.weights, prior, out=np.zeros(len(prior)), where=prior > 0)
    found = {}
    for name, one in leaders.items():
        has_it = rows.values[name] == words.quantities[name].categories().index(one["label"])
        found[name] = {**one, "without_prior": weights[has_it].sum() / weights.sum()}
    return found


def untried_rivals(
    tree: xr.DataTree, leaders: Mapping[str, Mapping[str, Any]]
) -> NDArray[np.int64]:
    """Return (rival, agent) the rivals of the leading goals that were never simulated.

    A rival differs in the landmark of one agent's goal; entity and sign are the same. There are no
    rows if the file has no prior: possible goals are then unknown.
    """
    space = trees.space_of_tree(tree)
    tried = trees.effective_goals(tree, "simulations")[~trees.array(tree, "simulations", "failed")]
    goals = space.world.goals
    leading = tuple(goals.index(leaders[name]["label"]) for name in space.goal_sites)
    rivals = [
        (*leading[:agent], other, *leading[agent + 1 :])
        for agent, goal in enumerate(leading)
        for other in range(len(goals))
        if _elsewhere(other, goal, agent, space)
    ]
    pairs = np.array(rivals, np.int64).reshape(-1, space.n_agents)
    prior = trees.prior_of_goals(tree, pairs)
    if prior is None:
        return pairs[:0]
    done = set(map(tuple, tried.tolist()))
    return pairs[(prior > 0) & np.array([one not in done for one in rivals], np.bool_)]


def _elsewhere(goal: int, other: int, agent: int, space: HypothesisSpace) -> bool:
    """Whether two goals of an agent differ in the landmark alone."""
    if space.impossible[agent, [goal, other]].any():
        return False
    one, two = (goal_literal(code, agent, space.world) for code in (goal, other))
    return (
        one.predicate is PredicateKind.ON is two.predicate
        and (one.subject, one.positive) == (two.subject, two.positive)
        and one.target != two.target
    )


def scalars(tree: xr.DataTree) -> dict[str, FloatArray]:
    """Return the real quantities of the draws, (chain, draw), a user's own sites last."""
    posterior, stats = tree["posterior"].dataset, tree["sample_stats"].dataset
    users = [name for name in trees.users_sites(tree) if posterior[name].dtype.kind == "f"]
    names = (*trees.space_of_tree(tree).strength_sites, *users)
    found = {"log_joint": stats["log_joint"], "total_error": stats["total_error"]}
    found |= {name: posterior[name] for name in names}
    return {name: one.values.astype(float) for name, one in found.items()}


def _windows(window: NDArray[Any], settings: str, n_frames: int) -> dict[str, Any]:
    chosen = window[window >= 0].astype(np.int64)  # -1, or not a number: none
    starts, counts = np.unique(chosen, return_counts=True)
    length = (json.loads(settings).get("simple") or {}).get("window")
    return {
        "proposals": chosen.size,
        "without": window.size - chosen.size,
        "frames": None if length is None else min(int(length), n_frames - 1) + 1,
        "starts": starts,
        "counts": counts,
    }


def _by_particle(
    codes: NDArray[Any], weights: FloatArray, labels: tuple[str, ...]
) -> dict[str, Any]:
    """Return a goal's statistics over particles with weight, and how far they agree."""
    mass = np.stack([np.bincount(c, w, len(labels)) for c, w in zip(codes, weights, strict=True)])
    by_chain = mass / np.maximum(mass.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    shares = weights.sum(axis=1)
    overall = (shares @ by_chain).argmax()
    by_chain = by_chain[shares > 0]
    leading = by_chain.argmax(axis=1)
    particles = np.bincount(leading, minlength=len(labels))
    order = [code for code in np.argsort(-particles, kind="stable") if particles[code]]
    apart = [total_variation(*two) for two in itertools.combinations(by_chain, 2)]
    return {
        "agreement": (leading == overall).mean(),
        "leading_goals": {labels[code]: particles[code] for code in order},
        "between_chain_tv": {"mean": np.mean(apart), "max": max(apart)} if apart else None,
    }


def _simulation_costs(tree: xr.DataTree, n_frames: int) -> dict[str, Any]:
    simulations, completed = tree["simulations"].dataset, trees.completed(tree)
    failed = simulations["failed"].values.astype(bool)
    aborted = ~completed & ~failed
    saved = (n_frames - simulations["frames_simulated"].values[aborted]).sum()
    wanted = n_frames * (~failed).sum()
    counts = {"completed": completed, "aborted": aborted, "failed": failed}
    iteration = simulations["iteration"].values
    rivals = iteration >= tree.attrs.get("rivals_from", np.inf)
    parts = {"start": iteration == 0, "iterations": (iteration > 0) & ~rivals, "rivals": rivals}
    return {
        "simulations": {"total": len(failed), **{k: one.sum() for k, one in counts.items()}},
        "simulations_of": {k: one.sum() for k, one in parts.items()},
        "first_failure": simulations.attrs.get(trees.FIRST_FAILURE, ""),
        "frames_saved": saved,
        "frames_saved_share": saved / wanted if wanted else 0.0,
    }


# --- as a table -----------------------------------------------------------------------------------

_SCALARS: Final = {"r_hat": "R-hat", "ess_bulk": "bulk ESS", "ess_tail": "tail ESS"}
_CATEGORIES: Final = {
    **{"probability": "P", "share": "share", "mcse": "MCSE"},
    **{"ess": "ESS", "r_hat": "R-hat"},
}
"""Columns of the tables -> their headings."""

_CALLED: Final = {"total_error": "total_error (summed distance)"}
_OF_WHAT: Final = (
    "P is by the weights; share, with its MCSE, ESS and R-hat, is of the unweighted draws"
)

_BLOCKS: Final = 10  # most stretches of iterations whose acceptance is printed


class Diagnostics(Printed, dict[str, Any]):
    """Diagnostics of chains; ``print`` shows a table of at most 88 columns with the verdict."""

    def __init__(self, event_id: str, found: Mapping[str, Any]) -> None:
        super().__init__(found)
        self._event_id = event_id

    def __str__(self) -> str:
        rates, counts = self["acceptance_by_iteration"], self["simulations"]
        blocks = np.array_split(np.array(rates), min(len(rates), _BLOCKS))
        few = len(rates) <= _BLOCKS
        by = "by iteration" if few else f"by tenth of the {len(rates)} iterations"
        texts = {
            "diagnostics": f"{self._event_id}: {self['particles']} particles x "
            f"{self['iterations']} iterations, {self['kernel']}"
            + (f" ({self['validity']})" if self["validity"] != "exact" else "")
            + f", weights {self['weights']}",
            "": "",
            "accepted": f"{self['acceptance_rate']:.0%} of the proposals; {by}, in percent: "
            + " ".join(f"{100 * part.mean():.0f}" for part in blocks),
            "moved": (
                ""
                if self["move_rate"] is None
                else f"to another pair of goals in {self['move_rate']:.0%} of the particles' "
                "iterations; "
            )
            + f"{self['distinct_hypotheses']} distinct hypotheses, "
            f"{self['distinct_goal_pairs']} pairs of goals",
            "windows": _of_windows(self["windows"]),
            "simulations": f"{counts['total']}{simulations_of(self)}: {counts['completed']} "
            f"completed, {counts['aborted']} stopped early as too far off (saved "
            f"{self['frames_saved_share']:.0%} of the frames; as rivals they count as tried), "
            f"{counts['failed']} failed; the best draw is off by "
            f"{self['best_error_per_frame']:.2f} units a frame",
        }
        lines = [line for label, text in texts.items() for line in wrapped(label, text) or [""]]
        scalars = {_CALLED.get(name, name): one for name, one in self["scalars"].items()}
        lines += ["", _table(scalars, _SCALARS), ""]
        by_label = {
            (name, label): entry
            for name, labels in self["categories"].items()
            for label, entry in labels.items()
        }
        lines += [_table(by_label, _CATEGORIES), _OF_WHAT, ""]
        for name, apart in self["between_chain_tv"].items():
            if apart is not None:
                lines += wrapped(
                    name,
                    f"the same goal leads in {self['agreement'][name]:.0%} of the particles; total "
                    f"variation between two particles: mean {apart['mean']:.2f}, largest "
                    f"{apart['max']:.2f}",
                )
        return "\n".join([*lines, "", *verdict_lines(self)])


def _table(rows: Mapping[Any, Mapping[str, float | None]], columns: Mapping[str, str]) -> str:
    """Return rows as a table; "-": not known."""
    found = pd.DataFrame.from_dict(rows, orient="index")[list(columns)].astype(float)
    for name in columns:
        form = "{:.0f}" if name.startswith("ess") else "{:.2f}"
        found[name] = [form.format(x) if np.isfinite(x) else "-" for x in found[name]]
    return found.rename(columns=columns).to_string()


def simulations_of(found: Mapping[str, Any]) -> str:
    """Return in brackets what the simulations were made for; "": all for the same."""
    words = {"start": "at the start", "iterations": "in iterations", "rivals": "of rivals"}
    told = [f"{n} {words[what]}" for what, n in found["simulations_of"].items() if n]
    return f" ({', '.join(told)})" if len(told) > 1 else ""


def _of_windows(windows: Mapping[str, Any]) -> str:
    if not windows["proposals"]:
        return "no proposal came from a window"
    starts = np.repeat(windows["starts"], windows["counts"])
    low, high = np.quantile(starts, (0.25, 0.75)).round().astype(int)
    text = f"{windows['proposals']} proposals from {len(windows['starts'])} windows"
    if windows["frames"] is not None:
        text += f" of {windows['frames']} frames"
    text += f"; the middle half of their windows begin in frames {low} to {high}"
    return f"{text}; {windows['without']} from none" if windows["without"] else text
