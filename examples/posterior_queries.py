"""What one can ask a posterior: quantities, conditions, your own definitions, words, tables.

python examples/posterior_queries.py
"""

from __future__ import annotations

import dataclasses

import phase_ppl as ppl


def main() -> None:
    event = ppl.load_event("collaborate")
    event = dataclasses.replace(
        event, observation=ppl.Observation(event.observation.trajectory[:20])
    )
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=2))
    post = ppl.infer(event, model)

    print("red wants", *post.top("goal_red", 3))  # probabilities with their Monte-Carlo errors
    goal = post.mode("goal_red")
    print("P(friendly) =", post.probability(relation="friendly"))
    print(
        f"P(friendly | {goal}) =", post.probability(relation="friendly", given={"goal_red": goal})
    )

    post.define("same_target", "target_red = target_green")
    print("P(both are after the same thing) =", post.probability(same_target=True))

    for question in (
        "P(strength_red > strength_green)",
        "P(relation=friendly or target_red = target_green, not alpha=(0, 0))",
        "E[strength_red | relation=friendly]",
        "H(goal_red, goal_green)",
        "I(goal_red; goal_green)",
    ):
        print(f"{question} = {post.query(question)}")

    print(post.joint("goal_red", "goal_green").to_series().nlargest(3))  # xarray, 36 x 36
    table = post.to_dataframe()  # a row per hypothesis, with its weight
    print(table.groupby("relation")["weight"].sum())


if __name__ == "__main__":
    main()
