"""A posterior that was read step by step is the sum over all hypotheses, at any frame."""

from __future__ import annotations

import functools
import itertools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from matplotlib import rc_context

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis import stepwise_table
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.models.roles import masses
from phase_ppl.render.frames import PANEL
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, PhasePPLError, QueryError
from phase_ppl.world.goals import GOALS, N_GOALS, effective_goals, possible_goals
from phase_ppl.world.hypothesis import ALPHAS, RELATIONS, Roles, all_ways, relation
from tests.analysis.readings import BLUE_NOT_TO_RED, BLUE_TO_RED, LEVELS, reading
from tests.render.test_video import read

FOUND = reading()


@functools.cache
def by_hand(frame: int) -> dict[tuple[int, int, int, int, int], float]:
    """Return the mass of every hypothesis: stated goals, alpha, strengths."""
    likelihood = FOUND["log_likelihood"].values[: frame + 1].sum(axis=0)
    log_prior, strengths = FOUND["log_prior"].values, FOUND["strengths"].values[frame]
    masses = {}
    for red, green, alpha, fr, fg in itertools.product(
        range(N_GOALS), range(N_GOALS), range(len(ALPHAS)), range(2), range(2)
    ):
        pair = effective_goals(red, green, ALPHAS[alpha])
        mass = np.exp(log_prior[red, green, alpha, fr, fg] + 0.5 * likelihood[pair])
        masses[red, green, alpha, fr, fg] = float(mass * strengths[fr, fg])
    total = sum(masses.values())
    return {hypothesis: mass / total for hypothesis, mass in masses.items()}


@pytest.mark.parametrize("frame", [0, 2, 3])
def test_every_answer_is_a_sum_over_hypotheses(frame: int) -> None:
    post, masses = StepwisePosterior(FOUND, frame), by_hand(frame)
    goals: dict[str, float] = dict.fromkeys(GOALS, 0.0)
    friendly = strong = 0.0
    for (red, green, alpha, fr, _), mass in masses.items():
        pair = effective_goals(red, green, ALPHAS[alpha])
        goals[GOALS[pair[0]]] += mass
        friendly += mass * (relation(*pair) == "friendly")
        strong += mass * (LEVELS[fr] == 600.0)
    marginal = post.marginal("goal_red")
    np.testing.assert_allclose(marginal.values, list(goals.values()), atol=1e-9)
    assert post.probability(relation="friendly") == pytest.approx(friendly, abs=1e-9)
    assert post.probability(strength_red=(500, 600)) == pytest.approx(strong, abs=1e-9)
    assert post.query("P(relation=friendly)") == pytest.approx(friendly, abs=1e-9)


def without_each() -> list[StepwisePosterior]:
    """Return what is read without each set of searches."""
    found = FOUND["log_likelihood_without"].values.astype(float)
    return [StepwisePosterior(reading(1, columns={"log_likelihood": one})) for one in found]


def test_errors_are_the_jackknife_over_sets_of_searches() -> None:
    post = StepwisePosterior(FOUND)
    shares = [alone.probability(relation="friendly") for alone in without_each()]
    expected = np.sqrt((3 - 1) * np.var(shares))
    assert expected > 0.001
    found = post.probability(relation="friendly")
    assert found.error == pytest.approx(expected, rel=1e-4)
    assert post.at(0).probability(relation="friendly").error == 0  # nothing was searched yet
    assert post.query("P(relation=friendly)").error == found.error
    for of_strengths in ("hdi strength_red", "E[strength_red]", "P(strength_red > 300)",
                         "P(relation=friendly and strength_red > strength_green)"):  # fmt: skip
        assert np.isnan(post.query(of_strengths).error).all(), "one filter follows strengths"
    one = StepwisePosterior(reading(planner_seeds=1))
    assert np.isnan(one.probability(relation="friendly").error)
    assert "With one set of searches nothing tells" in str(one)
    assert "± ?" in str(one)


def expected_errors(post: StepwisePosterior) -> list[float]:
    return [post.probability(relation=label).error for label in RELATIONS]


def test_over_time_is_the_posterior_at_each_frame() -> None:
    post = StepwisePosterior(FOUND)
    found = post.over_time()
    for frame in range(4):
        for name in ("goal_red", "goal_green", "relation", "scenario"):
            expected = post.at(frame).marginal(name)
            np.testing.assert_allclose(found[name].values[frame], expected, atol=1e-9)
        errors = found["relation_error"].values[frame]
        np.testing.assert_allclose(errors, expected_errors(post.at(frame)), rtol=1e-6, atol=1e-9)
    assert (found["relation_error"].values[-1] > 0.001).any()
    assert "filtering" in found.attrs
    assert len(post.at(1).over_time()["time"]) == 2
    one = StepwisePosterior(reading(planner_seeds=1)).over_time()
    assert np.isnan(one["relation_error"].values).all()


