"""Tracks of other programs: the same event, written as their tables."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import PhasePPLError

DUO = ppl.World(["red agent", "green agent"], [], {"home": (4.0, 4.0)}, arena=(0, 30, 0, 20))
NAMES = {"1": "red agent", "2": "green agent"}
FPS, PIXEL = 24.0, 0.05
TIME = np.arange(49) / FPS
PLACES = np.stack([np.column_stack([4 + 3 * TIME, 5 + TIME]),
                   np.column_stack([20 - TIME, 12 - 4 * TIME])], axis=1)  # fmt: skip
PIXELS = np.stack([PLACES[..., 0] / PIXEL, (20 - PLACES[..., 1]) / PIXEL], axis=-1)  # y down
MADE: dict[str, Any] = {"world": DUO, "names": NAMES, "fps": FPS, "units": PIXEL, "y_down": True}


def long() -> pd.DataFrame:
    rows = [(k, t, *PIXELS[t, k]) for k in range(2) for t in range(len(TIME))]
    found = pd.DataFrame(rows, columns=["TRACK_ID", "FRAME", "POSITION_X", "POSITION_Y"])
    heading = pd.DataFrame([["Track", "Frame", "X", "Y"]], columns=found.columns)
    found["TRACK_ID"] += 1
    return pd.concat([heading, found.sample(frac=1, random_state=0)])  # in any order


def wide() -> pd.DataFrame:
    return pd.DataFrame(
        {f"{c}{k + 1}": PIXELS[:, k, i] for k in range(2) for i, c in enumerate("xy")}
    )


def levels() -> pd.DataFrame:
    """Two parts of each body, the nose ahead of the tail in the picture's direction up."""
    columns = {}
    for k in range(2):
        for part, off in (("nose", -4.0), ("tail", 4.0)):
            for i, coord in enumerate("xy"):
                columns["net", str(k + 1), part, coord] = PIXELS[:, k, i] + (off if i else 0)
            columns["net", str(k + 1), part, "likelihood"] = np.ones(len(TIME))
    found = pd.DataFrame(columns)
    found.columns.names = ["scorer", "individuals", "bodyparts", "coords"]
    return found


def nodes() -> pd.DataFrame:
    frames = [
        pd.DataFrame({"track": f"{k + 1}", "frame_idx": range(len(TIME)),
                      **{f"{part}.{c}": PIXELS[:, k, i] + (off if i else 0)
                         for part, off in (("nose", -4.0), ("tail", 4.0))
                         for i, c in enumerate("xy")}})
        for k in range(2)
    ]  # fmt: skip
    return pd.concat(frames)


EXPECTED = ppl.Observation.at_rate(np.dstack([PLACES, np.zeros((len(TIME), 2))]), FPS)


@pytest.mark.parametrize("table", [long, wide, levels, nodes])
def test_tables_of_other_programs_show_the_same(table: Callable[[], pd.DataFrame]) -> None:
    ahead = {"ahead": ("tail", "nose")} if table in (levels, nodes) else {}
    found = ppl.Observation.from_tracks(table(), **MADE, **ahead)
    np.testing.assert_allclose(found.positions, EXPECTED.positions, atol=1e-9)
    if ahead:
        np.testing.assert_allclose(found.angles, 0.0, atol=1e-9)
    else:
        assert np.isnan(found.angles[1:]).all()
        np.testing.assert_allclose(found.angles[0], np.arctan2([-3, 1], [1, -4]), atol=1e-9)
    assert "y turned up; 1 length = 0.05 units" in found.said
    assert ("angles of red agent, green agent: not seen" in found.said) == (not ahead)


def test_times_in_a_table_take_the_place_of_a_rate_and_headings_can_be_angles() -> None:
    table = wide().assign(time=TIME)
    found = ppl.Observation.from_tracks(table, **{**MADE, "fps": None, "angles": "heading"})
    np.testing.assert_allclose(found.positions, EXPECTED.positions, atol=1e-9)
    np.testing.assert_allclose(found.angles, np.tile(found.angles[0], (found.n_frames, 1)))
    assert "49 time stamps" in found.said


def test_short_gaps_are_bridged_and_long_ones_stay() -> None:
    table = long()
    frame = pd.to_numeric(table["FRAME"], errors="coerce")
    lost = (table["TRACK_ID"] == 1) & (frame.between(5, 7) | frame.between(20, 31))
    found = ppl.Observation.from_tracks(table[~lost], **MADE)
    unseen = np.isnan(found.positions[..., 0])
    assert not unseen[:, 1].any()
    assert np.flatnonzero(unseen[:, 0]).tolist() == list(range(10, 17))
    assert "1 gaps of up to 0.25 s put on straight lines" in found.said
    np.testing.assert_allclose(found.positions[~unseen], EXPECTED.positions[~unseen], atol=1e-9)
    none = ppl.Observation.from_tracks(table[~lost], **MADE, gap=0)
    assert np.isnan(none.positions[3, 0, 0])
    doubted = levels()
    doubted.loc[10:30, ("net", "2", slice(None), "likelihood")] = 0.2
    found = ppl.Observation.from_tracks(doubted, **MADE)
    assert np.isnan(found.positions[10, 1, 0])
    assert "42 points of a certainty below 0.6 left out" in found.said
    assert found.start[1].tolist()[:2] == [20.0, 12.0]


@pytest.mark.parametrize(("change", "message"), [
    ({"names": None}, "expected one track for each of red agent, green agent; the tracks are ['1'"),
    ({"names": {"3": "red agent"}}, "unknown track '3'"),
    ({"fps": None}, "the tracks have no times: say fps="),
    ({"units": 0}, "units=0, expected a positive"),
    ({"names": ["red agent"]}, "names=['red agent'], expected names of tracks"),
    ({"ahead": ("nose",)}, "ahead=('nose',), expected two parts"),
])  # fmt: skip
def test_what_cannot_be_is_said(change: dict[str, Any], message: str) -> None:
    with pytest.raises(PhasePPLError, match=re.escape(message)):
        ppl.Observation.from_tracks(wide(), **{**MADE, **change})
    with pytest.raises(PhasePPLError, match="expected track, frame, x and y"):
        ppl.Observation.from_tracks(pd.DataFrame({"index": [1]}), **MADE)


@pytest.mark.parametrize(("tracks", "message"), [
    (wide()[:0], "no row with a number as its frame or time"),
    (wide().assign(frame=[*range(48), 10**13]), "would take"),
    (pd.concat([wide(), wide()[["x1"]]], axis=1), "column 'x1' twice"),
    ([[[1, 2], [1]], [[1, 2], [2, 3]]], "ragged"),
    (np.ma.masked_less(PIXELS, 150), "masked in places"),
])  # fmt: skip
def test_tables_that_cannot_be_read_are_refused(tracks: Any, message: str) -> None:
    names = NAMES if isinstance(tracks, pd.DataFrame) else None
    with pytest.raises(PhasePPLError, match=message):
        ppl.Observation.from_tracks(tracks, **{**MADE, "names": names})
