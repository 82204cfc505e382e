"""Kernels side by side on equal budgets: a table, a curve, a file."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phase_ppl.analysis.estimate import shares, total_variation
from phase_ppl.analysis.event_posterior import EventPosterior
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.quantities import Vocabulary
from phase_ppl.analysis.tree import SIMULATED, array, space_of_tree
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.analysis.with_arviz import ess
from phase_ppl.data.documents import check_schema, read_document
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, check_name
from phase_ppl.world.event import Truth
from phase_ppl.world.files import existing_file, write_json
from phase_ppl.world.goals import goal_index
from phase_ppl.world.hypothesis import RELATIONS, Hypothesis
from phase_ppl.world.picture import Printed, plain
from phase_ppl.world.space import space_of

SCHEMA: Final = "phase-ppl-comparison-1"

MEASURES: Final[Mapping[str, str]] = {
    "tv_goals": "TV goals",
    "tv_relation": "TV relation",
    "p_pair": "P(pair)",
    "p_goals": "P(goals)",
    "p_relation": "P(relation)",
    "map_goals": "goals right",
    "map_relation": "relation right",
    "draws": "draws",
    "acceptance": "acceptance",
    "moves": "moves",
    "distinct": "distinct",
    "r_hat": "R-hat",
    "ess_per_simulation": "ESS per simulation",
    "ess_per_second": "ESS a second",
    "simulations": "simulations",
    "frames": "frames",
    "seconds": "seconds",
}
"""Measure -> heading. See :func:`~phase_ppl.analysis.comparison.accuracy` and
:func:`~phase_ppl.analysis.comparison.efficiency`."""

RUN_COLUMNS: Final = ("kernel", "repeat", "seed", "validity", *MEASURES)
CURVE_COLUMNS: Final = ("kernel", "repeat", *list(MEASURES)[:7], "simulations", "frames")

DISTANCES: Final = ("tv_goals", "tv_relation")
"""Measures that are distances from the reference; they share its uncertainty."""

_PRINTED_COLUMNS: Final = 7


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison(Printed):
    """Results of several kernels on one event, with an equal budget for each and repeats.

    Attributes:
        runs: a row per kernel and repeat: ``kernel`` (its label), ``repeat``, ``seed`` (with it
            ``infer`` gives this run), ``validity`` (of the kernel, see
            :func:`phase_ppl.register_kernel`), and the measures of
            :data:`~phase_ppl.analysis.comparison.MEASURES`; NaN: the run has no such measure.
        curve: accuracy of each run by number of simulations: ``kernel``, ``repeat``,
            ``simulations``, ``frames``, and the measures of
            :func:`~phase_ppl.analysis.comparison.accuracy`.
        settings: all that determines the result: event, model, kernels with their options, budget,
            chains, seed, and ``reference``, the posterior that kernels are compared with. Keys of
            ``reference``: ``description``, ``marginals``, ``error`` (distances between its halves)
            and ``truth`` (probabilities of the true answers).
    """

    runs: pd.DataFrame
    curve: pd.DataFrame
    settings: Mapping[str, Any]

    @property
    def kernels(self) -> list[str]:
        """Labels of the kernels, in the given order."""
        return [name for name in self.settings["kernels"] if (self.runs["kernel"] == name).any()]

    @property
    def table(self) -> pd.DataFrame:
        """A row per kernel: mean and standard error of each measure over repeats.

        Columns are (measure, "mean") and (measure, "se"), and ("runs", "n"), the number of repeats.
        With one repeat the standard error is NaN.
        """
        grouped = self.runs.groupby("kernel", sort=False)
        table = grouped[list(MEASURES)].agg(["mean", "sem"]).rename(columns={"sem": "se"})
        table.insert(0, ("runs", "n"), grouped.size())
        return table.loc[self.kernels]

    def reference_error(self, measure: str = "tv_goals") -> float | None:
        """Return the distance between two halves of the reference posterior; None: unknown.

        The reference's error is smaller than this distance in some nine of ten cases.

        Args:
            measure: the distance, "tv_goals" or "tv_relation": total variation of the marginals.

        Raises:
            UnknownNameError: ``measure`` is neither.
        """
        check_name("distance", measure, DISTANCES)
        value = (self.settings["reference"].get("error") or {}).get(measure)
        return None if value is None else float(value)

    def ranks(self, measure: str = "tv_goals") -> pd.DataFrame:
        """Return the kernels' ranks by distance from the reference posterior, with uncertainty.

        Two kernels are told apart if their mean distances differ by more than a margin: the
        distance between the reference's halves plus two standard errors of the difference over
        repeats. With a single repeat, or without halves, no two kernels are told apart.

        Args:
            measure: the distance, "tv_goals" or "tv_relation": total variation of the marginals.

        Returns:
            A row per kernel, the nearest first: ``mean``, its mean distance; ``best`` and
            ``worst``, its possible ranks, from 1 to the number of kernels.

        Raises:
            UnknownNameError: ``measure`` is neither.
        """
        error, table = self.reference_error(measure), self.table
        mean, spread = table[measure].to_numpy(float).T
        margin = (np.nan if error is None else error) + 2 * np.hypot(spread[:, None], spread)
        nearer = mean[:, None] + margin < mean  # not a number: no
        best = 1 + nearer.sum(axis=0)
        worst = len(mean) - nearer.sum(axis=1)
        found = pd.DataFrame({"mean": mean, "best": best, "worst": worst}, index=table.index)
        return found.sort_values("mean", kind="stable")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write everything to ``path`` as JSON, whole or not at all.

        Raises:
            OutputError: the file cannot be written there, or its name does not end in .json.
        """
        tables = {"runs": self.runs.to_dict("list"), "curve": self.curve.to_dict("list")}
        write_json(path, plain({"schema": SCHEMA, "settings": self.settings, **tables}))
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Comparison:
        """Read a comparison that :meth:`save` wrote, or a checkpoint of one.

        Raises:
            InvalidEventError: there is no such file, or it is damaged or of another kind.
        """
        source = existing_file(path)
        try:
            record = read_document(source)
            check_schema(record, SCHEMA)
            runs = _frame(record["runs"], RUN_COLUMNS)
            curve = _frame(record["curve"], CURVE_COLUMNS)
            settings = dict(record["settings"])
            if unknown := set(runs["kernel"]) - set(settings["kernels"]):
                raise ValueError(f"its settings do not name the kernels {sorted(unknown)}")
        except (InvalidEventError, ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise InvalidEventError(f"{source} is no comparison: {reason}") from None
        return cls(runs, curve, settings)

    def __str__(self) -> str:
        table, settings = self.table, self.settings
        unit = settings["budget"].rpartition(" ")[2]
        others = " and ".join(o for o in ("simulations", "frames", "seconds") if o != unit)
        lengths = {name: settings["kernels"][name].get("iterations") for name in self.kernels}
        own = " and ".join(  # as presets have
            f"{name}, which has {length} iterations" for name, length in lengths.items() if length
        )
        words = (
            f"{settings['event']}: budget {settings['budget']}, {settings['chains']} chains; "
            "mean ± standard error\n"
            f"each run spends the budget of {unit} and ends its last iteration; {others} differ"
            f"{own and f'{chr(10)}other lengths: {own}'}\n"
            f"reference: {settings['reference']['description']}\n{self._error_in_words()}"
        )
        columns = {
            heading: [_cell(*row) for row in table[name].to_numpy(float)]
            for name, heading in MEASURES.items()
            if np.isfinite(table[name, "mean"].to_numpy(float)).any()
        }
        proposals = settings["proposals"]
        if any(proposals.values()):
            columns = {"proposals": [proposals.get(k) or "-" for k in table.index], **columns}
        cells = pd.DataFrame(columns, index=list(table.index))
        starts = range(0, len(columns), _PRINTED_COLUMNS)
        blocks = [words, *(cells.iloc[:, i : i + _PRINTED_COLUMNS].to_string() for i in starts)]
        known = [name for name in DISTANCES if self.runs[name].notna().any()]
        if len(table) > 1 and known:  # a single kernel has no rank
            blocks.append("\n".join(f"rank by {MEASURES[n]}: {self._ranking(n)}" for n in known))
        return "\n\n".join(blocks)

    def _error_in_words(self) -> str:
        if self.settings["reference"].get("marginals") is None:
            return "so there are no distances, and no ranks"
        errors = {name: self.reference_error(name) for name in DISTANCES}
        if set(errors.values()) == {0.0}:
            return "which is exact"
        known = [f"{MEASURES[n]} {e:.2f}" for n, e in errors.items() if e is not None and e == e]
        if not known:
            return "the distance between its halves is not known, so kernels are not ranked"
        return (
            f"distance between its halves: {', '.join(known)}\n"
            "kernels share a rank unless they differ by more than this plus two standard errors"
        )

    def _ranking(self, measure: str) -> str:
        ranks = self.ranks(measure)
        if (ranks["best"] == 1).all() and (ranks["worst"] == len(ranks)).all():
            by = "this reference" if (self.table["runs", "n"] > 1).all() else "a single run"
            return f"not told apart by {by}: {', '.join(ranks.index)}"
        parts = ranks.groupby(["best", "worst"], sort=False).groups.items()
        return "; ".join(
            f"{best}{'' if best == worst else f' to {worst}'}: {', '.join(names)}"
            for (best, worst), names in parts
        )

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self.kernels)}: {len(self.runs)} runs>"


