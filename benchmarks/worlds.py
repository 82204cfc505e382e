"""Who wants what in `solo` and `trio`, by the closed loop or by simulations.

    python benchmarks/worlds.py [--world NAME] [--events N] [--planner-seeds N] [--out DIR]
        [--kernel local_mh --simulations 105]

Events are made by ``phase_ppl.generate``; all own goals are to get somewhere. They are answered by
the closed loop, by predicate inverse planning and by the last frame, and with ``--kernel`` by
simulations. Many goals may be true in the last frame, so its figure is the probability that it
leaves the true goal. A run continues from what is in DIR.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import common
import numpy as np

import phase_ppl as ppl
from phase_ppl.evaluation.table import kinds_of, true_answers
from phase_ppl.world.hypothesis import Hypothesis

FRAMES = 90
TRIES = 50


def main() -> None:
    parser = common.parser(__doc__, "workers", "json")
    parser.add_argument("--world", default="solo", choices=[*ppl.worlds.available()][1:])
    parser.add_argument("--events", type=int, default=40)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--planner-seeds", type=int, default=1)
    parser.add_argument("--kernel", help="also infer by simulations, with this kernel")
    parser.add_argument("--simulations", type=int, default=105, help="budget of the kernel")
    parser.add_argument("--out", metavar="DIR", type=Path, help="keeps events and answers")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(options, options.out or Path(folder))


def measure(options: argparse.Namespace, out: Path) -> None:
    """Make the events, evaluate the models on them and print what they got right."""
    given = {"workers": options.workers, "resume": True}
    events = ppl.generate(
        out / "set",
        options.events,
        world=options.world,
        roles=to_get_somewhere,
        frames=options.frames,
        max_tries=TRIES,
        seed=options.seed,
        **given,
    )
    seeds = options.planner_seeds
    read = ppl.evaluate(
        events,
        "closed_loop",
        planner_seeds=seeds,
        seed=options.seed,
        out=out / "closed_loop",
        **given,
    )
    symbolic = ppl.evaluate(events, "predicate", out=out / "predicate", **given)
    last = ppl.evaluate(events, "last_frame", out=out / "last_frame", **given)
    costs = [
        read.predictions[event.id].cost for event in read.events if event.id in read.predictions
    ]
    frames = options.frames - 1
    per_frame = {
        name: float(np.mean([cost[name] for cost in costs])) / frames
        for name in ("cpu_seconds", "searches")
    }
    left = probability_of_true_goals(last)
    print(read, symbolic, sep="\n\n")
    print(f"\nlast frame: {left:.2f}; {per_frame['cpu_seconds']:.3f} CPU seconds and "
          f"{per_frame['searches']:.0f} searches a frame")  # fmt: skip
    models = {"closed_loop": read, "predicate": symbolic, "last_frame": last}
    if options.kernel:
        models[options.kernel] = ppl.evaluate(
            events,
            "simple",
            kernel=options.kernel,
            budget=ppl.simulations(options.simulations),
            seed=options.seed,
            out=out / options.kernel,
            **given,
        )
        print(f"\n{models[options.kernel]}")
    report = {name: found.metrics for name, found in models.items()}
    report["closed_loop"]["per_frame"] = per_frame
    report["last_frame"]["probability_of_true_goal"] = left
    common.write(report, options.json)


def to_get_somewhere(world: ppl.World, seed: int) -> Hypothesis | None:
    """Draw a hypothesis; None where somebody wants to get or keep something away."""
    drawn = ppl.roles.draw(world, seed)
    own = [
        goal for goal, other in zip(drawn.goals.values(), drawn.towards, strict=True) if not other
    ]
    return None if any(" away from " in goal for goal in own) else drawn


def probability_of_true_goals(evaluation: ppl.Evaluation) -> float:
    """Return the mean over events and agents of what is given to the true goal."""
    world = evaluation.events[0].scene.world
    found = [
        evaluation.predictions[event.id].estimate(question, true_answers(event)[question])
        for event in evaluation.events
        for question in kinds_of(world)["goal"]
    ]
    return float(np.mean(found))


if __name__ == "__main__":
    main()
