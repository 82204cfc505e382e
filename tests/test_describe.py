"""The commands ``describe`` and ``export``."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest

import phase_ppl
from phase_ppl.dataset.generated import MANIFEST_SCHEMA
from tests.dataset.authors.pickles import processed
from tests.test_cli import Capture, fails, told
from tests.world.examples import make_event

pytestmark = pytest.mark.usefixtures("unpainted")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a set and its manifest."""
    path = tmp_path / "my set"
    path.mkdir()
    phase_ppl.save_events([make_event(4, "one"), make_event(5, "two")], path / "events.nc")
    known = {"split": "train", "checksum": "not looked at here"}
    entries = [{"id": "one", "family": "compete", **known}, {"id": "two", "group": "one", **known}]
    record = {"schema": MANIFEST_SCHEMA, "entries": entries, "kept": {"compete": 1}}
    record["rejected"] = {"compete": {"dull": 3}}
    (path / "manifest.json").write_text(json.dumps(record))
    return path


def test_it_prints_a_table_and_writes_card_sheet_and_figures(
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    text = told(capsys, "describe", folder, "--out", out, "--quiet")
    figures = "data_card.png, contact_sheet.png"
    for words in ("my set: 2 events, 1 without copies", "dull 3", figures):
        assert words in text
    for name in ("data_card.png", "contact_sheet.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert json.loads((out / "statistics.json").read_text())["events"] == 2


def test_json_is_all_that_is_printed_where_it_is_asked_for(
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    said = told(capsys, "describe", folder, "--json", "--out", tmp_path / "out", "--quiet")
    found = json.loads(said)
    assert found["tables"]["scenario"]["counts"]["competing"] == 2
    assert found["draws"]["compete"]["share"] == 0.25


def test_a_file_a_folder_of_files_and_a_bundled_event_are_sets_too(
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    said = told(capsys, "describe", folder / "events.nc")
    assert "events: 2 events, 2 agents of unknown strength\n" in said
    files = tmp_path / "files"
    files.mkdir()
    for name in ("b", "a"):
        phase_ppl.save_event(make_event(4, name), files / f"{name}.json")
    text = told(capsys, "describe", files, "--beside", folder)
    assert "files: 2 events" in text
    assert "my set" in text
    assert "collaborate: 1 event\n" in told(capsys, "describe", "collaborate")


@pytest.mark.parametrize(
    ("manifest", "word"), [("{", "manifest.json"), ('{"entries": 1}', "schema")]
)
def test_a_damaged_set_is_named(folder: Path, capsys: Capture, manifest: str, word: str) -> None:
    (folder / "manifest.json").write_text(manifest)
    assert word in fails(capsys, "describe", folder)


def test_what_is_no_set_is_named(tmp_path: Path, capsys: Capture) -> None:
    assert "holds no event files" in fails(capsys, "describe", tmp_path)
    assert "missing.json" in fails(capsys, "describe", tmp_path / "missing.json")


# --- export ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("to", "name"), [("json", "x.json"), ("netcdf", "x.nc"), ("phase-test", "x.json")]
)
def test_events_of_several_files_go_into_one(
    tmp_path: Path, capsys: Capture, to: str, name: str
) -> None:
    out = tmp_path / "a new folder" / name
    told(capsys, "export", "collaborate", "compete", "--to", to, "--out", out)
    assert [event.id for event in phase_ppl.load_events(out)] == ["collaborate", "compete"]


def test_a_pickle_of_the_authors_is_converted(tmp_path: Path, capsys: Capture) -> None:
    path, out = tmp_path / "Videos", tmp_path / "videos.json"
    path.write_bytes(pickle.dumps([processed(None), processed(3)]))
    arguments = ["export", path, "--to", "json", "--out", out]
    assert "phase-ppl export --from phase-pickle" in fails(capsys, *arguments)
    assert not out.exists()
    assert told(capsys, *arguments, "--from", "phase-pickle") == f"2 events written to {out}\n"
    assert len(phase_ppl.load_events(out)) == 2


def test_what_is_exported_for_the_authors_programs_can_be_read_again(
    tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "x.pkl"
    told(capsys, "export", "oppose", "--to", "phase-processed", "--out", out)
    (event,) = phase_ppl.load_events(out, format="phase-pickle")
    assert event.id == "oppose"
    assert event.truth == phase_ppl.load_event("oppose").truth


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("collaborate --to netcdf --out x.json", "expected a name in .nc"),
        ("collaborate --to csv --out x.csv", "invalid choice: 'csv'"),
        ("collaborate --out x.json", "--to"),
        ("nobody --to json --out x.json", "nobody: no such file"),
        ("collaborate collaborate --to json --out x.json", "two videos with"),
    ],
)
def test_bad_input_is_answered_in_one_line(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch, arguments: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "export", *arguments.split())
    assert not any(tmp_path.iterdir())
