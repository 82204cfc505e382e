"""Your own simulator, sampled by a kernel as whole videos, and in the closed loop.

python examples/own_simulator.py
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist

import phase_ppl as ppl
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.names import PredicateKind

GOALS = {
    "goal_red": ("get to green agent", "Get red agent to red lm", "Get red agent to blue lm"),
    "goal_green": ("get to red agent", "Get green agent to red lm", "Get green agent to blue lm"),
}


class Walkers:
    """Each agent's goal entity goes straight to its target. Stronger agents are faster."""

    spread = 0.15  # of every body's step, units

    def expected(self, scene: ppl.Scene, hypothesis: ppl.Hypothesis, now: FloatArray) -> FloatArray:
        found = now.copy()
        for agent, goal in enumerate(hypothesis.effective_goals):
            wanted = goal_literal(goal, agent)
            to_landmark = wanted.predicate is PredicateKind.ON
            target = (
                scene.landmark_centres[wanted.target] if to_landmark else now[wanted.target, :2]
            )
            way = (target - now[wanted.subject, :2]) * (1 if wanted.positive else -1)
            pace = hypothesis.strengths[agent] / 2000 / max(np.linalg.norm(way), 1.0)
            found[wanted.subject, :2] += pace * way
        return found

    def __call__(
        self, scene: ppl.Scene, hypothesis: ppl.Hypothesis, rng: np.random.Generator
    ) -> Iterator[FloatArray]:
        now = scene.start.copy()
        while True:
            yield now
            now = self.expected(scene, hypothesis, now)
            now[:, :2] += rng.normal(0, self.spread, (4, 2))

    def log_prob_next(
        self, scene: ppl.Scene, hypothesis: ppl.Hypothesis, seen: FloatArray, frame: FloatArray
    ) -> float:
        off = (frame - self.expected(scene, hypothesis, seen[-1]))[:, :2] / self.spread
        return float(-0.5 * (off**2).sum() - 8 * np.log(self.spread * np.sqrt(2 * np.pi)))


def few_goals() -> None:
    """Each agent has one of three goals, or helps or hinders the other."""
    for site, goals in GOALS.items():
        codes = jnp.array([ppl.GOALS.index(goal) for goal in goals])
        probs = jnp.zeros(len(ppl.GOALS)).at[codes].set(1 / 3)
        numpyro.sample(site, dist.Categorical(probs=probs))
    ppl.sites.alpha()
    ppl.sites.strengths()


def main() -> None:
    scene, simulator = ppl.load_event("compete").scene, Walkers()
    truth = ppl.Hypothesis(GOALS["goal_red"][1], GOALS["goal_green"][0], strength_red=300.0)
    frames = simulator(scene, truth, np.random.default_rng(4))
    event = ppl.Event(scene, ppl.Observation([next(frames) for _ in range(30)]), id="walkers")
    print(f"truth: {truth}")
    closed_loop = ppl.Model(few_goals, simulator, ppl.ClosedLoopLikelihood())
    sampling = {"kernel": "importance", "chains": 20, "iterations": 10}
    for name, model, options in (
        ("200 whole videos", ppl.Model(few_goals, simulator), sampling),
        ("closed loop", closed_loop, {}),
    ):
        clock = time.perf_counter()
        post = ppl.infer(event, model, workers=1, progress=False, **options)
        print(f"\n{name}, {time.perf_counter() - clock:.1f} s")
        for question in (*GOALS, "relation"):
            print("  ", question, *post.top(question, 1)[0])
    found = post.over_time()["goal_red"].sel(goal_red_is=GOALS["goal_red"][1]).values
    print("\nof red's goal, by the closed loop, after 0, 1, 2, ... steps:", found[:8].round(2))


if __name__ == "__main__":
    main()
