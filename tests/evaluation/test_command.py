"""``phase-ppl evaluate`` and ``compare-models``: what they print and write, and how they end."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.cli.evaluate import options_of
from phase_ppl.evaluation import figures, report
from tests.evaluation.small import make_folder, prediction, with_posterior
from tests.evaluation.toys import FailsAt, raises, right, several, still, wrong
from tests.test_cli import Capture, fails, told

pytestmark = pytest.mark.usefixtures("unpainted")


@pytest.fixture(autouse=True)
def _models(own_models: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Give some models names, in a folder of its own for each test."""
    monkeypatch.chdir(tmp_path)

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
        "stops": lambda: FailsAt(4, stops),
        "stops_once": lambda: stops_once,
        "any": lambda **options: right,
    }
    for name, factory in models.items():
        factory.__qualname__ = name
        ppl.register_model(name, parallel=False)(factory)


@pytest.fixture
def events(tmp_path: Path) -> Path:
    path = tmp_path / "some events.json"
    ppl.save_events(several(3), path)
    return path


def evaluate(*arguments: object) -> int:
    return main(["evaluate", *map(str, arguments), "--workers", "1", "--quiet"])


BOTH = ("--model", "right", "--model")


def test_it_prints_a_table_and_writes_predictions_metrics_figures_and_pages(
    events: Path, capsys: Capture
) -> None:
    out = Path("out put")
    assert evaluate(events, "--model", "last_frame", "--out", out, "--limit", 1) == 0
    printed = capsys.readouterr().out
    assert "last_frame: 1 of 1 events, seed 0" in printed
    assert f"Kept in {out}" in printed
    assert json.loads((out / "metrics.json").read_text())["n_events"] == 1
    assert (out / "figures" / "accuracy.png").stat().st_size > 1000
    assert len(list(out.glob("events/*/page.html"))) == 1


def test_there_is_a_bar_only_where_it_is_asked_for_and_without_a_folder_nothing_is_kept(
    events: Path, capsys: Capture
) -> None:
    command = ["evaluate", str(events), "--model", "right", "--workers", "1"]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "Nothing was saved" in printed.out
    assert main([*command, "--progress"]) == 0
    assert "predicting" in capsys.readouterr().err


def test_a_failing_event_is_told_by_the_exit_code(events: Path, capsys: Capture) -> None:
    out = Path("out")
    assert evaluate(events, "--model", "fails", "--out", out, "--no-figures") == 1
    assert "failed: b: ValueError: not today" in capsys.readouterr().out
    assert not (out / "figures").exists()
    assert evaluate(events, *BOTH, "fails", "--out", "two", "--no-figures") == 1
    written = capsys.readouterr()
    assert "fails: failed: b: ValueError: not today" in written.err
    words = "fails predicts 2 of 3 events (1 failed); its scores are about those"
    assert words in " ".join(written.out.split())


