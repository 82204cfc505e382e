"""Would the filters of generation keep the real videos?

    python benchmarks/filters.py [--json FILE]

The authors sorted by hand, and kept all of these videos. What share would each filter keep, and
how far are the videos from its threshold? Pushing without effect is looked for in steps with known
actions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import common
import numpy as np

from phase_ppl.data.generation.making import (
    MAX_STUCK,
    NEAR,
    PUSHES,
    Recording,
    measures,
    reason_against,
)
from phase_ppl.physics.actions import ACTION_NAMES
from phase_ppl.world.event import Event
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import AGENTS, ENTITIES, PredicateKind

PUSHING: Final = [ACTION_NAMES[action] for action in PUSHES]
"""Names of actions that push, in the recovered ones."""


class Case(NamedTuple):
    """What is known of a video or a draw."""

    scenario: str
    goals: tuple[int, ...]
    found: dict[str, Any]
    reason: str | None


class Rule(NamedTuple):
    """A filter, thresholds to try, and the one that stands; None where there is no such filter."""

    name: str
    scenarios: Sequence[str]
    passes: Callable[[Case, float], bool]
    thresholds: Sequence[float]
    now: float | None


def taking_part(case: Case) -> int:
    """Return how many agents touch the item that their goal is about; all, if it is about none."""
    part = 0
    for agent, goal in enumerate(case.goals):
        literal = goal_literal(goal, agent)
        about_item = literal.predicate is PredicateKind.ON and literal.subject >= len(AGENTS)
        part += not about_item or ENTITIES[literal.subject] in case.found["touched"][agent]
    return part


RULES: Final = (
    Rule("longest push without effect, frames", common.SCENARIOS,
         lambda case, most: max(case.found["stuck"]) <= most,
         (3, 6, 12, 24, 36, 60, 100), MAX_STUCK),
    Rule("nearest approach, sum of sizes", ("opposing",),
         lambda case, below: min(case.found["closest"].values()) < below,
         (0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 4.0), NEAR),
    Rule("agents that touch the item of their goal", ("competing",),
         lambda case, least: taking_part(case) >= least, (2, 1, 0), 2),
    Rule("agents that touch the item of their goal", ("collaborative",),
         lambda case, least: taking_part(case) >= least, (2, 1, 0), None),
)  # fmt: skip


def real_case(event: Event, actions: Sequence[Sequence[str]]) -> Case:
    """Return what our filters see in a real video."""
    truth, n = event.truth, event.observation.n_frames
    pushes = np.zeros((n, len(AGENTS)), bool)
    pushes[1 : 1 + len(actions)] = np.isin(actions[: n - 1], PUSHING)
    hypothesis = common.true_hypothesis(event)
    track = event.observation.trajectory
    found = measures(Recording(event.scene, hypothesis, 0, track, pushes))
    reason = reason_against(truth.scenario, hypothesis, found)
    return Case(truth.scenario, hypothesis.effective_goals, found, reason)


def share(cases: Sequence[Case], passes: Callable[[Case], bool]) -> dict[str, float | int | None]:
    """Return how many cases there are, and the share that passes."""
    return {"n": len(cases), "share": float(np.mean([passes(c) for c in cases])) if cases else None}


def shown(found: dict[str, float | int | None]) -> str:
    return "" if found["share"] is None else f"{found['share']:.2f} of {found['n']}"


def main() -> None:
    parser = common.parser(__doc__, "json")
    options = parser.parse_args()
    actions = {video["id"]: video["actions"] for video in common.replays()}
    groups = {
        half: [real_case(event, actions[event.id]) for event in common.dev_events(half)]
        for half in ("first", "second")
    }
    report: dict[str, Any] = {"filters": {}, "refused": {}, "thresholds": []}
    heads = {"first": "real, first half", "second": "real, second half"}
    print(f"{'kept by the filters':52}" + "".join(f"{heads[name]:>20}" for name in groups))
    for scenario in (*common.SCENARIOS, "all"):
        row = {
            name: share(
                [case for case in cases if scenario in ("all", case.scenario)],
                lambda case: case.reason is None,
            )
            for name, cases in groups.items()
        }
        report["filters"][scenario] = row
        print(f"{scenario:52}" + "".join(f"{shown(found):>20}" for found in row.values()))
    for name, cases in groups.items():
        reasons = sorted({case.reason for case in cases if case.reason})
        report["refused"][name] = {
            reason: sum(case.reason == reason for case in cases) for reason in reasons
        }
        for reason, n in report["refused"][name].items():
            print(f"  {heads[name]}: {reason}: {n}")
    for rule in RULES:
        print(f"\n{rule.name} ({', '.join(rule.scenarios)})")
        for threshold in rule.thresholds:
            row = {
                name: share(
                    [case for case in cases if case.scenario in rule.scenarios],
                    lambda case, rule=rule, threshold=threshold: rule.passes(  # type: ignore[misc]
                        case, threshold
                    ),
                )
                for name, cases in groups.items()
            }
            mark = "   (the filter)" if threshold == rule.now else ""
            words = f"{threshold:g}{mark}"
            report["thresholds"].append(
                {"rule": rule.name, "scenarios": list(rule.scenarios), "value": threshold,
                 "filter": threshold == rule.now, **row}
            )  # fmt: skip
            print(f"{words:52}" + "".join(f"{shown(found):>20}" for found in row.values()))
    common.write(report, options.json)


if __name__ == "__main__":
    main()
