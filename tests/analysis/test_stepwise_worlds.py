"""Posteriors over roles in worlds of other casts."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis import stepwise_table
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.models.roles import masses
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    PhasePPLError,
    QueryError,
)
from phase_ppl.world.goals import possible_goals
from phase_ppl.world.hypothesis import Roles, all_ways
from tests.analysis.readings import reading

TRIO = ppl.worlds.TRIO
MODEL = ppl.Model(
    likelihood=ppl.StepwiseLikelihood(planner_seeds=2),
    planner=PlannerConfig(simulations=4, particles=6),
)


@functools.cache
def posterior() -> StepwisePosterior:
    scene = TRIO.scene(
        {
            "red agent": (4, 8), "green agent": (30, 18), "purple agent": (9, 3),
            "blue ball": (6, 5), "pink ball": (32, 16),
        }
    )  # fmt: skip
    event = ppl.simulate(
        scene,
        goals={"red agent": "blue ball to home", "green agent": "touch pink ball"},
        relation={("purple agent", "red agent"): "hinder"},
        frames=8,
        planner=MODEL.planner,
        seed=2,
    )
    found = ppl.infer(event, MODEL, workers=1, progress=False)
    assert isinstance(found, StepwisePosterior)
    return found


def test_it_answers_in_the_names_of_its_world() -> None:
    post = posterior()
    assert post.marginal("goal_purple").sum() == pytest.approx(1)
    assert post.query("P(relation_red_purple=adversarial)").error > 0
    assert -1 <= post.query("E[alpha_purple_red]") <= 1
    assert 150 <= post.mean("strength_green") <= 600
    for words in ("purple agent", "red & purple", "green & purple ", "strength"):
        assert words in str(post)
    roles = post.map()
    assert isinstance(roles, Roles)
    assert set(roles.goals) == set(post.summary()["goals"]) == set(TRIO.agents)
    found = post.over_time()["goal_red"]
    np.testing.assert_allclose(found[-1], post.marginal("goal_red"), atol=1e-6)
    np.testing.assert_allclose(found[4], post.at(4).marginal("goal_red"), atol=1e-3)
    assert found[0].max() < 0.03  # nothing was seen yet


def test_it_is_kept_in_a_file(tmp_path: Path) -> None:
    post = posterior()
    file = post.save(tmp_path / "trio.nc")
    again = StepwisePosterior.load(file)
    with pytest.raises(InvalidEventError, match="read step by step: load_posterior"):
        ppl.Posterior.load(file)
    with pytest.raises(InvalidSettingError, match="'trio' has relations only"):
        ppl.load_posterior(file, scenario=lambda red, green: "competing")
    assert again.scene.world == TRIO
    np.testing.assert_array_equal(again.scene.half_widths, post.scene.half_widths)
    for name in ("goal_red", "relation_green_purple", "alpha_red_purple"):
        np.testing.assert_array_equal(again.marginal(name), post.marginal(name))
    for damaged, words in (
        (post.dataset.drop_vars("density"), "it lacks density"),
        (reading(world=post.dataset.attrs["world"]), "is not that of 'trio'"),
        (reading(world="{"), "its world"),
        (reading().isel(planner_seed=[0]), "planner_seed has 1 entry"),
    ):
        with pytest.raises(InvalidEventError, match=words):
            StepwisePosterior(damaged)


@pytest.mark.usefixtures("unpainted")
def test_figures_and_the_page_of_a_run_speak_of_its_world(tmp_path: Path) -> None:
    post = posterior()
    figure = ppl.plot.posteriors({"read": post, "alone": post.with_prior("no_social_goals")})
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[2:4] == ["Goal of the purple agent", "Relation of red & green"]
    with pytest.raises(InvalidSettingError, match="must be of one world"):
        ppl.plot.posteriors({"read": post, "of PHASE": StepwisePosterior(reading())})
    post.save(tmp_path / "posterior.nc")
    page = ppl.report(tmp_path).read_text("utf-8")
    for words in ("Goal of the purple agent", "Relation of red &amp; purple", "What decided"):
        assert words in page


def test_another_prior_changes_what_is_asked_without_reading_again() -> None:
    post = posterior().with_prior("no_social_goals")
    assert post.probability(alpha_purple_red="0") == 1
    assert post.query("P(alpha_red_green=1)") == 0


def test_hypotheses_that_are_drawn_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepwise_table, "MOST_HYPOTHESES", 150_000)
    drawn = StepwisePosterior(posterior().dataset)
    assert drawn._table.sampled
    assert "were drawn" in str(drawn)
    for name in ("goal_red", "goal_purple", "relation_red_purple", "alpha_purple_red"):
        exact = posterior().marginal(name).values
        np.testing.assert_allclose(drawn.marginal(name).values, exact, atol=0.02)
    assert drawn.map().effective_goals == posterior().map().effective_goals  # whatever q was


def test_who_helps_with_what_two_agents_do_is_friendly() -> None:
    """Somebody who helps one of them to get to the other wants what both do."""
    goals = {"red agent": "get to green agent", "green agent": "get to red agent"}
    roles = Roles.of(TRIO, goals, {("purple agent", "red agent"): "help"})
    assert roles.goals["purple agent"] == "Get green agent to red agent"
    agents = TRIO.agents
    assert all(roles.relation_between(a, b) == "friendly" for a in agents for b in agents if a < b)
    goals = {"red agent": "get to pink ball", "green agent": "get to blue ball"}
    roles = Roles.of(TRIO, goals, {("purple agent", "red agent"): "hinder"})
    assert roles.relation_between("red agent", "purple agent") == "adversarial"
    assert roles.relation_between("green agent", "purple agent") == "neutral"


SMALL = {"landmarks": {"home": (4, 4), "field": (30, 12)}, "arena": (0, 36, 0, 24)}


@pytest.mark.parametrize(
    ("agents", "more"),
    [
        (["big red agent", "green agent"], {"items": ["ball"]}),
        (["red agent", "green agent", "purple agent"], {"touchable": ["green agent"]}),
        (["a", "b", "c", "d"], {"touchable": []}),
    ],
)
def test_casts_of_all_kinds_are_read(agents: list[str], more: dict[str, list[str]]) -> None:
    world = ppl.World(agents=agents, name="small", **{**SMALL, "items": [], **more})
    model = ppl.Model(likelihood=ppl.StepwiseLikelihood(planner_seeds=1), planner=MODEL.planner)
    scene, roles = world.random_scene(2), ppl.roles.draw(world, 3)
    event = ppl.simulate(scene, roles, frames=4, planner=MODEL.planner, seed=1)
    post = ppl.infer(event, model, workers=1, progress=False)
    n = len(agents)
    assert len(post.relations_of) == n * (n - 1) / 2
    for name in (*post.goals_of.values(), *post.relations_of.values()):
        assert post.marginal(name).sum() == pytest.approx(1)
    assert post.map().is_possible
    assert str(post.map().world) == str(world)


def test_why_speaks_of_goals_and_relations() -> None:
    post = StepwisePosterior(posterior().dataset).define("weak", "strength_red < 300")
    post.define("at_odds", "relation_red_purple = adversarial")
    found = post.why("at_odds=True")["log_odds"].values
    share = post.query("P(relation_red_purple=adversarial)")
    assert found[-1] == pytest.approx(np.log(share / (1 - share)), abs=1e-4)
    with pytest.raises(QueryError, match="strength_red"):
        post.why("strength_red > 300")


def test_nobody_helps_with_what_is_no_goal() -> None:
    """Where only green is a goal of touching, nobody has green's part of it."""
    world = ppl.World(
        agents=["red agent", "green agent"], items=[], touchable=["green agent"], **SMALL
    )
    with pytest.raises(PhasePPLError, match="the green agent cannot help the red agent with 'get"):
        Roles.of(world, {"red agent": "get to green agent"}, {("green agent", "red agent"): "help"})
    assert all(ppl.roles.draw(world, seed).is_possible for seed in range(20))
    scene = world.random_scene(0)
    with ppl.watch(scene, MODEL, threads=1) as watching:
        before = watching.update(scene.start)
    assert before.log_evidence == pytest.approx(0, abs=1e-9)  # what cannot be has no mass