def test_a_failing_figure_costs_no_results(
    events: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(folder: Any, *given: Any, **more: Any) -> Any:
        raise RuntimeError("no ink")

    monkeypatch.setattr(figures, "draw_figures", broken)
    monkeypatch.setattr(report, "page_of", broken)
    out = Path("out")
    assert evaluate(events, "--model", "right", "--out", out) == 1
    written = capsys.readouterr()
    assert "the figures cannot be drawn: no ink" in written.err
    assert "the page of b cannot be drawn: no ink" in written.err
    assert "goals right" in written.out
    assert (out / "metrics.json").exists()


def test_ctrl_c_says_how_to_go_on_and_resume_does(events: Path, capsys: Capture) -> None:
    out = Path("out")
    assert evaluate(events, "--model", "stops", "--out", out) == 130
    errors = capsys.readouterr().err
    assert "1 of 3 events are finished" in errors
    assert "--resume" in errors
    assert "already holds" in fails(capsys, "evaluate", events, "--model", "stops", "--out", out)
    other = fails(capsys, "evaluate", events, "--model", "right", "--out", out, "--resume")
    assert other.endswith("with other settings: model is 'right', was 'stops'\n")
    assert evaluate(events, "--model", "stops", "--out", out, "--resume") == 130


def test_against_compares_with_another_folder_also_later(events: Path, capsys: Capture) -> None:
    one, other = Path("one"), Path("other")
    assert evaluate(events, "--model", "wrong", "--out", other, "--no-figures") == 0
    now = (events, "--model", "right", "--out", one, "--no-figures", "--against", other)
    later = ("--out", other, "--against", one)
    for given, said, folder, value in (
        (now, "right minus wrong: on the 3 events", one, 1),
        (later, "wrong minus right", other, -1),
    ):
        assert evaluate(*given) == 0
        assert said in capsys.readouterr().out
        kept = json.loads((folder / "against.json").read_text())
        assert kept["relation_accuracy"]["value"] == value


def test_what_cannot_be_compared_with_is_refused_before_the_work(
    events: Path, capsys: Capture
) -> None:
    Path("empty").mkdir()
    ppl.save_events([still("x", predictions={"theirs": {"relation": "neutral"}})], "x.json")
    assert evaluate("x.json", "--model", "wrong", "--out", "other", "--no-figures") == 0
    capsys.readouterr()
    for given, against, message in (
        (events, "empty", "holds no evaluation"),
        (events, "other", "wrong predicts none of the 3 events"),
        ("x.json", "thiers", "thiers: no such folder, and no reference model (theirs)"),
    ):
        command = ["evaluate", given, "--model", "stops", "--against", against, "--out", "out"]
        assert message in fails(capsys, *command)
        assert not Path("out").exists()


def test_a_finished_evaluation_leads_to_its_report_and_is_no_folder_of_events(
    events: Path, capsys: Capture
) -> None:
    out = Path("out put")
    assert evaluate(events, "--model", "right", "--out", out, "--no-figures") == 0
    assert f"phase-ppl report '{out}'" in capsys.readouterr().out
    error = fails(capsys, "evaluate", out, "--model", "right")
    assert f"its events are in {out / 'events.json'}" in error
    assert f"{out} holds no posterior.nc\n" in fails(capsys, "query", out, "P(goal_red)")


def test_asked_for_a_posterior_an_evaluation_names_one(capsys: Capture) -> None:
    folder = make_folder(Path("out"))
    folder.add(prediction("one"), with_posterior)
    error = fails(capsys, "diagnose", folder.path)
    assert "holds an evaluation, with one such as" in error
    told(capsys, "diagnose", error.rsplit("such as ", 1)[1].strip())


def test_options_and_judgments_reach_the_evaluation(events: Path) -> None:
    study, out = Path("people.csv"), Path("out")
    study.write_text("participant,video,relation\np1,a,neutral\np2,a,friendly\n")
    given = ["--option", "size=3", "--judgments", study, "--out", out, "--no-figures"]
    assert evaluate(events, "--model", "right", *given) == 0
    assert json.loads((out / "settings.json").read_text())["options"] == {"size": 3}
    people = json.loads((out / "metrics.json").read_text())["people"]
    assert people["relation_accuracy"]["value"] == 0.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("nowhere.json", "nowhere.json: no such file"),
        ("", "EVENTS is missing"),
        ("--out nowhere --resume", "EVENTS is missing"),
        ("--out nowhere", "nowhere holds no evaluation"),
        ("--out nowhere --limit 2 --seed 0", "EVENTS is missing with --limit, --seed"),
        ("collaborate --model last_fram", "'last_frame'"),
        ("collaborate --model last_frame --planner fast", "planner"),
        ("collaborate --model right --option seed=3", "seed: no option of a model"),
        ("collaborate --planner fast --option planner=paper", "given twice"),
        ("collaborate --option size", "NAME=VALUE"),
        ("collaborate --resume", "--resume needs --out"),
        ("collaborate --limit 0", "at least 1"),
        ("collaborate --model right --judgments nowhere.csv", "nowhere.csv: no such file"),
        ("collaborate --model right --against nowhere", "nowhere: no such folder"),
    ],
)
def test_bad_input_ends_with_one_line(arguments: str, message: str, capsys: Capture) -> None:
    assert message in fails(capsys, "evaluate", *shlex.split(arguments))


