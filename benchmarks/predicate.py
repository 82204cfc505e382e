"""How accurate is predicate inverse planning on the real videos, by its settings?

    python benchmarks/predicate.py [--prior NAME] [--limit N] [--workers N] [--json FILE]

Thresholds are those of SIMPLE's planner times a factor: one factor for ON and for TOUCH of items,
one for TOUCH of agents. The other settings are the frames that a predicate must last, and the
rationality per unit of way. The first half of the videos chooses the highest log score; the second
half confirms it.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Sequence
from typing import Any

import common
import numpy as np

import phase_ppl as ppl
from phase_ppl.agents.symbols import NEAR_AGENT_ON, NEAR_ITEM_ON, NEAR_TOUCH
from phase_ppl.evaluation.models.predicate import PredicateInversePlanning, predicate
from phase_ppl.world.event import Event
from phase_ppl.world.geometry import GRAB_REACH

FACTORS = (1.0, 2.0, 3.0, 4.0)
TOUCH_FACTORS = (1.0, 2.0)
LASTING = (1, 3)
RATIONALITY = (0.2, 0.4, 0.8, 1.6)
KINDS = ("goal", "relation")
QUOTED = tuple(f"{kind}_accuracy" for kind in KINDS)

Setting = dict[str, float]


def settings() -> list[Setting]:
    names = ("factor", "touch", "lasting", "rationality")
    return [
        dict(zip(names, values, strict=True))
        for values in itertools.product(FACTORS, TOUCH_FACTORS, LASTING, RATIONALITY)
    ]


def model(setting: Setting, prior: str) -> PredicateInversePlanning:
    factor = setting["factor"]
    return predicate(  # type: ignore[return-value]
        prior=prior,
        rationality=setting["rationality"],
        lasting=int(setting["lasting"]),
        on_agent=factor * NEAR_AGENT_ON,
        on_item=factor * NEAR_ITEM_ON,
        touch_item=factor * GRAB_REACH,
        touch_agent=setting["touch"] * NEAR_TOUCH,
    )


def answers(task: tuple[Event, str, list[Setting]]) -> dict[str, Any]:
    """Return a video's predictions under some settings, and the CPU seconds of one."""
    event, prior, chosen = task
    models = [model(setting, prior) for setting in chosen]
    clock = time.process_time()
    found = [ask(event.scene, event.observation, 0) for ask in models]
    seconds = (time.process_time() - clock) / len(models)
    return {
        "predictions": [dataclasses.replace(one, event_id=event.id) for one in found],
        "cpu_seconds": seconds,
    }


def figures(
    events: Sequence[Event], prior: str, chosen: list[Setting], workers: int | None
) -> tuple[list[dict[str, Any]], list[float]]:
    """Return the metrics under each of the settings, and the CPU seconds of each video."""
    tasks = [(event, prior, chosen) for event in events]
    results = [result for _, result in common.parallel(answers, tasks, "videos", workers)]
    found = []
    for index in range(len(chosen)):
        given = [result["predictions"][index] for result in results]
        metrics = ppl.evaluate_predictions(events, {each.event_id: each for each in given})
        # a video has two goals and one relation
        goals, relation = (metrics[f"{kind}_log_score_truth"]["value"] for kind in KINDS)
        found.append(
            {
                **{name: metrics[name] for name in QUOTED},
                "by_scenario": metrics["by_scenario"],
                "log_score": (2 * goals + relation) / 3,
            }
        )
    return found, [result["cpu_seconds"] for result in results]


def line(setting: Setting, found: dict[str, Any]) -> str:
    words = "  ".join(f"{name} {value:<4g}" for name, value in setting.items())
    goals, relation = (found[name]["value"] for name in QUOTED)
    return (
        f"{words}  goals {goals:.2f}  relation {relation:.2f}  log score {found['log_score']:.2f}"
    )


def main() -> None:
    parser = common.parser(__doc__, "limit", "workers", "json")
    parser.add_argument("--prior", default="uniform", help="prior over pairs of goals")
    options = parser.parse_args()
    first_half, second_half = (common.dev_events(half, options.limit) for half in common.HALVES[:2])
    first, seconds = figures(first_half, options.prior, settings(), options.workers)
    for setting, found in zip(settings(), first, strict=True):
        print(line(setting, found))
    best = max(range(len(first)), key=lambda index: first[index]["log_score"])
    chosen = settings()[best]
    (second,), _ = figures(second_half, options.prior, [chosen], options.workers)
    cpu_seconds = float(np.mean(seconds))
    print(f"\nchosen on the first half   {line(chosen, first[best])}")
    print(f"confirmed on the second    {line(chosen, second)}")
    for scenario, found in second["by_scenario"].items():
        shown = "  ".join(f"{name} {found[name]['value']:.2f}" for name in QUOTED)
        print(f"  {scenario:14} {found['n']:3} videos  {shown}")
    print(f"{cpu_seconds:.2f} CPU seconds per video")
    report = {
        "prior": options.prior,
        "settings": settings(),
        "first": first,
        "chosen": best,
        "second": second,
        "cpu_seconds": cpu_seconds,
    }
    common.write(report, options.json)


if __name__ == "__main__":
    main()
