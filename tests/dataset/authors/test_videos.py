"""The authors' files, as they are described, become the events that they show."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phase_ppl.dataset.authors.videos import (
    Place,
    Recorded,
    file_name,
    goal_numbers,
    goal_string,
    parse_name,
    place_in_id,
    repaired,
)
from phase_ppl.dataset.load import load_event, load_events
from phase_ppl.dataset.motion import full_turn
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, PhasePPLError, UnknownNameError
from phase_ppl.world.event import Event, Truth
from phase_ppl.world.goals import GOALS, is_self_referring
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from tests.dataset.authors.pickles import (
    FRAMES,
    KINDS,
    SHORT,
    SHUFFLED,
    STAMP,
    averaged,
    expected,
    name_of,
    processed,
    record,
    wrapped,
)
from tests.world.examples import DEV, needs_dev


def write(folder: Path, content: Any, name: str = "videos.pkl", protocol: int = 3) -> Path:
    path = folder / name
    path.write_bytes(pickle.dumps(content, protocol))
    return path


def load(path: Path) -> list[Event]:
    return load_events(path, format="phase-pickle")


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
    assert event.truth is not None
    red, green = made.hypothesis.effective_goals
    assert (event.truth.goal_red, event.truth.goal_green) == (GOALS[red], GOALS[green])
    assert (event.truth.strength_red, event.truth.strength_green) == (600.0, 150.0)


@pytest.mark.parametrize("code", [SHUFFLED, SHORT, {0: 1, 1: 0, 2: 3, 3: 2}], ids=str)
@pytest.mark.parametrize("copy", KINDS)
def test_a_processed_video_becomes_what_it_shows(
    tmp_path: Path, copy: int | None, code: dict[int, int]
) -> None:
    (event,) = load(write(tmp_path, [processed(copy, code)]))
    assert_shows(event, copy)
    assert event.id == f"{STAMP}_E8" + ("" if copy is None else f".{copy}")
    assert event.observation.n_frames == FRAMES
    assert event.judgments == {"majority": "neutral"}


@pytest.mark.parametrize("copy", KINDS)
def test_a_record_of_the_generator_becomes_what_it_shows(tmp_path: Path, copy: int | None) -> None:
    (event,) = load(write(tmp_path, record(copy), name_of(copy) + ".pik"))
    assert_shows(event, copy)
    assert event.judgments is None


def test_the_made_up_angles_are_spoiled_before_they_are_repaired() -> None:
    spoiled = np.array(processed(3)["trajectories"][1])[:, 4]
    made = np.unwrap(spoiled) - expected(3).trajectory[:, 0, 2]
    assert np.ptp(made) > 1


def test_a_record_that_was_renamed_is_read_without_its_truth(tmp_path: Path) -> None:
    event = load_event(write(tmp_path, record(None), "mine.pik"), format="phase-pickle")
    assert (event.id, event.truth) == ("mine", None)


def test_one_of_several_videos_is_read_by_its_id(tmp_path: Path) -> None:
    path = write(tmp_path, [processed(copy) for copy in KINDS])
    assert [event.id for event in load(path)] == [
        f"{STAMP}_E8{suffix}" for suffix in ("", ".0", ".1", ".2", ".3")
    ]
    event = load_event(path, f"{STAMP}_E8.2", "both", format="phase-pickle")
    assert_shows(event, 2)
    assert event.scene.turning == "both"
    with pytest.raises(UnknownNameError, match=r"videos.pkl: unknown video 'other'"):
        load_event(path, "other", format="phase-pickle")


def test_videos_of_one_stamp_and_place_go_by_their_whole_names(tmp_path: Path) -> None:
    first, second = processed(0), processed(0)
    second["name"] = second["name"].replace("_e0", "_e1")
    ids = [event.id for event in load(write(tmp_path, [first, second, processed(1)]))]
    assert ids == [first["name"], second["name"], f"{STAMP}_E8.1"]


def test_the_way_agents_turn_is_read_off_their_angles(tmp_path: Path) -> None:
    video = processed(None)
    turns = np.zeros(1 + 5 * (FRAMES - 1))
    steps = np.cumsum(np.tile(np.arange(1, 6) / 15, 10)) * 1.0617  # full turns of size 0.8
    turns[1:51], turns[51:] = steps, steps[-1]
    video["trajectories"][1][:, 4] = averaged(turns[:, None], 1)[:, 0]
    video["trajectories"][0][:, 4] = 0.0
    (event,) = load(write(tmp_path, [video]))
    assert event.scene.turning == "ccw"


def test_a_pickle_is_read_only_when_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, [processed(None)])
    with pytest.raises(InvalidEventError, match=r"is a pickle.*format='phase-pickle'"):
        load_events(path)
    with pytest.raises(UnknownNameError, match=r"unknown format 'pickle'.*'phase-pickle'"):
        load_events(path, format="pickle")


def test_a_bundled_name_stands_for_no_pickle() -> None:
    with pytest.raises(InvalidEventError, match="collaborate: no such file"):
        load_events("collaborate", format="phase-pickle")


TRACKS = processed(None)["trajectories"]
NAN = [np.where(np.arange(5) == 1, np.nan, track) for track in TRACKS]
BAD: dict[str, tuple[Any, str]] = {
    "text": ("videos", "holds 'videos', expected a list of videos"),
    "number": (3.5, "holds 3.5, expected a list of videos"),
    "empty": ([], "the list is empty"),
    "no_dict": ([[1, 2]], "videos[0] is list, expected a dict"),
    "no_name": ([{}], "has no videos[0].name"),
    "name": ([{"name": 7}], "videos[0].name is 7, expected a string"),
    "control": ([{"name": "a\nb"}], "id is 'a\\nb', expected printable"),
    "no_code": ([{"name": "x"}], "has no entity_color_code"),
    "no_tracks": (
        [{"name": "x", "entity_color_code": SHUFFLED, "entity_sizes": [1] * 4}],
        "has no trajectories",
    ),
}
FIELDS: dict[str, tuple[dict[str, Any], str]] = {
    "tracks": ({"trajectories": {0: 1}}, "trajectories is dict, expected a list of tracks"),
    "three": ({"trajectories": TRACKS[:3]}, "trajectories has 3 tracks, expected 4"),
    "channels": (
        {"trajectories": [track[:, :4] for track in TRACKS]},
        "trajectories[1] has shape (40, 4), expected ('n', 5)",
    ),
    "nan": ({"trajectories": NAN}, "trajectories[1][0, 1] is nan, expected a finite number"),
    "flags": ({"trajectories": [track > 0 for track in TRACKS]}, "trajectories[1] holds"),
    "words": ({"trajectories": ["abcd"] * 4}, "trajectories[1] holds 'abcd', expected numbers"),
    "ragged": ({"trajectories": [[[1, 2, 3, 4, 5], [1]]] * 4}, "trajectories[1] is ragged"),
    "no_rows": ({"trajectories": [np.zeros((0, 5))] * 4}, "trajectory has 0 frame(s)"),
    "one_row": ({"trajectories": [track[:1] for track in TRACKS]}, "has 1 frame(s)"),
    "agents": (
        {"trajectories": [TRACKS[0][:9], *TRACKS[1:]]},
        "trajectories have 40 of body 1, 9 of body 0, 47 of body 3",
    ),
    "items": ({"trajectories": [*TRACKS[:3], TRACKS[3][:9]]}, "no fewer of items"),
    "outside": (
        {"trajectories": [track + 20 for track in TRACKS]},
        "the red agent is at (34, 28) in frame 0, outside",
    ),
    "sizes": ({"entity_sizes": [1, 2]}, "entity_sizes has shape (2,), expected (4,)"),
    "size": ({"entity_sizes": [0, 1, 1, 1]}, "sizes must lie in"),
    "tiny": ({"entity_sizes": [1e-300, 1, 1, 1]}, "sizes must lie in"),
    "code": ({"entity_color_code": [0, 1]}, "entity_color_code is [0, 1], expected an object"),
    "keys": ({"entity_color_code": {0: 0, 1: 1}}, "is {0: 0, 1: 1}, expected a code such as"),
    "colours": ({"entity_color_code": {0: 0, 1: 1, 3: 2, 4: 5}}, "expected a code such as"),
    "same": ({"entity_color_code": {0: 1, 1: 1, 3: 2, 4: 3}}, "expected a code such as"),
    "odd_short": ({"entity_color_code": {0: 2, 1: 2, 2: 3}}, "expected a code such as"),
    "colour_names": ({"entity_color_code": {0: "red", 1: 2, 2: 3}}, "expected a code such as"),
    "walls": ({"wall_segs": [[1, 2, 3]]}, "wall_segs has shape (1, 3), expected"),
    "wall": ({"wall_segs": [[(1, 2), (3, 4)]]}, "does not run from the arena's centre"),
    "landmarks": ({"landmark_centers": [[1, 2]]}, "landmark_centers has shape (1, 2)"),
    "moved": ({"landmark_centers": [[8.5, 4.5]] * 4}, "expected blue lm, green lm"),
    "social": ({"social_goals": "friends"}, "unknown relation in social_goals"),
    "social_array": ({"social_goals": np.arange(3)}, "unknown relation in social_goals 'ndarray'"),
    "goal": (
        {"name": name_of(None).replace("'TE', 1, 0", "'TE', 1, 2")},
        "goal ['TE', 1, 2, 1] is none of the paper's 36 goals",
    ),
    "goal_type": ({"name": name_of(None).replace("LMO", "LMX")}, "goal ['LMX', 0, 2, 1] is none"),
    "landmark": ({"name": name_of(None).replace("0, 2, 1", "0, 4, 1")}, "is none of the paper's"),
    "one_goal": (
        {"name": name_of(None).replace("['TE', 1, 0, 1]", "['stop']")},
        "expected one per agent",
    ),
    "long": ({"name": "x" * 2000}, "of more than 1000 characters"),
}


BAD |= {case: ([{**processed(None), **new}], said) for case, (new, said) in FIELDS.items()}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_video_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = BAD[case]
    path = write(tmp_path, content)
    with pytest.raises(PhasePPLError) as raised:
        load(path)
    said = str(raised.value)
    assert said.startswith(str(path))
    assert "\n" not in said
    assert message in said


def test_a_record_of_an_odd_number_of_substeps_is_refused(tmp_path: Path) -> None:
    made = record(None)
    made["trajectories"] = [rows[:-2] for rows in made["trajectories"]]
    with pytest.raises(InvalidEventError, match="has 194 rows, expected a multiple of 5, or one"):
        load(write(tmp_path, made))


def test_all_tracks_may_be_one_array(tmp_path: Path) -> None:
    video = processed(1)
    video["trajectories"] = np.stack([track[:FRAMES] for track in video["trajectories"]])
    (event,) = load(write(tmp_path, [video], protocol=5))
    assert_shows(event, 1)


# --- names ----------------------------------------------------------------------------------------

TRUTH = Truth(
    "Get blue item to red lm", "get to red agent", strength_red=600.0, strength_green=150.0
)


def test_a_name_says_where_it_was_and_who_wanted_what() -> None:
    recorded = Recorded("D082020_1817530_E8", Place(8, None), TRUTH)
    for ending in ("", ".mp4", ".pik"):
        assert parse_name(name_of(None) + ending) == recorded

    # a reflected copy has a number after the layout
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
def test_every_goal_has_numbers_unless_it_names_its_holder(holder: int) -> None:
    for goal, string in enumerate(GOALS):
        if is_self_referring(goal, holder):
            with pytest.raises(InvalidEventError, match="names its own holder"):
                goal_numbers(string, holder)
        else:
            assert goal_string(goal_numbers(string, holder), holder) == string


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


# --- angles of copies -----------------------------------------------------------------------------

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


def assert_equal_but_for_whole_turns(got: FloatArray, wanted: FloatArray) -> None:
    whole = np.round((got[0] - wanted[0]) / TURN) * TURN
    np.testing.assert_allclose(got, wanted + whole, atol=1e-9)


@settings(max_examples=200, deadline=None)
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
    assert_equal_but_for_whole_turns(repaired(spoiled(angles), radius), averaged(angles, 1))


def test_frames_that_pass_the_cut_are_wrong_before() -> None:
    angles = turning([1] * 10, 0.8, -1.0)
    off = spoiled(angles) - averaged(angles, 1)
    assert ((off % TURN > 0.1) & (off % TURN < TURN - 0.1)).sum() == 2


@pytest.mark.parametrize("angle", [0.0, -1e-12, -TURN, -TURN / 5, -4 * TURN / 5])
def test_an_agent_at_rest_is_left_alone(angle: float) -> None:
    given_ = np.full(20, angle)
    np.testing.assert_array_equal(repaired(given_, 0.8), given_)


def test_angles_beyond_the_cut_were_never_wrapped() -> None:
    angles = np.array([-0.3, -0.1, 0.2, -5.0, -0.1])
    np.testing.assert_array_equal(repaired(angles, 0.8), angles)


@needs_dev
def test_repaired_angles_are_left_alone() -> None:
    for event in load_events(DEV):
        for agent in range(2):
            angles = event.observation.trajectory[:, agent, 2]
            radius = float(event.scene.radius[agent])
            np.testing.assert_array_equal(repaired(angles, radius), angles)


@needs_dev
def test_hardly_a_frame_of_the_real_tracks_is_repaired_wrongly() -> None:
    """Tracks of all kinds, turned at random, wrapped and averaged; substeps by interpolation."""
    rng = np.random.default_rng(0)
    frames, wrong = 0, 0
    for event in load_events(DEV):
        for agent in range(2):
            track = event.observation.trajectory[:, agent, 2] + rng.uniform(0, TURN)
            at = np.arange(5 * (len(track) - 1)) / 5 + 0.6  # the middle of five is at a frame
            angles = np.concatenate([track[:1], np.interp(at, np.arange(len(track)), track)])
            radius = float(event.scene.radius[agent])
            got, wanted = repaired(spoiled(angles), radius), averaged(angles, 1)
            whole = np.round((got[0] - wanted[0]) / TURN) * TURN
            wrong += int((np.abs(got - wanted - whole) > 1e-6).sum())
            frames += len(track)
    assert frames > 5000
    assert wrong < 0.002 * frames
