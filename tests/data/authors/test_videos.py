"""The authors' files, as they are described, become the events that they show."""

from __future__ import annotations

import itertools
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.data.authors import Place, Recorded, goal_string, parse_name, repaired
from phase_ppl.data.load import load_event, load_events
from phase_ppl.data.motion import full_turn
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import PhasePPLError, UnknownNameError
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS
from tests.data.authors.pickles import (
    FRAMES,
    KINDS,
    SHORT,
    SHUFFLED,
    STAMP,
    averaged,
    expected,
    name_of,
    processed,
    wrapped,
)
from tests.world.examples import DEV, needs_dev


def write(folder: Path, content: Any, name: str = "videos.pkl", protocol: int = 3) -> Path:
    path = folder / name
    path.write_bytes(pickle.dumps(content, protocol))
    return path


def assert_shows(event: Event, copy: int | None) -> None:
    made = expected(copy)
    got, wanted = event.observation.trajectory, made.trajectory
    np.testing.assert_allclose(got[..., :2], wanted[..., :2], atol=1e-9)
    turns = np.round((got[0, :, 2] - wanted[0, :, 2]) / (2 * np.pi))  # where the first was wrapped
    np.testing.assert_allclose(got[..., 2], wanted[..., 2] + 2 * np.pi * turns, atol=1e-9)
    assert (turns == 0).all() or copy in (2, 3)
    np.testing.assert_array_equal(event.scene.start, got[0])
    np.testing.assert_array_equal(event.scene.radius, made.scene.radius)
    assert event.scene.rooms.wall_length.tolist() == made.scene.rooms.wall_length.tolist()
    red, green = made.hypothesis.effective_goals
    assert (event.truth.goal_red, event.truth.goal_green) == (GOALS[red], GOALS[green])
    assert (event.truth.strength_red, event.truth.strength_green) == (600.0, 150.0)


@pytest.mark.parametrize("copy", KINDS)
def test_videos_become_what_they_show(tmp_path: Path, copy: int | None) -> None:
    for code in (SHUFFLED, SHORT, {0: 1, 1: 0, 2: 3, 3: 2}):
        (event,) = load_events(write(tmp_path, [processed(copy, code)]))
        assert_shows(event, copy)
        assert event.id == f"{STAMP}_E8" + ("" if copy is None else f".{copy}")
        assert event.observation.n_frames == FRAMES
        assert event.judgments == {"majority": "neutral"}


def test_ids_are_stamp_and_place_or_what_the_name_says(tmp_path: Path) -> None:
    path = write(tmp_path, [processed(copy) for copy in KINDS])
    assert [event.id for event in load_events(path)] == [
        f"{STAMP}_E8{suffix}" for suffix in ("", ".0", ".1", ".2", ".3")
    ]
    event = load_event(path, f"{STAMP}_E8.2", "both")
    assert_shows(event, 2)
    assert event.scene.turning == "both"
    with pytest.raises(UnknownNameError, match=r"videos.pkl: unknown video 'other'"):
        load_event(path, "other")
    # stamps have 7 digits or 8
    for stamp in (STAMP, f"{STAMP[:-1]}00", f"{STAMP[:-1]}10"):
        made = [processed(copy, stamp=stamp) for copy in KINDS]
        found = [event.id for event in load_events(write(tmp_path, made))]
        assert found == [f"{stamp}_E8{suffix}" for suffix in ("", ".0", ".1", ".2", ".3")]
    # two of one stamp and place go by their whole names
    first, second = processed(0), processed(0)
    second["name"] = second["name"].replace("_e0", "_e1")
    ids = [event.id for event in load_events(write(tmp_path, [first, second, processed(1)]))]
    assert ids == [first["name"], second["name"], f"{STAMP}_E8.1"]


@pytest.mark.parametrize("protocol", [0, pickle.HIGHEST_PROTOCOL])
def test_a_pickle_is_known_by_its_content_whatever_its_name(tmp_path: Path, protocol: int) -> None:
    for name in ("Videos", "videos.json", "videos.pkl"):
        (event,) = load_events(write(tmp_path, [processed(None)], name, protocol))
        assert_shows(event, None)


ORIGINAL = DEV.parent / "original" / "Videos_Test_humanratings"


