"""Simulations on a dask cluster, one of whose workers is killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import SimulationError
from tests.inference.toy import walkers, walking_event

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills a process")

OPTIONS: dict[str, Any] = {
    "kernel": "prior_mh",
    "chains": 4,
    "iterations": 2,
    "seed": 3,
    "progress": False,
}


class SlowWalkers:
    """Walks as the toy does, some time after having said in which process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.seconds = folder, 0.2

    def __call__(self, scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
        (self.folder / f"{os.getpid()}-{time.monotonic_ns()}").touch()
        time.sleep(self.seconds)
        yield from walkers(scene, hypothesis, rng)


def kill_the_third(folder: Path, killed: list[int]) -> None:
    """Kill the process of the third simulation while it is running."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        begun = sorted(folder.iterdir(), key=lambda file: file.stat().st_mtime_ns)
        if len(begun) >= 3:
            killed.append(int(begun[2].name.split("-")[0]))
            os.kill(killed[0], signal.SIGKILL)
            return
        time.sleep(0.005)


def test_a_cluster_that_loses_a_worker_gives_the_same_posterior(tmp_path: Path) -> None:
    event, simulator = walking_event(), SlowWalkers(tmp_path)
    model = ppl.Model(simulator=simulator)
    killed: list[int] = []
    killer = threading.Thread(target=kill_the_third, args=(tmp_path, killed))
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        killer.start()
        post = ppl.infer(event, model, executor=client.get_executor(), **OPTIONS)
        killer.join()
        processes = {int(file.name.split("-")[0]) for file in tmp_path.iterdir()}
    simulator.seconds = 0.0
    alone = ppl.infer(event, model, workers=1, **OPTIONS)
    assert killed
    assert len(processes) == 3  # two, and the one that took the dead one's place
    for group in ("posterior", "sample_stats", "simulated", "simulations"):
        for name, values in alone.tree[group].dataset.items():
            assert values.equals(post.tree[group].dataset[name]), f"{group}/{name}"
    assert post.cost["simulations"] == 12
    assert post.cost["failures"] == 0
    assert post.cost["workers"] is None


def test_a_cluster_that_is_closed_ends_the_run(tmp_path: Path) -> None:
    simulator = SlowWalkers(tmp_path)
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):

        def close() -> None:
            while len(list(tmp_path.iterdir())) < 6:  # 4 to begin with, then an iteration
                time.sleep(0.01)
            cluster.close()

        closer = threading.Thread(target=close)
        closer.start()
        with pytest.raises(SimulationError, match="the executor takes no simulation") as caught:
            ppl.infer(
                walking_event(),
                ppl.Model(simulator=simulator),
                executor=client.get_executor(),
                **OPTIONS,
            )
        closer.join()
    assert caught.value.posterior is not None
