"""Simulation-based calibration (Talts et al. 2018): are posteriors as sure as they should be?

    python benchmarks/calibration.py [--kernel NAME] [--events N] [--json FILE] [--figure FILE]
    python benchmarks/calibration.py --closed-loop [--weight W] [--frames N] [--out FOLDER]
                                     [--weights W W ...]
    python benchmarks/calibration.py --simple [--frames N] [--out FOLDER]

``ppl.calibrate`` with a kernel on the tests' fast simulator, whose agents walk to their goals, and
informative noise. Kernels with weighted draws are refused. Or with the closed loop or a kernel, by
default SIMPLE's, on videos of the joint simulator in random scenes. ``--out`` continues what is in
the folder; with it ``--weights`` weighs the same readings anew, by what a frame counts.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import common
import numpy as np
import pandas as pd

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.evaluation.table import true_answers
from phase_ppl.inference.registry import kernel_info
from tests.inference.toy import walkers, walking_event

BETA = 1.0
"""1 / units: informative noise, some 8 units per frame over all entities."""

ARENA = (-84.0, 116.0, -88.0, 112.0)
"""Noise knows no border: the arena is large enough for it."""

PARTICLES = 15
"""Ranks go from 0 to this."""


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--kernel", default="local_mh", choices=ranked_kernels())
    parser.add_argument("--rule", help="rule of local_mh: exact or paper")
    parser.add_argument("--closed-loop", action="store_true")
    parser.add_argument("--simple", action="store_true")
    parser.add_argument("--weight", type=float, help="what a frame counts in the closed loop")
    parser.add_argument("--weights", type=float, nargs="+", default=[])
    parser.add_argument("--frames", type=int, help="by default 31, of the fast simulator 12")
    parser.add_argument("--events", type=int, default=200)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--out", metavar="FOLDER")
    parser.add_argument("--figure", metavar="FILE")
    options = parser.parse_args()
    how: dict[str, Any] = {"out": options.out, "resume": options.out is not None}
    if options.closed_loop:
        likelihood = ppl.ClosedLoopLikelihood(weight=options.weight)
        model = ppl.Model(likelihood=likelihood)
        found = ppl.calibrate(model, options.events, frames=options.frames or 31, **how)
    elif options.simple:
        how["kernel"] = options.kernel
        found = ppl.calibrate(ppl.Model(), options.events, frames=options.frames or 31, **how)
    else:
        model = ppl.Model(simulator=walkers, likelihood=ppl.RadialLikelihood(BETA))
        rule = {} if options.rule is None else {"rule": options.rule}
        found = ppl.calibrate(
            model,
            options.events,
            frames=options.frames or 12,
            scenes=dataclasses.replace(walking_event().scene, arena=ARENA),
            kernel=options.kernel,
            chains=PARTICLES,
            iterations=options.iterations,
            weights="count",
            **rule,
            **how,
        )
    print(found)
    if options.weights and options.closed_loop and options.out:
        print(reweighed(Path(options.out), options.weights).round(3).to_string())
    ranks = {name: part.tolist() for name, part in found.table.groupby("quantity")["rank"]}
    report = {"settings": vars(options), "ranks": ranks, "notes": found.notes}
    common.write({**report, "summary": found.summary.to_dict("index")}, options.json)
    if options.figure:
        found.plot(options.figure)


def reweighed(out: Path, weights: list[float]) -> pd.DataFrame:
    """Return how often the top answer is right, its probability and the log score, by weight."""
    rows = []
    for event in ppl.load_events(out / "events.json"):
        (folder,) = (out / "events").glob(f"*-{event.id}")
        post = ppl.load_posterior(folder / "posterior.nc")
        assert isinstance(post, ClosedLoopPosterior)
        answers = true_answers(event)
        for weight in weights:
            anew = ClosedLoopPosterior(post.dataset.assign_attrs(weight=weight), prior=post.prior)
            for question, truth in answers.items():
                p = anew.marginal(question).to_series()
                kind = question.split("_")[0]
                rows.append((weight, kind, p.idxmax() == truth, p.max(), np.log(p[truth])))
    table = pd.DataFrame(rows, columns=["weight", "kind", "right", "confidence", "log score"])
    return table.groupby(["weight", "kind"]).mean()


def ranked_kernels() -> list[str]:
    """Return the kernels whose draws all count alike."""
    found = {name: kernel_info(name) for name in ppl.available_kernels()}
    return [name for name, info in found.items() if info.keeps == "all" and not info.weighted]


if __name__ == "__main__":
    main()
