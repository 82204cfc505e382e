"""What if in other worlds than PHASE: their own names, and helpers follow whom they help."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro import handlers

import phase_ppl as ppl
from phase_ppl.analysis.what_if import Change, _drawn
from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.space import space_of

TRIO = ppl.worlds.TRIO
HOME, FIELD, AWAY = (
    TRIO.goal_index(goal)
    for goal in ("Get blue ball to home", "Get blue ball to field", "Get blue ball away from home")
)
TWO = ("red agent", "green agent")
CLOSED_LOOP = ppl.Model(likelihood=ppl.StepwiseLikelihood(planner_seeds=1))


def sites() -> dict[str, Any]:
    """Red brings a ball home, purple hinders it, green wants it in the field."""
    space = space_of(TRIO)
    return {
        "goal_red": HOME,
        "goal_green": FIELD,
        "goal_purple": 0,
        "company": space.ways.index((None, None, (0, -1))),
        **dict.fromkeys(space.strength_sites, 450.0),
    }


def changed(relation: Any = None, **given: str) -> tuple[int, ...]:
    found = Change.of(TRIO, given, relation=relation).hypothesis(sites())
    return found.effective_goals


def test_whoever_hinders_follows_a_stated_goal_and_not_an_effective_one() -> None:
    assert changed() == (HOME, FIELD, AWAY)
    away_from_field = TRIO.goal_index("Get blue ball away from field")
    assert changed(stated_goal_red="Get blue ball to field") == (FIELD, FIELD, away_from_field)
    assert changed(goal_red="Get blue ball to field") == (FIELD, FIELD, AWAY)
    assert changed(goal_purple="Get blue ball to field") == (HOME, FIELD, FIELD)
    assert changed(relation={("purple agent", "green agent"): "help"}) == (HOME, FIELD, FIELD)
    assert changed(relation={}) == (HOME, FIELD, 0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"goal_blue": "Get blue ball to home"}, "did you mean 'goal_red'"),
        ({"goal_red": "get to red agent"}, "names the agent itself"),
        ({"goal_red": "Get lost"}, "Get lost"),
        ({"strength_red": -1}, "strength_red=-1"),
        ({"remove": "dog"}, "unknown entity 'dog'; allowed: 'red agent'"),
        ({"alpha": (0, 0)}, "expected relation= in the world trio"),
        ({"relation": {("red agent", "red agent"): "help"}}, "another agent"),
        ({"relation": {TWO: "love"}}, "allowed: 'help', 'hinder'"),
        ({"relation": dict.fromkeys((TWO, TWO[::-1]), "help")}, "a goal of its own"),
    ],
)
def test_what_a_world_does_not_have_is_refused(given: dict[str, Any], words: str) -> None:
    said = {name: given.pop(name) for name in ("alpha", "relation", "remove") if name in given}
    with pytest.raises(PhasePPLError, match=words):
        Change.of(TRIO, given, **said)


def test_names_may_have_capitals_and_share_a_first_word() -> None:
    world = ppl.World(["Anna", "small Ben"], ["small", "Big box"], {"home": (8, 8)})
    for number, name in enumerate(world.entities):
        assert Change.of(world, {}, remove=name).removed == (number,)
    assert Change.of(world, {}, remove="big").removed == (3,)
    with pytest.raises(PhasePPLError, match="unknown entity 'the'"):
        Change.of(ppl.World(["the cat", "the dog"], [], {"home": (8, 8)}), {}, remove="the")


def of_one_agent(frames: int) -> tuple[ppl.Event, str]:
    """Return an event of one agent, and its goal."""
    scene = ppl.worlds.SOLO.random_scene(0)
    goal = next(goal for goal in ppl.worlds.SOLO.goals if goal.startswith("get to"))
    return ppl.simulate(scene, goals={scene.world.agents[0]: goal}, frames=frames, seed=0), goal


def test_a_closed_loop_goes_on_from_its_hypotheses() -> None:
    event, goal = of_one_agent(12)
    post = ppl.infer(event, CLOSED_LOOP, progress=False)
    sure = post.do(goal_red=goal, at=8, seconds=3, n=4, workers=1)
    assert sure.tracks.sizes["entity"] == 3
    assert sure.probability("red agent", goal)[1] == 1
    shares = [float((np.array(sure.goals)[:, 0] == code).mean()) for code in range(22)]
    likeliest = event.scene.world.goal_index(post.top("goal_red", 1)[0][0])
    assert shares[likeliest] == max(shares)


def test_ways_are_found_again_in_what_was_read_of_three_agents() -> None:
    scene = TRIO.random_scene(3)
    goals = {"red agent": HOME, "green agent": FIELD}
    event = ppl.simulate(
        scene, goals=goals, relation={("purple agent", "red agent"): "hinder"}, frames=4, seed=0
    )
    post = ppl.infer(event, CLOSED_LOOP, progress=False)
    found = post.do(relation={}, n=6, seconds=0.2, workers=1)
    assert found.poses.shape == (2, 6, 3, 5, 3)
    columns = [post.table.values[f"goal_{key}"].tolist() for key in TRIO.keys]
    seen = set(zip(*columns, strict=True))
    assert set(found.goals) <= seen
    assert "nobody helping or hindering" in " ".join(str(found).split())
    # whoever helped or hindered wants what the prior says, not what it did for or against others
    drawn = _drawn(post.with_prior(seldom)._source(), 4000, 0)
    idle = [one for one in drawn if space_of(TRIO).ways[one["company"]][2] is not None]
    wanted = [Change.of(TRIO, {}, relation={}).hypothesis(one).effective_goals[2] for one in idle]
    assert len(idle) > 200
    assert np.mean(np.array(wanted) == HOME) == pytest.approx(0.7, abs=0.1)
    assert set(wanted) == {HOME, FIELD}


def seldom(world: ppl.World) -> None:
    """Purple wants a ball at home more often than in the field, and nothing else."""
    probs = np.zeros(len(world.goals))
    probs[[HOME, FIELD]] = 0.7, 0.3
    with handlers.block(hide=["goal_purple"]):
        ppl.roles.goals(world)
    numpyro.sample("goal_purple", dist.Categorical(probs=jnp.array(probs)))
    ppl.roles.company(world)
    ppl.roles.strengths(world)


def test_simulated_posteriors_too() -> None:
    event, _ = of_one_agent(8)
    budget = ppl.simulations(4)
    post = ppl.infer(event, kernel="prior_mh", chains=2, budget=budget, workers=1, progress=False)
    names = list(event.scene.world.items[:1])
    without = post.do(remove=names, seconds=0.2, n=2, workers=1)
    assert without.tracks.sel(world="changed", entity=names[0]).isnull().all()
