"""The page of an event."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from phase_ppl.evaluation.evaluation import Evaluation
from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.report.contents import MAX_ROWS, page_of, rows_of
from phase_ppl.world.errors import InvalidEventError, UnknownNameError
from phase_ppl.world.goals import GOALS

from .small import GREEN, RED, events, make_folder, prediction, with_posterior
from .test_report import Page


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> ResultsFolder:
    folder = make_folder(tmp_path_factory.mktemp("pages") / "results")
    folder.add(prediction("one"), with_posterior)
    return folder


def test_a_page_shows_everybodys_answers_and_marks_the_true_ones(folder: ResultsFolder) -> None:
    page = Page(page_of(Evaluation.load(folder.path), "one"))
    for words in ("people", "SIMPLE", "<b>other</b>", "0.90", "0.60", "0.40", "0.70"):
        assert words in page.text
    for answer in (RED, GREEN, "adversarial"):
        assert f"{answer}true" in page.text
    assert page.text.count("true") == 3
    assert "Truth: competing, adversarial." in page.text
    assert "Best hypothesis, simulated" in page.text
    widths = [str(cell["style"])[:11] for cell in page.all("span") if cell.get("class") == "bar"]
    assert widths[:2] == ["width:62.0%", "width:55.8%"], "of people's 1.00 and the model's 0.90"
    assert len(page.all("img")) == 2


def test_a_page_without_truth_posterior_or_judgments(folder: ResultsFolder, tmp_path: Path) -> None:
    page = Page(page_of(Evaluation.load(folder.path), "three"))
    assert "Truth not known." in page.text
    assert "true" not in page.text
    assert "Best hypothesis" not in page.text
    bare = [dataclasses.replace(e, predictions=None) for e in events(judgments=None, truth=None)]
    empty = make_folder(tmp_path / "results", bare, predicted=lambda _: False)
    page = Page(page_of(Evaluation.load(empty.path), "one"))
    assert (page.all("table"), len(page.all("img"))) == ([], 1)


def test_goals_that_were_answered_or_are_true_always_have_a_row(tmp_path: Path) -> None:
    event = events()[0]
    wide = Prediction("one", {"goal_red": [0.0] * 6 + [1 / 30] * 30}, {"goal_red": GOALS[0]})
    folder = ResultsFolder.create(tmp_path / "results", {"model": "simple", "seed": 0}, [event])
    folder.add(wide)
    shown = [one for one in Evaluation.load(folder.path).answers if one.kind == "model"]
    rows = rows_of("goal_red", shown, event)
    assert len(rows) == MAX_ROWS
    assert {GOALS[0], RED} <= set(rows)
    assert rows_of("relation", shown, event) == ["friendly", "neutral", "adversarial"]


def test_an_event_that_is_not_there_and_a_damaged_posterior_are_named(
    folder: ResultsFolder, tmp_path: Path
) -> None:
    with pytest.raises(UnknownNameError, match="unknown event 'onn'; did you mean 'one'"):
        page_of(Evaluation.load(folder.path), "onn")
    damaged = make_folder(tmp_path / "results")
    (damaged.folder_of("one") / POSTERIOR).write_bytes(b"no NetCDF")
    with pytest.raises(InvalidEventError, match=r"posterior\.nc"):
        page_of(Evaluation.load(damaged.path), "one")
