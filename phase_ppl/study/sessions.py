"""Played sessions: what they ask of the agents, and the events that they are."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from phase_ppl.dataset.load import save_events
from phase_ppl.evaluation.csv_file import csv_bytes
from phase_ppl.physics import compiled
from phase_ppl.physics.actions import ACTION_NAMES, NO_ACTION, Action
from phase_ppl.physics.pymunk_world import PymunkWorld
from phase_ppl.study.room import PlaySettings, trajectory_sha256
from phase_ppl.study.store import COMPLETE, Store
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.files import write_bytes
from phase_ppl.world.goals import goal_literal, is_true
from phase_ppl.world.names import AGENTS, ENTITIES, NOTHING, Literal, Predicate
from phase_ppl.world.observation import Observation, State
from phase_ppl.world.scene import Scene

SLIPPED: Final = 500.0
"""Milliseconds by which a frame of a session may be late before the session is marked."""

# --- what is to be expected of a scene ------------------------------------------------------------


def warnings(events: Iterable[Event], settings: PlaySettings) -> list[str]:
    """Return which agents cannot do in the time what they are to do, in words."""
    found = []
    for event in events:
        truth, scene = event.truth, settings.scene(event.scene)
        assert truth is not None
        goals = truth.goal_red, truth.goal_green
        literals = [goal_literal(goal, agent) for agent, goal in enumerate(goals)]
        if all(one.positive and is_true(one, scene.start, scene) for one in literals):
            found.append(f"{event.id}: both goals are reached before anybody moves")
        for agent, strength in enumerate((truth.strength_red, truth.strength_green)):
            assert strength is not None
            name, size = ENTITIES[agent], float(scene.radius[agent])
            who = f"{event.id}: the {name} (size {size:g}, {strength:g} N)"
            needed = _needed(literals[agent], agent, scene, strength, settings)
            width = scene.arena[1] - scene.arena[0]
            crossing = driving(size, strength, width, settings.resets_velocity) * settings.step
            if needed == np.inf:
                item = ENTITIES[literals[agent].subject]
                found.append(f"{who} cannot move the {item} alone, which its goal is about")
            elif needed > settings.seconds:
                found.append(f"{who} needs {_said(needed)} for its goal, {_of(settings)}")
            elif crossing > settings.seconds:
                found.append(f"{who} needs {_said(crossing)} across the arena, {_of(settings)}")
    return found


def _said(seconds: float) -> str:
    return "forever" if seconds == np.inf else f"some {seconds:.0f} s"


def _of(settings: PlaySettings) -> str:
    return f"of the {settings.seconds:g} s that a session takes (limit in [play])"


def _needed(
    literal: Literal, agent: int, scene: Scene, strength: float, settings: PlaySettings
) -> float:
    """Return the seconds that an agent needs for its goal, alone and straight; inf: never."""
    places, distance, resets = scene.start[:, :2], scene.rooms.path_distance, scene.resets_velocity
    size, subject = float(scene.radius[agent]), literal.subject
    if not literal.positive or subject == 1 - agent:
        return 0.0
    if literal.predicate is Predicate.TOUCH:
        way = distance(places[agent], places[literal.target])
        return driving(size, strength, way, resets) * settings.step
    goal = scene.landmark_centres[literal.target]
    carried = max(0.0, float(distance(places[subject], goal)) - scene.landmark_half_width)
    if subject == agent:
        return driving(size, strength, carried, resets) * settings.step
    there = driving(size, strength, float(distance(places[agent], places[subject])), resets)
    item = float(scene.radius[subject])
    return (there + driving(size, strength, carried, resets, item)) * settings.step


_STEADY: Final = 24  # steps after which the speed of an agent that is reset is taken as it stays
_CREEPS: Final = 2e-3  # units per step that are no motion


@functools.lru_cache(maxsize=1024)
def driving(
    size: float, strength: float, way: float, resets_velocity: bool, item: float | None = None
) -> float:
    """Return the planner steps that an agent takes straight ahead from rest; inf: it stays.

    Of that size [units] and strength [N], for a way [units], carrying an item of a size in front.
    """
    if way <= 0:
        return 0.0
    room = 10 * max(way, 20.0)
    start = np.array([[0.5, 0.1], [0.1, 0.9], [0.9, 0.9], [0.9, 0.1]]) * room
    if item is not None:
        start[2] = start[0] + [0.0, size + item]
    corners = np.array([[0.1, 0.9], [0.9, 0.9], [0.9, 0.1], [0.1, 0.1]]) * room
    scene = Scene(
        start=np.column_stack([start, np.zeros(4)]),
        radius=np.array([size, 0.8, item or 0.8, 0.8]),
        arena=(0.0, room, 0.0, room),
        landmark_centres=corners,
        resets_velocity=resets_velocity,
    )
    params = compiled.make_params(scene, (strength, strength))
    arrays = compiled.from_state(State.at_start(scene), scene.radius)
    scratch = compiled.make_scratch()
    if item is not None:
        compiled.step(*arrays, np.array([Action.ATTACH, NO_ACTION]), params, scratch)
        if arrays[1][0] == NOTHING:
            return np.inf
    gone = before = 0.0
    for step in range(1, 100_000):
        compiled.step(*arrays, np.array([Action.UP, NO_ACTION]), params, scratch)
        before, gone = gone, arrays[0][0, 1] - start[0, 1] + size / 6
        if gone >= way:
            return float(step)
        if step >= _STEADY and (resets_velocity or gone <= _CREEPS):
            return step + (way - gone) / (gone - before) if gone - before > _CREEPS else np.inf
    return np.inf


# --- from what was recorded to events -------------------------------------------------------------


def replayed(session: Mapping[str, Any], event: Event) -> Event:
    """Return the event of a session, by doing its actions once more."""
    settings = session["settings"]
    scene = dataclasses.replace(
        event.scene, turning=settings["turning"], resets_velocity=settings["resets_velocity"]
    )
    strengths = session["strength_red"], session["strength_green"]
    world = PymunkWorld(scene, strengths)
    frames = [scene.start, *(world.step((one["red"], one["green"])) for one in session["steps"])]
    told = event.truth
    truth = Truth(
        session["goal_red"],
        session["goal_green"],
        relation="" if told is None else told.relation,
        scenario="" if told is None else told.scenario,
        strength_red=strengths[0],
        strength_green=strengths[1],
    )
    return Event(scene, Observation(np.array(frames)), id=f"session-{session['id']}", truth=truth)


def played(
    store: Store, events: Mapping[str, Event], broken_off: bool = False, excluded: bool = False
) -> tuple[list[Event], list[dict[str, Any]], dict[str, int]]:
    """Return the sessions of a study as events, with a row of facts about each, and counts.

    A session whose actions do not give its trajectory again, to the last bit, is left out.
    """
    out = {row["id"] for row in store.rows("SELECT id FROM participant WHERE excluded IS NOT NULL")}
    counts = dict.fromkeys(("sessions", *COMPLETE, "broken off", "excluded", "replay differs"), 0)
    found, rows = [], []
    for session in store.sessions():
        players = [player["participant"] for player in session["players"]]
        outcome = session["outcome"] if session["outcome"] in COMPLETE else "broken off"
        counts["sessions"] += 1
        counts[outcome] += 1
        counts["excluded"] += bool(out & set(players))
        if (outcome not in COMPLETE and not broken_off) or not session["steps"]:
            continue
        if out & set(players) and not excluded:
            continue
        event = replayed(session, events[session["event"]])
        kept = session["sha256"]
        if kept is not None and trajectory_sha256(event.observation.trajectory) != kept:
            counts["replay differs"] += 1
            continue
        found.append(event)
        rows.append(_row(session, event, players))
    return found, rows, counts


_SESSION: Final[Mapping[str, str]] = {
    "session": "id of the event in sessions.json",
    "scene": "id of the event in events.json whose scene, goals and strengths were played",
    "goal_red": "effective goal of the red agent, told to both players",
    "goal_green": "likewise of the green agent",
    "relation": "which the two goals imply",
    "strength_red": "newtons",
    "strength_green": "newtons",
    "red": "participant, or computer",
    "green": "participant, or computer",
    "outcome": "goals: both were reached; time: it was up; left: a player was gone; stopped: the "
    "server was ended",
    "steps": "planner steps, one frame each",
    "seconds": "that they took to play",
    "steps_per_second": "as played",
    "view": "own: players saw what their agent sees; all: everything",
    "resets_velocity": "1: agents stood still after each step",
    "rtt_ms_red": "median round trip of a message to the player, milliseconds",
    "rtt_ms_green": "likewise",
    "slip_ms": "most by which a frame was late, milliseconds",
    "slipped": f"1: by more than {SLIPPED:g} ms",
}
_STEP: Final[Mapping[str, str]] = {
    "session": "id of the event in sessions.json",
    "step": "planner step, from 1",
    "red": "action of the red agent",
    "green": "action of the green agent",
    "keys_red": "what its player pressed, the latest last",
    "keys_green": "likewise",
    "lag_ms": "most by which a frame of the step was late, milliseconds",
}
COLUMNS: Final = {"sessions.csv": _SESSION, "steps.csv": _STEP}  # table -> column -> what is in it


def _row(session: Mapping[str, Any], event: Event, players: list[str | None]) -> dict[str, Any]:
    settings, truth = session["settings"], event.truth
    assert truth is not None
    trips = [player["rtt_ms"] for player in session["players"]]
    values = (
        *(event.id, session["event"], truth.goal_red, truth.goal_green, truth.relation),
        *(truth.strength_red, truth.strength_green, *(who or "computer" for who in players)),
        *(session["outcome"] or "stopped", len(session["steps"])),
        *(len(session["steps"]) / settings["steps_per_second"], settings["steps_per_second"]),
        *(settings["view"], int(settings["resets_velocity"])),
        *("" if trip is None else round(trip, 1) for trip in trips),
        *(round(session["slip_ms"] or 0.0, 1), int((session["slip_ms"] or 0.0) > SLIPPED)),
    )
    return dict(zip(_SESSION, values, strict=True))


def export(
    store: Store,
    events: Mapping[str, Event],
    folder: Path,
    broken_off: bool = False,
    excluded: bool = False,
) -> dict[str, str]:
    """Write ``sessions.json``, ``sessions.csv`` and ``steps.csv``; return what they are, in words.

    Arguments as of :func:`played`; ``load_events`` reads the first, which is there if there are
    sessions.
    """
    found, rows, counts = played(store, events, broken_off, excluded)
    files = {}
    if found:
        save_events(found, folder / "sessions.json")
        files["sessions.json"] = "the sessions as events with their truth, for load_events"
    _write(folder, "sessions.csv", rows)
    said = ", ".join(f"{name} {n}" for name, n in counts.items())
    files["sessions.csv"] = f"a row for each session in sessions.json; of all there were: {said}"
    kept = {row["session"] for row in rows}
    steps = []
    for session in store.sessions():
        name = f"session-{session['id']}"
        if name not in kept:
            continue
        for step in session["steps"]:
            done = (ACTION_NAMES[step[agent.split()[0]]] for agent in AGENTS)
            keys = (" ".join(held) for held in json.loads(step["keys"]))
            values = (name, step["number"], *done, *keys, round(step["lag_ms"], 1))
            steps.append(dict(zip(_STEP, values, strict=True)))
    _write(folder, "steps.csv", steps)
    files["steps.csv"] = "what was done and pressed, from which the trajectories follow bit for bit"
    return files


def _write(folder: Path, name: str, rows: Iterable[Mapping[str, Any]]) -> None:
    columns = list(COLUMNS[name])
    content = csv_bytes(columns, ([row[column] for column in columns] for row in rows))
    write_bytes(folder / name, (".csv",), content)
