"""What do settings of the closed loop cost, and what do they lose?

    python benchmarks/realtime.py [EVENTS] [--frames N] [--json FILE]

Each row changes one setting of ``ppl.Model()``, the last ones all of them. Events are the bundled
ones or those of a file. Figures are means over events: CPU seconds per frame without each event's
first ten frames, in which code is compiled or loaded; the probability of the true goals and
relation after the last frame, and the share of them that lead.
"""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import common
import numpy as np
from tqdm import tqdm

import phase_ppl as ppl

FIRST = 10  # frames that are not timed


def settings() -> dict[str, ppl.Model]:
    """Return the rows of the table."""

    def model(sets: int = 4, tracking: ppl.Tracking | None = None, **planner: Any) -> ppl.Model:
        likelihood = ppl.ClosedLoopLikelihood(
            planner_seeds=sets, tracking=tracking or ppl.Tracking()
        )
        fast = dataclasses.replace(ppl.PlannerConfig.named("fast"), **planner)
        return ppl.Model(likelihood=likelihood, planner=fast)

    one = ppl.Tracking(strengths=(450.0,))
    return {
        "as they are: `planner_seeds=4`": model(),
        "`planner_seeds=1`": model(1),
        "`simulations=30`": model(simulations=30),
        "`particles=10`": model(particles=10),
        "`strengths=(450,)`": model(tracking=one),
        "`states=8`": model(tracking=ppl.Tracking(states=8)),
        "`ppl.Model.realtime()`": ppl.Model.realtime(),
    }


def measure(event: ppl.Event, model: ppl.Model, frames: int) -> dict[str, float]:
    """Return cost and accuracy of one event."""
    truth = {"goal_red": event.truth.goal_red, "goal_green": event.truth.goal_green,
             "relation": event.truth.relation}  # fmt: skip
    spent: list[float] = []
    with ppl.watch(event.scene, model, threads=1) as watch:
        for frame in event.observation.trajectory[:frames]:
            began = time.process_time()
            watch.take(frame)
            spent.append(time.process_time() - began)
        post = watch.posterior()
    masses = [post.marginal(name).to_series() for name in truth]
    given = [mass[label] for mass, label in zip(masses, truth.values(), strict=True)]
    leads = [mass.idxmax() == label for mass, label in zip(masses, truth.values(), strict=True)]
    return {
        "seconds": float(np.mean(spent[FIRST:])),
        "probability": float(np.mean(given)),
        "right": float(np.mean(leads)),
    }


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("events", nargs="?", help="file of events of PHASE")
    parser.add_argument("--frames", type=int, default=1000)
    options = parser.parse_args()
    bundled = [ppl.load_event(name) for name in ppl.bundled_events()]
    events = ppl.load_events(options.events) if options.events else bundled
    table: dict[str, dict[str, Any]] = {}
    for name, model in tqdm(settings().items(), "settings"):
        rows = [measure(event, model, options.frames) for event in events]
        table[name] = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    print("| setting | CPU s a frame | probability of the truth | right |\n|---|---|---|---|")
    for name, row in table.items():
        cells = f"{row['seconds']:.3f} | {row['probability']:.2f} | {row['right']:.0%}"
        print(f"| {name} | {cells} |")
    if options.json:
        Path(options.json).write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
