"""Pictures of whole sets, and their videos."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phase_ppl.render import contact_sheet, videos
from phase_ppl.render.stills import SCENARIO_COLOURS, THUMBNAIL, UNKNOWN_COLOUR, thumbnail
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, OutputError
from phase_ppl.world.event import Event, Observation
from tests.world.examples import make_event, make_scene, make_trajectory


def named(*ids: str) -> list[Event]:
    return [make_event(2, id) for id in ids]


def colours(path: Path) -> set[tuple[int, int, int]]:
    with Image.open(path) as picture:
        found = picture.convert("RGB").getcolors(2**24)
    return {colour for _, colour in found}  # type: ignore[misc, union-attr]


def test_a_thumbnail_shows_start_way_and_end() -> None:
    trajectory = np.repeat(make_trajectory(1), 3, axis=0)
    trajectory[:, 3, 0] = 20.0
    trajectory[:, 3, 1] = 8.0, 13.0, 18.0
    picture = np.asarray(thumbnail(Event(make_scene(walls=[]), Observation(trajectory)), 400))

    def at(x: float, y: float) -> list[int]:
        scale = 400 / (480 - 2 * 36) * 20
        row, column = 200 - (y - 12) * scale, 200 + (x - 16) * scale
        return picture[int(row), int(column)].astype(int).tolist()

    assert at(20, 18) == [255, 153, 153]
    faint = at(20.8, 8)
    assert 180 < faint[1] < 250
    assert at(20, 13) != [255, 255, 255]
    assert at(22.5, 13) == [255, 255, 255]


def test_a_sheet_has_a_thumbnail_and_a_colour_for_each_event(tmp_path: Path) -> None:
    one = make_event(2, "one")  # competing
    unknown = dataclasses.replace(one, id="two " * 30, truth=None)
    (file,) = contact_sheet([one, unknown], tmp_path / "sheet.png", columns=2)
    assert {SCENARIO_COLOURS["competing"], UNKNOWN_COLOUR} <= colours(file)
    assert SCENARIO_COLOURS["opposing"] not in colours(file)
    with Image.open(file) as picture:
        assert 2 * THUMBNAIL < picture.width < 2.5 * THUMBNAIL
        with_words = picture.height
    contact_sheet([one, unknown], tmp_path / "sheet.png", columns=1, captions=False)
    assert UNKNOWN_COLOUR not in colours(file)
    with Image.open(file) as picture:
        assert THUMBNAIL < picture.width < 1.5 * THUMBNAIL
        assert 2 * THUMBNAIL < picture.height < with_words + THUMBNAIL


def test_a_large_set_is_spread_over_pages(tmp_path: Path) -> None:
    ids = [str(n) for n in range(5)]
    files = contact_sheet(named(*ids), tmp_path / "a sheet.png", per_page=2, columns=9)
    assert [file.name for file in files] == ["a sheet-1.png", "a sheet-2.png", "a sheet-3.png"]
    assert sorted(file.name for file in tmp_path.iterdir()) == [file.name for file in files]
    sizes = set()
    for file in files:
        with Image.open(file) as picture:
            sizes.add(picture.size)
    assert len(sizes) == 1


def test_by_default_a_sheet_is_about_square(tmp_path: Path) -> None:
    (file,) = contact_sheet(named(*"abcdefghi"), tmp_path / "sheet.png", progress=False)
    with Image.open(file) as picture:
        assert 0.75 < picture.width / picture.height < 1


def test_sheets_that_cannot_be_made_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidEventError, match="no events"):
        contact_sheet([], tmp_path / "sheet.png")
    for setting in ("columns", "per_page"):
        with pytest.raises(InvalidSettingError, match=f"{setting}=0"):
            contact_sheet(named("a"), tmp_path / "sheet.png", **{setting: 0})  # type: ignore[arg-type]
    with pytest.raises(OutputError, match=r"sheet\.gif"):
        contact_sheet(named("a"), tmp_path / "sheet.gif")
    assert not list(tmp_path.iterdir())


# --- videos ------------------------------------------------------------------------------------


def test_every_event_gets_a_video_and_none_is_made_twice(tmp_path: Path) -> None:
    folder = tmp_path / "the films"
    files = videos(named("a", "b"), folder, workers=2)
    assert [file.name for file in files] == ["a.mp4", "b.mp4"]
    assert all(file.stat().st_size > 1000 for file in files)
    os.utime(files[0], (1, 1))
    files[1].unlink()
    assert videos(named("a", "b"), folder, workers=1) == files
    assert files[0].stat().st_mtime == 1
    assert sorted(folder.iterdir()) == files


def test_ids_that_are_no_file_names_get_one_each(tmp_path: Path) -> None:
    ids = ("../up", "a/b", "a b", "A", "a", "x" * 300, ".hidden")
    files = videos(named(*ids), tmp_path, workers=1)
    assert len({file.name.lower() for file in files}) == len(ids)
    assert sorted(files) == sorted(tmp_path.iterdir())


def test_two_videos_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidEventError, match="'a'"):
        videos(named("a", "b", "a"), tmp_path)
    with pytest.raises(InvalidSettingError, match="workers"):
        videos(named("a"), tmp_path, workers=0)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        videos(named("a"), tmp_path / "file")
