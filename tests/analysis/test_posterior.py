"""Queries of a posterior."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.quantities import GOAL_PARTS, part_codes
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import ALPHAS, RELATIONS, SCENARIOS

from .factory import (
    AWAY_FROM_RED,
    BLUE_TO_RED,
    PINK_TO_BLUE,
    TO_GREEN,
    TO_RED,
    Simulation,
    hypothesis,
    make_tree,
    posterior_of,
    random_tree,
)

GOAL_SITES = ("goal_red", "goal_green", "stated_goal_red", "stated_goal_green")
LABELS = dict.fromkeys(GOAL_SITES, GOALS) | {"relation": RELATIONS, "scenario": SCENARIOS}
LABELS["alpha"] = tuple(map(str, ALPHAS))


@pytest.fixture(scope="module")
def post() -> Posterior:
    return Posterior(random_tree(5, n_chains=6))


@pytest.fixture(scope="module")
def small() -> Posterior:
    """Four draws: friendly twice, adversarial once, neutral once."""
    hypotheses = [
        hypothesis(BLUE_TO_RED, BLUE_TO_RED, strengths=(200, 300)),
        hypothesis(PINK_TO_BLUE, BLUE_TO_RED, (1, 0), strengths=(250, 300)),
        hypothesis(TO_GREEN, AWAY_FROM_RED, strengths=(400, 300)),
        hypothesis(BLUE_TO_RED, PINK_TO_BLUE, strengths=(600, 300)),
    ]
    return posterior_of(hypotheses, [[0, 1], [2, 3]])


def test_marginals_and_joints_are_of_one_table(post: Posterior) -> None:
    for name, labels in LABELS.items():
        marginal = post.marginal(name)
        assert tuple(marginal[name].values) == labels
        assert float(marginal.sum()) == pytest.approx(1)
        assert float(marginal.min()) >= 0
    for names in (("goal_red", "goal_green"), ("goal_red", "relation", "alpha")):
        joint = post.joint(*names)
        assert joint.dims == names
        assert joint.error.shape == joint.shape
        for name in names:
            others = [other for other in names if other != name]
            np.testing.assert_allclose(joint.sum(name), post.joint(*others), atol=1e-12)


RED_BLUE = {"goal_red": BLUE_TO_RED}


def test_probabilities_of_effective_goals_and_what_follows(small: Posterior) -> None:
    cases: tuple[tuple[dict[str, Any], dict[str, Any], float], ...] = (
        # the second hypothesis helps green with the blue item, whatever red's own goal was
        (RED_BLUE, {}, 3 / 4),
        ({"stated_goal_red": PINK_TO_BLUE}, {}, 1 / 4),
        ({"goal_red": " get  BLUE item to red lm"}, {}, 3 / 4),
        ({"relation": ["friendly", "neutral"]}, {}, 3 / 4),
        ({"scenario": "opposing"}, {}, 1 / 4),
        ({"alpha": (1, 0)}, {}, 1 / 4),
        ({"alpha": "(1,0)"}, {}, 1 / 4),
        ({"target_red": "green agent"}, {}, 1 / 4),
        ({"sign_green": "away from"}, {"sign_red": "to"}, 1 / 4),
        ({"relation": "friendly", "alpha": (1, 0)}, RED_BLUE, 1 / 3),
        ({"strength_red": (240, 600)}, RED_BLUE, 2 / 3),
    )
    for event, given, expected in cases:
        assert small.probability(given, **event) == pytest.approx(expected), event


def test_means_intervals_and_entropies(small: Posterior) -> None:
    assert small.mean("strength_red", given=RED_BLUE) == pytest.approx((200 + 250 + 600) / 3)
    assert small.sd("strength_green") == 0
    # of n equal draws ArviZ has one more than the share of n in the interval
    for share, ends in ((0.3, [200, 250]), (0.5, [200, 400]), (1.0, [200, 600])):
        assert small.hdi("strength_red", share).values.tolist() == ends
    assert small.entropy("relation") == pytest.approx(0.5 * np.log(2) + 0.5 * np.log(4))
    assert small.entropy("goal_red", "goal_green", "alpha") == pytest.approx(np.log(4))
    assert small.entropy("relation", given={"goal_red": TO_GREEN}) == 0
    with pytest.raises(InvalidSettingError, match="at most"):
        small.joint(*LABELS)
    assert small.entropy(*LABELS) > 0, "where a table of the joint would be too large"


def test_top_goals_come_in_order_and_ties_in_label_order() -> None:
    post = posterior_of((5, 9, 2), [[0, 1], [1, 2]])
    assert post.top("goal_red", 3) == [(GOALS[9], 0.5), (GOALS[2], 0.25), (GOALS[5], 0.25)]


def test_map_is_the_best_completed_simulation_accepted_or_not() -> None:
    best = hypothesis(TO_GREEN, BLUE_TO_RED, (1, 0), (222, 333))
    simulations = [
        Simulation(hypothesis(), 0, log_prior=-1, log_likelihood=-4),
        Simulation(best, 1, log_prior=-2, log_likelihood=-2),
        Simulation(hypothesis(3), 2, log_prior=0, log_likelihood=-1, completed=False),
        Simulation(hypothesis(4), 3, log_prior=0, log_likelihood=0, failed=True),
    ]
    post = Posterior(make_tree(simulations, [[0]]))
    assert post.map() == best
    expected = {"goal_red": BLUE_TO_RED, "stated_goal_red": TO_GREEN, "relation": "friendly"}
    assert {**expected, "log_joint": -4}.items() <= post.map_record().items()


def test_replay_is_the_stored_simulation_of_the_map_where_a_chain_kept_it() -> None:
    simulations = [
        Simulation(hypothesis(), 7, log_likelihood=-4),
        Simulation(hypothesis(), 8, log_likelihood=-2),
        Simulation(hypothesis(3), 9, log_likelihood=-1),
    ]
    kept = Posterior(make_tree(simulations, [[0, 2], [1, 1]]))
    assert kept.replay().shape == (5, 4, 3)
    assert (kept.replay() == 2).all()
    rejected = Posterior(make_tree(simulations, [[0, 0], [1, 1]]))
    assert rejected.map().goal_red == 3
    assert (rejected.replay() == 1).all()


def test_a_site_of_the_users_own_can_be_asked_for() -> None:
    post = posterior_of([hypothesis()] * 3, [[0, 1, 2, 2]], own_site=[0, 2, 1])
    np.testing.assert_allclose(post.marginal("mood"), [0.25, 0.5, 0.25])
    assert post.probability(mood=1, given=RED_BLUE) == pytest.approx(0.5)
    negative = posterior_of([hypothesis()] * 2, [[0, 1]], own_site=[-3, 4])
    assert negative.marginal("mood")["mood"].values.tolist() == ["-3", "4"]


UNKNOWN: dict[str, Any] = {
    "goal_red": lambda post: post.marginal("goal_rde"),
    "friendly": lambda post: post.probability(relation="freindly"),
    BLUE_TO_RED: lambda post: post.probability(goal_red="Get blue item to redd lm"),
    r"\(1, 0\)": lambda post: post.probability(alpha=(1, 1)),
}
TO_RED_AT_ALL, IN_A_GAP = {"goal_red": TO_RED}, {"strength_red": (500, 550)}
IMPOSSIBLE: dict[str, Any] = {
    "no draw of this posterior": lambda post: post.probability(TO_RED_AT_ALL, relation="friendly"),
    "500": lambda post: post.probability(IN_A_GAP, relation="friendly"),
    "name the event": lambda post: post.probability(),
    "interval": lambda post: post.probability(strength_red=300),
    "empty": lambda post: post.probability(strength_red=(400, 300)),
    "mean or hdi": lambda post: post.marginal("strength_red"),
    "categories": lambda post: post.mean("relation"),
    "twice": lambda post: post.joint("relation", "relation"),
    "prob=94": lambda post: post.hdi("strength_red", 94),
    "n=0": lambda post: post.top("goal_red", 0),
}


def test_questions_without_an_answer_raise_and_say_why(small: Posterior) -> None:
    for error, questions in ((UnknownNameError, UNKNOWN), (InvalidSettingError, IMPOSSIBLE)):
        for said, ask in questions.items():
            with pytest.raises(error, match=said):
                ask(small)


def test_a_goal_has_a_kind_for_its_holder_a_target_a_landmark_and_a_sign() -> None:
    for goal, kinds, target, landmark, sign in (
        (BLUE_TO_RED, "item item", "blue item", "red lm", "to"),
        ("Get pink item away from green lm", "item item", "pink item", "green lm", "away from"),
        ("Get red agent to blue lm", "self other", "red agent", "blue lm", "to"),
        (TO_GREEN, "self self", "green agent", "none", "to"),
        (AWAY_FROM_RED, "self self", "red agent", "none", "away from"),
    ):
        codes = part_codes(*[np.array([GOALS.index(goal)])] * 2)
        for agent, kind in zip(("red", "green"), kinds.split(), strict=True):
            kind += "-other" if landmark == "none" else "-landmark"
            of = {part: labels[codes[f"{part}_{agent}"][0]] for part, labels in GOAL_PARTS.items()}
            assert of == {"goal_kind": kind, "target": target, "landmark": landmark, "sign": sign}


def test_a_defined_quantity_is_asked_for_like_any_other(small: Posterior) -> None:
    post = Posterior(small.tree)
    assert post.define("same_goal", lambda h: h.goal_red == h.goal_green) is post
    assert post.probability(same_goal=True) == pytest.approx(1 / 2)
    assert post.probability(relation="friendly", given={"same_goal": "true"}) == 1
    assert post.marginal("same_goal")["same_goal"].values.tolist() == ["False", "True"]
    post.define("stronger", lambda h: "red" if h.strength_red > h.strength_green else "green")
    post.define("gap", lambda h: h.strength_red - h.strength_green if h.same_goal else 0)
    post.define("helpers", lambda h: sum(sign > 0 for sign in h.alpha))
    assert post.mode("stronger", given={"same_goal": False}) == "red"
    assert post.mean("gap") == pytest.approx((-100 - 50 + 0 + 0) / 4)
    assert post.probability(gap=(-60, -1)) == pytest.approx(1 / 4)
    assert post.probability(helpers=1) == post.mean("helpers") == pytest.approx(1 / 4)
    assert post.probability(helpers=(1, 2)) == pytest.approx(1 / 4)
    post.define("gap", lambda h: h.strength_red / 2)  # it is replaced
    assert post.mean("gap") == pytest.approx(post.mean("strength_red") / 2)
    table = post.to_dataframe()
    assert table["weight"].sum() == pytest.approx(1)
    assert table["relation"].tolist() == ["friendly", "friendly", "adversarial", "neutral"]
    assert table["same_goal"].tolist() == [True, True, False, False]
    assert table["helpers"].tolist() == [0, 1, 0, 0]
    assert "same_goal" not in small.quantities


def _fails(h: object) -> bool:
    raise KeyError("oops")


def test_definitions_that_cannot_be_raise_and_name_the_hypothesis(small: Posterior) -> None:
    cases: tuple[tuple[Any, Any, str], ...] = (
        ("relation", lambda h: True, "'relation' already"),
        ("same goal", lambda h: True, "'same goal'"),
        ("in", lambda h: True, "valid Python name"),
        ("given", lambda h: True, "reserved"),
        (3, lambda h: True, "called 3"),
        ("x", 3, "expected a function"),
        ("x", _fails, "goal_red='Get.*KeyError: 'oops'"),
        ("x", lambda h: h.goal_rde, "did you mean 'goal_red'"),
        ("x", lambda h: float("nan"), "x is nan for goal_red="),
        ("x", lambda h: None, "x is None for .*expected a truth value"),
        ("x", lambda h: h.alpha == (1, 0) or "no", "several kinds: .*bool.*str|str.*bool"),
    )
    for name, function, said in cases:
        with pytest.raises(InvalidSettingError, match=said):
            small.define(name, function)
    assert "x" not in small.quantities


KEYS = ["goals", "relation", "scenario", "strengths", "errors", "map", "diagnostics", "settings"]
KEYS += ["cost"]


def test_summary_has_exactly_its_keys_and_is_json(post: Posterior) -> None:
    summary = post.summary()
    assert list(summary) == KEYS
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert list(summary["goals"]) == ["red agent", "green agent"]
    for name, found in zip(LABELS, summary["goals"].values(), strict=False):
        assert found == dict(zip(GOALS, post.marginal(name).values, strict=True))
    for name in ("relation", "scenario"):
        assert tuple(summary[name]) == LABELS[name]
    for strength in summary["strengths"].values():
        assert set(strength) == {"mean", "sd", "hdi_low", "hdi_high"}
        assert strength["hdi_low"] <= strength["mean"] <= strength["hdi_high"]
    assert set(summary["map"]) == {*LABELS, "strength_red", "strength_green", "log_joint"}
    errors = summary["errors"]
    assert {k: list(v) for k, v in errors.items()} == {k: list(summary[k]) for k in KEYS[:4]}
    assert errors["relation"]["neutral"] > 0
    assert summary["diagnostics"]["weights"] == post.weights
    assert summary["settings"] == {"seed": 0, "kernel": "local_mh", "beta": 0.05}
    single = Posterior(random_tree(1, n_chains=1)).summary()
    assert single["errors"]["relation"]["neutral"] is None  # JSON has no NaN


def test_table_fits_a_terminal_and_shows_the_leading_goals() -> None:
    tree = random_tree(4)
    tree.attrs["event_id"] = "a rather long name of an event " * 4
    post = Posterior(tree)
    text = str(post)
    assert max(len(line) for line in text.splitlines()) <= 88
    for name in ("goal_red", "goal_green"):
        goal, value = post.top(name, 1)[0]
        assert any(goal in line and str(value) in line for line in text.splitlines())
    assert text.index("answer  ") < text.index("relation  ")  # before the bars
    for word in ("relation", "scenario", "strength", "cost", "checks", "12 s on 2 workers"):
        assert word in text
    # d / beta, of x and y of four entities, is beyond the arena
    told = (
        "tempered: a frame's likelihood is exp(-0.05 x distance), so one frame says next to nothing"
    )
    assert told in " ".join(text.split())
    assert repr(post) == f"<Posterior of {post.event_id}: 4 x 6 draws, weights 'count'>"
    # goals without mass and costs that are not known are left out
    tree = make_tree([Simulation(hypothesis())], [[0]])
    tree.attrs["cost"] = "{}"
    text = str(Posterior(tree))
    assert text.partition("red agent")[2].count("Get ") == 2
    assert "1 simulations;" in text