def test_ids_that_are_long_or_odd_have_folders_of_their_own(tmp_path: Path) -> None:
    odd = ["../../x", "a/b c", "a?b c", "x" * 300, "x" * 299 + "y"]
    path, out = Path("odd.json"), Path("out")
    ppl.save_events([still(id, shift=0.1 * i) for i, id in enumerate(odd)], path)
    assert evaluate(path, "--model", "right", "--out", out, "--no-figures") == 0
    assert list(ppl.Evaluation.load(out).predictions) == odd
    assert len(list(out.glob("events/*/prediction.json"))) == 5
    assert {entry.name for entry in tmp_path.iterdir()} == {"odd.json", "out"}


# --- several models ------------------------------------------------------------------------------


def test_each_model_has_a_folder_as_if_it_were_alone_and_they_are_compared(
    events: Path, capsys: Capture
) -> None:
    out = Path("out")
    both = [*BOTH, "other=wrong", "--out", out, "--limit", 2]
    (out / "pages").mkdir(parents=True)
    (out / "pages" / "0007-of_an_event_no_more_compared.html").touch()
    assert evaluate(events, *both) == 0
    printed = capsys.readouterr().out
    for words in ("2 models on 2 events", "right - other", f"Kept in {out}"):
        assert words in printed
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


def test_an_interrupted_evaluation_of_several_models_goes_on(events: Path, capsys: Capture) -> None:
    out = Path("out")
    both = [*BOTH, "stops_once", "--out", out, "--no-figures"]
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
    found = options_of(models, {}, given)
    assert [*found.values()] == [{"size": 2}, {}, {"size": 3}, {"size": 2, "what": 4}]
    simple = {"simple": "simple", "last_frame": "last_frame"}
    given = [("rule", "paper"), ("chains", 3), ("beta", 0.1)]
    taken = {"planner": "fast", "rule": "paper", "chains": 3, "beta": 0.1}
    found = options_of(simple, {"planner": "fast"}, given)
    assert found == {"simple": taken, "last_frame": {}}
    alone = options_of({"x": "y"}, {"a": 1}, [("b", 2), ("x.c", 3)])
    assert alone == {"x": {"a": 1, "b": 2, "c": 3}}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--model right --model rigth", "'right'"),
        ("--model right --model wrong --option wrong.size=2", "wrong"),
        ("--model right --model wrong --planner fast", "planner: none of the models right, wrong"),
        ("--model right --model wrong --option ritgh.size=2", "did you mean 'right'"),
        ("--model right --model wrong --option size=2 --option size=3", "size: given twice"),
        ("--model right --model wrong --option right.seed=2", "no option of a model"),
        ("--model right --model right", "--model right is given twice: name them, as in --model o"),
        ("--model ../a=right", "'../a' is no name for a folder"),
        ("--model right --model wrong --against nobody", "model to compare with 'nobody'"),
        ("--model right --model wrong --stored theirs", "stored model 'theirs'"),
        ("--model right --model people=wrong", "called 'people', as people are"),
        ("--model right --model wrong --resume", "--resume needs --out"),
        ("--model right --stored theirs", "--stored is for several models"),
        ("--model right --model wrong --out single", "holds an evaluation of one model"),
    ],
)
def test_what_is_wrong_is_found_before_the_first_model_is_asked(
    arguments: str, message: str, events: Path, capsys: Capture
) -> None:
    if "single" in arguments:
        assert evaluate(events, "--model", "right", "--out", "single", "--no-figures") == 0
        capsys.readouterr()
    assert message in fails(capsys, "evaluate", events, *shlex.split(arguments))


def test_folders_are_compared_later_and_under_names(capsys: Capture) -> None:
    stored = {"theirs": {"relation": "neutral"}}
    ppl.save_events([still(i, shift=k, predictions=stored) for k, i in enumerate("ab")], "e.json")
    for model in ("right", "wrong"):
        assert evaluate("e.json", "--model", model, "--out", model, "--no-figures") == 0
    compare = ["compare-models", "--resamples", 50]
    printed = told(capsys, *compare, "right", "wrong", "--stored", "all")
    assert "3 models on 2 events" in printed
    assert "Nothing was saved" in printed
    given = ["x=right", "y=wrong", "--against", "y", "--margin", 0.2, "--out", "c", "--no-figures"]
    told(capsys, *compare, *given)
    kept = json.loads(Path("c/comparison.json").read_text())
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
