"""The keys, the clock and the expectations of a room, without a server."""

from __future__ import annotations

import asyncio
import dataclasses
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Polygon

pytest.importorskip("starlette", reason="the extra 'study' is not installed")

import phase_ppl as ppl
from phase_ppl.physics.actions import Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.render.frames import field_of_view
from phase_study.exports import SLIPPED
from phase_study.room import Controls, Outbox, Room, Seat, driving, outline, warnings
from phase_study.settings import PlaySettings, Settings, template
from tests.agents.scenes import FULL_WALL_UP, HALF_WALL_LEFT, scene
from tests.study.players import near_goals


def settings(**changes: Any) -> PlaySettings:
    return dataclasses.replace(Settings.parse(template("play", "")).play, **changes)


def pressed(*events: str) -> Controls:
    """Controls after keys went down ("+forward") and up ("-forward")."""
    controls = Controls()
    for event in events:
        controls.press(event[1:], event[0] == "+")
    return controls


@pytest.mark.parametrize(
    ("events", "action"),
    [
        ([], Action.NO_FORCE),
        (["+forward"], Action.UP),
        (["+forward", "+left"], Action.LEFT),
        (["+forward", "+left", "-left"], Action.LEFT),
        (["+forward", "-forward", "+left"], Action.UP),
        (["+turn right", "-turn right"], Action.TURN_RIGHT),
        (["+grab", "-grab"], Action.ATTACH),
        (["+forward", "+grab"], Action.ATTACH),
    ],
)
def test_the_latest_key_wins_and_a_tap_counts(events: list[str], action: Action) -> None:
    assert pressed(*events).action(holds=False) == action


def test_a_tap_counts_once_and_a_held_key_goes_on() -> None:
    controls = pressed("+left", "-left", "+forward", "+grab")
    assert controls.pressed() == ["left", "forward", "grab"]
    done = [controls.action(holds=True) for _ in range(4)]
    # the key of a grab must go up before the next one
    assert done == [Action.DETACH, Action.LEFT, Action.UP, Action.UP]
    controls.release()
    assert controls.action(holds=False) == Action.NO_FORCE


def test_nothing_is_done_long_after_it_was_pressed() -> None:
    controls = pressed(*["+left", "-left"] * 10)
    done = [controls.action(holds=False) for _ in range(4)]
    assert done == [Action.LEFT, Action.LEFT, Action.NO_FORCE, Action.NO_FORCE]


def test_a_slow_browser_misses_the_oldest_frames_and_nothing_else() -> None:
    outbox = Outbox()
    outbox.put({"t": "scene"})
    for number in range(100):
        outbox.put({"t": "frame", "number": number})
    outbox.put({"t": "end"})

    async def received() -> list[Any]:
        return [await outbox.get() for _ in range(Outbox.MOST + 2)]

    first, *frames, last = asyncio.run(received())
    assert (first["t"], last["t"]) == ("scene", "end")
    assert [frame["number"] for frame in frames] == [*range(100 - Outbox.MOST, 100)]


def room(
    event: ppl.Event, goals: tuple[str, str] | None = None,
    computer: np.random.Generator | None = None, **changes: Any,
) -> Room:  # fmt: skip
    play = settings(steps_per_second=12, **changes)
    goals = goals or (event.truth.goal_red, event.truth.goal_green)
    seats = [Seat(), Seat()]
    return Room(play.scene(event.scene), goals, (600.0, 600.0), play, seats, computer=computer)


class OwnTime(asyncio.SelectorEventLoop):
    """Its clock goes on while it sleeps, and by nothing else."""

    now = 0.0

    def time(self) -> float:
        return self.now

    def _run_once(self) -> None:
        if not self._ready and self._scheduled:
            self.now = max(self.now, self._scheduled[0].when())
        super()._run_once()


def test_a_clock_that_slips_is_seen_and_does_not_hurry() -> None:
    one = room(near_goals(), limit=4)
    slept: list[int] = []

    def stalls(room: Room) -> None:
        if len(room.steps) == 1 and not slept:
            slept.append(1)
            loop.now += 2 * SLIPPED / 1000

    with asyncio.Runner(loop_factory=OwnTime) as runner:
        loop = runner.get_loop()
        assert isinstance(loop, OwnTime)
        assert runner.run(one.run(stalls)) == "time"
    assert 1000 * one.slip > SLIPPED
    late = [step.lag_ms > SLIPPED for step in one.steps]
    assert late == [False, True, False, False]


