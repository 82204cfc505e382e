"""Observations with gaps: what was not seen, time stamps, files, pictures, and who refuses."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.verdict import of_tracks
from phase_ppl.render.frames import Painter, between_frames
from phase_ppl.simulator.contract import simulate_one
from phase_ppl.world.errors import AnswerError, InvalidEventError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.hypothesis import Hypothesis
from tests.world.examples import make_event, make_trajectory

PINK = 3


def with_gap() -> Event:
    seen = make_trajectory(6).copy()
    seen[2:4, PINK] = np.nan
    seen[1, 0, 2] = np.nan
    return dataclasses.replace(make_event(), observation=Observation(seen))


def test_gaps_are_said_and_can_be_put_on_straight_lines() -> None:
    seen = with_gap().observation
    assert seen.has_gaps
    assert "body 3 unseen in 2 frames" in repr(seen)
    filled, whole = seen.filled(), make_trajectory(6)
    assert not filled.has_gaps
    assert filled.filled() is filled
    assert "3 poses that were not seen put on straight lines" in repr(filled)
    line = whole[1, PINK] + (whole[4, PINK] - whole[1, PINK]) * np.array([[1], [2]]) / 3
    np.testing.assert_allclose(filled.trajectory[2:4, PINK], line)
    with pytest.raises(InvalidEventError, match=r"X needs to see all bodies, .* 3 of 6 frames"):
        seen.whole("X")
    never = whole.copy()
    never[:, PINK] = np.nan
    with pytest.raises(InvalidEventError, match="body 3 was never seen"):
        Observation(never).filled()


def test_bodies_and_agents_angles_that_were_not_seen_are_named() -> None:
    event = with_gap()
    found = of_tracks(event.observation.trajectory, event.scene, joint=True)
    assert found["unseen_frames"] == {"pink item": [2, 3], "red agent's angle": [1]}


def test_files_hold_gaps(tmp_path: Path) -> None:
    event, path = with_gap(), tmp_path / "gap.json"
    ppl.save_event(event, path)
    read = ppl.load_event(path)
    np.testing.assert_array_equal(read.observation.trajectory, event.observation.trajectory)
    assert "[null, null, null]" in path.read_text()
    ppl.save_events([event, make_event(4, "another")], path)
    read = ppl.load_events(path)[0]
    np.testing.assert_array_equal(read.observation.trajectory, event.observation.trajectory)


def test_frames_at_any_times_are_put_on_the_grid_and_long_gaps_are_gaps() -> None:
    times = np.delete(np.arange(61) / 30, slice(20, 32))  # of two seconds, 0.4 without a frame
    poses = np.zeros((len(times), 2, 3))
    poses[:, 0, 0] = 6 + 3 * times
    poses[:, 1, 2] = np.angle(np.exp(1j * 4 * times))  # turns on, as trackers wrap it
    poses[3, 1] = np.nan
    found = Observation.at_times(poses, times + 100.0)
    assert "49 time stamps (24 a second) put on 12 frames a second" in found.said
    assert found.n_frames == 25
    unseen = np.isnan(found.positions[..., 0])
    # the last frame before the gap ends at 19/30 s, the first one after it begins at 32/30 s
    assert np.flatnonzero(unseen[:, 0]).tolist() == list(range(8, 14))
    assert np.flatnonzero(unseen[:, 1]).tolist() == [1, 2, *range(8, 14)]
    seen = np.flatnonzero(~unseen[:, 0])[1:]
    middle = (seen - 0.4) / 12  # of a frame's five parts
    np.testing.assert_allclose(found.positions[seen, 0, 0], 6 + 3 * middle, atol=1e-9)
    late = seen[seen > 13]
    turned = np.diff(found.angles[late, 1]) * 12
    np.testing.assert_allclose(turned, 4, atol=1e-6)
    with pytest.raises(InvalidEventError, match=r"time stamp 0 after 0: .*later"):
        Observation.at_times(poses[:2], [0, 0])
    with pytest.raises(InvalidEventError, match=r"time stamp 1e\+09 after 0: .*at most 3600"):
        Observation.at_times(poses[:2], [0, 1e9])  # nanoseconds
    with pytest.raises(InvalidEventError, match=r"times has shape \(3,\), expected \(2,\)"):
        Observation.at_times(poses[:2], [0, 1, 2])
    with pytest.raises(InvalidEventError, match=r"trajectory has 0 frame"):
        Observation.at_times([], [])


def test_what_was_not_seen_is_not_drawn() -> None:
    event = with_gap()
    painter = Painter(event.scene)
    seen = event.observation.trajectory
    gone = np.asarray(painter.draw(seen[2], trail=seen[:3]))
    without = seen[2].copy()
    without[PINK] = make_trajectory(6)[2, PINK]
    assert not np.array_equal(gone, np.asarray(painter.draw(without, trail=seen[:3])))
    assert np.asarray(painter.draw(seen[1])).any()
    between = between_frames(seen, 2)
    assert np.flatnonzero(np.isnan(between[:, PINK, 0])).tolist() == list(range(3, 8))
    assert np.flatnonzero(np.isnan(between[:, 0, 2])).tolist() == [1, 2, 3]
    assert "svg" in event._repr_html_()
    assert "nan" not in event._repr_html_()


def test_simulations_are_compared_with_what_was_seen() -> None:
    event, shift = with_gap(), np.array([0.3, 0.4, 0.0])
    whole = make_trajectory(6)

    def shifted(scene: ppl.Scene, hypothesis: Hypothesis, rng: Any) -> Any:
        yield from whole + shift

    found = simulate_one(shifted, event.scene, Hypothesis(0, 5), 1, event.observation.positions)
    n_seen = 4 - np.isnan(event.observation.positions[..., 0]).sum(axis=1)
    np.testing.assert_allclose(found.errors, 0.5 * np.sqrt(n_seen))
    assert found.completed


@pytest.mark.parametrize("model", ["predicate", "last_frame", "socialgnn"])
def test_models_that_need_whole_tracks_refuse_gaps(model: str) -> None:
    event = dataclasses.replace(with_gap(), predictions=None, judgments=None)
    with pytest.raises(AnswerError, match=r"needs to see all bodies, .*filled\(\)"):
        ppl.evaluate([event], model, workers=1, progress=False)
