"""The command describe."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import phase_ppl
from phase_ppl.cli import main
from phase_ppl.dataset.generated import MANIFEST_SCHEMA
from tests.world.examples import make_event


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a set and its manifest."""
    path = tmp_path / "my set"
    path.mkdir()
    phase_ppl.save_events([make_event(4, "one"), make_event(5, "two")], path / "events.nc")
    known = {"split": "train", "checksum": "not looked at here"}
    entries = [{"id": "one", "family": "compete", **known}, {"id": "two", "group": "one", **known}]
    record = {
        "schema": MANIFEST_SCHEMA,
        "entries": entries,
        "kept": {"compete": 1},
        "rejected": {"compete": {"dull": 3}},
    }
    (path / "manifest.json").write_text(json.dumps(record))
    return path


def test_it_prints_a_table_and_writes_card_sheet_and_figures(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["describe", str(folder), "--out", str(out), "--quiet"]) == 0
    text = capsys.readouterr().out
    assert "my set: 2 events, 1 without copies" in text
    assert "dull 3" in text
    assert "data_card.png, contact_sheet.png" in text
    for name in ("data_card.png", "contact_sheet.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert json.loads((out / "statistics.json").read_text())["events"] == 2


def test_json_is_all_that_is_printed_where_it_is_asked_for(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "out"), "--quiet"]
    assert main(["describe", str(folder), "--json", *out]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["tables"]["scenario"]["counts"]["competing"] == 2
    assert found["draws"]["compete"]["share"] == 0.25


def test_a_file_a_folder_of_files_and_a_bundled_event_are_sets_too(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["describe", str(folder / "events.nc")]) == 0
    assert "events: 2 events, 2 agents of unknown strength\n" in capsys.readouterr().out
    files = tmp_path / "files"
    files.mkdir()
    for name in ("b", "a"):
        phase_ppl.save_event(make_event(4, name), files / f"{name}.json")
    assert main(["describe", str(files), "--beside", str(folder)]) == 0
    text = capsys.readouterr().out
    assert "files: 2 events" in text
    assert "my set" in text
    assert main(["describe", "collaborate"]) == 0
    assert "collaborate: 1 event\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("manifest", "word"), [("{", "manifest.json"), ('{"entries": 1}', "schema")]
)
def test_a_damaged_set_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str], manifest: str, word: str
) -> None:
    (folder / "manifest.json").write_text(manifest)
    assert main(["describe", str(folder)]) == 2
    error = capsys.readouterr().err
    assert word in error
    assert error.count("\n") == 1


def test_what_is_no_set_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["describe", str(tmp_path)]) == 2
    assert "holds no event files" in capsys.readouterr().err
    assert main(["describe", str(tmp_path / "missing.json")]) == 2
    assert "missing.json" in capsys.readouterr().err
