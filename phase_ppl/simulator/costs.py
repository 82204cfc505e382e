"""What simulations cost."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass
class Statistics:
    """What the simulations of a runner have cost.

    Attributes:
        simulations: run, failed ones among them; requests merged with an identical one do not
            count.
        frames: simulated.
        frames_saved: not simulated because the fate was decided.
        seconds_simulating: summed over workers.
        seconds_waiting: wall time spent in ``run``.
        failures: simulations that failed.
        retries: simulations run again, because they were lost, most often with their worker, or
            because they failed.
    """

    simulations: int = 0
    frames: int = 0
    frames_saved: int = 0
    seconds_simulating: float = 0.0
    seconds_waiting: float = 0.0
    failures: int = 0
    retries: int = 0
