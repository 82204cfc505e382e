"""``phase-ppl evaluate`` and ``compare-models``: what they print and write, and how they end."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from tests.evaluation.small import make_folder, prediction, with_posterior
from tests.evaluation.toys import FailsAt, raises, right, several, still, wrong
from tests.test_cli import Capture, fails, told

EVENTS = Path("some events.json")
OUT = Path("out put")
BOTH = ("--model", "right", "--model")
QUICK = ("--out", OUT)


@pytest.fixture(autouse=True)
def _models(own_models: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Give some models names, in a folder of its own for each test, with three events."""
    monkeypatch.chdir(tmp_path)
    ppl.save_events(several(3), EVENTS)

    def stops_once(scene: Any, observation: Any, seed: int) -> Any:
        if Path("stop").exists():
            Path("stop").unlink()
            raise KeyboardInterrupt
        return right(scene, observation, seed)

    def stops() -> Any:
        raise KeyboardInterrupt

    models: dict[str, Any] = {
        "right": lambda size=1: right,
        "wrong": lambda: wrong,
        "fails": lambda: FailsAt(4, raises),
        "broken": lambda: lambda scene, observation, seed: raises(),
        "stops": lambda: FailsAt(4, stops),
        "stops_once": lambda: stops_once,
        "any": lambda **options: right,
    }
    for name, factory in models.items():
        factory.__qualname__ = name
        ppl.register_model(name, parallel=False)(factory)


def evaluate(*arguments: object) -> int:
    return main(["evaluate", *map(str, arguments), "--workers", "1", "--quiet"])


def refused(capsys: Capture, *arguments: object) -> str:
    return fails(capsys, "evaluate", EVENTS, *arguments)


def read(name: str, folder: Path = OUT) -> Any:
    return json.loads((folder / name).read_text())


def test_it_prints_a_table_and_writes_predictions_and_metrics(
    capsys: Capture,
) -> None:
    study = Path("people.csv")
    study.write_text("participant,video,relation\np1,a,neutral\np2,a,friendly\n")
    more = ("--option", "size=3", "--judgments", study, "--out", OUT, "--limit", 1)
    assert evaluate(EVENTS, "--model", "right", *more) == 0
    printed = capsys.readouterr().out
    for words in ("right: 1 of 1 events, seed 0", f"Kept in {OUT}", f"phase-ppl report '{OUT}'"):
        assert words in printed
    assert read("metrics.json")["n_events"] == 1
    assert read("metrics.json")["people"]["relation_accuracy"]["value"] == 0.5
    assert read("settings.json")["options"] == {"size": 3}
    error = fails(capsys, "evaluate", OUT, "--model", "right")
    assert f"its events are in {OUT / 'events.json'}" in error
    assert f"{OUT} holds no posterior.nc\n" in fails(capsys, "query", OUT, "P(goal_red)")


def test_a_model_that_fails_at_every_event_is_one_error_and_others_go_on(capsys: Capture) -> None:
    error = refused(capsys, "--model", "broken", *QUICK)
    assert "'broken' failed at 3 of 3 events; event 'a': ValueError: not today" in error
    assert "--resume goes on" in error
    assert evaluate(EVENTS, "--model", "broken", *BOTH, "fails", "--out", "two") == 1
    written = capsys.readouterr()
    assert "broken: failed: a: ValueError: not today" in written.err
    words = "fails predicts 2 of 3 events (1 failed); its scores are about those"
    assert words in " ".join(written.out.split())
    assert len(read("metrics.json", Path("two", "right"))["cost"]["events"]) == 3


def test_ctrl_c_says_how_to_go_on_and_resume_does(capsys: Capture) -> None:
    Path("stop").touch()
    command = ("--model", "stops_once", "--out", OUT)
    assert evaluate(EVENTS, *command) == 130
    errors = capsys.readouterr().err
    assert "0 of 3 events are finished" in errors
    assert "--resume" in errors
    assert evaluate(EVENTS, *command, "--resume") == 0
    assert "already holds" in refused(capsys, *command)
    error = refused(capsys, "--model", "right", "--out", OUT, "--resume")
    assert error.endswith("with other settings: model is 'right', was 'stops_once'\n")


def test_asked_for_a_posterior_an_evaluation_names_one(capsys: Capture) -> None:
    folder = make_folder(OUT)
    folder.add(prediction("one"), with_posterior)
    error = fails(capsys, "diagnose", folder.path)
    assert "holds an evaluation, with one such as" in error
    named = shlex.split(error.rsplit("such as ", 1)[1])
    told(capsys, "diagnose", *named)


