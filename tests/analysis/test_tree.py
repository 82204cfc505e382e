"""The tree of draws: its schema, and its file."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.tree import REQUIRED, array
from phase_ppl.world.errors import InvalidEventError, OutputError
from phase_ppl.world.scene import Scene

from .factory import default_scene, random_tree


def assert_same_bits(one: xr.DataTree, other: xr.DataTree) -> None:
    assert [node.path for node in one.subtree] == [node.path for node in other.subtree]
    for node in one.subtree:
        twin = other[node.path]
        assert node.attrs == twin.attrs
        assert [type(v) for v in node.attrs.values()] == [type(twin.attrs[k]) for k in node.attrs]
        assert set(node.variables) == set(twin.variables)
        for name, variable in node.variables.items():
            same = twin.variables[name]
            assert variable.dims == same.dims
            assert variable.dtype == same.dtype
            assert variable.values.tobytes() == same.values.tobytes(), f"{node.path}/{name}"
            assert set(variable.attrs) == set(same.attrs)


@pytest.mark.parametrize("walls", [True, False])
def test_file_gives_back_the_tree_bit_for_bit(tmp_path: Path, walls: bool) -> None:
    scene = default_scene()
    tree = random_tree(1, scene=scene if walls else Scene(scene.start, scene.radius))
    array(tree, "simulations", "log_likelihood")[2] = -np.inf
    array(tree, "sample_stats", "step_error")[0, 0, 3] = np.nan
    tree.attrs["burn_in"] = 1
    (tmp_path / "run.nc").write_text("something older")
    path = Posterior(tree).save(tmp_path / "run.nc")
    assert os.listdir(tmp_path) == ["run.nc"]
    again = ppl.load_posterior(path)
    assert again.burn_in == 1
    assert again.summary() == Posterior(tree).summary()
    assert again.tree["constant_data"]["walls"].shape == (int(walls), 2, 2)
    assert_same_bits(tree, again.tree)


def test_a_path_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for name in ("missing/run.nc", "file/run.nc", "folder"):
        with pytest.raises(OutputError, match=name):
            Posterior(random_tree(1)).save(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


FOREIGN = xr.Dataset({"temperature": ("city", [1.0])})
DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text('{"goals": []}'),
    "pickle": lambda path: path.write_bytes(pickle.dumps({"goals": []})),
    "foreign": lambda path: FOREIGN.to_netcdf(path, engine="h5netcdf"),
    "missing": lambda path: path.unlink(),
}


def test_a_damaged_foreign_or_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    path = Posterior(random_tree(1)).save(tmp_path / "run.nc")
    content = path.read_bytes()
    for damage in DAMAGES.values():
        path.write_bytes(content)
        damage(path)
        with pytest.raises(InvalidEventError, match=r"run\.nc"):
            ppl.load_posterior(path)


def _other_codes(tree: xr.DataTree) -> xr.DataTree:
    array(tree, "simulations", "goal_red")[0] = 36
    return tree


def _changed(group: str, change: Callable[[xr.Dataset], xr.Dataset]) -> Any:
    return lambda tree: tree.assign({group: xr.DataTree(change(tree[group].to_dataset()))})


def test_what_is_missing_or_outside_the_schema_is_named() -> None:
    cases: tuple[tuple[Callable[[xr.DataTree], xr.DataTree], str], ...] = (
        *((lambda tree, group=group: tree.drop_nodes(group), group) for group in REQUIRED),
        (_changed("posterior", lambda found: found.drop_vars("alpha")), "'posterior'.*'alpha'"),
        (_changed("simulations", lambda found: found.drop_vars("log_prior")), "'log_prior'"),
        (_changed("sample_stats", lambda found: found.drop_vars("step_error")), "'step_error'"),
        (_changed("simulated", lambda found: found.isel(draw=slice(2))), "trajectory has shape"),
        (_other_codes, r"simulations/goal_red.*0\.\.35"),
        (lambda tree: tree.attrs.update(schema="other") or tree, "'other'"),
        (lambda tree: tree.attrs.pop("kernel") and tree, "kernel"),
        (lambda tree: tree.isel(draw=slice(0)), "no draws"),
    )
    for spoil, said in cases:
        with pytest.raises(InvalidEventError, match=said):
            Posterior(spoil(random_tree(1)))
