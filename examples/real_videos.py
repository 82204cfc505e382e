"""The closed loop on real videos of PHASE, as published by its authors' colleagues.

python examples/real_videos.py [Videos_Test_humanratings]

The file is PHASE/Videos_Test_humanratings of https://github.com/Isik-lab/SocialGNN; without an
argument it is taken from the folder $PHASE_TEST, or from ../shared/phase-test.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import phase_ppl as ppl

NAME = "Videos_Test_humanratings"


def found() -> Path | None:
    """Return the path of the file, or None."""
    beside = Path(__file__).parents[2] / "shared" / "phase-test"
    folder = Path(os.environ.get("PHASE_TEST", beside))
    given = [Path(name) for name in sys.argv[1:2]]
    places = given or [folder / NAME, folder / "original" / NAME, folder / "PHASE" / NAME]
    return next((path for path in places if path.is_file()), None)


def main() -> None:
    path = found()
    if path is None:
        print(f"There is no {NAME} here. It comes with git clone, and is read as it stands:")
        print("    git clone https://github.com/Isik-lab/SocialGNN")
        print(f"    python examples/real_videos.py SocialGNN/PHASE/{NAME}")
        return
    events = ppl.load_events(path)
    print(f"{len(events)} videos in {path.name}")
    shortest = sorted(events, key=lambda event: event.observation.n_frames)[:2]
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1))
    for event in shortest:
        post = ppl.infer(event, model)
        print(event)
        print("    people say", (event.judgments or {}).get("majority"))
        for question in ("goal_red", "goal_green", "relation"):
            print(f"    {question}:", *post.top(question, 2))


if __name__ == "__main__":
    main()
