"""``phase-ppl evaluate``: what it prints and writes, and how it ends."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation import figures, registry
from phase_ppl.evaluation.report import contents
from tests.evaluation.small import make_folder, prediction, with_posterior
from tests.evaluation.toys import FailsAt, right, several, still, wrong

QUIET = ["--workers", "1", "--quiet"]


@pytest.fixture(autouse=True)
def _models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give some models names."""
    registry.available_models()
    monkeypatch.setattr(registry.MODELS, "entries", dict(registry.MODELS.entries))

    def raises() -> Any:
        raise ValueError("not today")

    def stops() -> Any:
        raise KeyboardInterrupt

    models = {
        "right": right,
        "wrong": wrong,
        "fails": FailsAt(4, raises),
        "stops": FailsAt(4, stops),
    }
    for name, model in models.items():
        ppl.register_model(name)(_factory(model))


def _factory(model: Any) -> Any:
    def make(size: int = 1) -> Any:
        return model

    make.__qualname__ = repr(model)
    return make


@pytest.fixture
def events(tmp_path: Path) -> Path:
    path = tmp_path / "some events.json"
    ppl.save_events(several(3), path)
    return path


def evaluate(*arguments: object) -> int:
    return main(["evaluate", *map(str, arguments), *QUIET])


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the only line of an error with exit code 2."""
    try:
        code = evaluate(*arguments)
    except SystemExit as stop:
        code = stop.code  # type: ignore[assignment]
    written = capsys.readouterr()
    assert code == 2
    assert written.err.count("\n") == 1
    return written.err


def test_it_prints_a_table_and_writes_predictions_metrics_figures_and_pages(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out put"
    assert evaluate(events, "--model", "last_frame", "--out", out, "--limit", 1) == 0
    printed = capsys.readouterr()
    assert "last_frame: 1 of 1 events, seed 0" in printed.out
    assert f"Kept in {out}" in printed.out
    assert json.loads((out / "metrics.json").read_text())["n_events"] == 1
    assert (out / "figures" / "accuracy.png").stat().st_size > 1000
    assert len(list(out.glob("events/*/page.html"))) == 1


def test_there_is_a_bar_only_in_a_terminal_or_where_it_is_asked_for(
    events: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["evaluate", str(events), "--model", "right", "--workers", "1"]
    assert main(command) == 0
    assert capsys.readouterr().err == ""
    assert main([*command, "--progress"]) == 0
    assert "predicting" in capsys.readouterr().err


def test_without_a_folder_it_says_that_nothing_is_kept(
    events: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(events, "--model", "right") == 0
    assert "Nothing was saved" in capsys.readouterr().out


def test_a_failing_event_is_told_by_the_exit_code(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert evaluate(events, "--model", "fails", "--out", out, "--no-figures") == 1
    assert "failed: b: ValueError: not today" in capsys.readouterr().out
    assert not (out / "figures").exists()


def test_a_failing_figure_costs_no_results(
    events: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(folder: Any, *given: Any, **more: Any) -> Any:
        raise RuntimeError("no ink")

    monkeypatch.setattr(figures, "draw_figures", broken)
    monkeypatch.setattr(contents, "page_in_folder", broken)
    out = tmp_path / "out"
    assert evaluate(events, "--model", "right", "--out", out) == 1
    written = capsys.readouterr()
    assert "the figures cannot be drawn: no ink" in written.err
    assert "the page of b cannot be drawn: no ink" in written.err
    assert "goals right" in written.out
    assert (out / "metrics.json").exists()


def test_ctrl_c_says_how_to_go_on_and_resume_does(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert evaluate(events, "--model", "stops", "--out", out) == 130
    errors = capsys.readouterr().err
    assert "1 of 3 events are finished" in errors
    assert "--resume" in errors
    assert "already holds" in fails(capsys, events, "--model", "stops", "--out", out)
    other = fails(capsys, events, "--model", "right", "--out", out, "--resume")
    assert other.endswith("with other settings: model is 'right', was 'stops'\n")
    assert evaluate(events, "--model", "stops", "--out", out, "--resume") == 130


def test_against_compares_with_another_folder_also_later(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    assert evaluate(events, "--model", "wrong", "--out", other, "--no-figures") == 0
    args = ["--model", "right", "--out", one, "--no-figures", "--against", other]
    assert evaluate(events, *args) == 0
    assert "right minus wrong: on the 3 events" in capsys.readouterr().out
    first = json.loads((one / "against.json").read_text())
    assert first["relation_accuracy"]["value"] == 1
    assert evaluate("--out", other, "--against", one) == 0
    assert "wrong minus right" in capsys.readouterr().out
    second = json.loads((other / "against.json").read_text())
    assert second["relation_accuracy"]["value"] == -1


def test_a_folder_to_compare_with_that_is_none_is_refused_before_the_work(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    error = fails(capsys, events, "--model", "stops", "--against", other)
    assert "holds no evaluation" in error


def test_a_model_to_compare_with_that_nobody_knows_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "events.json", tmp_path / "out"
    ppl.save_events([still("a", predictions={"theirs": {"relation": "neutral"}})], path)
    error = fails(capsys, path, "--model", "stops", "--against", "thiers", "--out", out)
    assert "thiers: no such folder, and no reference model (theirs)" in error
    assert not out.exists()


def test_what_is_compared_with_must_predict_one_of_the_events_at_least(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, other = tmp_path / "others.json", tmp_path / "other"
    ppl.save_events([still("x")], path)
    assert evaluate(path, "--model", "wrong", "--out", other, "--no-figures") == 0
    capsys.readouterr()
    error = fails(capsys, events, "--model", "stops", "--against", other)
    assert "wrong predicts none of the 3 events" in error


def test_a_finished_evaluation_leads_to_its_report_and_is_no_folder_of_events(
    events: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out put"
    assert evaluate(events, "--model", "right", "--out", out, "--no-figures") == 0
    assert f"phase-ppl report '{out}'" in capsys.readouterr().out
    error = fails(capsys, out, "--model", "right")
    assert f"its events are in {out / 'events.json'}" in error
    assert main(["query", str(out), "P(goal_red)"]) == 2
    assert f"{out} holds no posterior.nc\n" in capsys.readouterr().err


def test_asked_for_a_posterior_an_evaluation_names_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_folder(tmp_path / "out")
    folder.add(prediction("one"), with_posterior)
    assert main(["diagnose", str(folder.path)]) == 2
    error = capsys.readouterr().err
    assert "holds an evaluation, with one such as" in error
    assert main(["diagnose", error.rsplit("such as ", 1)[1].strip()]) == 0


def test_options_reach_the_model(events: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert evaluate(events, "--model", "right", "--option", "size=3", "--out", out) == 0
    assert json.loads((out / "settings.json").read_text())["options"] == {"size": 3}


def test_judgments_come_from_a_file(events: Path, tmp_path: Path) -> None:
    study, out = tmp_path / "people.csv", tmp_path / "out"
    study.write_text("participant,video,relation\np1,a,neutral\np2,a,friendly\n")
    args = ["--model", "right", "--out", out, "--no-figures", "--judgments", study]
    assert evaluate(events, *args) == 0
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
def test_bad_input_ends_with_one_line(
    arguments: str,
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, *shlex.split(arguments))


def test_ids_that_are_long_or_odd_have_folders_of_their_own(tmp_path: Path) -> None:
    odd = ["../../x", "a/b c", "a?b c", "x" * 300, "x" * 299 + "y"]
    path, out = tmp_path / "odd.json", tmp_path / "out"
    ppl.save_events([still(id, shift=0.1 * i) for i, id in enumerate(odd)], path)
    assert evaluate(path, "--model", "right", "--out", out, "--no-figures") == 0
    assert list(ppl.Evaluation.load(out).predictions) == odd
    assert len(list(out.glob("events/*/prediction.json"))) == 5
    assert {entry.name for entry in tmp_path.iterdir()} == {"odd.json", "out"}