def test_ids_that_are_long_or_odd_have_folders_of_their_own(tmp_path: Path) -> None:
    odd = ["../../x", "a/b c", "a?b c", "x" * 300, "x" * 299 + "y"]
    ppl.save_events([still(id, shift=0.1 * i) for i, id in enumerate(odd)], "odd.json")
    assert evaluate("odd.json", "--model", "right", *QUICK) == 0
    assert list(ppl.Evaluation.load(OUT).predictions) == odd
    assert len(list(OUT.glob("events/*/prediction.json"))) == 5
    assert {entry.name for entry in tmp_path.iterdir()} == {"odd.json", str(EVENTS), str(OUT)}


# --- several models ------------------------------------------------------------------------------


def test_each_model_has_a_folder_as_if_it_were_alone_and_they_are_compared(
    capsys: Capture,
) -> None:
    assert evaluate(EVENTS, *BOTH, "other=wrong", "--out", OUT, "--limit", 2) == 0
    printed = capsys.readouterr().out
    for words in ("2 models on 2 events", "right - other", f"Kept in {OUT}"):
        assert words in printed
    for label, model in (("right", "right"), ("other", "wrong")):
        found = ppl.Evaluation.load(OUT / label)
        assert (found.name, len(found.predictions)) == (model, 2)
        assert (OUT / label / "metrics.json").is_file()
    assert ppl.ModelComparison.load(OUT).models == ["right", "other"]


def test_an_interrupted_evaluation_of_several_models_goes_on(capsys: Capture) -> None:
    both = [*BOTH, "stops_once", *QUICK]
    Path("stop").touch()
    assert evaluate(EVENTS, *both) == 130
    assert "--resume" in capsys.readouterr().err
    assert not (OUT / "comparison.json").exists()
    assert f"{OUT / 'right'} already holds an evaluation" in refused(capsys, *both)
    # that one cannot go on is said before another is asked, which would stop
    Path("stop").touch()
    others = ["--model", "stops_once", "--model", "right", "--option", "right.size=2"]
    error = refused(capsys, *others, *QUICK, "--resume")
    assert "holds an evaluation with other settings: options.size is 2, was None" in error
    Path("stop").unlink()
    assert evaluate(EVENTS, *both, "--resume") == 0
    assert ppl.ModelComparison.load(OUT).models == ["right", "stops_once"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("nowhere.json", "nowhere.json: no such file"),
        ("EVENTS --planner fast --option planner=paper", "given twice"),
        ("EVENTS --resume", "--resume needs --out"),
        ("EVENTS --model stops --against right", "--stored and --against are for several models"),
        # of several models
        ("BOTH --option wrong.size=2", "wrong"),
        ("BOTH --option right.seed=2", "seed: no option of a model"),
        ("EVENTS --model right --model right", "given twice: name them, as in --model o"),
        ("EVENTS --model ../a=right", "'../a' is no name for a folder"),
        ("BOTH --stored theirs", "stored model 'theirs'"),
        ("EVENTS --model right --model people=wrong", "called 'people', as people are"),
        ("BOTH --out single", "holds an evaluation of one model"),
    ],
)
def test_what_is_wrong_is_found_before_a_model_is_asked_and_told_in_one_line(
    arguments: str, message: str, capsys: Capture
) -> None:
    if "single" in arguments:
        assert evaluate(EVENTS, "--model", "right", "--out", "single") == 0
        capsys.readouterr()
    arguments = arguments.replace("BOTH", "EVENTS --model right --model wrong")
    given = shlex.split(arguments.replace("EVENTS", shlex.quote(str(EVENTS))))
    assert message in fails(capsys, "evaluate", *given)


def test_folders_are_compared_later_and_under_names(capsys: Capture) -> None:
    stored = {"theirs": {"relation": "neutral"}}
    ppl.save_events([still(i, shift=k, predictions=stored) for k, i in enumerate("ab")], "e.json")
    for model in ("right", "wrong"):
        assert evaluate("e.json", "--model", model, "--out", model) == 0
    compare = ["compare-models", "--resamples", 50]
    printed = told(capsys, *compare, "right", "wrong", "--stored", "all")
    assert "3 models on 2 events" in printed
    assert "Nothing was saved" in printed
    given = ["x=right", "y=wrong", "--against", "y", "--margin", 0.2, *QUICK]
    told(capsys, *compare, *given)
    kept = read("comparison.json")
    assert [one["name"] for one in kept["models"]] == ["x", "y"]
    assert kept["settings"] == {"margin": 0.2, "against": "y", "seed": 0, "resamples": 50}
    for arguments, message in (
        ("x=right wrong", "a different name for each"),
        ("right --out wrong", "--out wrong holds an evaluation"),
    ):
        assert message in fails(capsys, "compare-models", *arguments.split())
