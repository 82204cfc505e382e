"""Data sets: made, interrupted, resumed, checked."""

from __future__ import annotations

import functools
import itertools
import json
import pickle
import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.cli import main
from phase_ppl.data.generated import GeneratedEvents
from phase_ppl.data.generation import generate as module
from phase_ppl.data.generation import making
from phase_ppl.data.generation.families import family_of
from phase_ppl.data.generation.generate import GenerationInterrupted, generate
from phase_ppl.data.generation.making import SPLITS, Plan, apportioned, scaled
from phase_ppl.data.generation.situation import PHASE500
from phase_ppl.data.statistics import goal_type
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
    PhasePPLError,
    SimulationError,
)
from phase_ppl.world.files import locked
from phase_ppl.world.goals import goal_literal, is_true
from phase_ppl.world.hypothesis import RELATION_OF_SCENARIO

QUICK: dict[str, Any] = {
    "planner": PlannerConfig(particles=5, simulations=2, rollout_length=1),
    "frames": 12,
    "workers": 1,
    "progress": False,
}
CELLS = {"chasing": 3, "independent:LMA+LMA": 2}


@pytest.fixture
def anything_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    reasons = itertools.cycle([None, None, "the third"])
    monkeypatch.setattr(making, "reason_against", lambda *_: next(reasons))