def test_the_best_hypothesis_leads_and_the_evidence_grows() -> None:
    post = StepwisePosterior(FOUND)
    assert post.map().effective_goals == (BLUE_TO_RED, BLUE_TO_RED)
    assert post.map_record()["goal_red"] == GOALS[BLUE_TO_RED]
    evidence = [post.at(frame).log_evidence for frame in range(4)]
    assert evidence[0] == pytest.approx(0, abs=1e-9)
    assert evidence[3] > evidence[0]
    # frames count in full, although the posterior tempers them
    prior = by_hand(0)
    likelihood = FOUND["log_likelihood"].values.sum(axis=0)
    strengths = FOUND["strengths"].values[-1] * 4
    total = sum(
        mass * np.exp(likelihood[effective_goals(red, green, ALPHAS[alpha])]) * strengths[fr, fg]
        for (red, green, alpha, fr, fg), mass in prior.items()
    )
    assert evidence[3] == pytest.approx(np.log(total))
    tempered = StepwisePosterior(reading(weight=0.1))
    assert tempered.log_evidence == pytest.approx(evidence[3])
    assert "tempered: a frame counts 0.1 for goals" in str(tempered)
    assert "tempered" not in str(StepwisePosterior(reading(weight=1.0)))


def test_what_is_tempered_is_said_of_goals_and_strengths() -> None:
    found = reading(weight=1.0)
    found.attrs["settings"] = json.dumps({"likelihood": {"tracking": {"strength_weight": 0.05}}})
    post = StepwisePosterior(found)
    tempering = "tempered: a frame counts 0.05 for strengths"
    assert post.tempering == tempering
    assert tempering in str(post)
    assert "nats, every frame counted in full, for strengths 0.05" in str(post)
    assert post.why("relation=friendly").attrs["tempering"] == tempering
    assert post.over_time().attrs["tempering"] == tempering


def test_why_gives_the_log_odds_and_who_changed_them() -> None:
    post, names = StepwisePosterior(FOUND), ("to red lm", "away from red lm")
    found = post.why(*(f"goal_red=Get blue item {name}" for name in names))
    for frame in range(4):
        at = post.at(frame).marginal("goal_red").values
        odds = np.log(at[BLUE_TO_RED] / at[BLUE_NOT_TO_RED])
        assert found["log_odds"].values[frame] == pytest.approx(odds)
    np.testing.assert_allclose(np.diff(found["log_odds"]), found["change"].values[1:])
    assert found["change"].values[0] == 0
    alone = post.why("relation=friendly")
    share = post.probability(relation="friendly")
    assert alone["log_odds"].values[-1] == pytest.approx(np.log(share / (1 - share)))


def test_log_odds_have_the_jackknifes_error_over_the_sets_of_searches() -> None:
    found = StepwisePosterior(FOUND).why("relation=friendly")
    odds = np.array([post.why("relation=friendly")["log_odds"].values for post in without_each()])
    expected = np.sqrt((len(odds) - 1) / len(odds) * ((odds - odds.mean(axis=0)) ** 2).sum(axis=0))
    np.testing.assert_allclose(found["error"].values, expected, rtol=1e-6, atol=1e-9)
    assert (found["error"].values[1:] > 0).all()
    single = StepwisePosterior(reading(planner_seeds=1)).why("relation=friendly")
    assert np.isnan(single["error"].values).all()


