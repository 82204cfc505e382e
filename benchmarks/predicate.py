"""Accuracy of predicate inverse planning on the real videos, by thresholds and rationality.

python benchmarks/predicate.py [--prior NAME] [--limit N] [--workers N] [--json FILE]

Thresholds are those of SIMPLE's planner times a factor: one for ON and TOUCH of items, one for
TOUCH of agents; and the frames for which a predicate must last. Rationality is per unit of way.
The setting of the highest log score is chosen on the first half of the videos and confirmed on
the second.
"""

from __future__ import annotations

import argparse
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
from phase_ppl.evaluation.prediction import QUESTIONS, Prediction
from phase_ppl.world.event import Event
from phase_ppl.world.geometry import GRAB_REACH

FACTORS = (1.0, 2.0, 3.0, 4.0)
TOUCH_FACTORS = (1.0, 2.0)
LASTING = (1, 3)
RATIONALITY = (0.2, 0.4, 0.8, 1.6)
LAPSE = 0.01
QUOTED = ("goal_accuracy", "relation_accuracy")

Setting = dict[str, float]


def settings() -> list[Setting]:
    names = ("factor", "touch", "lasting", "rationality")
    return [
        dict(zip(names, values, strict=True))
        for values in itertools.product(FACTORS, TOUCH_FACTORS, LASTING, RATIONALITY)
    ]


def model(setting: Setting, prior: str) -> PredicateInversePlanning:
    factor = setting["factor"]
    return predicate(
        prior=prior,
        rationality=setting["rationality"],
        lasting=int(setting["lasting"]),
        on_agent=factor * NEAR_AGENT_ON,
        on_item=factor * NEAR_ITEM_ON,
        touch_item=factor * GRAB_REACH,
        touch_agent=setting["touch"] * NEAR_TOUCH,
    )


def answers(task: tuple[Event, str]) -> dict[str, Any]:
    """Return a video's predictions under all settings, and the CPU seconds of one."""
    event, prior = task
    models = [model(setting, prior) for setting in settings()]
    clock = time.process_time()
    found = [ask(event.scene, event.observation, 0) for ask in models]
    seconds = (time.process_time() - clock) / len(models)
    return {
        "predictions": [dataclasses.replace(one, event_id=event.id) for one in found],
        "cpu_seconds": seconds,
    }


def log_score(event: Event, prediction: Prediction) -> float:
    """Return the mean log probability of the true goals and relation, with a lapse."""
    found = []
    for question, labels in QUESTIONS.items():
        true = labels.index(getattr(event.truth, question))
        share = prediction.probabilities[question][true]
        found.append(np.log((1 - LAPSE) * share + LAPSE / len(labels)))
    return float(np.mean(found))


def figures(events: Sequence[Event], predictions: Sequence[Prediction]) -> dict[str, Any]:
    metrics = ppl.evaluate_predictions(
        events, {prediction.event_id: prediction for prediction in predictions}
    )
    scores = [log_score(event, given) for event, given in zip(events, predictions, strict=True)]
    return {
        **{name: metrics[name] for name in QUOTED},
        "by_scenario": metrics["by_scenario"],
        "log_score": float(np.mean(scores)),
    }


def line(setting: Setting, found: dict[str, Any]) -> str:
    words = "  ".join(f"{name} {value:<4g}" for name, value in setting.items())
    goals, relation = (found[name]["value"] for name in QUOTED)
    return (
        f"{words}  goals {goals:.2f}  relation {relation:.2f}  log score {found['log_score']:.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--prior", default="uniform", help="over pairs of goals")
    parser.add_argument("--limit", type=int, help="a stratified subset of about so many videos")
    parser.add_argument("--workers", type=int, help="processes; default one per core")
    parser.add_argument("--json", metavar="FILE", help="write the figures as JSON")
    options = parser.parse_args()
    halves = {half: common.dev_events(half, options.limit) for half in common.HALVES[:2]}
    tasks = [(event, options.prior) for events in halves.values() for event in events]
    done = {
        task[0].id: result
        for task, result in common.parallel(answers, tasks, "videos", options.workers)
    }

    def of(half: str, index: int) -> dict[str, Any]:
        events = halves[half]
        return figures(events, [done[event.id]["predictions"][index] for event in events])

    first = [of("first", index) for index in range(len(settings()))]
    for setting, found in zip(settings(), first, strict=True):
        print(line(setting, found))
    best = max(range(len(first)), key=lambda index: first[index]["log_score"])
    second = of("second", best)
    seconds = float(np.mean([result["cpu_seconds"] for result in done.values()]))
    print(f"\nchosen on the first half   {line(settings()[best], first[best])}")
    print(f"confirmed on the second    {line(settings()[best], second)}")
    for scenario, found in second["by_scenario"].items():
        shown = "  ".join(f"{name} {found[name]['value']:.2f}" for name in QUOTED)
        print(f"  {scenario:14} {found['n']:3} videos  {shown}")
    print(f"{seconds:.2f} CPU seconds per video")
    report = {
        "prior": options.prior,
        "settings": settings(),
        "first": first,
        "chosen": best,
        "second": second,
        "cpu_seconds": seconds,
    }
    common.write(report, options.json)


if __name__ == "__main__":
    main()
