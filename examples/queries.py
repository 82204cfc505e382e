"""What one can ask a posterior, in Python and in words, and how sure the answers are.

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

    print("Most probable goals of the red agent, with their Monte-Carlo errors")
    for goal, probability in post.top("goal_red", 5):
        print(f"  {probability}  {goal}")

    goal = post.mode("goal_red")
    friendly = post.probability(relation="friendly")
    given = post.probability(relation="friendly", given={"goal_red": goal})
    print(f"\nP(friendly) = {friendly}; given that red's goal is {goal!r}: {given}")

    print("\nThe same in words, as phase-ppl query does")
    for question in (
        f"P(relation=friendly | goal_red={goal})",
        "P(goal_kind_red=item-landmark, goal_kind_green=item-landmark)",
        "P(strength_red > 400)",
        "E[strength_red | relation=friendly]",
        "H(goal_red, goal_green)",
    ):
        print(f"  {question} = {post.query(question)}")

    # a quantity of one's own, from here on like any other
    post.define("same_target", lambda h: h.target_red == h.target_green)
    print(f"\nP(both are after the same thing) = {post.probability(same_target=True)}")
    interval = post.hdi("strength_red", given={"same_target": True})
    (low, high), (low_error, high_error) = interval.values, interval.error.values
    print(f"If so, red's strength is in {low:.0f} ± {low_error:.0f} to "
          f"{high:.0f} ± {high_error:.0f} N with 94 %")  # fmt: skip

    joint = post.joint("goal_red", "goal_green").to_series().nlargest(3)
    print("\nMost probable pairs of goals")
    for (red, green), probability in joint.items():
        print(f"  {probability:.2f}  {red} | {green}")

    print("\nTargets by relation, the five most probable rows of the table of hypotheses")
    table = post.to_dataframe().groupby(["relation", "target_red"])["weight"].sum()
    print(table.nlargest(5).round(3).to_string())
    print(f"\nBest single hypothesis: {post.map()}")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("file", nargs="?", metavar="FILE.nc")
    options.add_argument("--quick", action="store_true", help="fewer simulations")
    main(**vars(options.parse_args()))
