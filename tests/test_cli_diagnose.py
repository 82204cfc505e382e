"""``phase-ppl diagnose``: a table, JSON, figures, and clear errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from tests.analysis.factory import random_tree, tree_by_frame
from tests.test_cli import Capture, fails, told

pytestmark = pytest.mark.usefixtures("unpainted")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    out = tmp_path / "a run"
    out.mkdir()
    Posterior(tree_by_frame()).save(out / "posterior.nc")
    return out


def test_a_file_and_its_folder_print_the_same_table_or_json(folder: Path, capsys: Capture) -> None:
    printed = told(capsys, "diagnose", folder)
    assert told(capsys, "diagnose", folder / "posterior.nc") == printed
    for word in ("accepted", "windows", "log_joint", "goal_red", "scenario", "checks"):
        assert f"\n{word}" in printed
    said = told(capsys, "diagnose", folder, "--json", "--weights", "count")
    post = ppl.load_posterior(folder / "posterior.nc", "count")
    assert json.loads(said) == post.diagnostics()
    assert str(post.diagnostics()).startswith(f"diagnostics  {post.event_id}: ")


@pytest.mark.parametrize("shape", [(1, 1), (4, 123)])
def test_the_table_fits_88_columns(shape: tuple[int, int], tmp_path: Path, capsys: Capture) -> None:
    file = Posterior(random_tree(7, *shape)).save(tmp_path / "post.nc")
    assert max(map(len, told(capsys, "diagnose", file).splitlines())) <= 88


def test_numbers_of_the_table_are_those_of_the_diagnostics(tmp_path: Path, capsys: Capture) -> None:
    post = Posterior(random_tree(7, n_chains=8, n_draws=30))
    found = post.diagnostics()
    rows = told(capsys, "diagnose", post.save(tmp_path / "post.nc")).splitlines()
    one = found["scalars"]["log_joint"]
    row = next(row for row in rows if row.startswith("log_joint")).split()[1:]
    assert row == [f"{one['r_hat']:.2f}", f"{one['ess_bulk']:.0f}", f"{one['ess_tail']:.0f}"]
    label, entry = next(iter(found["categories"]["goal_red"].items()))
    row = next(row for row in rows if row.startswith("goal_red"))
    assert label in row
    numbers = [entry[name] for name in ("probability", "share", "mcse", "ess", "r_hat")]
    np.testing.assert_allclose([float(x) for x in row.split()[-5:]], numbers, atol=0.5)


def test_figures_are_written_to_a_new_folder(folder: Path, tmp_path: Path, capsys: Capture) -> None:
    old = Posterior(random_tree()).save(tmp_path / "old.nc")
    names = {folder: ["diagnostics.png", "over_time.png"], old: ["diagnostics.png"]}
    for source, figures in names.items():  # a file without frames has none over time
        out = tmp_path / f"new folder of {source.name}"
        assert ", ".join(figures) in told(capsys, "diagnose", source, "--out", out)
        assert sorted(p.name for p in out.iterdir()) == figures


def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    Posterior(random_tree()).save("run.nc")
    Path("bad.nc").write_bytes(b"nothing")
    for arguments, message in {
        "missing.nc": "missing.nc: no such file",
        ".": ". holds no posterior.nc",
        "run.nc --weights counts": "did you mean 'count'",
        "bad.nc": "is no NetCDF 4 file",
        "run.nc --out run.nc/x": "cannot write into folder",
    }.items():
        assert message in fails(capsys, "diagnose", *arguments.split())