@pytest.mark.skipif(
    not ORIGINAL.is_file(), reason="the original recordings (../shared/phase-test) are not here"
)
def test_the_original_file_shows_what_its_conversion_says() -> None:
    converted = {event.id: event for event in load_events(DEV)}
    found = load_events(ORIGINAL)
    assert sorted(event.id for event in found) == sorted(converted)
    for event in found:
        like = converted[event.id]
        tracks, others = event.observation.trajectory, like.observation.trajectory
        np.testing.assert_allclose(tracks[..., :2], others[..., :2], atol=1e-4)
        angles = tracks[:, :2, 2] - others[:, :2, 2]
        turns = TURN * np.round(angles[:1] / TURN)
        np.testing.assert_allclose(angles, np.broadcast_to(turns, angles.shape), atol=1e-4)
        for name in ("radius", "walls", "landmark_centres"):
            mine, theirs = getattr(event.scene, name), getattr(like.scene, name)
            np.testing.assert_allclose(np.sort(mine, axis=0), np.sort(theirs, axis=0), atol=1e-4)
        assert event.scene.turning == like.scene.turning
        assert event.truth == like.truth
        assert event.judgments == {"majority": (like.judgments or {})["majority"]}


TRACKS = processed(None)["trajectories"]
NAME = name_of(None)
BAD: dict[str, list[Any]] = {
    "the list is empty": [[]],
    "videos[0]: Object missing required field 'name'": [[{}]],
    "id is 'a\\nb', expected printable": [[{"name": "a\nb"}]],
    "missing required field 'trajectories'": [[{"name": "x"}]],
}
FIELDS: dict[str, list[dict[str, Any]]] = {
    "trajectories has 3 tracks, expected 4": [{"trajectories": TRACKS[:3]}],
    "trajectories[1][0, 1] is nan, expected a finite number": [
        {"trajectories": [np.where(np.arange(5) == 1, np.nan, track) for track in TRACKS]}
    ],
    "expected blue lm, green lm": [{"landmark_centers": [[8.5, 4.5]] * 4}],
    "trajectories have [40, 9, 47, ": [
        {"trajectories": [TRACKS[0][:9], *TRACKS[1:]]}
    ],
    "sizes has shape (2,), expected (4,)": [{"entity_sizes": [1, 2]}],
    "sizes must lie in": [{"entity_sizes": [0, 1, 1, 1]}, {"entity_sizes": [1e-300, 1, 1, 1]}],
    "entity_color_code: Expected 'object', got 'array'": [{"entity_color_code": [0, 1]}],
    "expected a code such as": [
        {"entity_color_code": code}
        for code in ({0: 0, 1: 1}, {0: 0, 1: 1, 3: 2, 4: 5}, {0: 1, 1: 1, 3: 2, 4: 3},
                     {0: 2, 1: 2, 2: 3})
    ],
    "social_goals: ": [{"social_goals": "friends"}, {"social_goals": np.arange(3)}],
    "is none of the paper's": [
        {"name": NAME.replace(*change)}
        for change in (("'TE', 1, 0", "'TE', 1, 2"), ("LMO", "LMX"), ("0, 2, 1", "0, 4, 1"))
    ],
    "expected one per agent": [{"name": NAME.replace("['TE', 1, 0, 1]", "['stop']")}],
}  # fmt: skip


def test_what_is_no_video_is_refused_in_one_line(tmp_path: Path) -> None:
    odd = {said: [[{**processed(None), **new}] for new in many] for said, many in FIELDS.items()}
    for message, contents in {**BAD, **odd}.items():
        for content in contents:
            path = write(tmp_path, content)
            with pytest.raises(PhasePPLError) as raised:
                load_events(path)
            said = str(raised.value)
            assert said.startswith(str(path))
            assert "\n" not in said
            assert message in said


TRUTH = Truth(
    "Get blue item to red lm", "get to red agent", strength_red=600.0, strength_green=150.0
)


def test_a_name_says_where_it_was_and_who_wanted_what() -> None:
    recorded = Recorded("D082020_1817530_E8", Place(8, None), TRUTH)
    for ending in ("", ".mp4", ".pik"):
        assert parse_name(name_of(None) + ending) == recorded
    for between in (",", "_", " "):
        assert parse_name(name_of(None).replace(", ", between)).truth == TRUTH
    # a reflected copy has a number after the layout
    said = parse_name(name_of(3))
    assert (said.id, said.place) == ("D082020_1817530_E8.3", Place(8, 3))
    for name in ("mine", "x.y.mp4", "", "_E8_G[]", "E8"):
        assert parse_name(name) == Recorded(name.removesuffix(".mp4"), None, None)


