"""What can be believed at each moment of a video, and which frames decided.

    python examples/watch.py [EVENT] [--out DIR] [--quick]

Watches a bundled event (or a file) frame by frame with the closed-loop likelihood, prints what it
makes of it once a second of the video, and draws why it ends up where it does. --quick watches the
first three seconds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import phase_ppl as ppl

SECONDS_PER_FRAME = 0.25  # as shown to people


def main(name: str, out: Path | None, quick: bool) -> None:
    event = ppl.load_event(name)
    frames = event.observation.trajectory[: 13 if quick else None]
    model = ppl.Model(likelihood=ppl.StepwiseLikelihood())
    with ppl.watch(event.scene, model, event_id=event.id) as watch:
        for number, frame in enumerate(frames):
            post = watch.update(frame)
            if number % 4 == 0:
                goal, share = post.top("goal_red", 1)[0]
                friendly = post.probability(relation="friendly")
                print(f"{number * SECONDS_PER_FRAME:5.1f} s  red: {goal} {share:.2f}; "
                      f"friendly {friendly:.2f}")  # fmt: skip

    print(f"\n{post}")
    best, second = (label for label, _ in post.top("relation", 2))
    found = post.why(f"relation={best}", over=f"relation={second}")
    frame = int(abs(found["change"].values).argmax())
    print(f"\nWhat decided most between {best} and {second}: frame {frame}, by "
          f"{float(found['change'][frame]):+.2f} nats")  # fmt: skip
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        ppl.plot.why(post, f"relation={best}", f"relation={second}", path=out / "why.png")
        ppl.plot.over_time(post, path=out / "over_time.png")
        ppl.watch_film(post, out / "watch.mp4")
        print(f"Drawn into {out}: why.png, over_time.png, watch.mp4")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("event", nargs="?", default="compete", help="bundled, or a file")
    parser.add_argument("--out", type=Path, help="folder for figures and the film")
    parser.add_argument("--quick", action="store_true", help="the first three seconds only")
    options = parser.parse_args()
    main(options.event, options.out, options.quick)
