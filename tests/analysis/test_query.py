"""Questions in words: what they mean, and that wrong ones point at the place."""

from __future__ import annotations

import contextlib
import math
import pickle
from pathlib import Path

import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import QueryError

from .factory import BLUE_TO_RED, PINK_TO_BLUE, TO_GREEN, hypothesis, posterior_of, random_tree


@pytest.fixture(scope="module")
def small() -> Posterior:
    hypotheses = [
        hypothesis(BLUE_TO_RED, BLUE_TO_RED, strengths=(200, 300)),
        hypothesis(PINK_TO_BLUE, BLUE_TO_RED, (1, 0), strengths=(250, 300)),
        hypothesis(TO_GREEN, PINK_TO_BLUE, strengths=(400, 300)),
        hypothesis(BLUE_TO_RED, PINK_TO_BLUE, strengths=(600, 300)),
    ]
    post = posterior_of(hypotheses, [[0, 1], [2, 3]])
    post.define("same_goal", lambda h: h.goal_red == h.goal_green)
    post.define("aim", lambda h: h.goal_green)  # the labels of goals in an order of its own
    return post.define("mood", lambda h: "keen, or not" if h.same_goal else "it's = {fine}")


NUMBERS = {
    "P(relation=friendly)": 1 / 2,
    "P(relation=friendly | goal_red=Get blue item to red lm)": 2 / 3,
    "  p [ relation = FRIENDLY|goal_red=get  BLUE item to red lm ] ": 2 / 3,
    "P(relation != friendly)": 1 / 2,
    "P(alpha in {(1,0), (0, 1)})": 1 / 4,
    "P(strength_red >= 250)": 3 / 4,
    "P(strength_red in [250, 400])": 1 / 2,
    "P(strength_red in [-1, .5])": 0.0,
    "P(same_goal = true | relation = friendly)": 1.0,
    "P(mood = 'keen, or not')": 1 / 2,
    'P("mood" = "it\'s = {fine}")': 1 / 2,
    "E[strength_red]": 362.5,
    "E same_goal": 1 / 2,
    "sd(strength_green)": 0.0,
    "H(same_goal)": math.log(2),
    "P(strength_red > strength_green)": 1 / 2,
    "P(goal_red = goal_green)": 1 / 2,
    "P(goal_red = aim)": 1 / 2,
    "P(aim != goal_green)": 0.0,
    "P(relation=friendly or strength_red > 500)": 3 / 4,
    "P(relation=friendly and strength_red > 200 or strength_red > 500)": 1 / 2,
    "P(relation=friendly and (strength_red > 200 or strength_red > 500))": 1 / 4,
    "P not relation=friendly": 1 / 2,
    "P(NOT (relation=friendly OR strength_red in [600, 700]))": 1 / 4,
    "E[strength_red | strength_red < strength_green or relation=friendly]": 225.0,
    "P(mood = 'keen, or not' or same_goal=False)": 1.0,
    "odds(strength_red >= 250)": 3.0,
    "P(relation=friendly, strength_red > 200) / P(relation=neutral)": 1 / 2,
    "E[strength_red | relation=friendly] / E(strength_green)": 3 / 4,
    "odds(strength_red > 0)": math.inf,
}


def test_numbers(small: Posterior) -> None:
    for question, number in NUMBERS.items():
        assert small.query(question) == pytest.approx(number), question


def test_tables_labels_and_intervals(small: Posterior) -> None:
    xr.testing.assert_identical(small.query("P(goal_red)"), small.marginal("goal_red"))
    joint = small.query("P goal_red, relation | strength_red < 500")
    expected = small.joint("goal_red", "relation", given={"strength_red": (0, 499)})
    xr.testing.assert_identical(joint, expected)
    assert small.query("mode(goal_red)") == BLUE_TO_RED
    assert small.query("top goal_red") == small.top("goal_red")
    assert small.query("top 1 (relation | strength_red > 300)") == [("neutral", 1.0)]
    assert small.query("hdi 30% strength_red").values.tolist() == [200, 250]
    assert small.query("hdi 0.3 (strength_red)").values.tolist() == [200, 250]
    assert small.query("hdi strength_red").values.tolist() == [200, 600]


