"""The figures of an evaluation: what they show, and which are left out."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import phase_ppl as ppl
from phase_ppl.evaluation import figures
from phase_ppl.evaluation.figures import NothingToDrawError, draw_figures, drawings_of
from phase_ppl.evaluation.figures.layout import Results
from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.world.errors import InvalidEventError, OutputError

from .small import COMPETING, events, make_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> ResultsFolder:
    return make_folder(tmp_path_factory.mktemp("a folder") / "results")


def texts_of(figure: Figure) -> list[Text]:
    """Return all texts that are seen once the figure is drawn."""
    figure.canvas.draw()
    found = [*figure.texts]
    for axes in figure.axes:
        if axes.get_visible():
            ticks = [] if axes.axison else [*axes.get_xticklabels(), *axes.get_yticklabels()]
            parts = [part for part in axes.findobj() if isinstance(part, Text)]
            found += [text for text in parts if text not in ticks]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


def shown_in(figure: Figure) -> list[str]:
    return [text.get_text() for text in texts_of(figure)]


def left_out(folder: ResultsFolder, capsys: pytest.CaptureFixture[str]) -> set[str]:
    """Draw all; return the names of those that were not drawn, of which each was said."""
    drawn = {path.stem for path in draw_figures(folder.path, folder.path)}
    said = capsys.readouterr().err
    missing = set(drawings_of(Results.of(folder.path))) - drawn
    assert said.count("\n") == len(missing)
    assert all(f"no figure {name}: " in said for name in missing)
    assert {p.name for p in (folder.path / "figures").iterdir()} == {f"{n}.png" for n in drawn}
    return missing


def test_all_figures_are_drawn_where_everything_is_known(
    folder: ResultsFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert left_out(folder, capsys) == set()


def test_without_judgments_nothing_is_compared_with_people(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_folder(tmp_path / "results", events(judgments=None))
    left = {"correlation", "scatter_goals", "scatter_relations", "people"}
    assert left_out(folder, capsys) == left


def test_without_truth_nothing_is_right_or_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_folder(tmp_path / "results", events(truth=None))
    assert left_out(folder, capsys) == {"accuracy", "confusion"}


def test_a_folder_without_predictions_has_people_and_references_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_folder(tmp_path / "results", predicted=lambda _: False)
    # of an evaluation that has not begun nothing is compared
    every = set(drawings_of(Results.of(folder.path)))
    assert left_out(folder, capsys) == every - {"film_strips"}


def test_one_event_of_one_scenario_is_enough(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    only = dataclasses.replace(events()[0], predictions=None)
    folder = make_folder(tmp_path / "results", [only])
    assert left_out(folder, capsys) == set()
    shown = shown_in(figures.accuracy(folder.path))
    assert "all" in shown
    assert "competing" not in shown  # it would be the same again


def test_a_figure_that_the_results_no_longer_allow_is_taken_away(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "results", events(judgments=None))
    (folder.path / "figures").mkdir()
    (folder.path / "figures" / "correlation.png").write_bytes(b"old")
    assert "correlation" not in {
        path.stem for path in draw_figures(folder.path, folder.path, progress=False)
    }
    assert not (folder.path / "figures" / "correlation.png").exists()


def test_accuracy_has_the_numbers_of_the_metrics(folder: ResultsFolder) -> None:
    shown = shown_in(figures.accuracy(folder.path))
    # SIMPLE: goals right, wrong | right, right; relation wrong | right
    assert shown.count("n = 2 to 4") == 1  # the other model answers red's goal only
    assert {"SIMPLE", "people", "<b>other</b>", "collaborative", "competing"} <= set(shown)
    assert "0.75" in shown  # 3 of the 4 goals
    # people: of the only event with truth and judgments, 7 of 10 relations; goals 1 and 3/4
    assert "0.70" in shown
    assert "0.88" in shown


def test_confusion_counts_events(folder: ResultsFolder) -> None:
    figure = figures.confusion(folder.path)
    named = {axes.get_title("left"): axes for axes in figure.axes}
    # the other model does not answer green's goal
    assert set(named) == {"SIMPLE", "people, majority"}
    cells = [text.get_text() for text in named["SIMPLE"].texts]
    # both true scenarios are taken for collaborative: competing is the third row
    assert [i for i, text in enumerate(cells) if text != "\N{MIDDLE DOT}"] == [0, 8]
    assert {text for text in cells if text.isdigit()} == {"1"}


def test_scatter_has_a_column_per_scenario_and_one_for_the_unknown(folder: ResultsFolder) -> None:
    shown = shown_in(figures.scatter_goals(folder.path))
    assert "competing" in shown
    assert "scenario not known" in shown
    assert "collaborative" not in shown  # nobody judged it


def test_figures_take_a_path_and_write_to_one(folder: ResultsFolder, tmp_path: Path) -> None:
    target = tmp_path / "a figure.pdf"
    ppl.figures.accuracy(folder.path, path=target)
    assert target.read_bytes().startswith(b"%PDF")
    with pytest.raises(OutputError, match="expected a name in"):
        ppl.figures.accuracy(folder.path, path=tmp_path / "figure.txt")
    with pytest.raises(InvalidEventError, match="holds no evaluation"):
        ppl.figures.accuracy(tmp_path)


def test_a_figure_that_cannot_be_drawn_says_what_is_missing(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "results", events(judgments=None))
    with pytest.raises(NothingToDrawError, match="people judged no goal"):
        figures.scatter_goals(folder.path)


def test_no_text_leaves_the_page_or_covers_another(tmp_path: Path) -> None:
    answers = {"goals": {"red agent": COMPETING.goal_red, "green agent": COMPETING.goal_green}}
    answers["relation_probs"] = {"adversarial": 0.7, "friendly": 0.3}
    names = ["x", "a model with a name that is long", "another"]
    folder = make_folder(tmp_path / "results", events(predictions=dict.fromkeys(names, answers)))
    results = Results.of(folder.path)
    for drawing in drawings_of(results).values():
        check_texts(drawing.draw(results))


def check_texts(figure: Figure) -> None:
    texts = [text for text in texts_of(figure) if not text.get_rotation() % 90]
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    page = figure.bbox
    for text, box in boxes:
        inside = page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
        assert inside, f"{text!r} leaves the page"
    for i, (text, box) in enumerate(boxes):
        for other, place in boxes[i + 1 :]:
            apart = (
                box.x1 <= place.x0 + 1
                or place.x1 <= box.x0 + 1
                or box.y1 <= place.y0 + 2
                or place.y1 <= box.y0 + 2
            )
            assert apart, f"{text!r} and {other!r} overlap"
