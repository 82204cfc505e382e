"""Goals of one's own in a simulation and in its inference: attained, prevented, found, stored."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.agents.agent import Agent
from phase_ppl.agents.world_model import WorldModel
from phase_ppl.inference.tables import bottom_up_tables
from phase_ppl.models.predicate import ForwardModel
from phase_ppl.physics import compiled
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import State
from phase_ppl.world.names import PredicateKind

NURSERY = ppl.World(
    agents=["red agent"],
    items=["ball", "doll"],
    landmarks={"cot": (4, 4)},
    arena=(0, 24, 0, 20),
    walls=[((12, 0), (12, 7)), ((12, 13), (12, 20))],
    predicates=[
        ppl.Predicate("toys together", "ball", "doll", within=4),
        ppl.Predicate("ball in the playroom", "ball", room=(18, 14)),
        ppl.Predicate("agent near the doll", "red agent", "doll", within=5),
        ppl.Predicate("ball near the cot", "ball", "cot", within=3),
        ppl.Predicate("toys apart", "ball", "doll", beyond=11),
    ],
)
SCENE = NURSERY.scene(
    start={"red agent": (6, 15), "ball": (4, 10), "doll": (9, 5)}, size={"ball": 0.8, "doll": 0.8}
)


@functools.cache
def simulate(goal: str, scene: ppl.Scene = SCENE, frames: int = 60) -> ppl.Event:
    return ppl.simulate(scene, goals={"red agent": goal}, strength=600, frames=frames, seed=0)


@pytest.mark.parametrize("own", NURSERY.predicates, ids=lambda own: own.name)
def test_an_agent_attains_a_goal_of_ones_own_and_is_content(own: ppl.Predicate) -> None:
    track = simulate(own.name).observation.trajectory
    true = own.holds(track, SCENE)
    assert not true[0]
    assert true[-10:].all()


def test_the_cost_of_the_whole_plan_has_the_way_into_the_room_too() -> None:
    own = NURSERY.predicates[1]
    goal, costs = NURSERY.goal_index(own.name), {}
    for cost in ("leg", "plan"):
        config = ppl.PlannerConfig(particles=2, simulations=1, true_state=True, cost=cost)
        model = WorldModel.of(SCENE, [600.0], config)
        agent = Agent(0, (goal,), model, config, np.random.default_rng(0))
        agent.observe(*compiled.from_state(State.at_start(SCENE), SCENE.radius))
        costs[cost] = agent._costs[0, 0]
    way = float(own.apart(SCENE.start[..., :2], SCENE))
    assert way > 5
    assert costs["leg"] == pytest.approx(np.hypot(2, 5))
    assert costs["plan"] == pytest.approx(np.hypot(2, 5) + way)


def test_an_agent_prevents_what_is_true_at_first() -> None:
    scene = NURSERY.scene(
        start={"red agent": (6, 15), "ball": (7, 6), "doll": (9, 5)},
        size={"ball": 0.8, "doll": 0.8},
    )
    together = NURSERY.predicates[0]
    true = together.holds(simulate("not toys together", scene).observation.trajectory, scene)
    assert true[0]
    assert not true[-10:].any()


def test_what_it_does_is_said_in_words_and_in_literals_of_all_worlds() -> None:
    event = simulate("toys together")
    assert "brings the ball to the doll" in ppl.explain(event)
    assert "as it has what it wants" in ppl.explain(event)
    assert all(
        one.predicate is not PredicateKind.USERS for step in event.thoughts.subgoals for one in step
    )


def test_the_closed_loop_finds_it_and_its_posterior_is_kept(tmp_path: Path) -> None:
    event = simulate("toys together", frames=30)
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1))
    post = ppl.infer(event, model)
    assert float(post.query("P(goal_red = toys together)")) > 0.5
    post.save(tmp_path / "post.nc")
    back = ppl.load_posterior(tmp_path / "post.nc")
    assert float(back.query("P(goal_red = not toys together)")) < 0.1
    assert back.top("goal_red", 1)[0][0] == "toys together"


def test_simple_proposes_it() -> None:
    event = simulate("ball in the playroom", frames=24)
    settings = ppl.SimpleSettings().settled(NURSERY)
    tables = bottom_up_tables(event.scene, event.observation, settings)
    found = np.asarray(tables.goal_logits)[-1, 0].argmax()
    assert NURSERY.goals[found] == "ball in the playroom"


def test_random_goals_know_it() -> None:
    drawn = {ppl.roles.draw(NURSERY, seed).effective_goals[0] for seed in range(120)}
    assert drawn >= {NURSERY.goal_index(own.name) for own in NURSERY.predicates}


def test_what_knows_no_predicates_of_ones_own_says_so() -> None:
    with pytest.raises(InvalidSettingError, match="knows no user-defined predicates, such as"):
        ForwardModel(SCENE)
