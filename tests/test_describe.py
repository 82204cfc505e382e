"""The commands ``describe`` and ``export``."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest

import phase_ppl
from phase_ppl.cli import main
from phase_ppl.dataset.generated import MANIFEST_SCHEMA
from tests.dataset.authors.pickles import processed
from tests.test_cli import Capture, fails
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
    record = {
        "schema": MANIFEST_SCHEMA,
        "entries": entries,
        "kept": {"compete": 1},
        "rejected": {"compete": {"dull": 3}},
    }
    (path / "manifest.json").write_text(json.dumps(record))
    return path


def test_it_prints_a_table_and_writes_card_sheet_and_figures(
    folder: Path, tmp_path: Path, capsys: Capture
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
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = ["--out", str(tmp_path / "out"), "--quiet"]
    assert main(["describe", str(folder), "--json", *out]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["tables"]["scenario"]["counts"]["competing"] == 2
    assert found["draws"]["compete"]["share"] == 0.25


def test_a_file_a_folder_of_files_and_a_bundled_event_are_sets_too(
    folder: Path, tmp_path: Path, capsys: Capture
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
def test_a_damaged_set_is_named(folder: Path, capsys: Capture, manifest: str, word: str) -> None:
    (folder / "manifest.json").write_text(manifest)
    assert word in fails(capsys, "describe", str(folder))


def test_what_is_no_set_is_named(tmp_path: Path, capsys: Capture) -> None:
    assert "holds no event files" in fails(capsys, "describe", str(tmp_path))
    assert "missing.json" in fails(capsys, "describe", str(tmp_path / "missing.json"))


# --- export ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("to", "name"), [("json", "x.json"), ("netcdf", "x.nc"), ("phase-test", "x.json")]
)
def test_events_of_several_files_go_into_one(tmp_path: Path, to: str, name: str) -> None:
    out = tmp_path / "a new folder" / name
    assert main(["export", "collaborate", "compete", "--to", to, "--out", str(out)]) == 0
    assert [event.id for event in phase_ppl.load_events(out)] == ["collaborate", "compete"]


def test_a_pickle_of_the_authors_is_converted(tmp_path: Path, capsys: Capture) -> None:
    path, out = tmp_path / "Videos", tmp_path / "videos.json"
    path.write_bytes(pickle.dumps([processed(None), processed(3)]))
    arguments = ["export", str(path), "--to", "json", "--out", str(out)]
    assert "phase-ppl export --from phase-pickle" in fails(capsys, *arguments)
    assert not out.exists()
    assert main([*arguments, "--from", "phase-pickle"]) == 0
    assert capsys.readouterr().out == f"2 events written to {out}\n"
    assert len(phase_ppl.load_events(out)) == 2


def test_what_is_exported_for_the_authors_programs_can_be_read_again(tmp_path: Path) -> None:
    out = tmp_path / "x.pkl"
    assert main(["export", "oppose", "--to", "phase-processed", "--out", str(out)]) == 0
    (event,) = phase_ppl.load_events(out, format="phase-pickle")
    assert event.id == "oppose"
    assert event.truth == phase_ppl.load_event("oppose").truth


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["collaborate", "--to", "netcdf", "--out", "x.json"], "expected a name in .nc"),
        (["collaborate", "--to", "csv", "--out", "x.csv"], "invalid choice: 'csv'"),
        (["collaborate", "--out", "x.json"], "--to"),
        (["nobody", "--to", "json", "--out", "x.json"], "nobody: no such file"),
        (["collaborate", "collaborate", "--to", "json", "--out", "x.json"], "two videos with"),
    ],
)
def test_bad_input_is_answered_in_one_line(
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "export", *arguments)
    assert not any(tmp_path.iterdir())
