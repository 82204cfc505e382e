"""Simulations, files and pictures of worlds with other casts, floor plans and goals."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import phase_ppl as ppl
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.simulator.no_physics import PathSimulator
from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.goals import goal_literal, is_true
from phase_ppl.world.names import NOTHING
from phase_ppl.world.worlds import SOLO, TRIO

QUICK = ppl.PlannerConfig(simulations=60, particles=20, paired=True)

ROOM = SOLO.scene(
    {"red agent": (17, 12), "ball": (20, 12), "box": (4, 14)}, size={"red agent": 0.8, "ball": 0.8}
)
"""The ball is before the red agent, in the room of the field and the barn."""

YARD = TRIO.scene(
    {"red agent": (6, 18, 3.0), "green agent": (30, 6, 0.0), "purple agent": (9.5, 5, 0.5),
     "blue ball": (6, 15), "pink ball": (18, 4)},
    size=0.8,
)  # fmt: skip


@pytest.fixture(scope="module")
def solo() -> ppl.Event:
    return ppl.simulate(ROOM, goals={"red agent": "ball to field"}, frames=60, planner=QUICK)


@pytest.fixture(scope="module")
def trio() -> ppl.Event:
    return ppl.simulate(
        YARD,
        goals={"red agent": "blue ball to home", "green agent": "get to purple agent"},
        relation={("purple agent", "red agent"): "hinder"},
        strength={"red agent": 300, "purple agent": 600},
        frames=40,
        seed=1,
        planner=QUICK,
        id="trio",
    )


def test_one_agent_brings_an_item_to_its_landmark(solo: ppl.Event) -> None:
    literal = goal_literal("ball to field", 0, SOLO)
    reached = [is_true(literal, frame, ROOM) for frame in solo.observation.trajectory]
    assert not reached[0]
    assert reached[-1]
    assert np.array_equal(solo.observation.trajectory[-1, 2], ROOM.start[2])  # the box
    assert solo.truth.goals == {"red agent": "Get ball to field"}


def test_each_of_three_agents_acts_on_its_own(trio: ppl.Event) -> None:
    truth, thoughts = trio.truth, trio.thoughts
    assert truth.goals == {
        "red agent": "Get blue ball to home",
        "green agent": "get to purple agent",
        "purple agent": "Get blue ball away from home",
    }
    assert truth.stances == {("purple agent", "red agent"): "hinder"}
    assert truth.strengths == (300.0, 450.0, 600.0)
    assert truth.relation_between("purple agent", "red agent") == "adversarial"
    assert truth.relation_between("green agent", "red agent") == "neutral"
    assert thoughts.actions.shape == (39, 3)
    assert thoughts.particles.shape == (39, 3, 20, 5, 3)
    track = trio.observation.trajectory
    assert track.shape == (40, 5, 3)
    apart = np.linalg.norm(track[:, 1, :2] - track[:, 2, :2], axis=1)
    assert apart[-1] < apart[0] - 5  # green goes to purple, through doors
    assert (thoughts.held[:, 0] == 3).any()  # red gets hold of the ball behind it


def test_in_the_papers_world_both_ways_of_saying_it_are_one() -> None:
    scene = ppl.worlds.PHASE.random_scene(5)
    goals, relation = {"red agent": "blue item to red lm"}, {("green agent", "red agent"): "help"}
    named = ppl.simulate(scene, goals=goals, relation=relation, frames=4, planner=QUICK)
    hypothesis = ppl.Hypothesis("Get blue item to red lm", 0, (0, 1))  # type: ignore[arg-type]
    told = ppl.simulate(scene, hypothesis, frames=4, planner=QUICK)
    assert named.truth == told.truth
    assert np.array_equal(named.observation.trajectory, told.observation.trajectory)


def test_agents_without_physics_live_in_any_world_too() -> None:
    goals, simulator = {"red agent": "ball to home"}, PathSimulator(QUICK)
    event = ppl.simulate(ROOM, goals=goals, frames=60, planner=QUICK, simulator=simulator)
    assert is_true(goal_literal("ball to home", 0, SOLO), event.observation.trajectory[-1], ROOM)


def test_both_engines_agree_on_five_bodies_in_six_rooms() -> None:
    rng, strengths = np.random.default_rng(2), (300.0, 450.0, 600.0)
    params = compiled.make_params(YARD, strengths, inner_steps=4, iterations=20)
    scratch = compiled.make_scratch(5, 3)
    world = PymunkWorld(YARD, strengths)
    for _ in range(12):
        state = compiled.from_state(world.state, YARD.radius)
        actions = rng.integers(0, len(Action), 3)
        frame = np.empty((5, 3))
        compiled.step_mean(*state, actions, params, scratch, frame)
        assert world.step(actions.tolist()) == pytest.approx(frame, abs=1e-3)
        assert state[1].tolist() == world.state.held.tolist()


def test_three_agents_can_hold_one_item_and_pull_it_together() -> None:
    agents = (16.1, 5, -np.pi / 2), (19.9, 5, np.pi / 2), (18, 3.1, 0)
    scene = TRIO.scene(dict(zip(TRIO.entities, (*agents, (18, 5), (30, 20)), strict=True)))
    world = PymunkWorld(scene, (450.0,) * 3)
    world.step([Action.ATTACH] * 3)
    assert world.state.held.tolist() == [3, 3, 3]
    before = world.state.pose[:4, 1].copy()
    for _ in range(5):
        world.step([Action.LEFT, Action.RIGHT, Action.UP])  # all towards the top
    assert (world.state.pose[:4, 1] > before + 0.5).all()
    world.step([Action.DETACH, Action.STOP, Action.STOP])
    assert world.state.held.tolist() == [NOTHING, 3, 3]


def test_files_hold_the_world(solo: ppl.Event, trio: ppl.Event, tmp_path: Path) -> None:
    short = ppl.simulate(YARD, trio.truth, frames=3, planner=QUICK)
    ppl.save_event(solo, tmp_path / "one.json")
    ppl.save_events([trio, short], tmp_path / "several.json")
    read = [ppl.load_event(tmp_path / "one.json"), *ppl.load_events(tmp_path / "several.json")]
    for event, back in zip((solo, trio, short), read, strict=True):
        assert back.scene.world == event.scene.world
        assert back.truth == event.truth
        assert np.array_equal(back.observation.trajectory, event.observation.trajectory)
        assert np.array_equal(back.scene.half_widths, event.scene.half_widths)
    ppl.save_events([solo, trio], tmp_path / "both.json")
    assert [e.scene.world.name for e in ppl.load_events(tmp_path / "both.json")] == ["solo", "trio"]


def test_pictures_and_words_are_of_the_world(trio: ppl.Event, tmp_path: Path) -> None:
    ppl.render.image(trio, 0, tmp_path / "start.png", fields_of_view=True)
    with Image.open(tmp_path / "start.png") as picture:
        assert picture.size == (840, 480), "as wide as the arena"
        colours = {colour for _, colour in picture.getcolors(10**6)}
    assert set(TRIO.entity_colours) <= colours
    ppl.render.strip(trio, tmp_path / "strip.png", 3)
    ppl.render.contact_sheet([trio], tmp_path / "sheet.png")
    assert ppl.render.video(trio.observation.trajectory[:3], tmp_path / "film.mp4", YARD).path
    assert trio._repr_html_().count("<polygon") == 3
    words = " ".join(ppl.explain(trio).split())
    for part in ("the red agent goes up to the blue ball", "as it holds the blue ball",
                 "the green agent", "the purple agent"):  # fmt: skip
        assert part in words
    assert "room of the" in words or "room at (" in words


WRONG: dict[str, tuple[Any, str]] = {
    "no goal": ({"goals": {"red agent": "ball to home"}}, "unknown goal 'ball to home'"),
    "a goal of itself": ({"goals": {"red agent": "touch red agent"}},
     "the goal 'get to red agent' of the red agent names the red agent itself"),
    "two at once": (
     {"relation": {("red agent", "green agent"): "help", ("red agent", "purple agent"): "help"}},
     "the red agent can help or hinder one other only"),
    "a chain": (
     {"relation": {("red agent", "green agent"): "help", ("green agent", "purple agent"): "help"}},
     "the red agent cannot help or hinder the green agent, who pursues no goal of its own"),
    "no force": ({"strength": {"red agent": -1}}, "strength of the red agent=-1 is no positive"),
    "the papers": ({"goals": None, "hypothesis": ppl.Hypothesis(0, 1)},
     "the hypothesis is of the world PHASE, the scene of trio: give goals="),
}  # fmt: skip


def test_roles_that_cannot_be_get_one_clear_line() -> None:
    own = "blue ball to home", "green agent to pond", "touch red agent"
    goals = dict(zip(TRIO.agents, own, strict=True))
    for case, (changes, message) in WRONG.items():
        with pytest.raises(PhasePPLError, match=re.escape(message)) as raised:
            ppl.simulate(YARD, **{"goals": goals, **changes})
        assert "\n" not in str(raised.value), case
