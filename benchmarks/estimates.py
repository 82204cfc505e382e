"""Do a posterior's stated errors hold, on simulators that nobody tuned on?

    python benchmarks/estimates.py [--only KERNEL ...] [--setting MxL ...] [--toy NAME ...]
        [--events N] [--runs N] [--json FILE]

The four toys (``toys.py``) have posteriors that can be summed. Every kernel is run N times on N
events of each, with M particles and L iterations. The table shows, by kernel and setting, over all
toys or by toy:

* ``enough``: share of runs with enough effective simulations. Figures of the other runs are in
  brackets.
* ``held``: how often the exact probability of a goal or relation (0.03 or more) lies within 1.96
  errors; the same for the exact mean strength (aim: 0.90 to 0.98).
* ``stated``: root mean square of the errors, over the root mean square distance from the exact
  value (aim: 0.8 to 1.5).
* ``TV``: mean total variation from the exact marginals of goals and relation.
* ``sure``: sure answers, and how many of them exceed 1/2 in the exact posterior. Then answers of
  decided runs, and how many of them are true of the event.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import Any

import common
import numpy as np
import toys
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.inference.draws import LONG, burn_in
from phase_ppl.inference.registry import kernel_info
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import Hypothesis

KERNELS = ("local_mh", "prior_mh", "single_site_mh", "gibbs", "importance", "smc", "amis")
SETTINGS = ("15x6", "15x40", "15x200", "100x49")
ASKED = ("goal_red", "goal_green", "relation")
LEAST = 0.03  # exact probability from which on an answer is looked at


def of_chains(tree: xr.DataTree, chains: slice) -> xr.DataTree:
    """Return what a run of only some of the chains would have left."""
    first, last = chains.start, chains.stop
    groups = {}
    for name, node in tree.children.items():
        dataset = node.to_dataset()
        if "chain" in dataset.dims:
            dataset = dataset.isel(chain=chains).assign_coords(chain=np.arange(last - first))
        if name == "simulations":
            chain = dataset["chain"].values
            dataset = dataset.isel(simulation=(first <= chain) & (chain < last))
            dataset["chain"] = dataset["chain"] - first
        groups[name] = dataset
    result = xr.DataTree.from_dict(groups)
    result.attrs = {**tree.attrs, "burn_in": burn_in(result["posterior"].sizes["draw"])}
    return result


def posteriors(
    toy: toys.Toy, event: ppl.Event, kernel: str, chains: int, iterations: int, runs: int
) -> Iterator[Posterior]:
    """Yield the posteriors of runs that differ by chance.

    Long chains that do not meet are run at once and divided; the rivals of short ones are theirs.
    """
    given: dict[str, Any] = {"kernel": kernel, "iterations": iterations, "workers": 1}
    given["progress"] = False
    if kernel in ("smc", "amis") or iterations < LONG:
        for seed in range(runs):
            yield ppl.infer(event, toy.model, chains=chains, seed=seed, **given)
        return
    tree = ppl.infer(event, toy.model, chains=chains * runs, seed=0, **given).tree
    for run in range(runs):
        part = of_chains(tree, slice(run * chains, (run + 1) * chains))
        if kernel_info(kernel).weighted:
            part.attrs["burn_in"] = 0
        yield Posterior(part)


def judged(
    post: Posterior, exact: Mapping[str, FloatArray], true: Hypothesis
) -> dict[str, list[Any]]:
    """Return distances, errors, and whether sure answers are right."""
    numbers, apart = [], []
    for name in ASKED:
        found = post.marginal(name)
        known = exact[name] > LEAST
        off = found.values - exact[name]
        numbers += list(zip(off[known], found["error"].values[known], strict=True))
        apart.append(0.5 * float(np.abs(off).sum()))
    strengths = []
    for agent, mean in zip(("red", "green"), exact["strength"], strict=True):
        answer = post.mean(f"strength_{agent}")
        strengths.append((float(answer) - mean, answer.error))
    red, green = true.effective_goals
    labels = post.quantities["goal_red"]
    assert labels is not None, "goals have labels"
    truth = {"goal_red": labels[red], "goal_green": labels[green], "relation": true.relation}
    sure, decided = [], []
    for name, one in post.leaders().items():
        asked = post.quantities[name]
        assert asked is not None, "it has labels"
        if one["sure"]:
            sure.append(bool(exact[name][asked.index(one["label"])] > 0.5))
            if post.diagnostics()["decided"]:
                decided.append(one["label"] == truth[name])
    return {"p": numbers, "strength": strengths, "tv": apart, "sure": sure, "decided": decided}


def summed(found: list[dict[str, list[Any]]]) -> dict[str, Any]:
    """Return the figures of many runs."""
    figures: dict[str, Any] = {"runs": len(found)}
    for kind in ("p", "strength"):
        rows = np.array([row for one in found for row in one[kind]], float).reshape(-1, 2)
        off, error = rows[~np.isnan(rows[:, 1])].T
        figures[f"{kind}_held"] = float((np.abs(off) <= 1.96 * error).mean()) if len(off) else None
        figures[f"{kind}_stated"] = (
            float(np.sqrt((error**2).mean() / (off**2).mean())) if (off**2).sum() else None
        )
    figures["tv"] = float(np.mean([one["tv"] for one in found])) if found else None
    for kind in ("sure", "decided"):
        right = [one for run in found for one in run[kind]]
        figures |= {kind: len(right), f"{kind}_right": sum(right)}
    return figures


def shown(name: str, enough: dict[str, Any], other: dict[str, Any]) -> str:
    def columns(of: dict[str, Any]) -> str:
        if not of["runs"]:
            return " " * 36
        names = ("p_held", "p_stated", "strength_held", "strength_stated", "tv")
        return " ".join(f"{math.nan if of[n] is None else of[n]:6.2f}" for n in names) + "  "

    share = enough["runs"] / (enough["runs"] + other["runs"])
    right = "  ".join(
        f"{enough[kind + '_right'] + other[kind + '_right']} of {enough[kind] + other[kind]}"
        for kind in ("sure", "decided")
    )
    return f"{name:34}{share:6.2f}  {columns(enough)}({columns(other).strip():>34})  {right}"


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--only", nargs="+", default=KERNELS, metavar="KERNEL")
    parser.add_argument("--setting", nargs="+", default=SETTINGS, metavar="MxL")
    names = [toy.name for toy in toys.TOYS]
    parser.add_argument("--toy", nargs="+", default=names, choices=names, metavar="NAME")
    parser.add_argument("--events", type=int, default=4)
    parser.add_argument("--runs", type=int, default=4)
    options = parser.parse_args()
    report: dict[str, Any] = {}
    print(f"{'':34}enough  p: held, stated; strength: held, stated; TV (not enough)  sure, decided")
    for kernel, setting in itertools.product(options.only, options.setting):
        chains, iterations = map(int, setting.split("x"))
        everything: dict[bool, list[Any]] = {True: [], False: []}
        for toy in (toy for toy in toys.TOYS if toy.name in options.toy):
            found: dict[bool, list[Any]] = {True: [], False: []}
            for seed in range(options.events):
                event, true = toy.event(seed)
                exact = toy.exact(event)
                for post in posteriors(toy, event, kernel, chains, iterations, options.runs):
                    found_out = post.diagnostics()
                    needed = found_out["effective_size_needed"] or math.inf
                    is_enough = found_out["effective_size"] >= needed
                    found[is_enough].append(judged(post, exact, true))
            for is_enough in found:
                everything[is_enough] += found[is_enough]
            both = summed(found[True]), summed(found[False])
            report[f"{kernel} {setting} {toy.name}"] = dict(
                zip(("enough", "not"), both, strict=True)
            )
            print(shown(f"  {kernel} {setting} {toy.name}", *both), flush=True)
        both = summed(everything[True]), summed(everything[False])
        report[f"{kernel} {setting}"] = dict(zip(("enough", "not"), both, strict=True))
        print(shown(f"{kernel} {setting}", *both), flush=True)
    common.write(report, options.json)


if __name__ == "__main__":
    main()