GOAL_OF_NUMBERS: dict[tuple[Any, int], str] = {
    (("LMO", 0, 0, 1), 0): "Get blue item to blue lm",
    (("LMO", 1, 3, -1), 1): "Get pink item away from yellow lm",
    (("LMA", 0, 1, 1), 1): "Get red agent to green lm",
    (("TE", 0, 1, 1), 0): "get to green agent",
    (("TE", 0, 1, -1), 1): "get away from red agent",
    (("TE", 1, 0, 1), 1): "get to red agent",
    (("TE", 1, 0, -1), 0): "get away from green agent",
}


def test_numbers_of_a_goal_stand_for_a_string_of_the_paper() -> None:
    for (numbers, holder), string in GOAL_OF_NUMBERS.items():
        assert goal_string(numbers, holder) == string


SIZES = (0.8, 1.01, 1.2, 1.6)
TURN = 2 * np.pi


def spoiled(substeps: FloatArray) -> FloatArray:
    """Return what the authors' processing makes of angles."""
    return averaged(wrapped(substeps), 1)


def turning(steps: list[int], radius: float, start: float) -> FloatArray:
    """Return angles per substep of an agent that turns by -1, 0 or 1 full turns in each step.

    Within a step the spin grows evenly, and is gone at its end.
    """
    part = np.arange(1, 6) / 15
    moves = np.concatenate([sign * full_turn(radius) * part for sign in steps])
    return np.concatenate([[start], start + np.cumsum(moves)])


@settings(max_examples=80)
@given(
    steps=st.lists(st.integers(1, 40), min_size=2, max_size=12),  # 40 are more than a whole turn
    radius=st.sampled_from(SIZES),
    start=st.floats(-TURN, 0),
    way=st.sampled_from([1, -1]),
)
def test_an_agent_that_turns_one_way_now_and_then(
    steps: list[int], radius: float, start: float, way: int
) -> None:
    moves = [way * (block % 2) for block, length in enumerate(steps) for _ in range(length)]
    angles = turning([0, 0, *moves, 0, 0], radius, start)
    got, wanted = repaired(spoiled(angles), radius), averaged(angles, 1)
    whole = np.round((got[0] - wanted[0]) / TURN) * TURN
    np.testing.assert_allclose(got, wanted + whole, atol=1e-9)


@pytest.mark.parametrize(("n", "radius"), [(1, 0.8), (4, 1.6)])
def test_an_agent_that_passes_the_cut_forth_and_back_within_a_frame(n: int, radius: float) -> None:
    for cut, side in itertools.product((0.0, -TURN), (1, -1)):
        angles = np.full(101, cut - 0.02 * side)
        angles[41 : 41 + n] = cut + 0.03 * side
        got, wanted = repaired(spoiled(angles), radius), averaged(angles, 1)
        turns = np.round((got - wanted)[0] / TURN)
        np.testing.assert_allclose(got, wanted + TURN * turns, atol=1e-9)


@needs_dev
def test_of_the_real_tracks_hardly_a_frame_is_repaired_wrongly_and_none_that_was_right() -> None:
    """Tracks of all kinds, turned at random, wrapped and averaged; substeps by interpolation."""
    rng = np.random.default_rng(0)
    frames, wrong = 0, 0
    for event in load_events(DEV):
        for agent in range(2):
            angles = event.observation.trajectory[:, agent, 2]
            radius = float(event.scene.radius[agent])
            np.testing.assert_array_equal(repaired(angles, radius), angles)
            track = angles + rng.uniform(0, TURN)
            at = np.arange(5 * (len(track) - 1)) / 5 + 0.6  # the middle of five is at a frame
            substeps = np.concatenate([track[:1], np.interp(at, np.arange(len(track)), track)])
            got, wanted = repaired(spoiled(substeps), radius), averaged(substeps, 1)
            whole = np.round((got[0] - wanted[0]) / TURN) * TURN
            wrong += int((np.abs(got - wanted - whole) > 1e-6).sum())
            frames += len(track)
    assert frames > 5000
    assert wrong < 0.002 * frames
