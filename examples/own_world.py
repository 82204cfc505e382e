"""Your own world: agents, rooms and goals. Simulate a video of it, and infer who wants what.

python examples/own_world.py
"""

from __future__ import annotations

import phase_ppl as ppl

NURSERY = ppl.World(
    agents=["Ann", "Ben"],
    items=["ball"],
    landmarks={"cot": (4, 4), "window": (20, 16)},
    arena=(0, 24, 0, 20),
    walls=[((12, 0), (12, 7)), ((12, 13), (12, 20))],
    predicates=[ppl.Predicate("ball in the playroom", "ball", room="window")],  # your own goal
)


def main() -> None:
    print(len(NURSERY.goals), "goals, such as", ", ".join(NURSERY.goals[-4:]))
    scene = NURSERY.scene(
        start={"Ann": (6, 15), "Ben": (18, 6), "ball": (9, 10)},
        size={"ball": 0.8},
    )
    event = ppl.simulate(
        scene,
        goals={"Ann": "ball in the playroom", "Ben": "get to Ann"},
        strength=600,
        frames=24,
        seed=0,
    )
    print(event.truth)
    ppl.render.strip(event, "nursery.png", n=4)

    post = ppl.infer(event, ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1)))
    print("Ann:", *post.top("goal_ann", 2))
    print("Ben:", *post.top("goal_ben", 2))
    print("P(Ben helps) =", post.query("P(alpha_ben_ann = 1)"))
    # what could be believed at each frame; one set of searches gives no errors, so no bands
    ppl.plot.over_time(post).savefig("over_time.png")


if __name__ == "__main__":
    main()