def _frame(columns: Mapping[str, Any], expected: tuple[str, ...]) -> pd.DataFrame:
    if missing := [name for name in expected if name not in columns]:
        raise ValueError(f"it lacks {missing}")
    frame = pd.DataFrame(columns)[list(expected)]
    numbers = [name for name in expected if name not in ("kernel", "validity")]
    return frame.astype({n: int if n in ("repeat", "seed") else float for n in numbers})


def _cell(mean: float, error: float) -> str:
    if not np.isfinite(mean):
        return "-"
    digits = 3 if abs(mean) < 10 else 0
    return f"{mean:.{digits}f}" + (f" ±{error:.{digits}f}" if np.isfinite(error) else "")


# --- measures -------------------------------------------------------------------------------------

CURVE_POINTS: Final = 40  # most prefixes of a run that are evaluated
Marginals = Mapping[str, FloatArray]  # goals and relations -> probabilities of their labels


def marginals(post: EventPosterior) -> dict[str, FloatArray]:
    """Return the marginals of all goals and relations."""
    return {name: np.asarray(post.marginal(name).values, float) for name in marginals_of(post)}


def marginals_of(post: EventPosterior) -> tuple[str, ...]:
    """Return the names of all goals and relations."""
    return (*post.goals_of.values(), *post.relations_of.values())


