"""Several models by one command, and their comparison in the terminal."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.cli.evaluate import models_of, options_of
from phase_ppl.evaluation import registry
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.evaluation.toys import right, several, still, wrong


@pytest.fixture(autouse=True)
def models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Register models of a few lines for a while."""
    registry.available_models()
    monkeypatch.setattr(registry.MODELS, "entries", dict(registry.MODELS.entries))

    def stops_once(scene: Any, observation: Any, seed: int) -> Any:
        if Path("stop").exists():
            Path("stop").unlink()
            raise KeyboardInterrupt
        return right(scene, observation, seed)

    def sized(size: int = 1) -> Any:
        return right

    ppl.register_model("right", parallel=False)(sized)
    ppl.register_model("wrong", parallel=False)(lambda: wrong)
    ppl.register_model("stops_once", parallel=False)(lambda: stops_once)
    ppl.register_model("any", parallel=False)(lambda **options: right)


@pytest.fixture
def events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    ppl.save_events(several(3), tmp_path / "events.json")
    return tmp_path / "events.json"


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def evaluate(*arguments: object) -> int:
    return run("evaluate", *arguments, "--quiet")


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the only line of an error with exit code 2."""
    assert run(*arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_each_model_has_a_folder_as_if_it_were_alone_and_they_are_compared(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    both = ["--model", "right", "--model", "other=wrong", "--out", out, "--limit", 2]
    (out / "pages").mkdir(parents=True)
    (out / "pages" / "0007-of_an_event_no_more_compared.html").touch()
    assert evaluate(events, *both) == 0
    printed = capsys.readouterr().out
    assert "2 models on 2 events" in printed
    assert "right - other" in printed
    assert f"Kept in {out}" in printed
    for label, model in (("right", "right"), ("other", "wrong")):
        found = ppl.Evaluation.load(out / label)
        assert (found.name, len(found.predictions)) == (model, 2)
        assert (out / label / "metrics.json").is_file()
        assert (out / label / "figures" / "accuracy.png").is_file()
        assert len(list((out / label).glob("events/*/page.html"))) == 2
    assert ppl.ModelComparison.load(out).models == ["right", "other"]
    assert (out / "figures" / "differences.png").is_file()
    assert [page.name for page in sorted((out / "pages").iterdir())] == [
        "0000-a.html", "0001-b.html",
    ]  # fmt: skip


def test_an_interrupted_evaluation_of_several_models_goes_on(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    both = ["--model", "right", "--model", "stops_once", "--out", out, "--no-figures"]
    Path("stop").touch()
    assert evaluate(events, *both) == 130
    assert "--resume" in capsys.readouterr().err
    assert not (out / "comparison.json").exists()
    error = fails(capsys, "evaluate", events, *both)
    assert f"{out / 'right'} already holds an evaluation" in error
    # that one cannot go on is said before another is asked, which would stop
    Path("stop").touch()
    others = ["--model", "stops_once", "--model", "right", "--option", "right.size=2"]
    error = fails(capsys, "evaluate", events, *others, *both[4:], "--resume")
    assert "holds an evaluation with other settings: options.size is 2, was None" in error
    Path("stop").unlink()
    assert evaluate(events, *both, "--resume") == 0
    assert ppl.ModelComparison.load(out).models == ["right", "stops_once"]


def test_plain_options_go_to_the_models_that_take_them_and_others_to_the_one_they_name() -> None:
    models = {"right": "right", "wrong": "wrong", "two": "right", "any": "any"}
    given = [("size", 2), ("two.size", 3), ("any.what", 4)]
    assert options_of(models, {}, given) == {
        "right": {"size": 2},
        "wrong": {},
        "two": {"size": 3},
        "any": {"size": 2, "what": 4},
    }
    simple = {"simple": "simple", "last_frame": "last_frame"}
    given = [("rule", "paper"), ("chains", 3), ("beta", 0.1)]
    assert options_of(simple, {"planner": "fast"}, given) == {
        "simple": {"planner": "fast", "rule": "paper", "chains": 3, "beta": 0.1},
        "last_frame": {},
    }
    assert options_of({"x": "y"}, {"a": 1}, [("b", 2), ("x.c", 3)]) == {
        "x": {"a": 1, "b": 2, "c": 3}
    }


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ([("length", 2)], InvalidSettingError, "length: none of the models right, wrong takes it"),
        ([("ritgh.size", 2)], UnknownNameError, "did you mean 'right'"),
        ([("size", 2), ("size", 3)], InvalidSettingError, "--option size: given twice"),
        ([("right.seed", 2)], InvalidSettingError, "no option of a model"),
    ],
)
def test_options_that_go_nowhere_are_refused(
    given: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        options_of({"right": "right", "wrong": "wrong"}, {}, given)


def test_labels_are_names_of_folders_and_different() -> None:
    assert models_of(None) == {"simple": "simple"}
    assert models_of(["a", "b=a"]) == {"a": "a", "b": "a"}
    with pytest.raises(InvalidSettingError, match=r"--model a is given twice.*one=a"):
        models_of(["a", "a"])
    with pytest.raises(InvalidSettingError, match="no name for a folder"):
        models_of(["../a=a"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--model right --model rigth", "'right'"),
        ("--model right --model wrong --option wrong.size=2", "wrong"),
        ("--model right --model wrong --planner fast", "planner: none of the models"),
        ("--model right --model wrong --against nobody", "model to compare with 'nobody'"),
        ("--model right --model wrong --stored theirs", "stored model 'theirs'"),
        ("--model right --model people=wrong", "called 'people', as people are"),
        ("--model right --model wrong --resume", "--resume needs --out"),
        ("--model right --stored theirs", "--stored is for several models"),
        ("--model right --model wrong --out single", "holds an evaluation of one model"),
    ],
)
def test_what_is_wrong_is_found_before_the_first_model_is_asked(
    arguments: str, message: str, events: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "single" in arguments:
        assert evaluate(events, "--model", "right", "--out", "single", "--no-figures") == 0
        capsys.readouterr()
    assert message in fails(capsys, "evaluate", events, *shlex.split(arguments))


def test_folders_are_compared_later_and_under_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    stored = {"theirs": {"relation": "neutral"}}
    ppl.save_events([still(i, shift=k, predictions=stored) for k, i in enumerate("ab")], "e.json")
    for model in ("right", "wrong"):
        assert evaluate("e.json", "--model", model, "--out", model, "--no-figures") == 0
    capsys.readouterr()
    resamples = ["--resamples", 50]
    assert run("compare-models", "right", "wrong", "--stored", "all", *resamples) == 0
    printed = capsys.readouterr().out
    assert "3 models on 2 events" in printed
    assert "Nothing was saved" in printed
    given = ["x=right", "y=wrong", "--against", "y", "--margin", 0.2, "--out", "c", "--no-figures"]
    assert run("compare-models", *given, *resamples) == 0
    kept = json.loads((tmp_path / "c" / "comparison.json").read_text())
    assert [one["name"] for one in kept["models"]] == ["x", "y"]
    assert kept["settings"] == {"margin": 0.2, "against": "y", "seed": 0, "resamples": 50}
    for arguments, message in (
        ("x=right wrong", "a different name for each"),
        ("x=right =wrong", "a different name for each"),
        ("right --margin 2", "margin=2.0"),
        ("nowhere", "nowhere: no such folder"),
        ("right --out wrong", "--out wrong holds an evaluation"),
        ("right --stored thiers", "'theirs'"),
    ):
        assert message in fails(capsys, "compare-models", *arguments.split())


def test_a_failing_event_is_told_by_the_exit_code(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails_at_four(scene: Any, observation: Any, seed: int) -> Any:
        if observation.n_frames == 4:
            raise ValueError("not today")
        return right(scene, observation, seed)

    ppl.register_model("fails", parallel=False)(lambda: fails_at_four)
    out = tmp_path / "out"
    args = ["--model", "right", "--model", "fails", "--out", out, "--no-figures"]
    assert evaluate(events, *args) == 1
    written = capsys.readouterr()
    assert "fails: failed: b: ValueError: not today" in written.err
    words = "fails predicts 2 of 3 events (1 failed); its scores are about those"
    assert words in " ".join(written.out.split())
