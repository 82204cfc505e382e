"""How often do proposals contain the true goals of real videos, before any simulation?

    python benchmarks/proposals.py [--half first|second|all] [--forms NAME ...] [--json FILE]

The table has the probability that the true pair of effective goals is among the 15 initial
particles, by form of the proposal and scenario. It also has the probability for these and 90
further proposals. The further ones come from evenly spaced windows; a run would choose windows
that it explains badly.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np

from phase_ppl.inference.settings import FORMS, Form, SimpleSettings
from phase_ppl.inference.tables import bottom_up_tables
from phase_ppl.models.sites import ALPHA_PROBABILITIES, SELF_REFERRING
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, effective_goals
from phase_ppl.world.hypothesis import ALPHAS

INITIAL, LATER = 15, 90
MEASURES = ("initial", "ever", "log_proposal")


def probabilities(event: Event, form: Form) -> np.ndarray:
    """Return (window + 1,) probabilities that the true effective goals are proposed."""
    truth = common.true_hypothesis(event).effective_goals
    tables = bottom_up_tables(event.scene, event.observation, SimpleSettings(proposal=form))
    logits = np.asarray(tables.goal_logits)
    if tables.way_logits is None:
        logits = np.repeat(logits[:, None], len(ALPHAS), axis=1)
        alpha = np.tile(ALPHA_PROBABILITIES, (len(logits), 1))
    else:
        alpha = np.array(ALPHA_PROBABILITIES) * np.exp(np.asarray(tables.way_logits))
    alpha /= alpha.sum(axis=1, keepdims=True)
    goal = np.exp(logits - logits.max(axis=-1, keepdims=True))
    goal /= goal.sum(axis=-1, keepdims=True)
    even = ~SELF_REFERRING / (~SELF_REFERRING).sum(axis=1, keepdims=True)
    share = SimpleSettings().prior_share
    found = np.zeros(len(goal))
    for red, green, index in np.ndindex(len(GOALS), len(GOALS), len(ALPHAS)):
        if effective_goals(red, green, ALPHAS[index]) == truth:
            local = alpha[:, index] * goal[:, index, 0, red] * goal[:, index, 1, green]
            prior = ALPHA_PROBABILITIES[index] * even[0, red] * even[1, green]
            found += (1 - share) * local + share * prior
    return found


def judge(task: tuple[Event, Form]) -> dict[str, Any]:
    event, form = task
    found = probabilities(event, form)
    first = (1 - found[-1]) ** INITIAL
    return {
        "scenario": event.truth.scenario,
        "form": form,
        "initial": 1 - first,
        "ever": 1 - first * (1 - found[:-1].mean()) ** LATER,
        "log_proposal": float(np.log(found[-1])),
    }


def main() -> None:
    parser = common.parser(__doc__, "half", "limit", "json")
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS)
    options = parser.parse_args()
    events = common.dev_events(options.half, options.limit)
    tasks = [(event, form) for form in options.forms for event in events]
    rows = [result for _, result in common.parallel(judge, tasks, "videos")]
    figures: dict[str, Any] = {}
    for form in options.forms:
        figures[form] = {}
        for scenario, group in common.by_scenario(row for row in rows if row["form"] == form):
            found = {name: common.interval([row[name] for row in group]) for name in MEASURES}
            figures[form][scenario] = found | {"n": len(group)}
            shown = "  ".join(f"{name} {found[name]['value']:6.2f}" for name in MEASURES)
            print(f"{form:8} {scenario:14} {len(group):3} videos  {shown}")
    common.write(figures, options.json)


if __name__ == "__main__":
    main()
