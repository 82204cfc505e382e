"""Compiled model against pymunk: one transition, one decision, and do they decide alike?"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import common
import numpy as np
from _pytest.outcomes import Skipped

from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import N_ACTIONS
from phase_ppl.physics.constants import IMAGINATION_ITERATIONS
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.world.event import State
from phase_ppl.world.goals import goal_index
from phase_ppl.world.scene import Scene
from speed.scenes import STRENGTHS, contact_mix, crowded, undecided
from tests.agents.oracle import OracleAgent
from tests.physics.test_agreement import Box2DWorld

REPEATS = 9
GOALS = (goal_index("Get blue item to red lm"), goal_index("Get pink item to green lm"))


def interleaved(work: dict[str, Callable[[], Any]], repeats: int = REPEATS) -> dict[str, float]:
    """Return the median CPU seconds of each piece of work, run in turn."""
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for name in work:
        work[name]()
    for _ in range(repeats):
        for name, do in work.items():
            clock = time.process_time()
            do()
            seconds[name].append(time.process_time() - clock)
    return {name: float(np.median(values)) for name, values in seconds.items()}


def transitions() -> dict[str, Any]:
    """Restore a state, apply both actions for five substeps, read the state; equal recipe."""
    n = 400
    mix, scene = contact_mix(n), crowded()
    params = compiled.make_params(scene, STRENGTHS, inner_steps=1)
    arrays = [compiled.from_state(state, scene.radius) for state, _ in mix]
    actions = np.array([pair for _, pair in mix])
    bodies = np.array([a[0] for a in arrays])
    held = np.array([a[1] for a in arrays])
    weld = np.array([a[2] for a in arrays])
    scratch = compiled.make_scratch()
    rounds = 20
    many = _many()

    def fast() -> None:
        many(bodies, held, weld, actions, rounds, params, scratch)

    world = PymunkWorld(
        scene, STRENGTHS, 1, State.at_start(scene), iterations=IMAGINATION_ITERATIONS
    )

    def slow() -> None:
        for state, pair in mix:
            world.restore(state)
            for _ in world.substeps(pair):
                pass
            _ = world.state

    work = {"compiled": fast, "pymunk": slow}
    with contextlib.suppress(Skipped):  # its wheel is for Python 3.11
        original = Box2DWorld(scene, STRENGTHS)
        work["box2d"] = lambda: _by_box2d(original, mix)
    seconds = interleaved(work)
    each = {name: 1e6 * seconds[name] / n for name in work}
    each["compiled"] /= rounds
    report = {f"transition_us_{name}": took for name, took in each.items()}
    report["transition_speedup"] = each["pymunk"] / each["compiled"]
    if "box2d" in each:
        report["transition_speedup_over_box2d"] = each["box2d"] / each["compiled"]
    return report


def _by_box2d(world: Box2DWorld, mix: list[tuple[State, tuple[int, int]]]) -> None:
    """The same with the original's engine; items that are held are loose there, and cost less."""
    for state, pair in mix:
        for body, pose, velocity, spin in zip(
            world.bodies, state.pose, state.velocity, state.spin, strict=True
        ):
            body.transform = pose[:2].tolist(), float(pose[2])
            body.linearVelocity, body.angularVelocity = velocity.tolist(), float(spin)
        world.step(pair)


def _many() -> Callable[..., None]:
    import numba

    step = compiled.step

    @numba.njit(nogil=True)
    def many(bodies, held, weld, actions, rounds, params, scratch):  # type: ignore[no-untyped-def]
        body, hold, rod = bodies[0].copy(), held[0].copy(), weld[0].copy()
        for _ in range(rounds):
            for k in range(bodies.shape[0]):
                body[:], hold[:], rod[:] = bodies[k], held[k], weld[k]
                step(body, hold, rod, actions[k], params, scratch)

    return many  # type: ignore[no-any-return]


def agents(config: PlannerConfig, seed: int, scene: Scene) -> dict[str, Agent]:
    """Return agents with the compiled and the slow search, of equal settings and beliefs."""
    world_model = WorldModel.of(scene, STRENGTHS, config)
    made = {
        "compiled": Agent(0, GOALS, world_model, config, np.random.default_rng(seed)),
        "pymunk": OracleAgent(
            0, GOALS, world_model, config, np.random.default_rng(seed), STRENGTHS
        ),
    }
    for agent in made.values():
        agent.observe(*compiled.from_state(State.at_start(scene), scene.radius))
    return made


def decisions() -> dict[str, Any]:
    """One decision by 1000 simulations, without early stop, from the same beliefs."""
    config = PlannerConfig(swivel=False, full_observation=True, early_stop=False)
    made = agents(config, 0, crowded())
    intent = made["compiled"].intent
    seconds = interleaved(
        {
            name: lambda agent=agent: agent.root_statistics([intent])  # type: ignore[misc]
            for name, agent in made.items()
        },
        repeats=5,
    )
    return {
        "decision_ms_compiled": 1e3 * seconds["compiled"],
        "decision_ms_pymunk": 1e3 * seconds["pymunk"],
        "decision_speedup": seconds["pymunk"] / seconds["compiled"],
    }


class Draw(NamedTuple):
    scene: str
    engine: str
    seed: int
    simulations: int


def choose(draw: Draw) -> dict[str, Any]:
    """Return the action that an engine's agent chooses first."""
    config = PlannerConfig(swivel=False, full_observation=True, simulations=draw.simulations)
    agent = agents(config, draw.seed, undecided()[draw.scene])[draw.engine]
    return {"action": int(agent.root_statistics([agent.intent])[0].best)}


def histograms(seeds: int, kept: Path | None = None, simulations: int = 1000) -> dict[str, Any]:
    """Total variation between the engines' first actions, and between sets of seeds of one.

    Where one action is as good as certain both are 0 whatever the engine: the share of the most
    frequent action is reported beside.

    Args:
        seeds: draws of each engine in each scene.
        kept: where the draws are kept as they come, so that a stopped run goes on.
        simulations: at most so many a decision.
    """
    groups = {
        "compiled": ("compiled", range(seeds)),
        "again": ("compiled", range(seeds, 2 * seeds)),
        "pymunk": ("pymunk", range(seeds)),
    }
    draws = {
        (scene, name): [Draw(scene, engine, seed, simulations) for seed in chosen]
        for scene in undecided()
        for name, (engine, chosen) in groups.items()
    }
    tasks = [draw for group in draws.values() for draw in group]
    settings = {"simulations": simulations}
    found = common.resumed(choose, tasks, str, "oracle", kept, settings)
    actions = {draw: result["action"] for draw, result in zip(tasks, found, strict=True)}
    counts = {
        key: np.bincount([actions[draw] for draw in group], minlength=N_ACTIONS) / seeds
        for key, group in draws.items()
    }

    def distance(scene: str, other: str) -> float:
        return float(np.abs(counts[scene, "compiled"] - counts[scene, other]).sum() / 2)

    scenes = {
        scene: {
            "tv": distance(scene, "pymunk"),
            "tv_between_seeds": distance(scene, "again"),
            "most_frequent": float(counts[scene, "compiled"].max()),
        }
        for scene in undecided()
    }
    return {
        "oracle_scenes": scenes,
        "oracle_tv": max(scene["tv"] for scene in scenes.values()),
        "oracle_tv_beyond_seeds": max(
            scene["tv"] - max(0.1, scene["tv_between_seeds"]) for scene in scenes.values()
        ),
        "oracle_seeds": seeds,
    }
