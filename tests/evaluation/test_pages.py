"""The page of an event."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from phase_ppl.evaluation.folder import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.observers import observers
from phase_ppl.evaluation.pages import MAX_ROWS, draw_page, rows_of
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.world.errors import InvalidEventError, UnknownNameError
from phase_ppl.world.goals import GOALS

from .small import GREEN, HOSTILE, RED, events, make_folder, prediction, with_posterior
from .test_figures import check_texts, words


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> ResultsFolder:
    folder = make_folder(tmp_path_factory.mktemp("pages") / "results")
    folder.add(prediction("one"), with_posterior)
    return folder


def test_a_page_shows_everybodys_answers_and_marks_the_true_ones(folder: ResultsFolder) -> None:
    figure = draw_page(folder, "one")
    shown = words(figure)
    assert {"people", "SIMPLE", "<b>other</b>"} <= set(shown)
    assert {f"{RED}  (true)", f"{GREEN}  (true)", "adversarial  (true)"} <= set(shown)
    assert {"0.90", "0.60", "0.40", "0.70"} <= set(shown)
    assert "truth: competing, adversarial" in shown
    assert "best hypothesis, simulated" in shown
    check_texts(figure)


def test_a_page_without_truth_posterior_or_judgments(folder: ResultsFolder, tmp_path: Path) -> None:
    shown = words(draw_page(folder, "three"))
    assert "truth not known" in shown
    assert not any("(true)" in text for text in shown)
    assert "best hypothesis, simulated" not in shown
    bare = [dataclasses.replace(e, predictions=None) for e in events(judgments=None, truth=None)]
    empty = make_folder(tmp_path / "results", bare, predicted=lambda _: False)
    assert words(draw_page(empty, "one")) == ["one", "truth not known", "observed"]


def test_an_id_is_not_read_as_mathematics_nor_as_a_path(
    folder: ResultsFolder, tmp_path: Path
) -> None:
    figure = draw_page(folder, HOSTILE, tmp_path / "a page.png")
    assert HOSTILE in words(figure)
    assert (tmp_path / "a page.png").stat().st_size > 10_000


def test_goals_that_were_answered_or_are_true_always_have_a_row(tmp_path: Path) -> None:
    event = events()[0]
    wide = Prediction("one", {"goal_red": [0.0] * 6 + [1 / 30] * 30}, {"goal_red": GOALS[0]})
    folder = ResultsFolder.create(tmp_path / "results", {"model": "simple"}, [event])
    folder.add(wide)
    shown = [one for one in observers(folder) if one.kind == "model"]
    rows = rows_of("goal_red", shown, event)
    assert len(rows) == MAX_ROWS
    assert {GOALS[0], RED} <= set(rows)
    assert rows_of("relation", shown, event) == ["friendly", "neutral", "adversarial"]


def test_an_event_that_is_not_there_and_a_damaged_posterior_are_named(
    folder: ResultsFolder, tmp_path: Path
) -> None:
    with pytest.raises(UnknownNameError, match="unknown event 'onn'; did you mean 'one'"):
        draw_page(folder, "onn")
    damaged = make_folder(tmp_path / "results")
    (damaged.folder_of("one") / POSTERIOR).write_bytes(b"no NetCDF")
    with pytest.raises(InvalidEventError, match=r"posterior\.nc"):
        draw_page(damaged, "one")
