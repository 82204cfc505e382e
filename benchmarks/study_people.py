"""Does a study lose answers under load, or when its server is killed?

    python benchmarks/study_people.py --kills 50

Scripted people take part, 20 at a time, until enough have finished; some leave midway. Is a
confirmed answer ever lost, or stored twice? How many people see each video, how many answers come
in a second, and how long does one take?
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import patch

import common
import numpy as np

import phase_ppl as ppl
from phase_ppl.evaluation.prediction import Prediction
from phase_study import Study
from phase_study.clips import CLIPS
from phase_study.simulate import Person, Visitor

PATIENCE = 120.0
"""Seconds for which people wait for a server that is gone."""


def make_study(folder: Path, n_videos: int, raters: int, trials: int) -> Study:
    """Make a study of short films, all different; those of the introduction are empty."""
    names = ppl.bundled_events()
    events = []
    for number in range(n_videos):
        event = ppl.load_event(names[number % len(names)])
        frames = event.observation.trajectory[: 3 + number // len(names)]
        events.append(
            dataclasses.replace(event, observation=ppl.Observation(frames), id=f"video-{number}")
        )

    def no_clips(folder: Path, world: ppl.World) -> None:
        folder.mkdir()
        for name in CLIPS:
            (folder / f"{name}.mp4").touch()

    with patch("phase_study.study.make_clips", no_clips):
        Study.new(folder, events, trials=trials, raters=raters, progress=False)
    # the places of those who leave are free again after a minute
    return changed(folder, place_kept=1, entries_per_minute=10**6, most_entries=10**6)


def changed(folder: Path, **settings: object) -> Study:
    """Return a study with other settings than those in its file."""
    file = folder / "study.toml"
    text = file.read_text()
    for name, value in settings.items():
        text = re.sub(rf"(?m)^{name} = \S+", f"{name} = {value}", text)
    file.write_text(text)
    return Study(folder)


class Server:
    """A study's server in a process of its own, at a port that stays the same."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.kills = folder, 0
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}/"
        self.start()

    def start(self) -> None:
        code = (
            "from phase_study import Study\n"
            f"Study({str(self.folder)!r}).run({self.port}, "
            "ready=lambda where: print(where, flush=True))"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        with self.process.stdout as told:
            if not told.readline():
                raise RuntimeError("the server did not start")

    def stop(self, how: signal.Signals = signal.SIGTERM) -> None:
        self.process.send_signal(how)
        self.process.wait()

    def kill_at_random(self, times: int, rng: np.random.Generator, done: threading.Event) -> None:
        """Kill the server again and again, each time a random moment after it has started."""
        while self.kills < times and not done.wait(rng.uniform(0.0, 1.2)):
            self.stop(signal.SIGKILL)
            self.kills += 1
            self.start()


class Timed(Visitor):
    """A visitor that notes how long confirmed answers took, in seconds."""

    took: list[float]

    def _once(self, method: str, path: str, body: bytes | None) -> tuple[int, bytes]:
        begun = time.perf_counter()
        status, content = super()._once(method, path, body)
        if path == "/api/answer" and status == 200:
            self.took.append(time.perf_counter() - begun)
        return status, content


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Let people take part until as many have finished as the study wants."""
    rng = np.random.default_rng(options.seed)
    confirmed: dict[tuple[str, str, int], Mapping[str, Any]] = {}
    outcomes: Counter[str] = Counter()
    took: list[float] = []
    lock, done = threading.Lock(), threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        study = make_study(Path(folder) / "study", options.videos, options.raters, options.trials)
        events = study.events_by_digest()
        guess = {
            event: Prediction(event, answers={"relation": "neutral"}) for event in study.events
        }
        server = Server(study.folder)

        def keep(who: str, page: str, attempt: int, answers: Mapping[str, Any]) -> None:
            with lock:
                confirmed[who, page, attempt] = answers

        def people(seed: np.random.SeedSequence) -> None:
            """One after another comes, until no place is left and nobody is at it."""
            chance = np.random.default_rng(seed)
            while not done.is_set():
                person = Person(
                    study.settings, server.address, guess, events, chance, options.lapse,
                    options.drop_outs, confirmed=keep, patience=PATIENCE,
                )  # fmt: skip
                person.visitor = Timed(server.address, PATIENCE)
                person.visitor.took = took
                person.take_part()
                with lock:
                    outcomes[person.outcome or "left"] += 1
                if person.outcome == "full":
                    if min(study.status().viewings.values()) >= options.raters:
                        done.set()
                    done.wait(2.0)

        killer = threading.Thread(target=server.kill_at_random, args=(options.kills, rng, done))
        begun = time.perf_counter()
        killer.start()
        with ThreadPoolExecutor(options.at_once) as pool:
            list(pool.map(people, np.random.SeedSequence(options.seed).spawn(options.at_once)))
        seconds = time.perf_counter() - begun
        done.set()
        killer.join()
        server.stop()
        with study.store() as store:
            kept = {
                (row["participant"], row["page"], row["attempt"]): json.loads(row["answers"])
                for row in store.rows("SELECT * FROM response")
            }
            rows = store.rows("SELECT count(*) AS n FROM response")[0]["n"]
            whole = store.rows("PRAGMA integrity_check")[0]["integrity_check"]
        viewings = study.status().viewings
    # of the page about the person the answers are in a table of their own
    lost = sum(
        kept.get(key) != (dict(given) if key[1] != "person" else {})
        for key, given in confirmed.items()
    )
    report = {
        "kills": server.kills,
        "confirmed": len(confirmed),
        "lost": lost,
        "doubled": rows - len(kept),
        "unconfirmed": len(set(kept) - set(confirmed)),
        "integrity": whole,
        "outcomes": dict(outcomes),
        "raters": {str(n): count for n, count in sorted(Counter(viewings.values()).items())},
        "seconds": round(seconds, 1),
        "answers_per_second": round(len(confirmed) / seconds, 1),
        "answer_ms": {
            name: round(1000 * float(np.quantile(took, share)), 1)
            for name, share in (("median", 0.5), ("p95", 0.95), ("p99", 0.99), ("max", 1.0))
        },
    }
    for name, value in report.items():
        print(f"{name:20} {value}")
    return report


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--videos", type=int, default=100)
    parser.add_argument("--trials", type=int, default=10, help="videos per person")
    parser.add_argument("--raters", type=int, default=20, help="people per video")
    parser.add_argument("--at-once", type=int, default=20, help="people at a time")
    parser.add_argument("--kills", type=int, default=0, help="kills of the server, by kill -9")
    parser.add_argument("--drop-outs", type=float, default=0.15)
    parser.add_argument("--lapse", type=float, default=0.05)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    common.write(run(options), options.json)


if __name__ == "__main__":
    main()
