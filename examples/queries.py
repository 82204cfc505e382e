"""What one can ask a posterior: probabilities, conditionals, joints, intervals, tables.

    python examples/queries.py [FILE.nc] [--quick]

Asks a file that `phase-ppl infer --out` or `Posterior.save` wrote; without one, infers a bundled
event with the fast simulator of own_simulator.py first. --quick makes fewer simulations.
"""

from __future__ import annotations

import argparse

from own_simulator import glide

import phase_ppl as ppl


def main(file: str | None, quick: bool) -> None:
    if file is None:
        event = ppl.load_event("collaborate")
        budget = ppl.simulations(100 if quick else 3000)
        post = ppl.infer(event, ppl.Model(simulator=glide), budget=budget, seed=0, workers=1)
    else:
        post = ppl.Posterior.load(file)

    print("Most probable goals of the red agent")
    for goal, probability in post.top("goal_red", 5):
        print(f"  {probability:.2f}  {goal}")

    goal = post.top("goal_red", 1)[0][0]
    friendly = post.probability(relation="friendly")
    given = post.probability(relation="friendly", given={"goal_red": goal})
    print(f"\nP(friendly) = {friendly:.2f}; given that red's goal is {goal!r}: {given:.2f}")

    items = [goal for goal in ppl.GOALS if "item" in goal]
    print(f"P(both agents care for an item) = "
          f"{post.probability(goal_red=items, goal_green=items):.2f}")  # fmt: skip
    print(f"P(red is stronger than 400 N) = {post.probability(strength_red=(400, 600)):.2f}")
    low, high = post.hdi("strength_red").values
    print(f"Strength of red: {post.mean('strength_red'):.0f} N, 94 % in {low:.0f} to {high:.0f} N")

    joint = post.joint("goal_red", "goal_green").to_series().nlargest(3)
    print("\nMost probable pairs of goals")
    for (red, green), probability in joint.items():
        print(f"  {probability:.2f}  {red} | {green}")

    print("\nGoals by relation, the five most probable rows of the table of hypotheses")
    table = post.to_dataframe().groupby(["relation", "goal_red"])["weight"].sum()
    print(table.nlargest(5).round(3).to_string())
    print(f"\nBest single hypothesis: {post.map()}")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("file", nargs="?", metavar="FILE.nc")
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
