"""The tree of draws: its schema, and its file."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import REQUIRED, array, check_tree
from phase_ppl.world.errors import InvalidEventError, OutputError
from phase_ppl.world.scene import Scene

from .factory import Simulation, default_scene, hypothesis, make_tree, random_tree


def assert_same_bits(one: xr.DataTree, other: xr.DataTree) -> None:
    assert [node.path for node in one.subtree] == [node.path for node in other.subtree]
    for node in one.subtree:
        twin = other[node.path]
        assert node.attrs == twin.attrs
        assert {k: type(v) for k, v in node.attrs.items()} == {
            k: type(v) for k, v in twin.attrs.items()
        }
        assert set(node.variables) == set(twin.variables)
        for name, variable in node.variables.items():
            same = twin.variables[name]
            assert variable.dims == same.dims
            assert variable.dtype == same.dtype
            assert variable.values.tobytes() == same.values.tobytes(), f"{node.path}/{name}"
            assert set(variable.attrs) == set(same.attrs)


def test_file_gives_back_the_tree_bit_for_bit(tmp_path: Path) -> None:
    tree = random_tree(1)
    array(tree, "simulations", "log_likelihood")[2] = -np.inf
    array(tree, "sample_stats", "step_error")[0, 0, 3] = np.nan
    tree.attrs["burn_in"] = 1
    path = Posterior(tree).save(tmp_path / "run.nc")
    again = Posterior.load(path)
    assert again.burn_in == 1
    assert_same_bits(tree, again.tree)
    assert again.summary() == Posterior(tree).summary()
    again.save(tmp_path / "copy.nc")
    assert_same_bits(tree, Posterior.load(tmp_path / "copy.nc").tree)


def test_a_scene_without_inner_walls_survives_the_file(tmp_path: Path) -> None:
    scene = Scene(default_scene().start, default_scene().radius)
    tree = make_tree([Simulation(hypothesis())], [[0]], scene=scene)
    tree.attrs["burn_in"] = 0
    Posterior(tree).save(tmp_path / "run.nc")
    again = Posterior.load(tmp_path / "run.nc").tree
    assert again["constant_data"]["walls"].shape == (0, 2, 2)
    assert_same_bits(tree, again)


def test_saving_records_the_weights_in_use_and_leaves_the_tree_alone(tmp_path: Path) -> None:
    tree = random_tree(1)
    Posterior(tree, "visited").save(tmp_path / "run.nc")
    assert tree.attrs["weights"] == "count"
    assert Posterior.load(tmp_path / "run.nc").weights == "visited"
    assert Posterior.load(tmp_path / "run.nc", "count").weights == "count"


def test_saving_replaces_a_file_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "run.nc"
    path.write_text("something older")
    Posterior(random_tree(1)).save(path)
    assert Posterior.load(path).event_id == "made-up"
    assert os.listdir(tmp_path) == ["run.nc"]


def test_a_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Posterior(random_tree(1)).save(tmp_path / "run.nc")
    before = path.read_bytes()

    def disk_full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", disk_full)
    with pytest.raises(OutputError, match="No space left"):
        Posterior(random_tree(2)).save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.nc"]


@pytest.mark.parametrize("name", ["missing/run.nc", "file/run.nc", "folder"])
def test_a_path_that_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=name):
        Posterior(random_tree(1)).save(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def _truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])


def _flipped(path: Path) -> None:
    with h5py.File(path) as file:
        trajectory = file["simulated/trajectory"]
        offset = trajectory.id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 5] ^= 0xFF
    path.write_bytes(content)


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _text(path: Path) -> None:
    path.write_text('{"goals": []}')


def _pickle(path: Path) -> None:
    path.write_bytes(pickle.dumps({"goals": []}))


def _foreign(path: Path) -> None:
    xr.Dataset({"temperature": ("city", [1.0])}).to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize("damage", [_truncated, _flipped, _empty, _text, _pickle, _foreign])
def test_a_damaged_or_foreign_file_is_refused_by_name(tmp_path: Path, damage) -> None:  # type: ignore[no-untyped-def]
    path = Posterior(random_tree(1)).save(tmp_path / "run.nc")
    damage(path)
    with pytest.raises(InvalidEventError, match=r"run\.nc"):
        Posterior.load(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidEventError, match=r"none\.nc: no such file"):
        Posterior.load(tmp_path / "none.nc")


@pytest.mark.parametrize("group", list(REQUIRED))
def test_a_missing_group_is_named(group: str) -> None:
    tree = random_tree(1)
    del tree[group]
    with pytest.raises(InvalidEventError, match=group):
        check_tree(tree)


@pytest.mark.parametrize(
    ("group", "name"),
    [("posterior", "alpha"), ("simulations", "log_prior"), ("sample_stats", "step_error")],
)
def test_a_missing_variable_is_named(group: str, name: str) -> None:
    tree = random_tree(1)
    tree[group] = xr.DataTree(tree[group].to_dataset().drop_vars(name))
    with pytest.raises(InvalidEventError, match=rf"'{group}'.*'{name}'"):
        Posterior(tree)


def test_codes_shapes_and_attributes_outside_the_schema_are_named() -> None:
    tree = random_tree(1)
    array(tree, "simulations", "goal_red")[0] = 36
    with pytest.raises(InvalidEventError, match=r"simulations/goal_red.*0\.\.35"):
        Posterior(tree)
    tree = random_tree(1)
    tree["simulated"] = xr.DataTree(tree["simulated"].to_dataset().isel(draw=slice(2)))
    with pytest.raises(InvalidEventError, match="simulated/trajectory has shape"):
        Posterior(tree)
    tree = random_tree(1)
    del tree.attrs["kernel"]
    with pytest.raises(InvalidEventError, match="kernel"):
        Posterior(tree)
    tree = random_tree(1)
    tree.attrs["schema"] = "other"
    with pytest.raises(InvalidEventError, match="'other'"):
        Posterior(tree)


def test_a_run_without_draws_is_refused() -> None:
    with pytest.raises(InvalidEventError, match="no draws"):
        Posterior(random_tree(1, n_draws=0))
