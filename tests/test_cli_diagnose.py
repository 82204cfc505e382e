"""``phase-ppl diagnose``: a table, JSON, figures, and clear errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.cli import main
from phase_ppl.cli.results import table
from tests.analysis.factory import random_tree
from tests.analysis.test_over_time import tree_by_frame


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    out = tmp_path / "a run"
    out.mkdir()
    Posterior(tree_by_frame()).save(out / "posterior.nc")
    return out


def test_a_file_and_its_folder_print_the_same_table(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert main(["diagnose", str(folder / "posterior.nc")]) == 0
    assert capsys.readouterr().out == printed
    for word in ("accepted", "windows", "log joint", "goal red", "scenario", "verdict"):
        assert f"\n{word}" in printed
    assert max(map(len, printed.splitlines())) <= 88


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (15, 6), (4, 123)])
def test_the_table_has_at_most_88_columns(shape: tuple[int, int]) -> None:
    found = Posterior(random_tree(7, *shape)).diagnostics()
    assert max(map(len, table("an event with a long name " * 9, found).splitlines())) <= 88


def test_numbers_of_the_table_are_those_of_the_diagnostics() -> None:
    found = Posterior(random_tree(7, n_chains=8, n_draws=30)).diagnostics()
    rows = table("event", found).splitlines()
    scalar = found["scalars"]["log_joint"]
    row = next(row for row in rows if row.startswith("log joint")).split()[2:]
    assert row == [
        f"{scalar['r_hat']:.2f}",
        f"{scalar['ess_bulk']:.0f}",
        f"{scalar['ess_tail']:.0f}",
    ]
    label, entry = next(iter(found["categories"]["goal_red"].items()))
    row = next(row for row in rows if row.startswith("goal red"))
    assert label in row
    numbers = [entry["probability"], entry["share"], entry["mcse"], entry["ess"], entry["r_hat"]]
    np.testing.assert_allclose([float(x) for x in row.split()[-5:]], numbers, atol=0.5)


def test_json_is_the_diagnostics_under_the_weights_asked_for(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(folder), "--json", "--weights", "visited"]) == 0
    post = Posterior.load(folder / "posterior.nc", "visited")
    assert json.loads(capsys.readouterr().out) == post.diagnostics()


def test_figures_are_written_to_a_new_folder(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new folder"
    assert main(["diagnose", str(folder), "--out", str(out)]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["diagnostics.png", "over_time.png"]
    assert "diagnostics.png, over_time.png" in capsys.readouterr().out


def test_a_file_without_frames_has_no_figure_over_time(tmp_path: Path) -> None:
    file = Posterior(random_tree()).save(tmp_path / "old.nc")
    assert main(["diagnose", str(file), "--out", str(tmp_path / "out")]) == 0
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["diagnostics.png"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.nc"], "missing.nc: no such file"),
        (["."], ". holds no posterior.nc"),
        (["run.nc", "--weights", "counts"], "did you mean 'count'"),
        (["bad.nc"], "is no NetCDF 4 file"),
        (["run.nc", "--out", "run.nc/x"], "cannot write into folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Posterior(random_tree()).save("run.nc")
    Path("bad.nc").write_bytes(b"nothing")
    assert main(["diagnose", *arguments]) == 2
    written = capsys.readouterr()
    assert message in written.err
    assert written.err.count("\n") == 1
    assert not written.out
