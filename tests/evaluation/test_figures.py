"""The figures of an evaluation: what they show, and which are left out."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import phase_ppl as ppl
from phase_ppl.evaluation import figures
from phase_ppl.evaluation.figures.frame import NothingToDrawError
from phase_ppl.world.errors import InvalidEventError, OutputError
from tests.analysis.pages import texts_apart, texts_of

from .small import events, make_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_folder(tmp_path_factory.mktemp("a folder") / "results").path


def shown_in(figure: Figure) -> list[str]:
    """Return all texts that are seen once the figure is drawn."""
    return [text.get_text() for text in texts_of(figure)]


@pytest.mark.usefixtures("unpainted")
def test_what_the_results_do_not_allow_is_not_drawn(tmp_path: Path) -> None:
    def missing(of: list[ppl.Event], predicted: bool = True) -> set[str]:
        folder = make_folder(tmp_path / f"{len(list(tmp_path.iterdir()))}", of, lambda _: predicted)
        found = set()
        for name, drawing in figures.DRAWINGS.items():
            try:
                assert drawing.draw(folder.path).axes
            except NothingToDrawError:
                found.add(name)
        return found

    of_people = {"correlation", "people"}
    assert missing(events(judgments=None)) == {*of_people, "over_time"}
    assert missing(events(truth=None)) == {"accuracy", "confusion", "over_time"}
    assert missing(events(judgments=None), predicted=False) >= {*of_people, "over_time"}
    only = dataclasses.replace(events()[0], predictions=None)
    assert missing([only]) == {"over_time"}, "one event of one scenario is enough"
    shown = shown_in(figures.accuracy(tmp_path / "3"))
    assert "all" in shown
    assert "competing" not in shown  # it would be the same again


def test_accuracy_has_the_numbers_of_the_metrics_and_is_written(
    folder: Path, tmp_path: Path
) -> None:
    target = tmp_path / "a figure.pdf"
    figure = ppl.figures.accuracy(folder, path=target)
    texts_apart(figure)
    shown = shown_in(figure)
    assert target.read_bytes().startswith(b"%PDF")
    # SIMPLE: goals right, wrong | right, right; relation wrong | right
    assert shown.count("n = 2 to 4") == 1  # the other model answers red's goal only
    assert {"SIMPLE", "people", "<b>other</b>", "collaborative", "competing"} <= set(shown)
    assert "0.75" in shown  # 3 of the 4 goals
    # people: of the only event with truth and judgments, 7 of 10 relations; goals 1 and 3/4
    assert "0.70" in shown
    assert "0.88" in shown
    with pytest.raises(OutputError, match="expected a name in"):
        ppl.figures.accuracy(folder, path=tmp_path / "figure.txt")
    with pytest.raises(InvalidEventError, match="holds no evaluation"):
        ppl.figures.accuracy(tmp_path)


def test_confusion_counts_events(folder: Path) -> None:
    figure = figures.confusion(folder)
    texts_apart(figure)
    named = {axes.get_title("left"): axes for axes in figure.axes}
    # the other model does not answer green's goal
    assert set(named) == {"SIMPLE", "people, majority"}
    cells = [text.get_text() for text in named["SIMPLE"].texts]
    # both true scenarios are taken for collaborative: competing is the third row
    assert [i for i, text in enumerate(cells) if text != "\N{MIDDLE DOT}"] == [0, 8]
    assert {text for text in cells if text.isdigit()} == {"1"}