WRONG = {
    "": (0, "expected one of P, E, sd"),
    "relation=friendly": (0, "expected one of P"),
    "P(relation=)": (11, "a value of 'relation'"),
    "P(relation=friendly": (19, "',' or '|' or ')'"),
    "P(relation=friendly) x": (21, "the end"),
    "P(relation=freindly)": (11, "did you mean 'friendly'"),
    "P(relatoin=friendly)": (2, "unknown quantity 'relatoin'; allowed: goal_red, "),
    "P(relation~friendly)": (10, "',' or '|' or ')'"),
    "P(relation=friendly, goal_red)": (29, "a comparison of goal_red (=, !=, <"),
    "P(goal_red, relation=friendly)": (20, "names only or conditions only"),
    "P(goal_red, goal_red)": (12, "named twice"),
    "P(relation=friendly | alpha=(1,0) | x)": (34, "',' or ')'"),
    "P(relation in friendly)": (14, "{ and labels"),
    "P(relation < 3)": (11, "has categories"),
    "P(relation=friendly, relation=neutral)": (21, "no value of relation"),
    "P(strength_red=300)": (14, "is a real number"),
    "P(strength_red)": (2, "without categories"),
    "P(strength_red < )": (17, "a number"),
    "P(strength_red < 1e999)": (17, "a finite number"),
    "P(strength_red in [400, 300])": (19, "lower end comes first"),
    "P(strength_red > 400, strength_red < 300)": (22, "no value of strength_red"),
    "P(mood='keen)": (13, "a closing '"),
    "P(relation=friendly | goal_red=Get pink item to red lm)": (22, "no draw of this"),
    "E(goal_red)": (2, "has categories"),
    "E[strength_red, strength_green]": (14, "'|' or ']'"),
    "hdi 94 strength_red": (4, "a share in (0, 1]"),
    "top 0 goal_red": (4, "a whole number from 1"),
    "top (strength_red)": (5, "without categories"),
    "mode 3 goal_red": (5, "the name of a quantity"),
    "P(strength_red > strong)": (17, "unknown quantity 'strong'"),
    "P(strength_red > relation)": (15, "relation has categories"),
    "P(sign_red=to or strength_red = strength_green)": (30, "is a real number"),
    "P(relation = goal_red)": (11, "no value in common"),
    "P(relation=friendly or neutral)": (30, "one of several values: in {a, neutral}"),
    "P(same_goal=1 or (strength_red > 3))": (12, "unknown same_goal '1'"),
    "P(relation=friendly | strength_red > strength_green, strength_red < 250)": (
        22,
        "no draw of this",
    ),
    "P(relation=friendly given alpha=(1,0))": (20, "write '|' in place of 'given'"),
    "P(relation) / P(relation=friendly)": (0, "a number on both sides of '/'"),
    "P(relation=friendly) / mode relation": (23, "a number on both sides of '/'"),
    "P(relation=friendly) / P(strength_red < 0)": (23, "this is 0"),
    "E[strength_red] / E[strength_green] / E[strength_red]": (36, "the end"),
    "P(goal_red,goal_green,stated_goal_red,stated_goal_green,alpha,relation)": (2, "at most"),
}


def test_a_wrong_question_points_at_the_place_and_says_what_is_expected(small: Posterior) -> None:
    for question, (place, said) in WRONG.items():
        with pytest.raises(QueryError) as caught:
            small.query(question)
        assert said in caught.value.reason
        assert caught.value.position == place, question
        lines = [caught.value.reason, "  " + question, " " * (2 + place) + "^"]
        assert str(caught.value).split("\n") == lines
        assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_words_and_a_mapping_say_the_same_of_what_is_given(small: Posterior) -> None:
    words = "relation=friendly or strength_red > 500"
    assert small.mean("strength_red", given=words) == pytest.approx((200 + 250 + 600) / 3)
    assert small.probability(words, same_goal=True) == small.query(f"P(same_goal=True | {words})")
    xr.testing.assert_identical(
        small.marginal("goal_red", given="relation=friendly"),
        small.marginal("goal_red", given={"relation": "friendly"}),
    )
    with pytest.raises(ValueError, match="cannot condition on not same_goal=True, relation=f"):
        small.mean("strength_red", given="not same_goal=True, relation=friendly")


