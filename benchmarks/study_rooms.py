"""How well does a study's server keep time, by the number of playing pairs?

    python benchmarks/study_rooms.py [--rooms N ...] [--json FILE]

How evenly do frames come to scripted players? How long is it from a key to a frame in which the
agent has moved? What does the server need?
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import common
import numpy as np
from study_people import Server, changed

import phase_ppl as ppl
from phase_study import Study
from phase_study.simulate import Visitor

RATE = 4
"""Planner steps a second."""


def shares(values: Sequence[float], scale: float = 1000.0) -> dict[str, float]:
    """Return median, 95 and 99 % quantile and maximum, in milliseconds."""
    found = np.quantile(np.array(values) * scale, [0.5, 0.95, 0.99, 1.0]).round(1).tolist()
    return dict(zip(("median", "p95", "p99", "max"), found, strict=True))


def cpu_seconds(process: int) -> float:
    """Return the seconds that a process has computed."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def prepared(study: Study, address: str) -> str:
    """Let somebody in who has read the introduction and practised; return their cookie."""
    before = {"consent": {"agree": True}, "device": {}, "tutorial": {"views": []}}
    with contextlib.closing(Visitor(address)) as visitor:
        visitor.post("/api/enter", {})
        for page, answers in before.items():
            visitor.post("/api/answer", {"page": page, "attempt": 1, "answers": answers})
        who = json.loads(visitor.get("/api/state"))["participant"]
    with study.store() as store:
        store.answer(who, "practice", 1, {})
    return visitor.cookie


class Player:
    """A script player that drives to and fro."""

    def __init__(self, address: str, cookie: str) -> None:
        self.address, self.cookie = address, cookie
        self.gaps: list[float] = []
        self.delays: list[float] = []
        self.received = 0

    async def play(self) -> None:
        """Play one session."""
        from websockets.asyncio.client import connect

        where = self.address.replace("http", "ws") + "play/socket"
        headers = {"Cookie": self.cookie}
        origin: Any = self.address.rstrip("/")
        agent, last, keys = 0, 0.0, ("forward", "backward")
        before: Any = None
        asked: float | None = None
        async with connect(where, origin=origin, additional_headers=headers) as socket:
            async for text in socket:
                now, message = time.perf_counter(), json.loads(text)
                self.received += len(text)
                if message["t"] == "scene":
                    agent = message["agent"]
                    await socket.send('{"t":"ready"}')
                elif message["t"] == "ping":
                    await socket.send('{"t":"pong"}')
                elif message["t"] in ("end", "go"):
                    return
                elif message["t"] == "begun":
                    last, before = 0.0, None
                elif message["t"] == "frame" and before is None:
                    last, before = now, message["poses"][agent]
                elif message["t"] == "frame" and last:
                    self.gaps.append(now - last)
                    last, pose = now, message["poses"][agent]
                    moved = abs(pose[1] - before[1]) + abs(pose[0] - before[0]) > 1e-3
                    if asked is None and not moved:
                        asked = now
                        await socket.send(json.dumps({"t": "key", "key": keys[0], "down": True}))
                    elif asked is not None and moved:
                        self.delays.append(now - asked)
                        asked = None
                        await socket.send(json.dumps({"t": "key", "key": keys[0], "down": False}))
                        keys = keys[::-1]
                    before = pose


def rooms(options: argparse.Namespace) -> dict[str, Any]:
    """Measure by how many rooms there are."""
    report: dict[str, Any] = {}
    for n in options.rooms:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "study"
            Study.new(target, ppl.load_event("oppose"), "play", raters=1000, progress=False)
            text = (target / "study.toml").read_text()
            text = "quiz = []\n" + re.sub(r"(?s)\[\[quiz\]\].*?(?=\n\[play\])", "", text)
            (target / "study.toml").write_text(text)
            study = changed(
                target, rooms=n, limit=int(RATE * options.seconds), steps_per_second=RATE,
                entries_per_minute=1000, trials=1, partner='"person"',
            )  # fmt: skip
            server = Server(target)
            address, process = server.address, server.process.pid
            with contextlib.ExitStack() as at_the_end:
                at_the_end.callback(server.stop)
                players = [Player(address, prepared(study, address)) for _ in range(2 * n)]

                async def all_play(players: Sequence[Player] = players) -> None:
                    await asyncio.gather(*(player.play() for player in players))

                computed, clock = cpu_seconds(process), time.perf_counter()
                asyncio.run(all_play())
                seconds = time.perf_counter() - clock
                share = (cpu_seconds(process) - computed) / seconds
            with study.store() as store:
                slips = [session["slip_ms"] for session in store.sessions()]
        report[str(n)] = {
            "gap_ms": shares([gap for player in players for gap in player.gaps]),
            "key_to_moved_ms": shares([delay for player in players for delay in player.delays]),
            "kB_per_second": round(
                sum(p.received for p in players) / len(players) / seconds / 1000, 1
            ),
            "cpu_share": round(share, 3),
            "slip_ms": shares(slips, 1.0),
        }
        print(f"{n:3} rooms: {report[str(n)]}", flush=True)
    return report


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("--rooms", type=int, nargs="+", default=[1, 5, 8, 20])
    parser.add_argument("--seconds", type=float, default=25.0, help="seconds of each session")
    options = parser.parse_args()
    common.write(rooms(options), options.json)


if __name__ == "__main__":
    main()
