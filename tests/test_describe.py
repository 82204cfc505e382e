"""The commands ``describe`` and ``export``."""

from __future__ import annotations

import pickle
from pathlib import Path

import pandas as pd
import pytest

import phase_ppl
from tests.data.authors.pickles import processed
from tests.models.walks import make_set
from tests.test_cli import Capture, fails, told
from tests.world.examples import make_event

pytestmark = pytest.mark.usefixtures("unpainted")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    events = [make_event(4, "one"), make_event(5, "two")]
    more = [{"family": "compete"}, {"group": "one"}]
    made = {"kept": {"compete": 1}, "rejected": {"compete": {"dull": 3}}}
    return make_set(tmp_path / "my set", events, ["train"] * 2, more, **made)


def test_it_prints_a_table_and_writes_it_with_card_and_sheet(
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    text = told(capsys, "describe", folder, "--out", out, "--quiet")
    for words in ("my set: 2 events, 1 without copies", "scenario", "data_card.png, contact_sheet"):
        assert words in text
    for name in ("data_card.png", "contact_sheet.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    found = pd.read_csv(out / "statistics.csv", index_col=["quantity", "label"])
    assert found.loc[("scenario", "competing"), "count"] == 2
    assert found.loc[("family", "compete"), "value"] == 1


def test_a_file_a_folder_of_files_and_a_bundled_event_are_sets_too(
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert "events: 2 events, 2 agents of unknown strength\n" in told(
        capsys, "describe", folder / "events.json"
    )
    files = tmp_path / "files"
    files.mkdir()
    for name in ("b", "a"):
        phase_ppl.save_event(make_event(4, name), files / f"{name}.json")
    assert "files: 2 events" in told(capsys, "describe", files)
    assert "collaborate: 1 event\n" in told(capsys, "describe", "collaborate")


def test_what_is_no_set_or_damaged_is_named(folder: Path, tmp_path: Path, capsys: Capture) -> None:
    for manifest, word in (("{", "manifest.json"), ('{"entries": 1}', "entries")):
        (folder / "manifest.json").write_text(manifest)
        assert word in fails(capsys, "describe", folder)
    assert "holds no event files" in fails(capsys, "describe", tmp_path)
    assert "missing.json" in fails(capsys, "describe", tmp_path / "missing.json")


def test_events_of_several_files_go_into_one(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "a new folder" / "x.json"
    told(capsys, "export", "collaborate", "compete", "--out", out)
    assert [event.id for event in phase_ppl.load_events(out)] == ["collaborate", "compete"]


def test_pickles_of_the_authors_are_described_and_read(tmp_path: Path, capsys: Capture) -> None:
    path, out = tmp_path / "Videos", tmp_path / "videos.json"
    path.write_bytes(pickle.dumps([processed(None), processed(3)]))
    arguments = ["export", path, "--out", out]
    assert told(capsys, *arguments) == f"2 events written to {out}\n"
    assert "Videos: 2 events\n" in told(capsys, "describe", path)
    assert len(phase_ppl.load_events(out)) == 2
