"""What the authors' file names say, and names that say as much."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phase_ppl.dataset.authors.names import (
    Place,
    Recorded,
    file_name,
    goal_numbers,
    goal_string,
    parse_name,
    place_in_id,
)
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Truth
from phase_ppl.world.goals import GOALS, N_GOALS, is_self_referring
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from tests.dataset.authors.pickles import name_of

TRUTH = Truth(
    "Get blue item to red lm", "get to red agent", strength_red=600.0, strength_green=150.0
)


def test_a_name_says_where_it_was_and_who_wanted_what() -> None:
    recorded = Recorded("D082020_1817530_E8", Place(8, None), TRUTH)
    for ending in ("", ".mp4", ".pik"):
        assert parse_name(name_of(None) + ending) == recorded


def test_a_reflected_copy_has_a_number_after_the_layout() -> None:
    said = parse_name(name_of(3))
    assert (said.id, said.place) == ("D082020_1817530_E8.3", Place(8, 3))
    assert place_in_id(said.id) == said.place
    assert place_in_id("collaborate") is None


@pytest.mark.parametrize("name", ["mine", "x.y.mp4", "", "_E8_G[]", "E8"])
def test_another_name_says_nothing(name: str) -> None:
    assert parse_name(name) == Recorded(name.removesuffix(".mp4"), None, None)


@pytest.mark.parametrize("between", [", ", ",", "_", " "])
def test_goals_are_read_whatever_is_between_their_numbers(between: str) -> None:
    name = name_of(None).replace(", ", between)
    assert parse_name(name).truth == TRUTH


GOAL_OF_NUMBERS = {
    (("LMO", 0, 0, 1), 0): "Get blue item to blue lm",
    (("LMO", 1, 3, -1), 1): "Get pink item away from yellow lm",
    (("LMA", 0, 1, 1), 1): "Get red agent to green lm",
    (("LMA", 1, 2, -1), 0): "Get green agent away from red lm",
    (("TE", 0, 1, 1), 0): "get to green agent",
    (("TE", 0, 1, -1), 1): "get away from red agent",
    (("TE", 1, 0, 1), 1): "get to red agent",
    (("TE", 1, 0, -1), 0): "get away from green agent",
}


@pytest.mark.parametrize(("given_", "string"), GOAL_OF_NUMBERS.items())
def test_numbers_of_a_goal_stand_for_a_string_of_the_paper(given_: tuple, string: str) -> None:
    goal, holder = given_
    assert goal_string(goal, holder) == string
    assert goal_numbers(string, holder) == goal


@pytest.mark.parametrize("holder", [0, 1])
@pytest.mark.parametrize("goal", range(N_GOALS))
def test_every_goal_has_numbers_unless_it_names_its_holder(goal: int, holder: int) -> None:
    if is_self_referring(goal, holder):
        with pytest.raises(InvalidEventError, match="names its own holder"):
            goal_numbers(GOALS[goal], holder)
    else:
        assert goal_string(goal_numbers(GOALS[goal], holder), holder) == GOALS[goal]


places = st.builds(Place, st.integers(0, 99), st.sampled_from([None, 0, 1, 2, 3]))
goals = st.sampled_from(GOALS[:32])
strengths = st.sampled_from([None, *STRENGTH_LEVELS])
truths = st.none() | st.builds(
    Truth, goals, goals, strength_red=strengths, strength_green=strengths
)
ids = st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=40)
stamps = st.from_regex(r"D[0-9]{6}_[0-9]{7}_E[0-9]{1,2}(\.[0-3])?", fullmatch=True)


@given(id=ids | stamps, place=places, truth=truths)
def test_a_name_that_is_written_says_the_same_when_read(
    id: str, place: Place, truth: Truth | None
) -> None:
    assert parse_name(file_name(id, place, truth, 40)) == Recorded(id, place, truth)


def test_a_name_is_written_as_the_authors_write_it() -> None:
    written = file_name("D082020_1817530_E8.3", Place(8, 3), TRUTH, 40)
    assert written.startswith("D082020_1817530_0_F8_E8.3_G['LMO', 0, 2, 1]_['TE', 1, 0, 1]_ST3_0_")
    assert written.endswith("_MCTS_L39_R0.0_0.0.mp4")


@pytest.mark.parametrize(
    ("red", "green", "alphas"),
    [
        ("get to green agent", "get away from red agent", "R0.0_-10.0"),
        ("Get green agent away from red lm", "Get green agent to red lm", "R-10.0_0.0"),
        ("Get blue item to red lm", "Get blue item to blue lm", "R0.0_0.0"),
    ],
)
def test_who_hinders_has_a_negative_alpha(red: str, green: str, alphas: str) -> None:
    assert f"_{alphas}.mp4" in file_name("x", Place(0, None), Truth(red, green), 40)


@pytest.mark.parametrize(
    ("id", "truth", "message"),
    [
        ("x", Truth(GOALS[0], GOALS[1], strength_red=400.0), "a strength is 400 N, expected one"),
        ("x", Truth(GOALS[0], GOALS[1], relation="friendly"), "would not say all"),
        ("x" * 990, None, "of more than 1000 characters"),
    ],
)
def test_what_no_name_can_say_is_refused(id: str, truth: Truth | None, message: str) -> None:
    with pytest.raises(InvalidEventError, match=message):
        file_name(id, Place(8, None), truth, 40)
