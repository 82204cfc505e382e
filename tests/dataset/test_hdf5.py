"""HDF5 files on a full disk, and files that were made to do harm to whoever opens them."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl import event_dataset, event_from_dataset
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.dataset.hdf5 import read_netcdf
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.names import ENTITIES
from tests.analysis.factory import random_tree
from tests.dataset.test_events_json import assert_same
from tests.world.examples import make_event, make_trajectory

ROOT = Path(ppl.__file__).parents[1]

_FULL = """
import resource, sys
from pathlib import Path
import numpy as np
import phase_ppl as ppl
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.inference.checkpoint import write_archive
from phase_ppl.world.errors import OutputError
from tests.analysis.factory import random_tree
from tests.analysis.readings import reading

folder = Path(sys.argv[1])
event = ppl.load_event("collaborate")
read = StepwisePosterior(reading())
tree = Posterior(random_tree(1))
for room in (5000, 3):
    # what a disk does that has room for a little more
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    for name, write in {
        "tree.nc": tree.save,
        "read.nc": read.save,
        "event.nc": lambda path: ppl.save_event(event, path),
        "events.nc": lambda path: ppl.save_events([event], path),
        "run.ckpt": lambda path: write_archive(path, {}, {"a": np.zeros(10**5)}),
    }.items():
        (folder / name).write_text("old")
        try:
            write(folder / name)
        except OutputError as error:
            print(error)
