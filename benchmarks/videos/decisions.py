"""Teacher-forced: would our agents do what the real ones did, state by state?

The true state is followed along the video: our physics with the recovered actions, corrected by
the observed positions and angles after each step. Both agents decide in each state. They know
their true goals, and their beliefs come from what they could have seen. A decision agrees if it
would have had the same effect as the real action. Without chaos, planners are told apart with far
less noise than by whole trajectories.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import common
import numpy as np
from numpy.typing import NDArray

from phase_ppl.agents.agent import Agent
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import N_ACTIONS, Action, executed
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS
from phase_ppl.world.scene import PHASE
from videos.replay import actions_of, scene_of

SAME_PLACE, SAME_VELOCITY = 0.01, 0.05
LOST = 0.5
"""The state has been lost if an entity must be moved by more than this, units."""

LAPSE = 0.05
"""Share of actions taken at random, in the log-likelihood."""

# landmark of the video -> landmark of the original, by the reflection of the copy
SWAPPED = {
    "none": {},
    "up-down": {"blue": "yellow", "green": "red"},
    "left-right": {"blue": "green", "yellow": "red"},
    "about y=x": {"blue": "red"},
    "about y=-x": {"green": "yellow"},
}
# angle of the video -> (offset - angle) in the original
MIRRORED = {
    "up-down": math.pi,
    "left-right": 0.0,
    "about y=x": -math.pi / 2,
    "about y=-x": math.pi / 2,
}


class Task(NamedTuple):
    video: dict[str, Any]
    event: Event
    planner: PlannerConfig
    repeats: int


def original_goal(goal: str, reflection: str) -> int:
    """Return a goal of a video in the frame of the original recording."""
    swapped = SWAPPED[reflection]
    both_ways = swapped | {b: a for a, b in swapped.items()}
    words = goal.split()
    if words[-1] == "lm":
        words[-2] = both_ways.get(words[-2], words[-2])
    return GOALS.index(" ".join(words))


def original_angles(event: Event, reflection: str) -> FloatArray:
    """Return (time, 2) angles of the agents in the frame of the original recording, rad."""
    angles = event.observation.trajectory[:, :2, 2]
    return angles if reflection == "none" else MIRRORED[reflection] - angles


class State(NamedTuple):
    bodies: FloatArray
    held: NDArray[np.int64]
    weld: FloatArray

    def copy(self) -> State:
        return State(self.bodies.copy(), self.held.copy(), self.weld.copy())


def states(task: Task, params: compiled.Params) -> Iterator[tuple[State, tuple[int, int]]]:
    """Yield the state before each step and the actions that the agents then took."""
    video, scene = task.video, scene_of(task.video)
    start = PymunkWorld(scene, tuple(video["strength_newton"]), 4).state
    state = State(*compiled.from_state(start, scene.radius))
    angles = original_angles(task.event, video["reflection"])
    scratch, frame = compiled.make_scratch(), np.empty((4, 3))
    rows = np.array(video["rows"])
    for t, pair in enumerate(actions_of(video)):
        yield state.copy(), pair
        compiled.step_mean(*state, np.array(pair), params, scratch, frame)
        off = rows[t + 1] - frame[:, :2]
        if np.abs(off).max() > LOST or t + 1 >= len(angles):
            return
        state.bodies[:, :2] += off
        turn = angles[t + 1] - frame[:2, 2]
        turn = (turn + math.pi) % (2 * math.pi) - math.pi
        # the angles of two kinds of copies are off where they were wrapped before averaging
        state.bodies[:2, 2] += np.where(np.abs(turn) < LOST, turn, 0.0)


def equivalent(
    state: State, pair: tuple[int, int], agent: int, params: compiled.Params
) -> NDArray[np.bool_]:
    """Return (14, 14) which actions of an agent have the same effect in this state."""
    scratch = compiled.make_scratch()
    ends = np.empty((N_ACTIONS, 4, 9))
    holds = np.empty((N_ACTIONS, 2))
    for action in range(N_ACTIONS):
        trial = state.copy()
        red, green = (executed(action, "ccw") if a == agent else pair[a] for a in range(2))
        compiled.step(*trial, np.array([red, green]), params, scratch)
        ends[action], holds[action] = trial.bodies, trial.held
    off = np.abs(ends[:, None] - ends[None])
    same = (off[..., :3].max((2, 3)) < SAME_PLACE) & (off[..., 3:5].max((2, 3)) < SAME_VELOCITY)
    return same & (holds[:, None] == holds[None]).all(2)


def judge(task: Task) -> list[dict[str, Any]]:
    """Return one record per step, agent and repeat of a video."""
    video, truth = task.video, task.event.truth
    scene, strengths = scene_of(video), tuple(video["strength_newton"])
    goals = tuple(
        original_goal(goal, video["reflection"]) for goal in (truth.goal_red, truth.goal_green)
    )
    world = compiled.make_params(scene, strengths, inner_steps=4)
    model = WorldModel.of(scene, strengths, task.planner)
    agents = [
        [
            Agent(a, goals, model, task.planner, np.random.default_rng([a, repeat]))
            for repeat in range(task.repeats)
        ]
        for a in range(2)
    ]
    records = []
    for t, (state, pair) in enumerate(states(task, world)):
        for a in range(2):
            same = equivalent(state, pair, a, world)
            decisions = []
            for agent in agents[a]:
                decisions.append(agent.decide(*state))
                agent.acted(Action(pair[a]))
            chosen = [int(decision.action) for decision in decisions]
            others = ~np.eye(len(chosen), dtype=bool)
            with_itself = float(np.mean(same[np.ix_(chosen, chosen)][others]))
            for decision in decisions:
                subgoal, root = decision.intent.subgoal, decision.root
                alike = same[pair[a], root.actions]
                share = float(root.visits[alike].sum() / root.visits.sum())
                chance = float(same[pair[a]].mean())
                records.append(
                    {
                        "step": t,
                        "agent": a,
                        "holds": bool(state.held[a] >= 0),
                        "subgoal": PHASE.words(subgoal),
                        "kind": kind(subgoal, a),
                        "role": role(truth, goals[a], kind(subgoal, a)),
                        "action": int(decision.action),
                        "real": pair[a],
                        "agrees": bool(same[pair[a], decision.action]),
                        "agrees_with_itself": with_itself,
                        "log_likelihood": math.log((1 - LAPSE) * share + LAPSE * chance),
                    }
                )
    return records


def kind(subgoal: Any, agent: int) -> str:
    """Return predicate, sign and whether it is about the agent itself, the other or an item."""
    who = "item" if subgoal.subject >= 2 else ("self" if subgoal.subject == agent else "other")
    if subgoal.predicate.name == "STOP":
        return "STOP"
    return f"{'' if subgoal.positive else 'not '}{subgoal.predicate.name} {who}"


def role(truth: Truth, goal: int, kind: str) -> str:
    """Return in opposing videos whether an agent hinders, and of those that do the subgoal."""
    if truth.scenario != "opposing":
        return ""
    return f"hinders: {kind}" if "away" in GOALS[goal].split() else "is hindered"


def add_options(parser: argparse.ArgumentParser) -> None:
    common.add(parser, "half")
    common.add_planner(parser)
    parser.add_argument(
        "--repeats",
        type=int,
        default=2,
        help="decisions per state, with different seeds; at least 2",
    )
    parser.add_argument("--records", help="write every decision to this JSON file")


def main(options: argparse.Namespace) -> dict[str, Any]:
    planner = common.planner_of(options)
    events = {event.id: event for event in common.dev_events(options.half)}
    JointSimulator(planner).warm_up()
    tasks = [
        Task(video, events[video["id"]], planner, options.repeats)
        for video in common.replays()
        if video["id"] in events
    ]
    records = []
    for task, found in common.parallel(judge, tasks, "videos"):
        of_video = {"video": task.event.id, "scenario": task.event.truth.scenario}
        records += [row | of_video for row in found]
    common.write({"records": records}, options.records)

    def figures(group: list[dict[str, Any]]) -> dict[str, Any]:
        mean = {
            name: float(np.mean([row[name] for row in group]))
            for name in ("agrees", "agrees_with_itself", "log_likelihood")
        }
        return {"n": len(group)} | mean

    report: dict[str, Any] = figures(records) | {"planner": planner.to_dict()}
    for key in ("scenario", "kind", "role"):
        names = sorted({row[key] for row in records if row[key]})
        report[f"by_{key}"] = {
            name: figures([row for row in records if row[key] == name]) for name in names
        }
    print(f"{'':24} {'n':>6}  agrees  with itself  log-likelihood")
    groups = [report[f"by_{key}"].items() for key in ("scenario", "kind", "role")]
    for name, row in [("all", report), *itertools.chain(*groups)]:
        print(
            f"{name:24} {row['n']:6d}  {row['agrees']:6.3f}  {row['agrees_with_itself']:11.3f}"
            f"  {row['log_likelihood']:14.3f}"
        )
    return report
