"""Simulations on a dask cluster, one of whose workers is killed."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import SimulationError
from tests.inference.toy import walkers, walking_event
from tests.simulator.clusters import local_cluster, note, processes, the_third_killed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills a process")

OPTIONS: Any = {"kernel": "prior_mh", "chains": 4, "iterations": 2, "seed": 3, "progress": False}


class SlowWalkers:
    """Walks as the toy does, some time after having said in which process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.seconds = folder, 0.2

    def __call__(self, scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
        note(self.folder)
        time.sleep(self.seconds)
        yield from walkers(scene, hypothesis, rng)


def test_a_cluster_may_lose_a_worker_and_ends_the_run_when_it_is_closed(tmp_path: Path) -> None:
    event, folders = walking_event(), [tmp_path / name for name in ("loses", "closes")]
    for folder in folders:
        folder.mkdir()
    simulator, others = map(SlowWalkers, folders)
    model = ppl.Model(simulator=simulator)
    with local_cluster() as (cluster, client):
        executor = client.get_executor()
        with the_third_killed(folders[0]):
            post = ppl.infer(event, model, executor=executor, **OPTIONS)

        def close() -> None:
            while len(list(folders[1].iterdir())) < 6:  # 4 to begin with, then an iteration
                time.sleep(0.01)
            cluster.close()

        closer = threading.Thread(target=close)
        closer.start()
        with pytest.raises(SimulationError, match="the executor takes no more work") as caught:
            ppl.infer(event, ppl.Model(simulator=others), executor=executor, **OPTIONS)
        closer.join()
    assert caught.value.posterior is not None
    assert len(processes(folders[0])) == 3  # two, and the one that took the dead one's place
    simulator.seconds = 0.0
    alone = ppl.infer(event, model, workers=1, **OPTIONS)
    for group in ("posterior", "sample_stats", "simulated", "simulations"):
        for name, values in alone.tree[group].dataset.items():
            assert values.equals(post.tree[group].dataset[name]), f"{group}/{name}"
    assert post.cost["simulations"] == alone.cost["simulations"] >= 12
    assert (post.cost["failures"], post.cost["workers"]) == (0, None)
