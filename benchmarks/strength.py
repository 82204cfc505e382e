"""How well are strengths read off real videos?

    python benchmarks/strength.py [--json FILE] [--half HALF]

Each estimator sees the videos as they are, and with jitter on what was observed. How often does it
say anything, how far off is it, and how probable is the true strength in SIMPLE's proposal? The
uniform prior has a log density of -6.11. Without an estimate the error is that of the prior's
mean.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
from strength_training import Quality, blurred, quality

from phase_ppl.inference.strength import (
    ESTIMATORS,
    Estimator,
    StrengthEstimates,
    StrengthNetwork,
)
from phase_ppl.inference.tables import window_count, window_length
from phase_ppl.world.event import Event, Observation

JITTER = (0.0, 0.05, 0.1, 0.3)
WINDOW = 10
COLUMNS = Quality._fields


def windows_of(n_frames: int, whole: bool) -> np.ndarray:
    """Return (window, 2) the whole video, or all windows of SIMPLE's length."""
    if whole:
        return np.array([[0, n_frames - 1]])
    first = np.arange(window_count(n_frames, WINDOW))
    return np.column_stack([first, first + window_length(n_frames, WINDOW)])


def observations(events: list[Event], jitter: float, draws: int) -> list[tuple[Event, Observation]]:
    """Return each event with what is seen of it; with jitter, more than once."""
    found = []
    for number, event in enumerate(events):
        for draw in range(draws if jitter else 1):
            rng = np.random.default_rng([number, draw])
            seen = blurred(event.observation.trajectory, jitter, rng)
            found.append((event, Observation(seen)))
    return found


def judged(
    estimator: Estimator, seen: list[tuple[Event, Observation]], whole: bool
) -> dict[str, float | None]:
    """Return the quality over all windows and agents."""
    means, sds, truths = [], [], []
    for event, observation in seen:
        windows = windows_of(observation.n_frames, whole)
        mean, sd = estimator(event.scene, observation, windows)
        means.append(mean)
        sds.append(sd)
        truths += [common.true_hypothesis(event).strengths] * len(windows)
    found = StrengthEstimates(np.concatenate(means), np.concatenate(sds))
    figures = quality(found, np.array(truths, float))._asdict()
    return {name: None if np.isnan(value) else value for name, value in figures.items()}


def main() -> None:
    parser = common.parser(__doc__, "half", "limit", "json")
    parser.add_argument("--draws", type=int, default=3, help="draws of the jitter, per video")
    parser.add_argument("--weights", metavar="NPZ", help="your own network, beside the rest")
    options = parser.parse_args()
    estimators = dict(ESTIMATORS)
    if options.weights:
        estimators[options.weights] = StrengthNetwork(np.load(options.weights, allow_pickle=False))
    events = common.dev_events(options.half, options.limit)
    report: dict[str, Any] = {"half": options.half, "videos": len(events), "draws": options.draws}
    rows = []
    print(f"{'window':8}{'jitter':8}{'estimator':20}" + "".join(f"{c:>13}" for c in COLUMNS))
    for window in ("all", "10 steps"):
        for jitter in JITTER:
            seen = observations(events, jitter, options.draws)
            for name, estimator in estimators.items():
                figures = judged(estimator, seen, window == "all")
                rows.append({"window": window, "jitter": jitter, "estimator": name, **figures})
                shown = "".join(
                    f"{'-':>13}" if figures[column] is None else f"{figures[column]:13.3f}"
                    for column in COLUMNS
                )
                print(f"{window:8}{jitter:<8g}{name:20}{shown}", flush=True)
    common.write(report | {"rows": rows}, options.json)


if __name__ == "__main__":
    main()