def test_comparisons_have_errors_as_of_a_definition_that_says_the_same() -> None:
    post = Posterior(random_tree(7, n_chains=6))
    post.define("stronger", lambda h: h.strength_red > h.strength_green)
    for condition in ("", "| relation=neutral or goal_red != goal_green"):
        compared = post.query(f"P(strength_red > strength_green {condition})")
        named = post.query(f"P(stronger=True {condition})")
        assert (compared, compared.error) == (named, named.error)
        assert 0 < compared.error < 1


def test_odds_and_ratios_have_the_errors_of_both_numbers_together() -> None:
    post = Posterior(random_tree(7, n_chains=6))
    p, rest = post.query("P(relation=neutral)"), post.query("P(not relation=neutral)")
    odds, ratio = (
        post.query("odds(relation=neutral)"),
        post.query("P(relation=neutral) / P(not relation=neutral)"),
    )
    assert odds == pytest.approx(p / rest)
    assert odds.error == pytest.approx(p.error / rest**2)
    # what is added to one is missing from the other, which independent errors would not know
    apart = ratio * math.hypot(p.error / p, rest.error / rest)
    assert apart < ratio.error < 2 * odds.error
    same = post.query("E[strength_red] / E[strength_red]")
    alone = post.query("E[strength_red]")
    assert same == 1.0
    assert same.error < alone.error / alone * math.sqrt(2)
    given = post.query("P(alpha=(1,0) | relation=neutral)")
    both = post.query("P(alpha=(1,0), relation=neutral) / P(relation=neutral)")
    assert both == pytest.approx(float(given))


def test_definitions_in_words_are_saved(tmp_path: Path) -> None:
    post = Posterior(random_tree(3, n_chains=4))
    post.define("same", "goal_red = goal_green").define("odd", lambda h: h.relation == "neutral")
    post.define("strong_pair", "same=True, strength_red > strength_green")
    post.define("odder", "odd=True or same=False")  # rests on a function
    again = ppl.load_posterior(post.save(tmp_path / "run.nc"))
    assert list(again.definitions) == ["same", "strong_pair"]
    for question in ("P(same=True)", "E[same | strong_pair=False]"):
        assert again.query(question) == post.query(question)


HOSTILE = [
    "P(" * 50_000,
    "P(relation in {" + "friendly, " * 800 + "freindly})",
    "P(relation=\x00\x1b[31m\n\r\tfriendly)",
    "P(relation=" + "a" * 9_000 + ")",
    "top " + "9" * 9_000 + " goal_red",
    "P(\u202erelation)",
    "P(relation='" + "\n" * 500,
    "\ud800",
    "P(" + "(" * 9_000,
    "P(" + "not " * 2_000 + "relation=friendly)",
]


def test_hostile_questions_get_one_short_clear_error(small: Posterior) -> None:
    for question in HOSTILE:
        with pytest.raises(QueryError) as caught:
            small.query(question)
        lines = str(caught.value).split("\n")
        assert len(lines) == 3
        assert all(len(line) < 250 for line in lines)
        assert all(character.isprintable() for line in lines for character in line)
    with pytest.raises(QueryError, match="a question is text, not 3"):
        small.query(3)  # type: ignore[arg-type]


POST = Posterior(random_tree(5, n_chains=5))
POST.define("strong", "strength_red > 300")


PIECES = st.sampled_from(
    [
        *("P", "E", "H", "top", "hdi", "mode", "in", "(", ")", "[", "]", "{", "}", ",", "|"),
        *("=", "!=", "<", ">=", "3", "50%", "'", '"', ".", " ", "\n", "\x00"),
        *("or", "and", "not", "strength_green", "goal_green"),
        *("relation", "friendly", "goal_red", "strength_red", "alpha", "(1, 0)", "to red lm"),
    ]
)


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=60) | st.lists(PIECES, max_size=14).map("".join))
def test_whatever_is_asked_only_a_question_error_is_raised(text: str) -> None:
    for question in (text, "P(" + text, "P(goal_red|" + text + ")"):
        with contextlib.suppress(QueryError):
            POST.query(question)
