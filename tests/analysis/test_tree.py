"""The tree of draws: its schema, and its file."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import REQUIRED, array
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
    (tmp_path / "run.nc").write_text("something older")
    path = Posterior(tree).save(tmp_path / "run.nc")
    assert os.listdir(tmp_path) == ["run.nc"]
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
    Posterior(tree, "likelihood").save(tmp_path / "run.nc")
    assert tree.attrs["weights"] == "count"
    assert Posterior.load(tmp_path / "run.nc").weights == "likelihood"
    assert Posterior.load(tmp_path / "run.nc", "count").weights == "count"


@pytest.mark.parametrize("name", ["missing/run.nc", "file/run.nc", "folder"])
def test_a_path_that_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=name):
        Posterior(random_tree(1)).save(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def _flipped(path: Path) -> None:
    with h5py.File(path) as file:
        trajectory = file["simulated/trajectory"]
        offset = trajectory.id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[offset + 5] ^= 0xFF
    path.write_bytes(content)


def _foreign(path: Path) -> None:
    xr.Dataset({"temperature": ("city", [1.0])}).to_netcdf(path, engine="h5netcdf")


DAMAGES: dict[str, Callable[[Path], object]] = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:5000]),
    "flipped": _flipped,
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text('{"goals": []}'),
    "pickle": lambda path: path.write_bytes(pickle.dumps({"goals": []})),
    "foreign": _foreign,
    "missing": lambda path: path.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_foreign_or_missing_file_is_refused_by_name(
    tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    path = Posterior(random_tree(1)).save(tmp_path / "run.nc")
    damage(path)
    with pytest.raises(InvalidEventError, match=r"run\.nc"):
        Posterior.load(path)


def _other_codes(tree: xr.DataTree) -> xr.DataTree:
    array(tree, "simulations", "goal_red")[0] = 36
    return tree


def _other_attributes(tree: xr.DataTree, **attributes: object) -> xr.DataTree:
    attrs = {**tree.attrs, **attributes}
    tree.attrs = {name: value for name, value in attrs.items() if value is not None}
    return tree


def _without(group: str, name: str) -> Callable[[xr.DataTree], xr.DataTree]:
    return lambda tree: tree.assign({group: xr.DataTree(tree[group].to_dataset().drop_vars(name))})


def _fewer_draws(tree: xr.DataTree) -> xr.DataTree:
    return tree.assign(simulated=xr.DataTree(tree["simulated"].to_dataset().isel(draw=slice(2))))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        *((lambda tree, group=group: tree.drop_nodes(group), group) for group in REQUIRED),
        (_without("posterior", "alpha"), "'posterior'.*'alpha'"),
        (_without("simulations", "log_prior"), "'simulations'.*'log_prior'"),
        (_without("sample_stats", "step_error"), "'sample_stats'.*'step_error'"),
        (_other_codes, r"simulations/goal_red.*0\.\.35"),
        (_fewer_draws, "simulated/trajectory has shape"),
        (lambda tree: _other_attributes(tree, kernel=None), "kernel"),
        (lambda tree: _other_attributes(tree, schema="other"), "'other'"),
        (lambda tree: tree.isel(draw=slice(0)), "no draws"),
    ],
)
def test_what_is_missing_or_outside_the_schema_is_named(
    spoil: Callable[[xr.DataTree], xr.DataTree], said: str
) -> None:
    with pytest.raises(InvalidEventError, match=said):
        Posterior(spoil(random_tree(1)))
