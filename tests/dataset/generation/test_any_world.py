"""Data sets of worlds of other casts than PHASE's."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.dataset.generated import GeneratedEvents, verify
from phase_ppl.dataset.generation.generate import generate
from phase_ppl.dataset.generation.making import uniform_roles
from phase_ppl.world.errors import InvalidSettingError, SimulationError, UnknownNameError
from phase_ppl.world.goals import goal_literal, is_true, possible_goals
from phase_ppl.world.hypothesis import Roles

SOLO, TRIO = ppl.worlds.SOLO, ppl.worlds.TRIO
ONE_THREAD: dict[str, Any] = {"workers": 1, "progress": False}


def homewards(world: ppl.World, seed: int) -> Roles | None:
    """Whoever it is, it wants to be home; every third draw is refused."""
    return None if seed % 3 == 1 else Roles.of(world, {"red agent": "red agent to home"})


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> GeneratedEvents:
    folder = tmp_path_factory.mktemp("sets") / "solo"
    return generate(folder, 3, world=SOLO, frames=36, seed=0, keep_rejected=True, **ONE_THREAD)


def test_an_event_is_made_of_the_one_number_of_its_entry(made: GeneratedEvents) -> None:
    for event, entry in zip(ppl.load_events(made.path), made.entries, strict=True):
        seed = entry["seed"]
        again = ppl.simulate(
            SOLO.random_scene(seed), uniform_roles(SOLO, seed), frames=36, seed=seed
        )
        assert np.array_equal(event.observation.trajectory, again.observation.trajectory)
        assert event.truth == again.truth
        assert event.scene.world == SOLO
    assert len({entry["seed"] for entry in made.entries}) == 3


def test_kept_are_events_in_which_a_goal_of_ones_own_is_reached(made: GeneratedEvents) -> None:
    def is_reached(event: ppl.Event) -> bool:
        literal, frames = goal_literal(event.truth.stated[0], 0, SOLO), event.observation.trajectory
        return is_true(literal, frames[-1], event.scene) > is_true(literal, frames[0], event.scene)

    assert all(is_reached(event) for event in made)
    assert not any(is_reached(event) for event, _ in made.rejected())
    kept, refused = made.manifest["kept"], made.manifest["rejected"]
    assert kept == {"solo": 3}
    assert refused["solo"] == {"no goal is reached": len(made.rejected())}, "there are some"
    assert verify(made.path) == []


def test_roles_of_ones_own_are_drawn_and_part_of_the_plan(tmp_path: Path) -> None:
    given = {"world": "solo", "roles": homewards, "frames": 40, **ONE_THREAD}
    found = generate(tmp_path / "set", 3, **given)
    assert {event.truth.goals["red agent"] for event in found} == {"Get red agent to home"}
    assert found.manifest["rejected"]["solo"]["roles that are not wanted"] >= 1
    with pytest.raises(ppl.PhasePPLError, match="another plan: roles"):
        generate(tmp_path / "set", 3, **{**given, "roles": ppl.roles.draw}, resume=True)


def test_a_prior_of_ones_own_is_drawn_from_and_recorded(tmp_path: Path) -> None:
    source = tmp_path / "own.py"
    source.write_text(
        "import numpyro\n"
        "import phase_ppl as ppl\n"
        "def strong(world):\n"
        "    ppl.roles.goals(world)\n"
        "    ppl.roles.company(world)\n"
        "    numpyro.sample('strength_red', numpyro.distributions.Uniform(590, 600))\n"
    )
    command = ["generate", "--world", "solo", "--n", "1", "--prior", f"{source}:strong"]
    assert main([*command, "--workers", "1", "--out", str(tmp_path / "set")]) == 0
    made = ppl.load_events(tmp_path / "set")
    assert isinstance(made, GeneratedEvents)
    assert made[0].truth.strengths[0] > 590
    assert made.manifest["plan"]["world"]["agents"] == list(SOLO.agents)
    assert "strong" in made.manifest["plan"]["roles"]["function"]
    assert " at 0x" not in made.manifest["plan"]["roles"]["function"]


def test_all_goals_and_ways_to_help_or_hinder_are_drawn_alike() -> None:
    drawn = [uniform_roles(TRIO, seed) for seed in range(200)]
    alone = np.mean([not roles.relation for roles in drawn])
    assert abs(alone - 1 / 3) < 4 * np.sqrt(2 / 9 / len(drawn))
    own = {roles.stated[0] for roles in drawn} - {None}
    assert own <= set(possible_goals(0, TRIO))
    assert len(own) > 0.8 * len(possible_goals(0, TRIO))
    helped = np.array([bool(roles.relation) for roles in drawn])
    place = np.array([TRIO.random_scene(seed).start[0, 0] for seed in range(200)])
    apart = place[helped].mean() - place[~helped].mean()
    assert abs(apart) < 4 * place.std() * np.sqrt(1 / helped.sum() + 1 / (~helped).sum())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"n": 2, "cells": {"help_lift": 1}}, "the family 'help_lift' is for the world PHASE only"),
        ({"cells": {"help": 1}}, "the family 'help' needs 2 agents; 'solo' has 1 agent"),
        (
            {"cells": {"hlep": 1}},
            "unknown family of 'solo' 'hlep'; did you mean 'help'|allowed: 'ind",
        ),
        ({"n": 2, "copies": 1}, "copies=1 is for the world PHASE only, not 'solo'"),
        ({"n": 2, "replans": 1}, "replans=1 is for"),
        ({"n": 2, "reflect": True}, "reflect=True is for"),
        ({"n": 2, "recolour": True}, "recolour=True is for"),
        ({"n": 2, "max_tries": 1001}, "max_tries=1001, expected at most 1000"),
        ({"n": 2, "roles": "uniform"}, r"roles='uniform', expected a function \(world, seed\)"),
        ({}, "n, the number of events, is needed in the world 'solo'"),
        ({"n": 2, "world": "sola"}, "unknown world 'sola'"),
        ({"n": 2, "world": ppl.worlds}, "expected a phase_ppl.World"),
        ({"n": 2, "world": "PHASE", "roles": homewards}, "families draw those of PHASE"),
    ],
)
def test_what_is_of_phase_only_is_refused_by_name(
    tmp_path: Path, given: dict[str, Any], message: str
) -> None:
    with pytest.raises((InvalidSettingError, UnknownNameError), match=message):
        generate(tmp_path / "set", **{"world": SOLO, **given, **ONE_THREAD})
    assert not (tmp_path / "set").exists()


def test_roles_of_another_world_are_refused_and_named(tmp_path: Path) -> None:
    drawn = functools.partial(ppl.roles.draw, TRIO)
    with pytest.raises(SimulationError, match="the world 'trio', not 'solo'"):
        generate(
            tmp_path / "set", 1, world=SOLO, roles=lambda world, seed: drawn(seed), **ONE_THREAD
        )
