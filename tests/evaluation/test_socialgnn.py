"""SocialGNN as a model that is asked by name, and its training from a set to a folder."""

from __future__ import annotations

import importlib.util
import json
import pickle
import shutil
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation.models.socialgnn import socialgnn
from phase_ppl.evaluation.prediction import GOAL_QUESTIONS
from phase_ppl.evaluation.registry import ready
from phase_ppl.models.socialgnn.graphs import VARIANTS
from phase_ppl.models.socialgnn.store import TrainingSettings, load, shipped
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, OutputError
from phase_ppl.world.files import locked
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import RELATIONS
from tests.evaluation.toys import changed
from tests.models.walks import eight, make_set, needs_torch, walk

QUICK = TrainingSettings(epochs=3)
SPLITS = ["train"] * 5 + ["validation"] * 2 + ["test"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_set(tmp_path_factory.mktemp("set") / "events", eight(), SPLITS)


@pytest.fixture(scope="module")
def trained(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trained")
    ppl.train_socialgnn(data, out, seeds=2, settings=QUICK, progress=False)
    return out


@pytest.mark.parametrize("variant", VARIANTS)
def test_networks_come_with_the_package_and_how_they_were_made(variant: Any) -> None:
    found = shipped(variant)
    assert found.variant == variant
    assert len(found.members) == 1, "the paper's is one"
    folder = Path(ppl.__file__).parent / "models" / "socialgnn" / "weights"
    assert sum(file.stat().st_size for file in folder.glob("*.npz")) < 1_500_000
    with zipfile.ZipFile(folder / f"{variant}.npz") as packed:
        made = json.loads(packed.read("report.json"))
    assert [member["seed"] for member in made["members"]] == [0]
    assert made["settings"].items() >= vars(TrainingSettings(variant)).items()
    assert made["data"]["events"] == {"train": 320, "validation": 80, "test": 100}


@needs_torch
def test_what_is_true_of_the_bundled_events_gets_more_than_its_share() -> None:
    predict, goals, relations = socialgnn(), [], []
    for event in map(ppl.load_event, ppl.bundled_events()):
        shares, truth = predict(event.scene, event.observation, 0).probabilities, event.truth
        assert truth is not None
        goals += [
            shares[name][GOALS.index(getattr(truth, name))] for name in GOAL_QUESTIONS.values()
        ]
        relations.append(shares["relation"][RELATIONS.index(truth.relation)])
    assert np.mean(goals) > 4 / 36
    assert np.mean(relations) > 1 / 3


def test_options_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    for options, message in (
        ({"threads": 0}, "threads=0"),
        ({"variant": "other"}, "variant 'other'"),
        ({"weights": tmp_path, "variant": "original"}, "either weights or variant"),
        ({"weights": tmp_path / "no.npz"}, r"no\.npz holds no weights"),
        ({"weights": 3}, "weights=3, expected the name of a file or folder"),
    ):
        with pytest.raises(ValueError, match=message):
            socialgnn(**options)  # type: ignore[arg-type]


def test_without_torch_the_model_and_the_training_name_the_extra(
    monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "torch" else find(name)
    )
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InvalidSettingError, match=r"'socialgnn' needs torch.*phase_ppl\[neural\]"):
        ready("socialgnn", {})
    with pytest.raises(InvalidSettingError, match=r"PyTorch: pip install 'phase_ppl\[neural\]'"):
        ppl.train_socialgnn(data, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@needs_torch
def test_training_leaves_networks_a_report_and_its_curves(trained: Path) -> None:
    report = json.loads((trained / "extended.json").read_text())
    assert report["data"]["events"] == {"train": 5, "validation": 2, "test": 1}
    assert [member["seed"] for member in report["members"]] == [0, 1]
    for member in report["members"]:
        assert {len(values) for values in member["curves"].values()} == {3}
        assert set(member["accuracy"]) == {"train", "validation", "test"}
    assert set(report["together"]["train"]["goal_accuracy"]) == {"value", "ci_low", "ci_high"}


@needs_torch
def test_a_folder_that_holds_networks_is_left_alone(data: Path, trained: Path) -> None:
    with pytest.raises(OutputError, match="holds networks already"):
        ppl.train_socialgnn(data, trained, seeds=2, settings=QUICK, progress=False)
    with locked(trained), pytest.raises(OutputError, match="another process is at work"):
        ppl.train_socialgnn(data, trained, settings=QUICK)


@needs_torch
def test_the_command_trains_the_same_networks(
    data: Path, trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["train", "socialgnn", "--data", str(data), "--out", str(out), "--seeds", "2"]
    assert main([*command, "--option", "epochs=3", "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert "seed 1" in printed
    assert f"--weights {out}" in printed
    assert load(out).digest() == load(trained).digest()


@needs_torch
def test_what_was_trained_is_asked_by_its_folder(trained: Path, tmp_path: Path) -> None:
    found = ppl.evaluate(
        [walk(0, 1, 2)], "socialgnn", weights=trained, out=tmp_path, progress=False
    )
    assert found.settings["model_settings"]["networks"] == 2
    assert len(found.predictions["0-1-2-False"].probabilities) == 3
    model = socialgnn(weights=trained)
    event = walk(1, 2)
    before = model(event.scene, event.observation, 0)
    again = pickle.loads(pickle.dumps(model))(event.scene, event.observation, 7)
    for question, shares in before.probabilities.items():
        np.testing.assert_array_equal(shares, again.probabilities[question])


@needs_torch
def test_what_is_no_set_to_learn_from_is_refused(data: Path, tmp_path: Path) -> None:
    only = make_set(tmp_path / "only", eight(), ["train"] * 8)
    damaged = shutil.copytree(data, tmp_path / "damaged")
    changed(damaged / "manifest.json", plan=3)
    for folder, message in (
        (tmp_path, "holds no generated data set"),
        (only, "no events in split 'validation'"),
        (damaged, r"manifest\.json: plan is 3, not an object"),
    ):
        with pytest.raises(InvalidEventError, match=message):
            ppl.train_socialgnn(folder, tmp_path / "out")