@pytest.mark.parametrize(
    ("event", "error", "message"),
    [
        ("relation", QueryError, "expected =, !="),
        ("relation=cordial", QueryError, "cordial"),
        ("relation=friendly | alpha=(1, 0)", QueryError, "'or' or the end"),
        ("goal_red=get to red agent", InvalidSettingError, "impossible under the prior"),
        ("strength_red > 0", InvalidSettingError, "^not strength_red > 0 is impossible"),
    ],
)
def test_what_has_no_odds_is_refused(event: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        StepwisePosterior(FOUND).why(event)


def test_it_is_saved_and_read_again(tmp_path: Path) -> None:
    post = StepwisePosterior(FOUND)
    file = post.save(tmp_path / "found.nc")
    for again in (StepwisePosterior.load(file), ppl.load_posterior(file)):
        assert isinstance(again, StepwisePosterior)
        np.testing.assert_array_equal(
            again.joint("goal_red", "relation"), post.joint("goal_red", "relation")
        )
        assert str(again) == str(post)
    with pytest.raises(InvalidEventError, match="read step by step: load_posterior"):
        ppl.Posterior.load(file)
    with pytest.raises(InvalidSettingError, match="no draws"):
        ppl.load_posterior(file, "count")
    content = bytearray(file.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 64] = bytes(64)
    file.write_bytes(content)
    with pytest.raises(InvalidEventError):
        StepwisePosterior.load(file)


def test_the_verdict_leads_with_the_worst_sign() -> None:
    def diagnosed(**columns: Any) -> dict[str, Any]:
        return StepwisePosterior(reading(columns=columns)).diagnostics()

    fine = diagnosed()
    assert fine["unexplained_frames"] == fine["overlapping_frames"] == []
    assert fine["verdict"].startswith("Actions explain every frame")
    poses = FOUND["trajectory"].values.copy()
    poses[2, 0, :2] = poses[2, 1, :2]  # red lies on green
    lying = diagnosed(trajectory=poses)
    assert lying["overlapping_frames"] == [2]
    assert lying["verdict"].startswith("Bodies lie on each other or in a wall in frame 2,")
    torn = diagnosed(unexplained=np.array([0.0, 1.0, 40.0, 1.0]), trajectory=poses)
    assert torn["unexplained_frames"] == [2]
    assert torn["verdict"].startswith("No action explains frame 2:")
    assert "Bodies lie" in torn["verdict"]
    odd = diagnosed(log_peak=np.full(4, 60.0))
    assert odd["surprising_share"] == 1.0
    assert odd["verdict"].startswith("100% of the frames surprise")
    without = FOUND["log_likelihood_without"].values.copy()
    without[0, 1:, BLUE_NOT_TO_RED, BLUE_TO_RED] += 30.0
    split = diagnosed(log_likelihood_without=without)
    assert "sets of searches disagree" in split["verdict"]
    for found in (lying, torn, odd, split):
        assert "Actions explain every frame" not in found["verdict"]
    text = str(StepwisePosterior(FOUND))
    assert text.index("verdict") < text.index(fine["verdict"][-20:]) < text.index("relation  ")


def test_what_is_no_reading_is_refused() -> None:
    nan = FOUND["log_likelihood"].values * np.nan
    for found, said in (
        (FOUND.drop_vars("held"), "lacks held"),
        (reading(schema="other"), "schema is 'other'"),
        (reading(columns={"log_likelihood": nan}), "no log densities"),
    ):
        with pytest.raises(InvalidEventError, match=said):
            StepwisePosterior(found)


def test_figures_and_film(tmp_path: Path) -> None:
    post = StepwisePosterior(FOUND)
    figure = ppl.plot.why(post, "relation=friendly", "relation=adversarial", tmp_path / "why.png")
    assert len(figure.axes) >= 3
    ppl.plot.over_time(post, tmp_path / "over_time.png")
    ppl.plot.posterior(post, tmp_path / "posterior.png")
    with rc_context({"figure.dpi": 150}):  # a user's own, which films do not follow
        film = ppl.watch_film(post, tmp_path / "watch.mp4")
    _, frames = read(film.path)
    assert frames.shape[2] < 2.1 * PANEL
    assert all(file.stat().st_size > 1000 for file in tmp_path.iterdir())
    assert len(list(tmp_path.iterdir())) == 4


def test_medians_and_mutual_information() -> None:
    post, masses = StepwisePosterior(FOUND), by_hand(3)
    joint = np.zeros((N_GOALS, N_GOALS))
    for (red, green, alpha, _, _), mass in masses.items():
        joint[effective_goals(red, green, ALPHAS[alpha])] += mass
    apart = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.nansum(joint * np.log(joint / apart))
    found = post.query("I(goal_red; goal_green)")
    assert found == pytest.approx(expected, abs=1e-6)
    assert found == pytest.approx(post.mutual_information("goal_green", "goal_red"))
    assert found.error > 0
    assert post.query("I(goal_red; relation | goal_red=get to green agent)") == pytest.approx(0)
    strong = sum(mass for (*_, fr, _), mass in masses.items() if fr == 1)
    assert post.query("median strength_red") == LEVELS[int(strong > 0.5)]
    with pytest.raises(QueryError, match="';' and another"):
        post.query("I(goal_red)")
    with pytest.raises(QueryError, match="categories, not numbers"):
        post.query("median(goal_red)")


def test_comparisons_and_definitions_hold_at_every_frame_in_why_and_in_files(
    tmp_path: Path,
) -> None:
    post = StepwisePosterior(FOUND)
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
    again = StepwisePosterior.load(post.save(tmp_path / "x.nc"))
    assert list(again.definitions) == ["red_leads"]
    assert again.query("P(red_leads=True)") == last
    with pytest.raises(InvalidSettingError, match="no draws to be weighted"):
        post.query("P(relation)", weights="count")


def test_a_video_of_one_frame_says_what_was_believed_before_it() -> None:
    one = FOUND.isel(time=slice(0, 1))
    post = StepwisePosterior(one)
    assert post.surprise().tolist() == [0.0]
    assert "Nothing was seen but the start" in post.diagnostics()["verdict"]


@pytest.mark.parametrize("frame", [1.5, "2", True, -1, 4])
def test_frames_that_there_are_not_are_refused(frame: Any) -> None:
    with pytest.raises(InvalidSettingError, match="frame="):
        StepwisePosterior(FOUND).at(frame)


# --- other worlds ---------------------------------------------------------------------------------

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
