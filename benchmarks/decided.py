"""Are decided answers right, and how many of the right ones are decided?

    python benchmarks/decided.py FOLDER [FOLDER ...] [--events FILE] [--json FILE]

A folder holds posteriors (.nc) of the real videos, or of ``--events`` with their truth.
``phase-ppl infer EVENTS --out FOLDER`` and ``phase-ppl evaluate EVENTS --out FOLDER`` write them.

Each agent's goal and the relation are decided on their own if their probability exceeds 1/2 by its
errors. The row "verdict" takes all answers of an event together, as ``post.diagnostics()`` does:
no rival may be untried, and the prior alone may not decide. Intervals are bootstrapped over
events.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import common
import numpy as np

import phase_ppl as ppl
from phase_ppl.evaluation.table import true_answers
from phase_ppl.world.event import Event

KINDS = ("goals", "relation", "all", "verdict")


def answers(folder: Path, events: Sequence[Event]) -> list[dict[str, list[tuple[bool, bool]]]]:
    """Return whether each answer is right, and called decided: by kind, of each posterior."""
    known = {event.id: event for event in events if event.truth is not None}
    found = []
    for path in sorted(folder.rglob("*.nc")):
        post = ppl.load_posterior(path)
        if post.event_id not in known:
            print(f"{path}: of {post.event_id!r}, which is none of the events with truth")
            continue
        event = known[post.event_id]
        together = bool(post.diagnostics()["decided"])
        pairs: dict[str, list[tuple[bool, bool]]] = {kind: [] for kind in KINDS}
        for name, leader in post.leaders().items():
            right = leader["label"] == true_answers(event).get(name)
            for kind in ("goals" if name.startswith("goal_") else "relation", "all"):
                pairs[kind].append((right, leader["sure"]))
            pairs["verdict"].append((right, together))
        found.append(pairs)
    return found


def report(found: Sequence[dict[str, list[tuple[bool, bool]]]], kind: str) -> dict[str, Any]:
    """Return shares, each with its interval."""
    rows = [np.array(pairs[kind], bool).reshape(-1, 2) for pairs in found]
    decided = [own[own[:, 1], 0] for own in rows]
    of_right = [own[own[:, 0], 1] for own in rows]
    return {
        "answers": sum(map(len, rows)),
        "right": shared([own[:, 0] for own in rows]),
        "decided": sum(map(len, decided)),
        "decided_right": shared(decided),
        "decided_wrong": int(sum((~own).sum() for own in decided)),
        "right_decided": shared(of_right),
    }


def shared(of_events: Sequence[Any]) -> dict[str, float] | None:
    """Return the mean over events of a share, with its interval; None where there is none."""
    shares = [float(own.mean()) for own in of_events if len(own)]
    return common.interval(shares) if shares else None


def main() -> None:
    parser = common.parser(__doc__, "json")
    parser.add_argument("folders", nargs="+", metavar="FOLDER", type=Path)
    parser.add_argument("--events", metavar="FILE", help="events with truth, not the real videos")
    options = parser.parse_args()
    events = ppl.load_events(options.events) if options.events else common.dev_events()
    figures = {}
    for folder in options.folders:
        found = answers(folder, events)
        if not found:
            parser.error(f"{folder} has no posteriors of these events")
        figures[str(folder)] = {kind: report(found, kind) for kind in KINDS}
        print(f"{folder}: {len(found)} events")
        for kind, row in figures[str(folder)].items():
            shares = "  ".join(
                f"{name} {common.shown(row[name])}"
                for name in ("right", "decided_right", "right_decided")
                if row[name]
            )
            print(
                f"  {kind:9}{row['answers']:4} answers, {row['decided']:3} decided, of these "
                f"{row['decided_wrong']} wrong  {shares}"
            )
    common.write(figures, options.json)


if __name__ == "__main__":
    main()