def _means(measure: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the means of a measure over goals and over relations; NaN where there are none."""
    goals = [value for name, value in values.items() if name.startswith("goal_")]
    relations = [value for name, value in values.items() if not name.startswith("goal_")]
    relation = float(np.mean(relations)) if relations else np.nan
    return {f"{measure}_goals": float(np.mean(goals)), f"{measure}_relation": relation}


def distances(found: Marginals, reference: Marginals | None) -> dict[str, float]:
    """Return ``tv_goals`` and ``tv_relation`` of marginals; see :func:`accuracy`."""
    if reference is None:
        return dict.fromkeys(DISTANCES, np.nan)
    return _means("tv", {n: total_variation(p, reference[n]) for n, p in found.items()})


def accuracy(
    post: Posterior, reference: Marginals | None, truth: Truth | Hypothesis | None
) -> dict[str, float]:
    """Return measures of a posterior against a reference and the truth; NaN without these.

    Keys:

    * ``tv_goals``: total variation between a goal's marginal and the reference's, mean over
      agents; ``tv_relation``: total variation between a relation's marginals, mean over pairs.
    * ``p_pair``: joint probability of all agents' true effective goals; ``p_goals``: probability
      of an agent's true goal, mean over agents; ``p_relation``: of a true relation, over pairs.
    * ``map_goals``: share of agents whose most probable goal is the true one; ``map_relation``:
      share of pairs whose most probable relation is the true one.
    """
    found, pair = marginals(post), np.nan
    if truth is not None:
        goals, codes = post.world.goals, _true_codes(truth).items()
        true = {name: goals[code] for name, code in codes if name.startswith("goal_")}
        pair = float(post.probability(**true))
    return distances(found, reference) | {"p_pair": pair} | of_truth(found, truth)


def _true_codes(truth: Truth | Hypothesis) -> dict[str, int]:
    """Return the labels of goals and relations, as codes."""
    if isinstance(truth, Hypothesis):
        space, goals = space_of(truth.world), np.array(truth.effective_goals)
        relations = {name: int(code) for name, code in space.relation_codes(goals).items()}
        return dict(zip(space.goal_sites, goals.tolist(), strict=True)) | relations
    relation = RELATIONS.index(truth.relation)
    red, green = goal_index(truth.goal_red), goal_index(truth.goal_green)
    return {"goal_red": red, "goal_green": green, "relation": relation}


def of_truth(found: Marginals, truth: Truth | Hypothesis | None) -> dict[str, float]:
    """Return the measures of marginals against the truth, as :func:`accuracy`; NaN without it."""
    if truth is None:
        return dict.fromkeys(("p_goals", "p_relation", "map_goals", "map_relation"), np.nan)
    codes = _true_codes(truth)
    p = {name: float(found[name][code]) for name, code in codes.items()}
    best = {name: float(found[name].argmax() == code) for name, code in codes.items()}
    return _means("p", p) | _means("map", best)


def efficiency(post: Posterior) -> dict[str, float]:
    """Return measures of the chains' mixing and cost; NaN: unknown.

    Keys:

    * ``draws``: number of rows that answers rest on, such as the last population of ``smc``.
    * ``acceptance``, ``moves``: share of proposals accepted, and of iterations in which
      effective goals changed.
    * ``distinct``: number of different hypotheses among the draws.
    * ``r_hat``: the worst R-hat of the log joint, strengths, goals and relations.
    * ``ess_per_simulation``: effective sample size of the log joint
      (:func:`phase_ppl.analysis.diagnostics.ess`), per simulation; of weighted draws, 1 / the
      sum of their squared weights. ``ess_per_second``: this size divided by ``seconds``.
    * ``simulations``: their number, with their ``frames``, and ``seconds`` of wall time. If
      proposals need a reading of the video before the first simulation, its time counts.
    """
    found, weight = post.diagnostics(), post.table.weights
    simulations, moves = int(post.cost["simulations"]), found["move_rate"]
    by_label = [one for labels in found["categories"].values() for one in labels.values()]
    r_hats = [one["r_hat"] for one in (*found["scalars"].values(), *by_label)]
    known = [value for value in r_hats if value is not None]
    if np.allclose(weight, weight[0]):
        size = ess(array(post.tree, "sample_stats", "log_joint").astype(float), "mean")
    else:
        size = float(found["effective_rows"])
    return {
        "draws": float(len(weight)),
        "acceptance": found["acceptance_rate"],
        "moves": np.nan if moves is None else moves,
        "distinct": float(found["distinct_hypotheses"]),
        "r_hat": max(known, default=np.nan),
        "ess_per_simulation": size / simulations,
        "ess_per_second": size / float(post.cost["seconds"]),
        "simulations": float(simulations),
        # nothing is simulated where a table is looked up
        "frames": float(array(post.tree, "simulations", "frames_simulated").sum()) or np.nan,
        "seconds": float(post.cost["seconds"]),
    }


def curve(
    post: Posterior, reference: Marginals | None, truth: Truth | Hypothesis | None
) -> pd.DataFrame:
    """Return :func:`accuracy` of a run by number of simulations.

    Each row uses the first draws of all chains, with the simulations made until then; nothing is
    simulated. Columns are ``simulations``, ``frames`` and those of :func:`accuracy`. There are at
    most :data:`CURVE_POINTS` rows, and one for a run that keeps its last population only.
    """
    tree = post.tree
    n_draws = tree["posterior"].sizes["draw"]
    iteration, frames = (
        array(tree, "simulations", name) for name in ("iteration", "frames_simulated")
    )
    # draws are those after the last iterations: a run can have more of these, or one fewer
    first = int(iteration.max(initial=0)) - n_draws + 1
    is_table = "trajectory" not in tree[SIMULATED]
    total = int(post.cost["simulations"])
    lengths = np.array([n_draws])
    if n_draws > 1 and (first in (0, 1) or is_table):
        lengths = np.unique(np.linspace(1, n_draws, CURVE_POINTS).round().astype(int))
    rows = []
    for length in lengths.tolist():
        done = (iteration < first + length) | (length == n_draws)
        # what is looked up in a table is not recorded one by one
        n = total * length / n_draws if is_table else float(done.sum())
        paid = {"simulations": n, "frames": float(frames[done].sum())}
        rows.append({**paid, **_of_first(post, length, done, reference, truth)})
    return pd.DataFrame(rows)


def _of_first(
    post: Posterior,
    length: int,
    done: NDArray[np.bool_],
    reference: Marginals | None,
    truth: Truth | Hypothesis | None,
) -> dict[str, float]:
    """Return :func:`accuracy` of the first draws, and of the simulations done until then."""
    n_draws = post.tree["posterior"].sizes["draw"]
    if length == n_draws:
        return accuracy(post, reference, truth)
    tree = post.tree.isel(draw=slice(int(post.burn_in * (length / n_draws)), length))
    if post.weights != "count":
        tree = tree.isel(simulation=np.flatnonzero(done))
    rows = WEIGHTINGS[post.weights](tree)  # a posterior of each would take long
    codes, weights = Vocabulary(space_of_tree(tree)).completed(rows.values), rows.weights
    found = {
        name: shares(codes[name], weights, len(post.quantities[name] or ()))
        for name in marginals_of(post)
    }
    pair = np.nan
    if truth is not None:
        wanted = _true_codes(truth)
        true = [codes[name] == wanted[name] for name in post.goals_of.values()]
        pair = float(weights[np.logical_and.reduce(true)].sum())
    return distances(found, reference) | {"p_pair": pair} | of_truth(found, truth)
