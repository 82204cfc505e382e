"""A posterior of the closed loop is the sum over all hypotheses, at any frame."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from matplotlib import rc_context

import phase_ppl as ppl
from phase_ppl.analysis import closed_loop_table
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.models import prior_masses
from phase_ppl.models.world_priors import bound, masses
from phase_ppl.render.frames import PANEL
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, PhasePPLError, QueryError
from phase_ppl.world.goals import GOALS, N_GOALS, effective_goals, possible_goals
from phase_ppl.world.hypothesis import ALPHAS, RELATIONS, Hypothesis, all_ways, relation
from tests.analysis.readings import (
    BLUE_NOT_TO_RED,
    BLUE_TO_RED,
    CAST,
    LEVELS,
    QUICK,
    by_pairs,
    of_three,
    reading,
)
from tests.render.test_video import read

FOUND, BY_PAIRS = reading(), by_pairs()


@pytest.fixture(scope="module")
def post() -> ClosedLoopPosterior:
    return ClosedLoopPosterior(FOUND)


@pytest.fixture(scope="module")
def single() -> ClosedLoopPosterior:
    return ClosedLoopPosterior(reading(planner_seeds=1))


@functools.cache
def pairs() -> np.ndarray:
    """Return (agent, stated red, stated green, alpha) effective goals."""
    found = [effective_goals(r, g, ALPHAS[a]) for r, g, a in np.ndindex(N_GOALS, N_GOALS, 5)]
    return np.array(found).T.reshape(2, N_GOALS, N_GOALS, 5)


def mass_of_each(frame: int, weight: float = 0.5) -> FloatArray:
    """Return the mass of every hypothesis: stated goals, alpha, strengths."""
    likelihood = BY_PAIRS["log_likelihood"][: frame + 1].sum(axis=0)[tuple(pairs())]
    of_goals = np.exp(weight * likelihood)[..., None, None]
    return np.exp(BY_PAIRS["log_prior"]) * of_goals * BY_PAIRS["strengths"][frame] * 4


@pytest.mark.parametrize("frame", [0, 3])
def test_every_answer_is_a_sum_over_hypotheses(frame: int) -> None:
    post, mass = ClosedLoopPosterior(FOUND, frame), mass_of_each(frame)
    mass /= mass.sum()
    joint = np.zeros((N_GOALS, N_GOALS))
    np.add.at(joint, tuple(pairs()), mass.sum(axis=(3, 4)))
    np.testing.assert_allclose(post.joint("goal_red", "goal_green"), joint, atol=1e-9)
    np.testing.assert_allclose(post.marginal("goal_red"), joint.sum(axis=1), atol=1e-9)
    friendly = sum(p for pair, p in np.ndenumerate(joint) if relation(*pair) == "friendly")
    assert post.probability(relation="friendly") == pytest.approx(friendly, abs=1e-9)
    assert post.query("P(relation=friendly)") == pytest.approx(friendly, abs=1e-9)
    strong = mass[:, :, :, 1].sum()
    assert post.probability(strength_red=(500, 600)) == pytest.approx(strong, abs=1e-9)
    if abs(strong - 0.5) > 1e-9:
        assert post.query("median strength_red") == LEVELS[int(strong > 0.5)]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(joint / (joint.sum(axis=1, keepdims=True) * joint.sum(axis=0)))
    found = post.query("I(goal_red; goal_green)")
    assert found == pytest.approx(np.nansum(joint * logs), abs=1e-6)
    assert found == pytest.approx(post.mutual_information("goal_green", "goal_red"))
    given = "goal_red=get to green agent"
    assert post.query(f"I(goal_red; relation | {given})") == pytest.approx(0)


def test_strengths_that_may_depend_on_goals_are_not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    log_prior = BY_PAIRS["log_prior"].copy()
    log_prior[:, :, 1:, 0] -= 5.0  # who helps or hinders is strong
    dependent = reading(columns={"log_prior": log_prior})
    questions = ("P(strength_red > 500)", "P(strength_red > 500 | alpha=(1, 0))")
    found = [ClosedLoopPosterior(dependent).query(question) for question in questions]
    assert found[1] > found[0] + 0.05
    monkeypatch.setattr(closed_loop_table, "MOST_ROWS", 1000)
    post = ClosedLoopPosterior(dependent)
    assert [post.query(question) for question in questions] == pytest.approx(found)
    odds = post.why("strength_red > 500")["log_odds"].values[-1]
    assert odds == pytest.approx(np.log(found[0] / (1 - found[0])))


def test_errors_are_the_jackknife_over_sets_of_searches(
    post: ClosedLoopPosterior, single: ClosedLoopPosterior
) -> None:
    each = [
        ClosedLoopPosterior(reading(1, columns={"log_likelihood": one}))
        for one in BY_PAIRS["log_likelihood_without"].astype(float)
    ]

    def of(answers: list[Any]) -> Any:
        # (3 - 1) / 3 times the sum of squares; 1.96 errors cover what 4.303, of Student's t, would
        return 4.303 / 1.96 * np.sqrt(2 * np.var(answers, axis=0))

    found = post.probability(relation="friendly")
    expected = of([alone.probability(relation="friendly") for alone in each])
    assert expected > 0.001
    assert found.error == pytest.approx(expected, rel=1e-4)
    assert post.query("P(relation=friendly)").error == found.error
    why = post.why("relation=friendly")
    expected = of([alone.why("relation=friendly")["log_odds"].values for alone in each])
    np.testing.assert_allclose(why["error"], expected, rtol=1e-4, atol=1e-9)
    assert (why["error"].values[1:] > 0).all()
    assert post.query("I(goal_red; goal_green)").error > 0
    assert post.at(0).probability(relation="friendly").error == 0  # nothing was searched yet
    for of_strengths in ("hdi strength_red", "E[strength_red]", "P(strength_red > 300)",
                         "P(relation=friendly and strength_red > strength_green)"):  # fmt: skip
        assert np.isnan(post.query(of_strengths).error).all(), "one filter follows strengths"
    assert np.isnan(single.probability(relation="friendly").error)
    for nothing in (single.why("relation=friendly")["error"], single.over_time()["relation_error"]):
        assert np.isnan(nothing).all()
    found = single.diagnostics()
    assert "With one set of searches nothing tells" in found["verdict"]
    assert found["trust"] == "not certain"
    assert "± unknown" in str(single)


def test_no_more_searches_are_advised_where_they_cannot_decide() -> None:
    alike = ClosedLoopPosterior(reading(weight=1e-6)).diagnostics()
    assert "Smaller errors would not decide it" in alike["verdict"]
    assert "over_time" in alike["next"]


def test_over_time_and_why_follow_the_posterior_at_each_frame(post: ClosedLoopPosterior) -> None:
    found, names = post.over_time(), ("to red lm", "away from red lm")
    why = post.why(*(f"goal_red=Get blue item {name}" for name in names))
    alone = post.why("relation=friendly")["log_odds"].values
    for frame in range(4):
        at = post.at(frame)
        for name in ("goal_red", "goal_green", "relation", "scenario"):
            np.testing.assert_allclose(found[name][frame], at.marginal(name), atol=1e-9)
        errors = [at.probability(relation=label).error for label in RELATIONS]
        np.testing.assert_allclose(found["relation_error"][frame], errors, rtol=1e-6, atol=1e-9)
        goals, friendly = at.marginal("goal_red").values, at.probability(relation="friendly")
        odds = np.log(goals[BLUE_TO_RED] / goals[BLUE_NOT_TO_RED])
        assert why["log_odds"].values[frame] == pytest.approx(odds)
        assert alone[frame] == pytest.approx(np.log(friendly / (1 - friendly)))
    np.testing.assert_allclose(np.diff(why["log_odds"]), why["change"].values[1:])
    assert why["change"].values[0] == 0
    assert "filtering" in found.attrs
    assert len(post.at(1).over_time()["time"]) == 2


def test_the_best_hypothesis_leads_and_the_evidence_grows(post: ClosedLoopPosterior) -> None:
    assert post.map().effective_goals == (BLUE_TO_RED, BLUE_TO_RED)
    assert post.map_record()["goal_red"] == GOALS[BLUE_TO_RED]
    start, evidence = post.at(0).log_evidence, post.log_evidence
    assert evidence > start == pytest.approx(0, abs=1e-9)
    # frames count in full, although the posterior tempers them
    assert evidence == pytest.approx(np.log(mass_of_each(3, weight=1.0).sum()))
    # the last one is as surprising as those before, tempered as they are, make it
    before, of_frame = mass_of_each(2), BY_PAIRS["log_likelihood"][3][tuple(pairs())]
    expected = (before.sum(axis=(3, 4)) * np.exp(of_frame)).sum() / before.sum()
    surprise = BY_PAIRS["log_peak"][3] - np.log(expected)
    assert post.surprise()[3] == pytest.approx(surprise)
    tempered = ClosedLoopPosterior(reading(weight=0.1))
    assert tempered.log_evidence == pytest.approx(evidence)
    assert "tempered: a frame counts 0.1 for goals" in str(tempered)
    found = reading(weight=1.0)
    assert "tempered" not in str(ClosedLoopPosterior(found))
    found.attrs["settings"] = json.dumps({"likelihood": {"tracking": {"strength_weight": 0.05}}})
    of_strengths = ClosedLoopPosterior(found)
    tempering = "tempered: a frame counts 0.05 for strengths"
    assert tempering in str(of_strengths)
    counted = "nats, not tempered for goals; for strengths a frame counts 0.05"
    assert counted in " ".join(str(of_strengths).split())
    for told in (of_strengths.why("relation=friendly"), of_strengths.over_time()):
        assert told.attrs["tempering"] == tempering


def test_what_cannot_be_asked_is_refused(post: ClosedLoopPosterior) -> None:
    def frame(number: Any) -> Callable[[], object]:
        return lambda: post.at(number)

    for ask, error, said in (
        (
            lambda: post.why("relation"),
            QueryError,
            "expected a comparison of relation .*, as in relation = friendly",
        ),
        (lambda: post.why("red"), QueryError, "unknown quantity .red.; allowed: goal_red"),
        (lambda: post.why("relation=cordial"), QueryError, "cordial"),
        (lambda: post.why("relation=friendly | alpha=(1, 0)"), QueryError, "'or' or the end"),
        (lambda: post.why("goal_red=get to red agent"), InvalidSettingError, "under the prior"),
        (lambda: post.why("strength_red > 0"), InvalidSettingError, "^not strength_red > 0 is imp"),
        (lambda: post.query("I(goal_red)"), QueryError, "';' and another"),
        (lambda: post.query("median(goal_red)"), QueryError, "categories, not numbers"),
        *((frame(number), InvalidSettingError, "frame=") for number in (1.5, "2", True, -1, 4)),
    ):
        with pytest.raises(error, match=said):
            ask()


def test_definitions_hold_at_every_frame_in_why_and_in_files(tmp_path: Path) -> None:
    post = ClosedLoopPosterior(FOUND)
    post.define("red_leads", "strength_red > strength_green")
    post.define("same", lambda h: h.goal_red == h.goal_green)
    last, before = post.query("P(red_leads=True)"), post.at(0).query("P(red_leads=True)")
    assert last == pytest.approx(0.3, abs=1e-3)  # the filter's, as the prior of both is flat
    assert before == pytest.approx(0.25)
    assert np.isnan(last.error)  # one filter follows strengths
    odds = post.why("same=True", over="not goal_red = goal_green")["log_odds"].values
    assert odds[-1] == pytest.approx(post.why("same=True")["log_odds"].values[-1])
    share = post.query("P(goal_red = goal_green)")
    assert odds[-1] == pytest.approx(np.log(share / (1 - share)), abs=1e-6)

    file = post.save(tmp_path / "found.nc")
    again = ppl.load_posterior(file)
    assert list(again.definitions) == ["red_leads"]
    assert again.query("P(red_leads=True)") == last
    for asked in (("goal_red", "relation"), ("alpha",)):
        np.testing.assert_array_equal(again.joint(*asked), post.joint(*asked))
    assert str(again) == str(post)
    paid = "12 searches by 3 sets in 3 steps, in 1.0 s (the film: 0.8 s)"
    assert all(paid in " ".join(str(post.at(frame)).split()) for frame in range(4))
    early = ppl.load_posterior(post.at(1).save(tmp_path / "early.nc"))
    assert str(early) == str(post.at(1))  # what came later is still there, and counts for nothing
    assert str(ppl.load_posterior(early.at(3).save(tmp_path / "late.nc"))) == str(post)
    for frame in (4, -1, 1.5, "last", [0, 1]):
        with h5py.File(early.save(tmp_path / "edited.nc"), "r+") as edited:
            edited.attrs["frame"] = frame
            del edited.attrs["sha256"]
        with pytest.raises(InvalidSettingError, match=r"edited.nc: frame=.*expected"):
            ppl.load_posterior(tmp_path / "edited.nc")
    with pytest.raises(InvalidSettingError, match="no draws"):
        ppl.load_posterior(file, "count")


def test_the_verdict_leads_with_the_worst_sign(post: ClosedLoopPosterior) -> None:
    def diagnosed(**columns: Any) -> dict[str, Any]:
        return ClosedLoopPosterior(reading(columns=columns)).diagnostics()

    fine = post.diagnostics()
    assert fine["unexplained_frames"] == fine["overlapping_frames"] == []
    assert fine["verdict"].startswith("Actions explain every frame")
    poses = BY_PAIRS["trajectory"].copy()
    poses[2, 0, :2] = poses[2, 1, :2]  # red lies on green
    lying = diagnosed(trajectory=poses)
    assert lying["overlapping_frames"] == [2]
    assert lying["verdict"].startswith("Bodies lie on each other or in a wall in frame 2,")
    unexplained = np.array([0.0, 1.0, 40.0, 1.0])
    torn = diagnosed(unexplained=unexplained, trajectory=poses)
    assert torn["surprise_median"] == np.median((post.surprise() - unexplained)[1:])
    assert torn["unexplained_frames"] == [2]
    assert torn["verdict"].startswith("No action explains frame 2:")
    assert "Bodies lie" in torn["verdict"]
    odd = diagnosed(log_peak=np.array([0.0, 60.0, 60.0, 60.0]))
    assert odd["surprising_share"] == 1.0
    assert "in 100% of the frames their actions surprise" in odd["verdict"]
    without = BY_PAIRS["log_likelihood_without"].copy()
    without[0, 1:, BLUE_NOT_TO_RED, BLUE_TO_RED] += 30.0
    split = diagnosed(log_likelihood_without=without)
    assert "sets of searches disagree" in split["verdict"]
    for found in (lying, torn, odd, split):
        assert "Actions explain every frame" not in found["verdict"]
    text = str(post)
    assert text.index("answer  ") < text.index("checks  ") < text.index("relation  ")
    assert fine["trust"] != "do not trust"
    assert {found["trust"] for found in (lying, torn, odd)} == {"do not trust"}
    one = ClosedLoopPosterior(FOUND.isel(time=slice(0, 1)))
    assert one.surprise().tolist() == [0.0]
    assert "Nothing was seen but the start" in one.diagnostics()["verdict"]


def test_figures_and_film(tmp_path: Path, post: ClosedLoopPosterior) -> None:
    figure = ppl.plot.why(post, "relation=friendly", "relation=adversarial", tmp_path / "why.png")
    assert len(figure.axes) >= 3
    ppl.plot.over_time(post, tmp_path / "over_time.png")
    ppl.plot.posterior(post, tmp_path / "posterior.png")
    with rc_context({"figure.dpi": 150}):  # a user's own, which films do not follow
        film = ppl.watch_film(post, tmp_path / "watch.mp4")
    _, frames = read(film.path)
    assert frames.shape[2] < 2.1 * PANEL
    sizes = [file.stat().st_size for file in tmp_path.iterdir()]
    assert len(sizes) == 4
    assert min(sizes) > 1000


# --- other worlds ---------------------------------------------------------------------------------


def test_it_answers_in_the_names_of_its_world() -> None:
    post = of_three()
    assert post.marginal("goal_purple").sum() == pytest.approx(1)
    assert post.query("P(relation_red_purple=adversarial)").error > 0
    assert -1 <= post.query("E[alpha_purple_red]") <= 1
    assert 150 <= post.mean("strength_green") <= 600
    for words in ("purple agent", "red & purple", "green & purple ", "strength"):
        assert words in str(post)
    roles = post.map()
    assert set(roles.goals) == set(post.summary()["goals"]) == set(CAST.agents)
    found = post.over_time()["goal_red"]
    np.testing.assert_allclose(found[-1], post.marginal("goal_red"), atol=1e-6)
    np.testing.assert_allclose(found[4], post.at(4).marginal("goal_red"), atol=1e-3)
    assert found[0].max() < 0.07  # nothing was seen yet
    assert post.at(0).log_evidence == pytest.approx(0, abs=1e-9)  # what cannot be has no mass

    asked = ClosedLoopPosterior(post.dataset).define("weak", "strength_red < 300")
    asked.define("at_odds", "relation_red_purple = adversarial")
    odds = asked.why("at_odds=True")["log_odds"].values[-1]
    share = asked.query("P(relation_red_purple=adversarial)")
    assert odds == pytest.approx(np.log(share / (1 - share)), abs=1e-4)
    alone = post.with_prior("no_social_goals")  # without reading again
    assert alone.probability(alpha_purple_red="0") == 1
    assert alone.query("P(alpha_red_green=1)") == 0


def strong_and_weak(world: ppl.World) -> None:
    ppl.roles.goals(world)
    ppl.roles.alpha(world)
    for key, low in zip(world.keys, (550.0, 150.0, 150.0), strict=True):
        numpyro.sample(f"strength_{key}", dist.Uniform(low, low + 50))


def test_a_prior_that_is_sure_of_strengths_that_nobody_followed_is_refused() -> None:
    with pytest.raises(InvalidSettingError, match="strengths that are not followed together"):
        of_three().with_prior(strong_and_weak)


def test_hypotheses_that_are_drawn_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    post, table = of_three(), of_three()._table
    (mass,), combinations = table.prior.of_strengths, table.combinations
    for agent in range(3):
        found = [mass[combinations[:, agent] == level].sum() for level in (150, 300, 450, 600)]
        np.testing.assert_allclose(found, [1 / 6, 1 / 3, 1 / 3, 1 / 6], atol=1e-6)
    assert [len(all_ways(n)) for n in (1, 2, 3, 4)] == [1, 5, 25, 153]
    n = [len(possible_goals(agent, CAST)) for agent in range(3)]
    owners = ([own for own, one in zip(n, way, strict=True) if one is None] for way in all_ways(3))
    n_hypotheses = table.prior.n_hypotheses
    assert n_hypotheses == sum(map(math.prod, owners))
    monkeypatch.setattr(prior_masses, "MOST_HYPOTHESES", n_hypotheses // 2)
    monkeypatch.setattr(closed_loop_table, "MOST_ROWS", n_hypotheses)  # strengths are drawn too
    drawn = ClosedLoopPosterior(post.dataset)
    assert drawn._table.sampled
    assert "were drawn" in str(drawn)
    for name in ("goal_red", "goal_purple", "relation_red_purple", "alpha_purple_red"):
        exact = post.marginal(name).values
        np.testing.assert_allclose(drawn.marginal(name).values, exact, atol=0.03)
    assert drawn.mean("strength_green") == pytest.approx(post.mean("strength_green"), abs=2)
    # whatever it was drawn with, none is more probable; others may be as probable
    best, masses = drawn._table.most_probable(drawn.frame), table.log_masses(post.frame)[0]
    same = np.all([column == best[name] for name, column in table.columns().items()], axis=0)
    assert masses[same].max() == pytest.approx(masses.max())
    with pytest.raises(QueryError, match="strength_red"):
        drawn.why("strength_red > 300")


def test_what_is_no_reading_is_refused(tmp_path: Path) -> None:
    post = of_three()
    file = post.save(tmp_path / "three.nc")
    again = ppl.load_posterior(file)
    assert again.scene.world == CAST
    np.testing.assert_array_equal(again.scene.half_widths, post.scene.half_widths)
    for name in ("goal_red", "relation_green_purple", "alpha_red_purple"):
        np.testing.assert_array_equal(again.marginal(name), post.marginal(name))
    nan = BY_PAIRS["log_likelihood"] * np.nan
    for damaged, said in (
        (FOUND.drop_vars("held"), "lacks held"),
        (reading(schema="other"), "schema is 'other'"),
        (reading(columns={"log_likelihood": nan}), "no log densities"),
        (reading().isel(planner_seed=[0]), "planner_seed has 1 entry"),
        (post.dataset.drop_vars("density"), "it lacks density"),
        (post.dataset.drop_vars("marginals"), "it lacks marginals"),
        (reading(world=post.dataset.attrs["world"]), "log_prior has dimensions"),
        (reading(world="{"), "its world"),
    ):
        with pytest.raises(InvalidEventError, match=said):
            ClosedLoopPosterior(damaged)


PLACE = {"landmarks": {"home": (4, 4), "field": (30, 12)}, "arena": (0, 36, 0, 24)}


@pytest.mark.parametrize(
    ("agents", "more"),
    [
        (["big red agent", "green agent"], {"items": ["ball"]}),
        (["a", "b", "c", "d"], {"touchable": []}),
    ],
)
def test_casts_of_all_kinds_are_read(agents: list[str], more: dict[str, list[str]]) -> None:
    world = ppl.World(agents=agents, name="small", **{**PLACE, "items": [], **more})
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=1), planner=QUICK)
    scene, roles = world.random_scene(2), ppl.roles.draw(world, 3)
    event = ppl.simulate(scene, roles, frames=3, planner=QUICK, seed=1)
    post = ppl.infer(event, model, workers=1, progress=False)
    n = len(agents)
    assert len(post.relations_of) == n * (n - 1) / 2
    for name in (*post.goals_of.values(), *post.relations_of.values()):
        assert post.marginal(name).sum() == pytest.approx(1)
    assert post.map().is_possible
    assert str(post.map().world) == str(world)


def test_helpers_take_their_part_of_what_is_wanted() -> None:
    """Somebody who helps one of two agents to get to the other wants what both do."""
    trio = ppl.worlds.TRIO
    goals = {"red agent": "get to green agent", "green agent": "get to red agent"}
    roles = Hypothesis.of(trio, goals, {("purple agent", "red agent"): "help"})
    assert roles.goals["purple agent"] == "Get green agent to red agent"
    agents = trio.agents
    assert all(roles.relation_between(a, b) == "friendly" for a in agents for b in agents if a < b)
    # where only green is a goal of touching, nobody has green's part of it
    with pytest.raises(PhasePPLError, match="the green agent cannot help the red agent with 'get"):
        Hypothesis.of(
            CAST, {"red agent": "get to green agent"}, {("green agent", "red agent"): "help"}
        )
    assert all(ppl.roles.draw(CAST, seed).is_possible for seed in range(20))


def wide_goal(world: ppl.World) -> None:
    for key in world.keys:
        numpyro.sample(f"goal_{key}", dist.Categorical(probs=np.full(100, 0.01)))
    ppl.roles.alpha(world)
    ppl.roles.strengths(world)


def dependent(world: ppl.World) -> None:
    ppl.roles.goals(world)
    ways = numpyro.sample("alpha", dist.Categorical(probs=np.ones(25) / 25))
    ppl.roles.strengths(world)
    numpyro.sample("goal_more", dist.Normal(ways, 1.0))


def leaning(world: ppl.World) -> None:
    strong = numpyro.sample("strong", dist.Bernoulli(0.5))
    ppl.roles.goals(world)
    ppl.roles.alpha(world)
    for key in world.keys:
        numpyro.sample(f"strength_{key}", dist.Uniform(150.0 + 100 * strong, 600.0))


def test_an_agent_that_cannot_leave_its_room_is_said(post: ClosedLoopPosterior) -> None:
    assert post.diagnostics()["sealed_agents"] == []
    scene = ppl.load_event("collaborate").scene
    centre = scene.centre
    walls = np.array([[centre, [16.0, 22.0]], [centre, [26.0, 12.0]], [centre, [11.0, 12.0]]])
    found = reading(columns={"trajectory": np.repeat(scene.start[None], 4, axis=0)})
    found = found.drop_vars("walls").assign(walls=(("wall", "end", "axis"), walls))
    sealed = ClosedLoopPosterior(found.assign(start=(("entity", "coord"), scene.start)))
    told = sealed.diagnostics()
    assert told["sealed_agents"] == ["red agent"]
    assert "The red agent starts in a room that walls close" in told["verdict"]
    assert "agents can leave their room" in str(sealed)


def test_priors_that_cannot_be_are_refused_in_one_line() -> None:
    last = len(CAST.goals) - 1
    for prior, message in (
        (ppl.priors.relation_first, "is of PHASE only, not of 'three': expected uniform, sparse_s"),
        (wide_goal, f"gives mass to goal_red={last + 1}: expected 0..{last}"),
        (lambda world: ppl.roles.goals(world), "does not sample 'alpha'; in 'three' it takes"),
        (lambda world: world.nothing, "cannot be run: AttributeError"),
        (leaning, "makes 'strength_red' depend on strong"),
    ):
        with pytest.raises(PhasePPLError, match=re.escape(message)) as raised:
            masses(bound(prior, CAST))
        assert "\n" not in str(raised.value)
    assert masses(bound(dependent, CAST)).alpha.shape == (25,)