def test_hypotheses_are_counted_and_strengths_have_the_priors_margins() -> None:
    table = posterior()._table
    (mass,), combinations = table.prior_of_strengths, table.combinations
    for agent in range(3):
        found = [mass[combinations[:, agent] == level].sum() for level in (150, 300, 450, 600)]
        np.testing.assert_allclose(found, [1 / 6, 1 / 3, 1 / 3, 1 / 6], atol=1e-6)
    assert [len(all_ways(n)) for n in (1, 2, 3, 4)] == [1, 5, 25, 153]
    n = len(possible_goals(0, TRIO))
    assert table.n_hypotheses == n**3 + 12 * n**2 + 12 * n


def wide_goal(world: ppl.World) -> None:
    for key in world.keys:
        numpyro.sample(f"goal_{key}", dist.Categorical(probs=np.full(100, 0.01)))
    ppl.roles.company(world)
    ppl.roles.strengths(world)


def dependent(world: ppl.World) -> None:
    ppl.roles.goals(world)
    ways = numpyro.sample("company", dist.Categorical(probs=np.ones(25) / 25))
    ppl.roles.strengths(world)
    numpyro.sample("goal_more", dist.Normal(ways, 1.0))


def leaning(world: ppl.World) -> None:
    strong = numpyro.sample("strong", dist.Bernoulli(0.5))
    ppl.roles.goals(world)
    ppl.roles.company(world)
    for key in world.keys:
        numpyro.sample(f"strength_{key}", dist.Uniform(150.0 + 100 * strong, 600.0))


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ("relation_first", "is of PHASE only, not of 'trio': expected uniform, sparse_social"),
        (wide_goal, "gives mass to goal_red=68: expected 0..67"),
        (lambda world: ppl.roles.goals(world), "does not sample 'company'; in 'trio' it takes"),
        (lambda world: world.nothing, "cannot be run: AttributeError"),
        (leaning, "makes 'strength_red' depend on strong"),
    ],
)
def test_priors_that_cannot_be_are_refused_in_one_line(prior: object, message: str) -> None:
    given = getattr(ppl.priors, prior) if isinstance(prior, str) else prior
    with pytest.raises(PhasePPLError, match=re.escape(message)) as raised:
        masses(given, TRIO)
    assert "\n" not in str(raised.value)
    assert masses(dependent, TRIO).company.shape == (25,)
