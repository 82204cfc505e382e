"""``phase-ppl export``."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

import phase_ppl
from phase_ppl.cli import main
from tests.dataset.authors.pickles import processed
from tests.test_cli import fails


@pytest.mark.parametrize(
    ("to", "name"), [("json", "x.json"), ("netcdf", "x.nc"), ("phase-test", "x.json")]
)
def test_events_of_several_files_go_into_one(tmp_path: Path, to: str, name: str) -> None:
    out = tmp_path / "a new folder" / name
    assert main(["export", "collaborate", "compete", "--to", to, "--out", str(out)]) == 0
    assert [event.id for event in phase_ppl.load_events(out)] == ["collaborate", "compete"]


def test_a_pickle_of_the_authors_is_converted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "export", *arguments)
    assert not any(tmp_path.iterdir())