def test_goals_must_hold_for_a_while_and_goals_of_avoidance_end_nothing() -> None:
    event = near_goals(start=[[8.5, 19.5, 0], [23.5, 19.5, 0], [12, 7, 0], [20, 7, 0]])
    one = room(event, hold=3, limit=10)
    assert asyncio.run(one.run()) == "goals"
    assert len(one.steps) == 3
    away = "Get red agent away from red lm", "Get green agent to green lm"
    assert not room(event, away).ends_by_goals


@pytest.mark.parametrize("agent", [0, 1])
def test_the_outline_is_the_field_of_view_within_the_arena(agent: int) -> None:
    for angle in np.linspace(0, 2 * np.pi, 9):
        where = scene(
            red=(9.0, 12.0, angle), green=(20.0, 13.0, angle), walls=[FULL_WALL_UP, HALF_WALL_LEFT]
        )
        corners = np.array(outline(where, where.start, agent))
        assert (corners >= [5.99, 1.99]).all()
        assert (corners <= [26.01, 22.01]).all()
        points = np.random.default_rng(0).uniform([6, 2], [26, 22], (400, 2))
        whole = Polygon(field_of_view(where, where.start, agent)).contains_points(points)
        assert (Polygon(corners).contains_points(points) != whole).mean() < 0.01


def test_a_computer_sees_no_more_than_its_agent() -> None:
    # the item of its goal is out of its sight, beside it
    start = [[12.0, 19.5, 0.0], [20.0, 12.0, 0.0], [12.0, 7.0, 0.0], [20.0, 5.0, 0.0]]
    goals = "get to green agent", "Get pink item to red lm"
    one = room(near_goals(start=start), goals, computer=np.random.default_rng(0), limit=3)
    asyncio.run(one._planned())
    seen = one._computers[1]._agent.beliefs.observed
    assert not seen[3]
    np.testing.assert_array_equal(seen, one._picture().seen[1])


@pytest.mark.parametrize(("size", "strength"), [(0.8, 300.0), (1.6, 150.0)])
@pytest.mark.parametrize("resets", [True, False])
def test_expected_steps_are_those_of_the_world(size: float, strength: float, resets: bool) -> None:
    where = scene(red=(16.0, 4.5, 0.0), radius=[size, 0.8, 0.8, 0.8])
    world = PymunkWorld(settings(resets_velocity=resets).scene(where), (strength, 300.0))
    expected, steps = driving(size, strength, 2.0, resets), 0
    while world.state.pose[0, 1] - 4.5 < 2.0:
        world.step((Action.UP, Action.NO_FORCE))
        steps += 1
    assert steps == pytest.approx(expected, rel=0.05, abs=1)


def test_agents_that_cannot_make_it_are_named() -> None:
    def said(strength: float, radius: float, goal: str, **changes: Any) -> list[str]:
        start = [[23.5, 3.5, 0.0], [20.0, 19.5, 0.0], [12.0, 7.0, 0.0], [20.0, 7.0, 0.0]]
        event = near_goals("scene", start=start, radius=[radius, 0.8, 0.8, 0.8])
        truth = ppl.Truth(goal, "Get green agent to green lm", "", "", strength, 600.0)
        changed = ppl.Event(event.scene, event.observation, "scene", truth)
        return warnings([changed], settings(**changes))

    home = "Get red agent to blue lm"
    assert said(600.0, 0.8, home) == []
    (slow,) = said(150.0, 1.6, home)
    assert slow.startswith("scene: the red agent (size 1.6, 150 N) needs some 2")
    assert slow.endswith("s for its goal, of the 60 s that a session takes (limit in [play])")
    assert said(150.0, 1.6, home, limit=2000) == []
    (near,) = said(150.0, 1.6, "Get red agent to red lm")
    assert "across the arena" in near
    (weak,) = said(150.0, 0.8, "Get blue item to red lm")
    assert "cannot move the blue item alone" in weak