"""


def test_a_full_disk_ends_no_process_and_leaves_what_was_there(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _FULL, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        # what XLA compiles could not be kept whole either
        env={**os.environ, "PYTHONPATH": str(ROOT), "JAX_ENABLE_COMPILATION_CACHE": "false"},
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 10
    assert all("cannot write" in line and "large" in line for line in lines)
    left = {path.name: path.read_text() for path in tmp_path.iterdir()}
    names = ("tree.nc", "read.nc", "event.nc", "events.nc", "run.ckpt")
    assert left == dict.fromkeys(names, "old")


# --- files that somebody else made -------------------------------------------------------------


@pytest.fixture(scope="module")
def posterior(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return Posterior(random_tree(1)).save(tmp_path_factory.mktemp("one") / "run.nc").read_bytes()


Change = Callable[[h5py.Group], object]


def _put(value: Any) -> Change:
    return lambda group: group.__setitem__("more", value)


def _array(*described: Any, **options: Any) -> Change:
    return lambda group: group.create_dataset("more", *described, **options)


def _external(group: h5py.Group) -> None:
    if "radius" in group:
        del group["radius"]
    group.create_dataset("radius", (4,), "f8", external=[("/etc/passwd", 0, 99)])


def _virtual(group: h5py.Group) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource("other.nc", "radius", (4,))
    group.create_virtual_dataset("more", layout)


def _long_text(group: h5py.Group) -> None:
    many = group.create_dataset("more", (200_000,), h5py.string_dtype())
    many[0] = "x" * 100_000


TEXT = h5py.string_dtype()
TRICKS: dict[str, tuple[Change, str]] = {
    "external": (_external, "array 'radius' lies in another file"),
    "virtual": (_virtual, "array 'more' lies in another file"),
    "link": (_put(h5py.ExternalLink("/etc/passwd", "/")), "holds a link, 'more'"),
    "soft link": (_put(h5py.SoftLink("/more")), "holds a link, 'more'"),
    "itself": (lambda group: group.__setitem__("more", group), "holds a group, 'more'"),
    "group in group": (lambda group: group.create_group("more/inner"), "holds a group, 'more'"),
    "grows": (
        _array((2**30,), "f8", chunks=(2**20,), compression=9),
        "is larger than the 512 MB",
    ),
    "large chunk": (
        _array((4,), "f8", maxshape=(None,), chunks=(2**28,), compression=9),
        "is larger than the 512 MB",
    ),
    "long text": (_long_text, "is larger than the 512 MB"),
    "sparse texts": (
        _array((10**8,), TEXT, chunks=(2**20,)),
        "has more entries than the file has bytes",
    ),
    "texts of attribute": (
        lambda group: group.attrs.create("more", ["x"] * 1000, dtype=TEXT),
        "attribute 'more' has 1000 entries",
    ),
    "empty": (_put(h5py.Empty("f8")), "array 'more' is without a shape"),
    "compound": (
        _put(np.zeros(3, [("a", "f8"), ("b", "i4")])),
        "array 'more' holds neither numbers nor texts",
    ),
}


@pytest.mark.parametrize("trick", TRICKS)
def test_a_posterior_made_to_do_harm_is_refused_unread(
    tmp_path: Path, posterior: bytes, trick: str
) -> None:
    change, message = TRICKS[trick]
    path = tmp_path / "run.nc"
    path.write_bytes(posterior)
    with h5py.File(path, "r+") as file:
        change(file["constant_data"])
    for load in (ppl.load_posterior, Posterior.load):
        with pytest.raises(InvalidEventError, match=f"run.nc: .*{message}") as raised:
            load(path)
        assert "\n" not in str(raised.value)


def test_what_a_terminal_would_obey_is_taken_out_of_a_posterior(
    tmp_path: Path, posterior: bytes
) -> None:
    path = tmp_path / "run.nc"
    path.write_bytes(posterior)
    with h5py.File(path, "r+") as file:
        del file.attrs["sha256"]
        file.attrs["event_id"] = "one\x1b[2J\x9btwo"
        file.attrs["settings"] = '{"kernel": {"name": "\\u001b[31m"}, "chains": 1}'
    post = Posterior.load(path)
    assert post.event_id == "one\ufffd[2J\ufffdtwo"
    assert post.settings["kernel"]["name"] == "\ufffd[31m"


@pytest.mark.parametrize("place", ["weights", "settings", "posterior/alpha", "a label"])
def test_a_posterior_that_is_not_what_it_was_is_refused(
    tmp_path: Path, posterior: bytes, place: str
) -> None:
    path = tmp_path / "run.nc"
    path.write_bytes(posterior)
    with h5py.File(path, "r+") as file:
        if place == "posterior/alpha":
            file[place][0, 0] += 1
        elif place == "a label":
            labels = file["observed_data/entity"]
            labels[0] = "rod agent"
        else:
            file.attrs[place] += " "
    with pytest.raises(InvalidEventError, match="its content is not what sha256 says"):
        Posterior.load(path)


def test_texts_are_read_a_few_at_a_time_and_come_back(tmp_path: Path) -> None:
    path, words = tmp_path / "texts.nc", [["a", "", "ccc"], ["dd", "é", "f"]]
    xr.Dataset({"word": (("x", "y"), np.array(words, object))}).to_netcdf(path, engine="h5netcdf")
    assert read_netcdf(path)["/"]["word"].values.tolist() == words


def test_a_file_whose_root_cannot_be_opened_is_refused_by_name(
    tmp_path: Path, posterior: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def damaged(*_: object, **__: object) -> None:
        raise KeyError("Unable to synchronously open object")

    (tmp_path / "run.nc").write_bytes(posterior)
    monkeypatch.setattr(h5py, "File", damaged)
    with pytest.raises(InvalidEventError, match=r"run\.nc: cannot be read as NetCDF"):
        ppl.load_posterior(tmp_path / "run.nc")


# --- events as Datasets ---------------------------------------------------------------------------


def test_a_dataset_has_the_trajectory_by_names_and_seconds() -> None:
    event = make_event(n_frames=13)
    dataset = event_dataset(event)
    assert dict(dataset["trajectory"].sizes) == {"time": 13, "entity": 4, "coord": 3}
    x = dataset["trajectory"].sel(entity="blue item", coord="x", time=1.0)
    assert x.item() == event.observation.trajectory[12, 2, 0]
    assert dataset["radius"].sel(entity="green agent").item() == 1.2
    assert dataset["goal_green"].item() == "Get blue item to green lm"
    assert (dataset["relation"].item(), dataset["scenario"].item()) == ("adversarial", "competing")
    assert dataset["strength_red"].item() == 300.0
    assert math.isnan(dataset["strength_green"].item())
    assert json.loads(dataset["judgments"].item()) == event.judgments
    assert dataset["event"].item() == "example"


def test_a_dataset_does_not_share_the_arrays_of_its_event() -> None:
    event = make_event()
    dataset = event_dataset(event)
    dataset["trajectory"][0, 0, 0] = 9.0
    assert event.observation.trajectory[0, 0, 0] == 8.0
    assert event_from_dataset(dataset).observation.trajectory[0, 0, 0] == 9.0


def test_dimensions_and_names_may_come_in_any_order() -> None:
    event = make_event()
    turned = event_dataset(event).transpose("xy", "coord", "end", "entity", ...)
    shuffled = turned.isel(
        entity=[2, 0, 3, 1], coord=[2, 0, 1], xy=[1, 0], landmark=[3, 1, 0, 2], bound=[3, 0, 2, 1]
    )
    assert_same(event_from_dataset(shuffled.assign(speed=("time", np.zeros(4)))), event)


def test_a_part_of_the_frames_is_an_event_too() -> None:
    part = event_dataset(make_event(n_frames=8)).isel(time=slice(3, 6))
    trajectory = event_from_dataset(part).observation.trajectory
    assert np.array_equal(trajectory, make_trajectory(8)[3:6])


def test_what_is_known_about_an_event_may_be_missing() -> None:
    known = ["goal_red", "goal_green", "relation", "scenario", "strength_red", "strength_green"]
    bare = event_dataset(make_event()).drop_vars([*known, "judgments", "predictions", "time"])
    event = event_from_dataset(bare)
    assert (event.truth, event.judgments, event.predictions) == (None, None, None)


def _dropped(*names: str) -> xr.Dataset:
    return event_dataset(make_event()).drop_vars(names)


def _with(**changes: Any) -> xr.Dataset:
    return event_dataset(make_event()).assign(changes)


WRONG: dict[str, tuple[Any, str]] = {
    "no_dataset": ({"trajectory": 3}, "{'trajectory': 3} is no xarray Dataset"),
    "no_trajectory": (_dropped("trajectory"), "has no variable trajectory"),
    "no_turning": (_dropped("turning"), "has no turning"),
    "no_id": (_dropped("event"), "has no event"),
    "no_names": (_dropped("entity"), "has no coordinate entity"),
    "dims": (_with(radius=((), 1.0)), "radius has dimensions (), expected (entity)"),
    "extra_dim": (event_dataset(make_event()).expand_dims("draw"), "trajectory has dimensions"),
    "nan": (_with(radius=("entity", [1.0, math.nan, 1.0, 1.0])), "radius[1] is nan"),
    "text": (_with(radius=("entity", ["a", "b", "c", "d"])), "scene.radius holds 'a'"),
    "outside": (_with(start=(("entity", "coord"), np.zeros((4, 3)))), "is at (0, 0)"),
    "number": (_with(turning=((), 7)), "turning is 7, expected a string"),
    "shown_time": (_with(time=np.arange(4) / 4), "time goes on by 0.25 s, expected 1/12 s"),
    "odd_time": (_with(time=["a", "b", "c", "d"]), "time holds 'a', expected numbers"),
    "json": (_with(judgments=((), "{")), "judgments: is not JSON: line 1"),
    "json_list": (_with(predictions=((), "[]")), "predictions: holds [], expected a JSON object"),
    "twice": (_with(entity=["red agent", "red agent", "x", "y"]), "has a label twice"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_dataset_that_is_no_event_is_refused(case: str) -> None:
    dataset, message = WRONG[case]
    with pytest.raises(InvalidEventError, match=re.escape(message)):
        event_from_dataset(dataset)


def test_a_strength_that_is_none_is_refused() -> None:
    with pytest.raises(InvalidSettingError, match=r"truth.strength_red=-1.0 is no positive force"):
        event_from_dataset(_with(strength_red=((), -1.0)))


@pytest.mark.parametrize(
    ("dataset", "message"),
    [
        (_with(entity=[*ENTITIES[:3], "pink ball"]), "coordinate entity 'pink ball'.*'pink item'"),
        (_with(goal_red=((), "Get blue ball to red lm")), "unknown goal 'Get blue ball"),
        (_with(turning=((), "left")), "unknown turning 'left'"),
    ],
)
def test_unknown_names_are_answered_with_those_there_are(dataset: xr.Dataset, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        event_from_dataset(dataset)
