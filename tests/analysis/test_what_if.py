"""Hypotheses of a posterior simulated anew, with something changed; causes are known here."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro import handlers
from scipy.stats import multinomial

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis import what_if
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.what_if import Change, WhatIf, _drawn
from phase_ppl.closed_loop.hidden_state import Tracking, reconstructed
from phase_ppl.models.effective import prior_of_pairs, prior_table
from phase_ppl.physics import pymunk_world
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, PhasePPLError
from phase_ppl.world.geometry import is_on
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import NOTHING
from phase_ppl.world.scene import PHASE
from phase_ppl.world.space import space_of
from phase_ppl.world.worlds import SOLO
from tests.agents.scenes import scene
from tests.analysis.factory import Simulation, hypothesis, make_tree, with_log_weight, with_prior
from tests.analysis.readings import CAST, LEVELS, QUICK, of_three, reading
from tests.inference import runs

PULL = ppl.Hypothesis("Get blue item to red lm", "Get blue item away from red lm", (0, 0), 300, 600)
PLANNER = PlannerConfig(simulations=30, particles=10, paired=True)
LAST, LONG = 19, 35 / 12


@pytest.fixture(scope="module")
def contested() -> Iterator[ppl.Posterior]:
    """Green, the stronger one, keeps an item away from where red wants it, as is known for sure.

    What its video shows is read from the frames, which takes longer than to go on: it is done once.
    """
    where = scene((13.0, 7.0, -1.5), (18.5, 8.0, 1.5), (16.0, 7.0), (8.0, 20.0))
    event = ppl.simulate(where, PULL, frames=LAST + 1, planner=PLANNER)
    track = event.observation.trajectory
    tree = make_tree([Simulation(PULL)], [[0]], scene=where, observed=track, predicted=track[None])
    tree.attrs["settings"] = json.dumps({"model": {"planner": PLANNER.to_dict()}})
    found: dict[bytes, Any] = {}

    def remembered(where: ppl.Scene, observed: np.ndarray, tracking: None) -> Any:
        key = observed.tobytes()
        if key not in found:
            found[key] = reconstructed(where, observed, tracking)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(what_if, "reconstructed", remembered)
        yield ppl.Posterior(tree)


@pytest.fixture(scope="module")
def alone(contested: ppl.Posterior) -> WhatIf:
    return contested.do(remove="green agent", seconds=LONG, n=6, workers=1)


def told(found: object) -> str:
    """Return what is printed, without line breaks."""
    return " ".join(str(found).split())


def test_without_who_is_in_its_way_an_agent_reaches_its_goal(alone: WhatIf) -> None:
    before, after = alone.probability("red")
    assert after == 1
    assert before < after
    assert alone.difference("red") == pytest.approx(after - before)
    assert "may be chance" in told(alone)  # five pairs differ
    poses = np.concatenate([alone.poses] * 2, axis=1)
    twice = dataclasses.replace(alone, poses=poses, goals=[*alone.goals] * 2)
    assert "the green agent was in its way" in told(twice)
    more = dataclasses.replace(twice, is_removal=False)
    assert "was in its way" not in told(more)  # it may be due to what else was changed
    assert ": more often" in told(more)
    removal = Change.of(PHASE, {}, remove="green agent")
    assert removal.is_removal
    also = ({"strength_red": 300.0}, {}), ({"goal_red": 3}, {}), ({}, {"walls": []})
    assert not any(Change.of(PHASE, a, remove="green agent", **b).is_removal for a, b in also)
    assert "the green agent reaches" not in told(alone)
    own = ppl.GOALS[alone.goals[0][0]]
    assert f"the red agent reaches its goal ({own}): probability " in told(alone)
    differing = dataclasses.replace(alone, goals=[*alone.goals[:-1], (3, 3)])
    several = f". Goals drawn: {own} (5), {ppl.GOALS[3]} (1)"
    assert several in told(differing)
    for row, seconds in enumerate(alone.reached("red").sel(world="changed").values):
        pose = alone.poses[1, row, round(seconds * 12), 2, :2]
        assert is_on(pose, alone.scenes[0].landmark_centres[2], 2.5)
    assert alone.tracks.sel(world="changed", entity="green agent").isnull().all()
    assert not alone.tracks.sel(entity="red agent").isnull().any()


@pytest.mark.parametrize(("n", "differing"), [(2, 1.0), (4, 0.5), (6, 1.0)])
def test_chance_is_rarely_taken_for_a_change(alone: WhatIf, n: int, differing: float) -> None:
    """Of pairs that differ, either world is the better one as often as the other."""
    there = alone.poses[1, 0]
    away = np.repeat(there[:1], len(there), axis=0)
    both = {1: [away, there], -1: [there, away], 0: [away, away]}
    wrong = 0.0
    law = multinomial(n, [differing / 2, differing / 2, 1 - differing])
    for rows in itertools.combinations_with_replacement((1, -1, 0), n):
        poses = np.stack([both[row] for row in rows], axis=1)
        goals = [alone.goals[0]] * n
        found = dataclasses.replace(alone, poses=poses, goals=goals)
        if "may be chance" not in told(found):
            wrong += law.pmf([rows.count(row) for row in both])
        # errors are as if there had been one more of either sort
        change = found.difference("red")
        assert change == pytest.approx(np.mean(rows))
        assert change.error == pytest.approx(np.std([*rows, 1, -1]) / np.sqrt(n + 2))
        reached = [row == -1 for row in rows]
        expected = np.std([*reached, True, False]) / np.sqrt(n + 2)
        assert found.probability("red")[0].error == pytest.approx(expected)
    assert wrong <= 0.05  # it was 0.50, 0.07, 0.22


def test_from_a_frame_on_what_was_seen_has_happened(contested: ppl.Posterior) -> None:
    later = contested.do(goal_green="Get green agent to green lm", at=LAST, seconds=1.5, n=2,
                         workers=1)  # fmt: skip
    observed = contested.observed()
    assert (later.poses[:, :, 0] == observed[LAST]).all()
    assert np.linalg.norm(np.diff(later.poses[:, :, :3, :, :2], axis=2), axis=-1).max() < 2
    assert later.poses.shape[2] == 19
    gap = np.linalg.norm(later.poses[:, :, -1, 1, :2] - [23.5, 19.5], axis=-1)
    assert (gap[1] < gap[0]).all()
    following = contested.predict(0.5, n=2, workers=1)  # what comes next as it is
    np.testing.assert_array_equal(following.poses[0], later.poses[0, :, :7])
    assert float(following.tracks["time"][0]) == pytest.approx(LAST / 12)
    assert following.tracks.sizes["world"] == 1
    assert " with " not in str(following)
    with pytest.raises(InvalidSettingError, match="nothing was changed"):
        following.difference("red")

    past = what_if.reconstructed(contested.scene, observed, None)  # what it goes on from
    assert len(past.states) == len(past.actions) + 1 == LAST + 1
    poses = np.array([state.pose[:, :2] for state in past.states])
    assert np.abs(poses - observed[..., :2]).max() < 0.7
    assert (past.states[-1].held != NOTHING).any()
    rng, roles = np.random.default_rng(0), Hypothesis.of(SOLO, {"red agent": "ball to field"})
    elsewhere = ppl.JointSimulator().steps(SOLO.random_scene(0), roles, rng, past)
    with pytest.raises(InvalidEventError, match="past: 4 entities, expected the 3 of"):
        next(elsewhere)


def test_the_same_seeds_give_the_same_worlds(contested: ppl.Posterior) -> None:
    nothing = contested.do(strength_red=300.0, n=2, workers=1, seconds=0.5)
    np.testing.assert_array_equal(nothing.poses[0], nothing.poses[1])
    assert nothing.difference("red") == 0
    assert "may be chance" in told(nothing)


def test_what_was_read_goes_on_from_the_past_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    likelihood = ppl.ClosedLoopLikelihood(tracking=Tracking(LEVELS, noise=0.02))
    settings = {"likelihood": likelihood.to_dict(), "model": {"planner": PLANNER.to_dict()}}
    followed: list[Any] = []
    monkeypatch.setattr(
        what_if, "reconstructed", lambda *given: followed.append(given[2]) or reconstructed(*given)
    )
    post = ClosedLoopPosterior(reading(settings=json.dumps(settings)))
    assert post.predict(0.25, n=2, workers=1).poses.shape[:2] == (1, 2)
    assert followed == [likelihood.tracking]


def test_walls_are_moved_and_items_removed(contested: ppl.Posterior) -> None:
    closed = [[[16.0, 12.0], [16.0, 2.0]], [[16.0, 12.0], [16.0, 22.0]]]
    shut = contested.do(walls=closed, remove=["pink item"], seconds=1, n=2, workers=1)
    assert (shut.poses[1, :, :, 0, 0] < 16).all()
    assert shut.scenes[1].rooms.door_width[2] == pytest.approx(0)
    assert told(shut).count("other walls") == 2
    assert shut.tracks.sel(world="changed", entity="pink item").isnull().all()


def test_what_was_removed_is_in_no_room_and_near_nothing() -> None:
    world = ppl.World(
        ["anna"],
        ["ball", "doll"],
        {"home": (4, 4)},
        arena=(0, 24, 0, 20),
        walls=[((12, 0), (12, 7)), ((12, 13), (12, 20))],
        predicates=[
            ppl.Predicate("ball in the den", "ball", room=(4, 4)),
            ppl.Predicate("toys together", "ball", "doll", within=4),
            ppl.Predicate("toys apart", "ball", "doll", beyond=4),
        ],
    )
    where = world.scene({"anna": (6, 16), "ball": (4, 10), "doll": (7, 10)})
    poses = np.repeat(where.start[None, None, None], 2, axis=0)
    poses[1, :, :, 1:, :2] = pymunk_world.AWAY
    found = WhatIf("", "", 0, (where, where), [(0,)], poses, (1, 2))
    for goal, expected in {
        **{"ball in the den": [0, np.inf], "not ball in the den": [np.inf, 0]},
        **{"toys together": [0, np.inf], "not toys together": [np.inf, 0]},
        **{"toys apart": [np.inf, 0], "not toys apart": [0, np.inf]},
        **{"Get ball to home": [np.inf, np.inf], "get away from ball": [0, 0]},
        **{"Get anna to home": [np.inf, np.inf], "Get anna away from home": [0, 0]},
    }.items():
        assert found.reached("anna", goal).values[:, 0].tolist() == expected, goal
        this = dataclasses.replace(found, goals=[(world.goals.index(goal),)])
        by_removal = "(what is removed counts as far away)" in told(this)
        assert by_removal == ("home" not in goal or "ball" in goal), goal
        assert ("(true at the end)" in told(this)) == ("not " in goal or "away from" in goal), goal


def test_a_film_shows_both_worlds(alone: WhatIf, tmp_path: Path) -> None:
    brief = dataclasses.replace(alone, poses=alone.poses[:, :, :3])
    film = brief.film(tmp_path / "both.mp4")
    assert film.path.stat().st_size > 1000
    assert film._repr_html_().startswith("<video controls")


def test_what_cannot_be_is_refused(contested: ppl.Posterior) -> None:
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"at": LAST + 1}, f"0..{LAST}"),
        ({"at": LAST}, "last frame"),
        ({"n": 1}, "n=1"),
        ({"seconds": -1.0}, "seconds"),
        ({"remove": "grene agent"}, "did you mean 'green agent'"),
        ({"goal_green": "Get lost"}, "unknown goal"),
    )
    for options, words in cases:
        with pytest.raises(PhasePPLError, match=words):
            contested.do(**{"remove": "green agent", "workers": 1, **options})
    tree = contested.tree.copy()
    tree.attrs["settings"] = json.dumps({"model": {"simulator": "mine.walks"}})
    of_another = ppl.Posterior(tree)
    with pytest.raises(InvalidSettingError, match=r"need the joint simulator, not mine\.walks"):
        of_another.predict(1)
    with pytest.raises(InvalidSettingError, match="give it, simulator="):
        of_another.do(strength_red=300.0)


def test_helpers_follow_a_stated_goal_and_not_an_effective_one() -> None:
    own, helped, other = (
        ppl.GOALS.index(f"Get {goal} lm")
        for goal in ("pink item to red", "blue item to red", "pink item to blue")
    )
    sites = {"goal_red": own, "goal_green": helped, "alpha": ppl.ALPHAS.index((1, 0))}
    sites |= {"strength_red": 450, "strength_green": 450}

    def changed(alpha: tuple[int, int] | None = None, **given: str) -> tuple[int, ...]:
        return Change.of(PHASE, given, alpha).hypothesis(sites).effective_goals

    assert changed(goal_green=ppl.GOALS[other]) == (helped, other)
    assert changed(stated_goal_green=ppl.GOALS[other]) == (other, other)
    assert changed(alpha=(0, 0)) == (own, helped)


HOME, FIELD, AWAY, AWAY_FROM_FIELD = (
    CAST.goal_index(f"Get blue ball {where}")
    for where in ("to home", "to field", "away from home", "away from field")
)


def test_what_a_world_does_not_have_is_refused() -> None:
    two = ("red agent", "green agent")
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"goal_blue": "Get blue ball to home"}, "did you mean 'goal_red'"),
        ({"goal_green": "get to green agent"}, "names the agent itself"),
        ({"goal_red": "Get lost"}, "Get lost"),
        ({"strength_red": -1}, "strength_red=-1"),
        ({"remove": "dog"}, "unknown entity 'dog'; allowed: 'red agent'"),
        ({"alpha": (0, 0)}, "expected relation= in the world three"),
        ({"relation": {("red agent", "red agent"): "help"}}, "cannot help itself"),
        ({"relation": "friendly"}, "'friendly', expected {.*: 'help'}"),
        ({"relation": {"red agent": "help"}}, "relation of 'red agent', expected {"),
        ({"relation": {two: "love"}}, "allowed: 'help', 'hinder'"),
        ({"relation": dict.fromkeys((two, two[::-1]), "help")}, "a goal of its own"),
    )
    for given, words in cases:
        said = {name: given.pop(name) for name in ("alpha", "relation", "remove") if name in given}
        with pytest.raises(PhasePPLError, match=words):
            Change.of(CAST, given, **said)
    # names may have capitals and share a first word
    world = ppl.World(["Anna", "small Ben"], ["small", "Big box"], {"home": (8, 8)})
    for number, name in enumerate(world.entities):
        assert Change.of(world, {}, remove=name).removed == (number,)
    assert Change.of(world, {}, remove="big").removed == (3,)
    assert Change.of(world, {}, remove=world.items).removed == (2, 3)
    with pytest.raises(PhasePPLError, match="unknown entity 'the'"):
        Change.of(ppl.World(["the cat", "the dog"], [], {"home": (8, 8)}), {}, remove="the")


def test_a_closed_loop_goes_on_from_its_hypotheses() -> None:
    scene = ppl.worlds.SOLO.random_scene(0)
    (agent,) = scene.world.agents
    goal = next(goal for goal in scene.world.goals if goal.startswith("get to"))
    event = ppl.simulate(scene, goals={agent: goal}, frames=8, seed=0, planner=QUICK)
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1), planner=PLANNER)
    post = ppl.infer(event, model, progress=False, workers=1)
    sure = post.do(goal_red=goal, at=6, seconds=6, n=4, workers=1)
    assert sure.tracks.sizes["entity"] == 3
    assert sure.probability(agent, goal)[1] == 1
    shares = np.bincount([goals[0] for goals in sure.goals], minlength=len(scene.world.goals))
    assert shares[scene.world.goal_index(post.top("goal_red", 1)[0][0])] == shares.max()
    with pytest.raises(InvalidSettingError, match="expected relation= in the world solo"):
        post.do(alpha=(1, 0))


def test_ways_are_found_again_in_what_was_read_of_three_agents() -> None:
    post = of_three()
    found = post.do(relation={}, n=6, seconds=0.2, workers=1)
    assert found.poses.shape == (2, 6, 3, 4, 3)
    columns = [post.table.values[f"goal_{key}"].tolist() for key in CAST.keys]
    assert set(found.goals) <= set(zip(*columns, strict=True))
    assert "nobody helping or hindering" in told(found)
    # whoever helped or hindered wants what the prior says, not what it did for or against others
    changed = post.with_prior(seldom)
    drawn = _drawn(changed, np.exp(changed.dataset["log_prior_goals"].values), 4000, 0)
    idle = [one for one in drawn if space_of(CAST).ways[one["alpha"]][2] is not None]
    wanted = [Change.of(CAST, {}, relation={}).hypothesis(one).effective_goals[2] for one in idle]
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
    ppl.roles.alpha(world)
    ppl.roles.strengths(world)


# --- another prior --------------------------------------------------------------------------------


def test_a_table_under_another_prior_is_that_of_a_run_with_it() -> None:
    post = ClosedLoopPosterior(reading())
    post.define("same", lambda h: h.goal_red == h.goal_green)
    changed = post.with_prior("sparse_social")
    prior = prior_table(ppl.priors.sparse_social, LEVELS)
    anew = ClosedLoopPosterior(reading(columns={"log_prior": prior}))
    found = changed.probability(relation="friendly")
    assert found == pytest.approx(anew.probability(relation="friendly"), abs=1e-9)
    assert found.error > 0
    assert changed.at(2).query("P(same=True)") > 0
    assert changed.settings["model"]["prior"] == "phase_ppl.models.priors.sparse_social"
    assert "sparse_social, taken instead of" in str(changed)
    assert "taken instead of" not in str(post)


def test_draws_under_another_prior_are_weighted_by_it(tmp_path: Path) -> None:
    before, after = map(prior_of_pairs, (ppl.priors.uniform, ppl.priors.relation_first))
    pairs, likelihood = np.argwhere(before > 0), np.random.default_rng(0).normal(size=34**2)
    prior = np.log(before[tuple(pairs.T)])
    simulations = [
        Simulation(hypothesis(*pair), seed, *masses)
        for seed, (pair, *masses) in enumerate(zip(pairs.tolist(), prior, likelihood, strict=True))
    ]
    tree = make_tree(simulations, np.arange(34**2).reshape(34, 34).tolist())
    tree = with_log_weight(with_prior(tree, before), (prior + likelihood).reshape(34, 34))
    tree.attrs["settings"] = json.dumps({"model": {"prior": "the.uniform"}})
    post = ppl.Posterior(tree)
    changed, expected = post.with_prior("relation_first"), np.zeros(after.shape)
    expected[tuple(pairs.T)] = after[tuple(pairs.T)] * np.exp(likelihood)
    joint = changed.joint("goal_red", "goal_green")
    np.testing.assert_allclose(joint, expected / expected.sum(), atol=1e-6)
    assert abs(changed.marginal("relation") - post.marginal("relation")).max() > 0.01
    lone = changed.with_prior("no_social_goals")
    assert lone.probability(alpha="(0, 0)") == pytest.approx(1)
    assert lone.settings["reweighted"]["effective_size"] < 34**2
    assert "equal draws" in str(lone)
    again = ppl.load_posterior(lone.save(tmp_path / "run.nc"))
    np.testing.assert_array_equal(again.marginal("relation"), lone.marginal("relation"))
    assert again.settings["reweighted"]["from"] == "the.uniform"  # the run's, not the last one


def test_users_sites_are_weighted_with_the_rest() -> None:
    def friendlier(low: float) -> None:
        mood = numpyro.sample("mood", dist.Uniform(low, 1.0))
        shares = jnp.stack([0.2, *[0.4 * mood] * 2, *[0.4 * (1 - mood)] * 2])
        numpyro.sample("alpha", dist.Categorical(probs=shares))
        ppl.sites.goals()
        ppl.sites.strengths()

    rng = np.random.default_rng(0)
    moods, helps = rng.random(40), rng.integers(2, size=40)
    simulations = [
        Simulation(hypothesis(alpha=(1 if one else -1, 0)), seed, np.log(mood if one else 1 - mood))
        for seed, (mood, one) in enumerate(zip(moods, helps, strict=True))
    ]
    draws = np.arange(40).reshape(4, 10).tolist()
    post = ppl.Posterior(make_tree(simulations, draws, own_site=moods.tolist()))
    assert post.mean("mood") == pytest.approx(moods.mean())
    changed = post.with_prior(lambda: friendlier(0.5))
    assert changed.mean("mood") == pytest.approx(moods[moods >= 0.5].mean(), rel=1e-4)
    assert "mood" not in changed.with_prior("uniform").quantities


def test_what_was_not_simulated_is_refused() -> None:
    def only_away() -> None:
        last = jnp.where(jnp.arange(36) == 0, 0.0, -1e30)
        numpyro.sample("goal_red", dist.Categorical(logits=last))
        numpyro.sample("goal_green", dist.Categorical(logits=last))
        numpyro.sample("alpha", dist.Categorical(probs=jnp.eye(5)[0]))
        ppl.sites.strengths()

    post = runs.infer(weights="count")
    with pytest.raises(InvalidSettingError):
        post.with_prior(only_away)
    with pytest.raises(PhasePPLError, match="sparse_social"):
        post.with_prior("sparse_soziel")


def related(share: float) -> None:
    numpyro.sample("alpha", dist.Categorical(probs=jnp.array([1 - share] + [share / 4] * 4)))
    ppl.sites.goals()
    ppl.sites.strengths()


def test_a_curve_against_an_argument_of_the_prior() -> None:
    post = ClosedLoopPosterior(reading())
    curve = post.sensitivity("P(relation)", related, (0.1, 0.9))
    assert curve.dims == ("value", "relation")
    alone = post.with_prior(functools.partial(related, 0.9)).marginal("relation")
    np.testing.assert_allclose(curve.sel(value=0.9), alone, atol=1e-6)
    np.testing.assert_allclose(curve.sel(value=0.9)["error"], alone["error"], atol=1e-6)
    number = post.sensitivity("P(relation=friendly)", related, (0.1, 0.9))
    np.testing.assert_allclose(number, curve.sel(relation="friendly"))
    for asked, prior, values, said in (
        ("top goal_red", related, (0.5,), "makes no curve"),
        ("P(relation)", related, (), "empty"),
        ("P(relation)", lambda p: None, (0.1, 0.2), "does not sample"),
    ):
        with pytest.raises(InvalidSettingError, match=said):
            post.sensitivity(asked, prior, values)
