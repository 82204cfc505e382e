"""The summary for a file and the table for a terminal."""

from __future__ import annotations

import json
import math

import pytest

from phase_ppl.analysis import Posterior
from phase_ppl.analysis.summary import plain
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import RELATIONS, SCENARIOS

from .factory import BLUE_TO_RED, Simulation, hypothesis, make_tree, random_tree

KEYS = ["goals", "relation", "scenario", "strengths", "errors", "map"]
KEYS += ["diagnostics", "settings", "cost"]


@pytest.mark.parametrize("weights", ["count", "visited", "likelihood"])
def test_summary_has_exactly_its_keys_and_is_json(weights: str) -> None:
    summary = Posterior(random_tree(4), weights).summary()
    assert list(summary) == KEYS
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert list(summary["goals"]) == ["red agent", "green agent"]
    for goals in summary["goals"].values():
        assert tuple(goals) == GOALS
        assert sum(goals.values()) == pytest.approx(1)
    assert tuple(summary["relation"]) == RELATIONS
    assert tuple(summary["scenario"]) == SCENARIOS
    for strength in summary["strengths"].values():
        assert set(strength) == {"mean", "sd", "hdi_low", "hdi_high"}
        assert strength["hdi_low"] <= strength["mean"] <= strength["hdi_high"]
    assert set(summary["map"]) == {
        *("goal_red", "goal_green", "stated_goal_red", "stated_goal_green", "alpha"),
        *("strength_red", "strength_green", "log_joint", "relation", "scenario"),
    }
    errors = summary["errors"]
    assert {name: list(errors[name]) for name in errors} == {
        name: list(summary[name]) for name in ("goals", "relation", "scenario", "strengths")
    }
    assert errors["relation"]["neutral"] > 0
    assert summary["diagnostics"]["weights"] == weights
    assert summary["settings"] == {"seed": 0, "kernel": "local_mh", "beta": 0.05}


def test_summary_of_one_particle_gives_null_for_what_does_not_exist() -> None:
    summary = Posterior(make_tree([Simulation(hypothesis())], [[0]])).summary()
    assert summary["diagnostics"]["between_chain_tv"]["goal_red"] is None
    json.dumps(summary, allow_nan=False)


def test_numbers_that_are_not_finite_become_null() -> None:
    assert plain({"a": [math.nan, 1.5], 2: (math.inf, True)}) == {
        "a": [None, 1.5],
        "2": [None, True],
    }


@pytest.mark.parametrize("weights", ["count", "visited", "likelihood"])
def test_table_fits_a_terminal_and_shows_the_leading_goals(weights: str) -> None:
    tree = random_tree(4)
    tree.attrs["event_id"] = "a rather long name of an event " * 4
    post = Posterior(tree, weights)
    text = str(post)
    assert max(len(line) for line in text.splitlines()) <= 88
    for name in ("goal_red", "goal_green"):
        goal, value = post.top(name, 1)[0]
        assert any(goal in line and str(value) in line for line in text.splitlines())
    assert text.index("verdict") < text.index("relation  ")  # before the bars
    for word in ("relation", "scenario", "strength", "cost", "verdict", "12 s on 2 workers"):
        assert word in text


def test_table_leaves_out_goals_without_mass_and_costs_that_are_not_known() -> None:
    tree = make_tree([Simulation(hypothesis())], [[0]])
    tree.attrs["cost"] = "{}"
    text = str(Posterior(tree))
    assert text.partition("red agent")[2].count("Get ") == 2
    assert BLUE_TO_RED in text
    assert "1 simulations;" in text


def test_repr_names_the_event_and_the_weighting() -> None:
    text = repr(Posterior(random_tree(4), "visited"))
    assert text == "<Posterior of made-up: 4 x 6 draws, weights 'visited'>"
