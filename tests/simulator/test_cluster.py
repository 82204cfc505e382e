"""Simulations on a dask cluster, one of whose workers is killed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from tests.inference.toy import walkers, walking_event
from tests.simulator.clusters import local_cluster, note, processes, the_third_killed

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="kills a process")]

OPTIONS: Any = {"kernel": "prior_mh", "chains": 4, "iterations": 2, "seed": 3, "progress": False}


class SlowWalkers:
    """Walks as the toy does, some time after having said in which process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.seconds = folder, 0.1

    def __call__(self, scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
        note(self.folder)
        time.sleep(self.seconds)
        yield from walkers(scene, hypothesis, rng)


def test_a_cluster_may_lose_a_worker(tmp_path: Path) -> None:
    event, simulator = walking_event(), SlowWalkers(tmp_path)
    model = ppl.Model(simulator=simulator)
    with local_cluster() as (_, client), the_third_killed(tmp_path):
        post = ppl.infer(event, model, executor=client.get_executor(), **OPTIONS)
    assert len(processes(tmp_path)) in (2, 3)  # perhaps also one that took the dead one's place
    simulator.seconds = 0.0
    alone = ppl.infer(event, model, workers=1, **OPTIONS)
    for group in ("posterior", "sample_stats", "simulated", "simulations"):
        for name, values in alone.tree[group].dataset.items():
            assert values.equals(post.tree[group].dataset[name]), f"{group}/{name}"
    assert post.cost["simulations"] == alone.cost["simulations"] >= 12
    assert (post.cost["failures"], post.cost["workers"]) == (0, None)
