"""A dask cluster of two processes, and somebody who kills one of them."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed


@contextlib.contextmanager
def local_cluster(n_workers: int = 2) -> Iterator[tuple[Any, Any]]:
    # A free port for the dashboard: tests that run beside each other have a cluster each.
    of: Any = {"threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with (
        distributed.LocalCluster(n_workers=n_workers, **of) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield cluster, client


def note(folder: Path) -> None:
    (folder / f"{os.getpid()}-{time.monotonic_ns()}").touch()


def processes(folder: Path) -> set[int]:
    return {int(file.name.split("-")[0]) for file in folder.iterdir()}


@contextlib.contextmanager
def the_third_killed(folder: Path) -> Iterator[None]:
    killed: list[int] = []

    def kill() -> None:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            begun = sorted(folder.iterdir(), key=lambda file: file.stat().st_mtime_ns)
            if len(begun) >= 3:
                killed.append(int(begun[2].name.split("-")[0]))
                os.kill(killed[0], signal.SIGKILL)
                return
            time.sleep(0.005)

    killer = threading.Thread(target=kill)
    killer.start()
    yield
    killer.join()
    assert killed