@pytest.fixture
def all_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "reason_against", lambda *_: None)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> GeneratedEvents:
    """A set that was never interrupted, of which every draw was kept."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "reason_against", lambda *_: None)
        return generate(tmp_path_factory.mktemp("sets") / "whole", cells=CELLS, **QUICK)


def interrupted(folder: Path, monkeypatch: pytest.MonkeyPatch, before: int = 3) -> list[Any]:
    """Begin a set of five events, interrupted before one; return what keeps the calls of make."""
    calls: list[Any] = []

    def make(*job: Any) -> Any:
        calls.append(job)
        if len(calls) == before:
            raise KeyboardInterrupt
        return making.make(*job)

    monkeypatch.setattr(module, "make", make)
    with pytest.raises(GenerationInterrupted, match=f"{6 - before} of 5"):
        generate(folder, cells=CELLS, **QUICK)
    return calls


def test_the_preset_and_its_splits_are_the_papers() -> None:
    relations: Counter[str] = Counter()
    goals: Counter[str] = Counter()
    for cell, n in PHASE500.items():
        family = family_of(cell)
        relations[RELATION_OF_SCENARIO[family.scenario]] += n
        drawn = family.draw(ppl.worlds.PHASE, np.random.default_rng(0))
        for goal in drawn.roles.effective_goals:
            goals[goal_type(goal)] += n
    assert relations == {"friendly": 200, "adversarial": 192, "neutral": 108}
    assert goals == {"LMO+": 584, "LMA+": 215, "LMA-": 68, "TE+": 63, "TE-": 63, "LMO-": 7}
    slots = Plan().slots()
    assert [slot.number for slot in slots] == list(range(500))
    assert Counter(slot.split for slot in slots) == SPLITS
    assert Counter(slot.cell for slot in slots) == PHASE500
    for cell, n in PHASE500.items():
        of_cell = Counter(slot.split for slot in slots if slot.cell == cell)
        for split, size in SPLITS.items():
            assert abs(of_cell[split] - n * size / 500) < 2.01
    assert Plan().slots() == slots
    assert Plan(seed=1).slots() != slots
    # numbers are shared out by largest remainders
    for total, expected in ((10, [6, 2, 2]), (1, [1, 0, 0]), (3, [2, 0, 1])):
        assert list(apportioned(total, SPLITS).values()) == expected
    cells = scaled(PHASE500, 50)
    assert sum(cells.values()) == 50
    assert all(abs(n - PHASE500[cell] / 10) < 1 for cell, n in cells.items())
    # a family's number is spread over its variants
    cells = dict(Plan(cells={"independent": 7, "chasing": 1, "independent:LMA+LMA": 1}).cells)
    of_each = {"LMO+LMO": 3, "LMO+LMA": 2, "LMA+LMA": 3}
    assert cells == {"chasing": 1} | {f"independent:{v}": n for v, n in of_each.items()}


def test_a_set_is_the_same_for_any_number_of_workers_and_passes_its_filters(tmp_path: Path) -> None:
    cells = {"chasing": 1, "hinder:LMA": 1}
    given = {**QUICK, "cells": cells, "seed": 4, "frames": 34}
    one = generate(tmp_path / "one", **given)
    two = generate(tmp_path / "two", **{**given, "workers": 2})
    assert [event.id for event in one] == [event.id for event in two]
    for first, second in zip(one, two, strict=True):
        np.testing.assert_array_equal(first.observation.trajectory, second.observation.trajectory)
    assert one.entries == two.entries
    for entry in one.entries:
        assert entry["measures"]["closest"]["red & green"] < 1.5
        assert entry["relation"] == "adversarial"


@pytest.mark.usefixtures("anything_goes")
def test_the_manifest_says_how_each_event_and_its_copies_were_made(tmp_path: Path) -> None:
    made = generate(tmp_path / "set", cells=CELLS, seed=2, copies=3, **QUICK)
    assert len(made) == 4 * 5
    assert made.manifest["kept"] == CELLS
    refused = made.manifest["rejected"]
    assert sum(refused[cell].get("the third", 0) for cell in CELLS) == 2
    assert not (tmp_path / "set" / "parts").exists()
    groups: dict[str, list[tuple[ppl.Event, dict[str, Any]]]] = {}
    for event, entry in zip(made, made.entries, strict=True):
        groups.setdefault(entry["group"], []).append((event, entry))
        assert event.id == entry["id"]
        assert event.truth.scenario == entry["scenario"]
        alpha = tuple(entry["hypothesis"]["alpha"])
        red, green = ppl.Hypothesis(**{**entry["hypothesis"], "alpha": alpha}).effective_goals
        assert (event.truth.goal_red, event.truth.goal_green) == (ppl.GOALS[red], ppl.GOALS[green])
        assert entry["split"] in SPLITS
        # measures are of the colours that are shown
        literals = [goal_literal(goal, agent) for agent, goal in enumerate((red, green))]
        last = event.observation.trajectory[-1]
        assert entry["measures"]["at_end"] == [is_true(one, last, event.scene) for one in literals]
    assert {entry["agents_exchanged"] for entry in made.entries} == {True, False}
    for group in groups.values():
        looks = {(e["reflection"], e["agents_exchanged"], e["items_exchanged"]) for _, e in group}
        assert len(looks) == 4
        assert len({entry["split"] for _, entry in group}) == 1
        spans = [np.ptp(event.observation.positions, axis=0).max(axis=1) for event, _ in group]
        ways = np.sort(spans, axis=1)
        np.testing.assert_allclose(ways, np.broadcast_to(ways[0], (4, 4)))


def test_what_no_draw_makes_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = "independent:LMA+LMA"
    monkeypatch.setattr(
        making, "reason_against", lambda shown, *_: shown if shown == "independent" else None
    )
    made = generate(tmp_path / "two", cells={"chasing": 1, cell: 1}, max_tries=2, **QUICK)
    assert len(made) == len(made.manifest["given_up"]) == 1
    assert made.manifest["rejected"][cell] == {"independent": 2}


@pytest.mark.usefixtures("all_go")
def test_damaged_parts_are_named_and_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: GeneratedEvents
) -> None:
    calls = interrupted(tmp_path / "part", monkeypatch, before=5)
    cut, changed, other, fine = sorted((tmp_path / "part" / "parts").iterdir())
    cut.write_text(cut.read_text()[:300])
    changed.write_text(changed.read_text().replace('"attempt": 0', '"attempt": 1'))
    other.write_text(fine.read_text())
    (tmp_path / "part" / "parts" / ".part-0a1b2c3d.json").write_text("half")
    (tmp_path / "part" / "parts" / "notes.txt").write_text("of a user")
    with pytest.warns(RuntimeWarning, match="is made anew") as warned:
        resumed = generate(tmp_path / "part", cells=CELLS, resume=True, **QUICK)
    told = [str(one.message).partition(": is ")[0] for one in warned]
    assert told == [str(file) for file in (cut, changed, other)]
    assert len(calls) == 5 + 4
    left = [file.name for file in (tmp_path / "part" / "parts").iterdir()]
    assert left == ["notes.txt"]
    assert resumed.entries == whole.entries


@pytest.mark.usefixtures("all_go")
def test_interrupted_generation_goes_on_to_the_same_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: GeneratedEvents
) -> None:
    calls = interrupted(tmp_path / "part", monkeypatch)
    with pytest.raises(InvalidEventError, match="can be resumed"):
        ppl.load_events(tmp_path / "part")
    with pytest.raises(OutputError, match="resume"):
        generate(tmp_path / "part", cells=CELLS, **QUICK)
    with locked(tmp_path / "part"), pytest.raises(OutputError, match="another process is at work"):
        generate(tmp_path / "part", cells=CELLS, resume=True, **QUICK)
    with pytest.raises(OutputError, match="seed is 1, was 0"):
        generate(tmp_path / "part", cells=CELLS, seed=1, resume=True, **QUICK)
    shutil.copytree(tmp_path / "part", tmp_path / "older")
    for _ in range(2):
        resumed = generate(tmp_path / "part", cells=CELLS, resume=True, **QUICK)
        assert len(calls) == 3 + 3
        assert resumed.entries == whole.entries
    # of other versions it is finished where that is wanted, and says so
    plan = json.loads((tmp_path / "older" / "plan.json").read_text())
    plan["versions"][-1]["phase_ppl"] = "0.0"
    (tmp_path / "older" / "plan.json").write_text(json.dumps(plan))
    with pytest.raises(InvalidSettingError, match="other versions"):
        generate(tmp_path / "older", cells=CELLS, resume=True, **QUICK)
    found = generate(tmp_path / "older", cells=CELLS, resume=True, other_versions=True, **QUICK)
    assert found.entries == whole.entries
    assert [one["phase_ppl"] for one in found.manifest["earlier_versions"]] == ["0.0"]


def test_a_set_is_loaded_by_its_folder_and_checked(tmp_path: Path, whole: GeneratedEvents) -> None:
    shutil.copytree(whole.path, tmp_path / "set")
    found = ppl.load_events(tmp_path / "set")
    assert found[0].id == found.entries[0]["id"]
    assert sum(len(found.split(name)) for name in {e["split"] for e in found.entries}) == 5
    with pytest.raises(InvalidEventError, match="no events in split 'training'"):
        found.split("training")
    train = found.split("train")
    assert [event.id for event in train] == [entry["id"] for entry in train.entries]
    assert {entry["split"] for entry in train.entries} == {"train"}
    assert [event.id for event in found[1:4]] == [entry["id"] for entry in found.entries[1:4]]
    turned = pickle.loads(pickle.dumps(ppl.load_events(tmp_path / "set", "cw")))
    assert {event.scene.turning for event in turned} == {"cw"}
    stored = tmp_path / "set" / "events.json"
    edited = json.loads(stored.read_text())
    edited["events"][3]["trajectories"]["red agent"][1][0] += 1e-9
    stored.write_text(json.dumps(edited))
    damaged = ppl.load_events(tmp_path / "set")
    assert damaged[2].id == found[2].id
    with pytest.raises(InvalidEventError, match=rf"events\.json, video {found[3].id}: its content"):
        damaged[3]
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    manifest["entries"].reverse()
    (tmp_path / "set" / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InvalidEventError, match="are not of the same events"):
        ppl.load_events(tmp_path / "set")
    (tmp_path / "set" / "manifest.json").write_text("{")
    with pytest.raises(InvalidEventError, match=r"manifest\.json"):
        ppl.load_events(tmp_path / "set")


@pytest.mark.usefixtures("all_go")
def test_an_executor_that_is_shut_down_leaves_what_another_can_finish(
    tmp_path: Path, whole: GeneratedEvents
) -> None:
    given = {name: value for name, value in QUICK.items() if name != "workers"}
    with ThreadPoolExecutor(1) as executor:
        pass
    with pytest.raises(SimulationError, match=r"no more work.*5 of 5 .*resume goes on"):
        generate(tmp_path / "set", cells=CELLS, executor=executor, **given)
    with ThreadPoolExecutor(1) as executor:
        made = generate(tmp_path / "set", cells=CELLS, executor=executor, resume=True, **given)
    assert made.entries == whole.entries
    one, other = ((found.path / "events.json").read_bytes() for found in (made, whole))
    assert one == other


@pytest.mark.usefixtures("all_go")
def test_an_event_that_cannot_be_made_is_named_and_the_rest_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(plan: Plan, slot: Any) -> Any:
        if slot.number == 1:
            raise RuntimeError("no more ideas")
        return making.make(plan, slot)

    monkeypatch.setattr(module, "make", fails)
    with pytest.raises(SimulationError, match=r"chasing, number 1: RuntimeError: no more ideas"):
        generate(tmp_path / "set", cells={"chasing": 3}, **QUICK)
    assert len(list((tmp_path / "set" / "parts").iterdir())) == 2
    monkeypatch.setattr(module, "make", making.make)
    assert len(generate(tmp_path / "set", cells={"chasing": 3}, resume=True, **QUICK)) == 3


BAD: list[tuple[dict[str, Any], str]] = [
    ({"cells": {"chase": 1}}, "chasing"),
    ({"cells": {"chasing": -1}}, "chasing=-1"),
    ({"planner": "slow"}, "slow"),
    ({"turning": "left"}, "ccw"),
    ({"splits": {"train": 0}}, "no shares"),
    ({"copies": 99}, "copies=99, but an event of 'PHASE' has only 19 other looks"),
]


def test_bad_settings_are_named_before_anything_is_written(tmp_path: Path) -> None:
    for options, message in BAD:
        with pytest.raises(PhasePPLError, match=message):
            generate(tmp_path / "set", **options)
    assert not (tmp_path / "set").exists()


def test_a_split_is_evaluated(whole: GeneratedEvents, capsys: pytest.CaptureFixture[str]) -> None:
    found = ppl.all_events(whole.path, "test")
    assert len(found) == len(whole.split("test")) == 1
    arguments = ["evaluate", str(whole.path), "--model", "last_frame", "--split"]
    assert main([*arguments, "test", "--quiet"]) == 0
    assert "1 of 1 events" in capsys.readouterr().out
    assert main([*arguments, "dev", "--quiet"]) == 2
    everything = ppl.evaluate(whole, "last_frame", workers=1, progress=False)
    assert everything.metrics["n_events"] == 5
    with pytest.raises(InvalidEventError, match="'dev'"):
        ppl.all_events(whole, "dev")
    with pytest.raises(InvalidEventError, match="only generated"):
        ppl.all_events(list(whole), "test")


@pytest.mark.usefixtures("anything_goes")
def test_the_terminal_makes_films_and_says_what_was_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a set"
    monkeypatch.setattr(
        "phase_ppl.generate",
        functools.wraps(generate)(lambda **options: generate(**{**options, **QUICK, "frames": 3})),
    )
    arguments = ["generate", "--cell", "chasing=3", "--videos", "--quiet", "--workers", "1"]
    assert main([*arguments, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    made = ppl.load_events(out)
    assert "chasing                  3 of    4 draws   rejected: the third: 1" in printed
    assert len(list((out / "videos").glob("*.mp4"))) == len(made) == 3
    assert (out / "contact_sheet.png").stat().st_size > 1000
    assert main([*arguments, "--out", str(out)]) == 2
    assert "resume" in capsys.readouterr().err


@pytest.mark.slow
def test_events_with_the_fast_planner_show_what_they_should(tmp_path: Path) -> None:
    arguments = ["generate", "--n", "6", "--seed", "7", "--planner", "fast", "--quiet"]
    assert main([*arguments, "--workers", "1", "--out", str(tmp_path / "set")]) == 0
    made = GeneratedEvents(tmp_path / "set")
    cells = {cell: n for cell, n in scaled(PHASE500, 6).items() if n}
    assert {cell: n for cell, n in made.manifest["kept"].items() if n} == cells
    for event, entry in zip(made, made.entries, strict=True):
        assert event.truth.relation == entry["relation"]
        # whoever helps or minds its own business has reached its goal, and not from the start
        first, last = event.observation.trajectory[[0, -1]]
        for agent, goal in enumerate((event.truth.goal_red, event.truth.goal_green)):
            if entry["relation"] != "adversarial":
                literal = goal_literal(goal, agent)
                assert is_true(literal, last, event.scene)
                assert not is_true(literal, first, event.scene)
