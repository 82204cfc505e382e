"""Data sets of worlds of other casts than PHASE's."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.cli import main
from phase_ppl.data.generated import GeneratedEvents
from phase_ppl.data.generation import making
from phase_ppl.data.generation.families import FAMILIES, draw_situation, family_of, register_family
from phase_ppl.data.generation.generate import generate
from phase_ppl.data.generation.making import MAX_STUCK, NEAR, reason_against, uniform_roles
from phase_ppl.data.generation.situation import SIZES, Draw, Situation
from phase_ppl.world.errors import (
    InvalidSettingError,
    OutputError,
    PhasePPLError,
    SimulationError,
    UnknownNameError,
)
from phase_ppl.world.goals import goal_literal, is_true, possible_goals
from phase_ppl.world.hypothesis import STRENGTH_LEVELS, Hypothesis, scenario

SOLO, TRIO = ppl.worlds.SOLO, ppl.worlds.TRIO
ONE_THREAD: dict[str, Any] = {"workers": 1, "progress": False}


OURS = ("chasing", "collab", "compete", "help", "hinder", "independent")
QUICK = PlannerConfig(particles=4, simulations=2, rollout_length=1)
SMALL: dict[str, Any] = {"workers": 1, "progress": False, "frames": 3, "planner": QUICK}
HOME, FIELD = "Get blue ball to home", "Get blue ball to field"


@pytest.fixture
def _forgetful(monkeypatch: pytest.MonkeyPatch) -> None:
    FAMILIES.names()
    monkeypatch.setattr(FAMILIES, "entries", dict(FAMILIES.entries))


@pytest.fixture
def _all_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "reason_against", lambda *_: None)


def test_events_follow_from_the_numbers_of_their_entries_and_show_a_goal_that_is_reached(
    tmp_path: Path,
) -> None:
    options = {"frames": 36, "seed": 0, **ONE_THREAD}
    made = generate(tmp_path / "set", 3, world=SOLO, **options)

    def is_reached(event: ppl.Event) -> bool:
        literal, frames = goal_literal(event.truth.stated[0], 0, SOLO), event.observation.trajectory
        return is_true(literal, frames[-1], event.scene) > is_true(literal, frames[0], event.scene)

    for event, entry in zip(made, made.entries, strict=True):
        seed = entry["seed"]
        scene, wanted = SOLO.random_scene(seed), uniform_roles(SOLO, seed)
        again = ppl.simulate(scene, wanted, frames=36, seed=seed)
        assert np.array_equal(event.observation.trajectory, again.observation.trajectory)
        assert event.truth == again.truth
        assert event.scene.world == SOLO
        assert is_reached(event)
    assert len({entry["seed"] for entry in made.entries}) == 3
    assert made.manifest["kept"] == {"solo": 3}
    assert set(made.manifest["rejected"]["solo"]) == {"no goal is reached"}, "there are some"


@pytest.mark.usefixtures("_forgetful", "_all_are_kept")
def test_the_command_takes_a_prior_and_a_family_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "own.py"
    source.write_text(
        "import numpyro\n"
        "import phase_ppl as ppl\n"
        "def strong(world):\n"
        "    ppl.roles.goals(world)\n"
        "    ppl.roles.alpha(world)\n"
        "    numpyro.sample('strength_red', numpyro.distributions.Uniform(590, 600))\n"
        "places = {'home': (8, 8), 'far': (24, 18)}\n"
        "mine = ppl.World(['red agent', 'green agent'], ['ball'], places, name='mine')\n"
        "@ppl.register_family('fetch', scenario='collaborative', world=mine)\n"
        "def fetch(draw):\n"
        "    'One helps the other to bring the ball home.'\n"
        "    return draw.situation({'red agent': 'ball to home'},\n"
        "                          {('green agent', 'red agent'): 'help'}, near={'ball': 'far'})\n"
    )
    quick = functools.wraps(generate)(lambda **options: generate(**{**options, **SMALL}))

    def made(name: str, *words: str) -> GeneratedEvents:
        command = ["generate", *words, "--workers", "1", "--out", str(tmp_path / name)]
        assert main(command) == 0
        return GeneratedEvents(tmp_path / name)

    strong = made("one", "--world", "solo", "--n", "1", "--prior", f"{source}:strong")
    assert strong[0].truth.strengths[0] > 590
    assert strong.manifest["plan"]["world"]["agents"] == list(SOLO.agents)
    assert "strong" in strong.manifest["plan"]["roles"]["function"]
    assert " at 0x" not in strong.manifest["plan"]["roles"]["function"]
    monkeypatch.setattr("phase_ppl.generate", quick)
    (fetched,) = made("two", "--world", f"{source}:mine", "--cell", f"{source}:fetch=1")
    assert fetched.id == "fetch-00000"
    assert fetched.truth.stances == {("green agent", "red agent"): "help"}


def test_all_goals_and_ways_to_help_or_hinder_are_drawn_alike() -> None:
    drawn = [uniform_roles(TRIO, seed) for seed in range(150)]
    alone = np.mean([not roles.stances for roles in drawn])
    assert abs(alone - 1 / 3) < 4 * np.sqrt(2 / 9 / len(drawn))
    own = {roles.stated[0] for roles in drawn} - {None}
    assert own <= set(possible_goals(0, TRIO))
    assert len(own) > 0.8 * len(possible_goals(0, TRIO))
    helped = np.array([bool(roles.stances) for roles in drawn])
    place = np.array([TRIO.random_scene(seed).start[0, 0] for seed in range(150)])
    apart = place[helped].mean() - place[~helped].mean()
    assert abs(apart) < 4 * place.std() * np.sqrt(1 / helped.sum() + 1 / (~helped).sum())


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"n": 2, "cells": {"help_lift": 1}}, "'help_lift' is of the world 'PHASE', not of 'solo'"),
    ({"cells": {"hlep": 1}}, "unknown family of 'solo' 'hlep'; did you mean 'help'|allowed: 'ind"),
    ({"n": 2, "copies": 1}, "an event of 'solo' has only 0 other looks"),
    ({}, "n, the number of events, is needed in the world 'solo'"),
]


def test_what_is_of_phase_or_another_world_only_is_refused_by_name(tmp_path: Path) -> None:
    for given, message in REFUSED:
        with pytest.raises(PhasePPLError, match=message):
            generate(tmp_path / "set", **{"world": SOLO, **given, **ONE_THREAD})
    assert not (tmp_path / "set").exists()
    of_trio = lambda world, seed: ppl.roles.draw(TRIO, seed)  # noqa: E731
    with pytest.raises(SimulationError, match="the world 'trio', not 'solo'"):
        generate(tmp_path / "set", 1, world=SOLO, roles=of_trio, **ONE_THREAD)


@pytest.mark.usefixtures("_all_are_kept")
def test_phase_is_a_world_like_any_other(tmp_path: Path) -> None:
    scene, roles = draw_situation("chasing", "PHASE", 3)
    event = ppl.simulate(scene, roles, frames=3, planner=QUICK)
    assert event.truth.scenario == "opposing"
    # a family of any world is drawn from PHASE's tables, and has copies
    given: dict[str, Any] = {"cells": {"help": 2}, "copies": 1, **SMALL}
    for event, entry in zip(generate(tmp_path / "help", **given), range(4), strict=True):
        assert event.truth.scenario == "collaborative", entry
        assert {*event.scene.radius.tolist()} <= {*SIZES}
        assert {event.truth.strength_red, event.truth.strength_green} <= {*STRENGTH_LEVELS}

    def home(world: ppl.World, seed: int) -> Hypothesis:
        return ppl.Hypothesis.of(world, {a: f"{a} to red lm" for a in world.agents})

    (event,) = generate(tmp_path / "roles", 1, roles=home, **{**SMALL, "frames": 60})
    assert event.id == "PHASE-00000"
    assert event.truth.goal_red == "Get red agent to red lm"


def relay(draw: Draw) -> Situation:
    """Two bring the blue ball home, one from home, one from beside it."""
    one, other, _ = draw.agents()
    return draw.situation(
        dict.fromkeys((one, other), HOME),
        strength={one: 150},
        rooms={"blue ball": "field", one: "home"},
        near={other: "blue ball"},
        size={"blue ball": 0.8},
    )


def test_worlds_have_the_families_that_their_cast_is_enough_for() -> None:
    assert ppl.available_families("solo") == ["independent"]
    assert set(ppl.available_families(TRIO)) >= set(OURS)
    assert "help_lift" in ppl.available_families()
    assert "help" in ppl.available_families(), "it is of any world"
    lonely = ppl.World(["red agent", "green agent"], [], {"home": (8.0, 8.0)}, name="lonely")
    assert ppl.available_families(lonely) == ["chasing", "hinder", "independent"]
    with pytest.raises(InvalidSettingError, match="needs 1 item and 2 landmarks; 'lonely' has 0"):
        draw_situation("compete", lonely, 0)


@pytest.mark.parametrize("name", OURS)
def test_two_show_the_scenario_and_the_others_run_errands(name: str) -> None:
    cast = set()
    for seed in range(8):
        scene, roles = draw_situation(name, TRIO, seed)
        again = draw_situation(name, "trio", seed)
        assert roles == again.roles
        assert np.array_equal(scene.start, again.scene.start)
        found = {
            pair: scenario(*(roles.effective_goals[a] for a in pair), TRIO, pair)
            for pair in itertools.combinations(range(3), 2)
        }
        others = [pair for pair, shown in found.items() if shown == "independent"]
        assert len(others) == (3 if name == "independent" else 2)
        assert set(found.values()) - {"independent"} <= {family_of(name, TRIO).scenario}
        cast |= {pair for pair in found if pair not in others}
        for agent, goal in enumerate(roles.effective_goals):
            literal = goal_literal(goal, agent, TRIO)
            assert not (literal.positive and is_true(literal, scene.start, scene))
    assert len(cast) != 1, "anybody may be one of the two"


@pytest.mark.usefixtures("_forgetful")
def test_a_family_of_ones_own_says_who_is_how_strong() -> None:
    register_family("relay", scenario="collaborative", world=TRIO)(relay)
    for seed in range(5):
        _, roles = draw_situation("relay", TRIO, seed)
        at_home, beside = [TRIO.agent(a) for a, goal in roles.goals.items() if goal == HOME]
        if roles.strengths[beside] == 150:
            at_home, beside = beside, at_home
        assert roles.strengths[at_home] == 150
    with pytest.raises(InvalidSettingError, match="'relay' is of the world 'trio', not of 'solo'"):
        draw_situation("relay", SOLO, 0)
    assert "relay" not in ppl.available_families("solo")


@pytest.mark.usefixtures("_forgetful", "_all_are_kept")
def test_a_set_has_so_many_of_each_and_says_of_which_family_each_is(tmp_path: Path) -> None:
    register_family("relay", scenario="collaborative", world=TRIO)(relay)
    given = {"world": "trio", "cells": {"relay": 2, "hinder": 1}, "seed": 4, **SMALL}
    made = generate(tmp_path / "set", **given)
    again = generate(tmp_path / "again", **given)
    assert made.manifest["entries"] == again.manifest["entries"]
    assert made.manifest["kept"] == {"relay": 2, "hinder": 1}
    for event, entry in zip(made, made.entries, strict=True):
        assert entry["id"].startswith(entry["family"])
        _, roles = draw_situation(entry["family"], "trio", entry["seed"])
        assert event.truth == roles

    def other(draw: Draw) -> Situation:
        """Two bring the ball to the field."""
        return draw.situation(dict.fromkeys(draw.agents()[:2], FIELD))

    del FAMILIES.entries["relay of trio"]
    register_family("relay", scenario="collaborative", world=TRIO)(other)
    with pytest.raises(OutputError, match="another plan: families"):
        generate(tmp_path / "set", **given, resume=True)


ODD: list[tuple[Any, str]] = [
    (lambda draw: None, "no situation in 200 draws in 'solo', the last since it returned None"),
    (lambda draw: draw.situation({"red agent": "ball to barn"}, rooms={"ball": "barn"},
                                 near={"ball": "barn"}, size=4.5), "no place was found"),
    (lambda draw: draw.situation({"red": "ball to barn"}), "unknown agent 'red'"),
    (lambda draw: draw_situation("help", TRIO, 0), "hypothesis of the world 'solo'"),
    (lambda draw: (SOLO.scene({"red agent": (4, 4), "ball": (20, 4), "box": (8, 16)}),
                   Hypothesis.of(SOLO, {"red agent": "red agent to home"})),
     "since 'Get red agent to home' is true at the start"),
]  # fmt: skip


@pytest.mark.usefixtures("_forgetful")
def test_what_a_family_cannot_draw_is_said(tmp_path: Path) -> None:
    for drawn, message in ODD:
        register_family("odd", scenario="independent", world=SOLO)(drawn)
        with pytest.raises(PhasePPLError, match=message):
            draw_situation("odd", SOLO, 0)
        del FAMILIES.entries["odd of solo"]
    # one that breaks its promise is refused before anything is made
    register_family("odd", scenario="opposing", world=TRIO)(relay)
    with pytest.raises(InvalidSettingError, match="which is not opposing"):
        generate(tmp_path / "set", world=TRIO, cells={"odd": 1}, **SMALL)
    with pytest.raises(UnknownNameError, match="unknown variant 'help:LMA'; did you mean 'help'"):
        generate(tmp_path / "set", world=TRIO, cells={"help:LMA": 1}, **SMALL)
    assert not (tmp_path / "set").exists()


PAIRS = ("red & green", "red & purple", "green & purple")
WELL: dict[str, Any] = {
    "at_start": [False] * 3,
    "at_end": [True] * 3,
    "stuck": [0] * 3,
    "touched": [["blue ball"], ["blue ball"], []],
    "closest": dict.fromkeys(PAIRS, NEAR / 2),
}
"""Measures of an event of the trio in which everything went well."""


def roles(green: str, relation: str | None = None, red: str = HOME) -> Hypothesis:
    """Red wants the ball home, green what is said, or helps or hinders; purple walks about."""
    goals = {"red agent": red, "purple agent": "purple agent to pond"}
    if relation is not None:
        return Hypothesis.of(TRIO, goals, {("green agent", "red agent"): relation})
    return Hypothesis.of(TRIO, {**goals, "green agent": green})


KEPT: list[tuple[str, Hypothesis, dict[str, Any], str | None]] = [
    ("collaborative", roles("", "help"), {"at_end": [True, True, False]}, None),
    ("collaborative", roles(HOME), {"stuck": [0, 0, MAX_STUCK + 1]}, "is stuck"),
    ("competing", roles(FIELD), {"at_end": [False] * 3}, None),
    ("independent", roles("green agent to barn"), {"at_end": [True, True, False]}, "reached"),
]


def test_kept_is_what_two_show_or_all_if_they_are_independent() -> None:
    for shown, wanted, found, reason in KEPT:
        told = reason_against(shown, wanted, {**WELL, **found})
        assert (told is None) if reason is None else reason in str(told)
    # of several pairs one is enough
    everybody = Hypothesis.of(TRIO, dict.fromkeys(TRIO.agents, HOME))
    for third, is_kept in ((["blue ball"], True), ([], False)):
        found = {**WELL, "touched": [["blue ball"], [], third]}
        assert (reason_against("collaborative", everybody, found) is None) is is_kept
