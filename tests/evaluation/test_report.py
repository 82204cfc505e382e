"""The report: one page that holds everything, fetches nothing and believes no file."""

from __future__ import annotations

import dataclasses
import html
import html.parser
import itertools
import re
from pathlib import Path

import pytest

import phase_ppl as ppl
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.cli import main
from phase_ppl.evaluation.evaluation import POSTERIOR, ResultsFolder
from phase_ppl.evaluation.report import MAX_ROWS, page_of, rows_of, write_page
from phase_ppl.world.errors import InvalidEventError, OutputError, UnknownNameError
from phase_ppl.world.files import write_json
from phase_ppl.world.goals import GOALS
from tests.analysis.readings import reading
from tests.conftest import nothing_painted

from .small import (
    GREEN,
    HOSTILE,
    RED,
    events,
    make_folder,
    make_posterior,
    prediction,
    with_posterior,
)

PAGES = ("evaluation", "run", "comparison", "event")
"""Names of fixtures, of which each is a page."""


class Page(html.parser.HTMLParser):
    """The elements of a page, its text, and whether they are well nested."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data

    def all(self, name: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.elements if tag == name]


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_folder(tmp_path_factory.mktemp("report") / "a folder")
    folder.add(prediction("one"), with_posterior)
    write_json(folder.path / "failures.json", {"four": "<b>SimulationError</b>: no"})
    with nothing_painted():
        assert ppl.report(folder.path) == folder.path / "report.html"
    return folder.path / "report.html"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    post = make_posterior(HOSTILE)
    post.save(folder / POSTERIOR)
    ppl.render.video(post.observed(), folder / "replay.mp4", events()[0].scene)
    with nothing_painted():
        return ppl.report(folder)


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_folder(tmp_path_factory.mktemp("compared") / "one")
    sources = {HOSTILE: folder.path, "<i>second</i>": folder.path}
    found = ppl.compare_models(sources, stored="all", resamples=50)
    with nothing_painted():
        return ppl.report(found.save(folder.path.parent / "both"), progress=False)


@pytest.fixture(scope="module")
def event(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_folder(tmp_path_factory.mktemp("event") / "results")
    return write_page(page_of(ppl.Evaluation.load(folder.path), HOSTILE), folder.path / "page.html")


def test_the_report_of_an_evaluation_has_all_its_parts(evaluation: Path) -> None:
    page = Page(evaluation.read_text("utf-8"))
    for words in ("Evaluation of SIMPLE", "3 of 3 events", "Summary", "Figures", "Failures",
                  "Settings", "Goals right, by true scenario", "With one particle",
                  "competing \N{MIDDLE DOT} right in all they answered: nobody",
                  "collaborative \N{MIDDLE DOT} right in all they answered: SIMPLE"):  # fmt: skip
        assert words in page.text
    titles = re.findall("<summary><h3>(.*?)</h3>", evaluation.read_text("utf-8"))
    assert [html.unescape(title) for title in titles] == ["one", HOSTILE, "three"]
    assert page.text.count("Best hypothesis, simulated") == 1
    assert page.all("video") == []


def test_the_report_of_a_run_has_all_its_parts(run: Path) -> None:
    page = Page(run.read_text("utf-8"))
    for words in ("What happens", "Posterior", "Settings", "Cost",
                  "Get blue item to red lm", "With one particle"):  # fmt: skip
        assert words in page.text
    assert len(page.all("video")) == 1


@pytest.mark.usefixtures("unpainted")
def test_the_report_of_a_stepwise_run_says_what_decided(tmp_path: Path) -> None:
    StepwisePosterior(reading()).save(tmp_path / POSTERIOR)
    page = Page(ppl.report(tmp_path).read_text("utf-8"))
    for words in ("What decided", "Get blue item to red lm", "strength", "Settings and cost",
                  "planner_seeds"):  # fmt: skip
        assert words in page.text
    assert len(page.all("img")) == 3, "a film strip, the posterior, and what decided"


@pytest.mark.parametrize("which", PAGES)
def test_a_page_is_whole_fetches_nothing_and_takes_no_html_from_files(
    which: str, request: pytest.FixtureRequest
) -> None:
    text = request.getfixturevalue(which).read_text("utf-8")
    page = Page(text)
    assert "<script>alert" not in text
    assert HOSTILE in page.text
    assert page.all("script") == []
    assert page.all("b") == page.all("i") == []
    sources = [a[k] for _, a in page.elements for k in ("src", "href", "srcset") if k in a]
    assert sources
    assert all(str(source).startswith("data:") for source in sources)
    assert not re.search(r"url\(|@import|https?://", text)
    policy = str(page.all("meta")[1]["content"])
    assert policy.startswith("default-src 'none'")
    assert "script-src" not in policy
    # pictures and tables say what they are
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("h1")) == len(page.all("main")) == len(page.all("title")) == 1
    assert all(image["alt"] for image in page.all("img"))
    assert len(page.all("caption")) == len(page.all("table")) > 2
    assert all(head["scope"] in ("row", "col") for head in page.all("th"))
    levels = [int(name[1]) for name, _ in page.elements if re.fullmatch("h[1-6]", name)]
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


@pytest.mark.usefixtures("unpainted")
def test_an_unfinished_evaluation_compares_what_is_finished_with_films_on_demand(
    tmp_path: Path,
) -> None:
    folder = make_folder(tmp_path / "results", predicted=lambda name: name == "one")
    target = tmp_path / "films.html"
    page = Page(ppl.report(folder.path, target, videos=True).read_text("utf-8"))
    assert "1 of 3 events predicted; not finished" in page.text
    assert page.text.count("no prediction") == 2
    assert str(page.all("video")[0]["src"]).startswith("data:video/mp4;base64,")


@pytest.mark.usefixtures("unpainted")
def test_an_evaluation_without_truth_judgments_and_predictions_is_reported_too(
    tmp_path: Path,
) -> None:
    bare = events(truth=None, judgments=None, predictions=None)
    folder = make_folder(tmp_path / "results", bare, predicted=lambda _: False)
    page = Page(ppl.report(folder.path).read_text("utf-8"))
    assert "nothing to compare" in page.text
    assert "Not drawn." in page.text
    assert len(page.all("img")) == 1 + 3


@pytest.mark.usefixtures("unpainted")
def test_bad_folders_and_places_are_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidEventError, match="no such folder"):
        ppl.report(tmp_path / "nowhere")
    with pytest.raises(InvalidEventError, match=r"neither a run .* nor an evaluation"):
        ppl.report(tmp_path)
    folder = make_folder(tmp_path / "results")
    with pytest.raises(OutputError, match=r"expected a name in \.html"):
        ppl.report(folder.path, tmp_path / "report.txt")
    (folder.path / "metrics.json").write_text('{"goal_accuracy": ')
    with pytest.raises(InvalidEventError, match=r"metrics\.json"):
        ppl.report(folder.path)
    (tmp_path / POSTERIOR).write_bytes(b"cut")
    with pytest.raises(InvalidEventError, match=r"posterior\.nc"):
        ppl.report(tmp_path)
    assert not list(tmp_path.glob("**/*.html"))


@pytest.mark.usefixtures("unpainted")
def test_the_command_writes_the_report_and_says_where(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "a new folder" / "a report.html"
    assert main(["report", str(run.parent), "--out", str(target)]) == 0
    assert capsys.readouterr().out.strip().endswith(str(target))
    assert target.read_text("utf-8") == run.read_text("utf-8")
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("phase-ppl: error: ")


# --- the page of an event ----------------------------------------------------------------------


def test_a_page_shows_everybodys_answers_and_marks_the_true_ones(evaluation: Path) -> None:
    page = Page(page_of(ppl.Evaluation.load(evaluation.parent), "one"))
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


def test_a_page_without_truth_posterior_or_judgments(evaluation: Path, tmp_path: Path) -> None:
    page = Page(page_of(ppl.Evaluation.load(evaluation.parent), "three"))
    assert "Truth not known." in page.text
    assert "true" not in page.text
    assert "Best hypothesis" not in page.text
    bare = [dataclasses.replace(e, predictions=None) for e in events(judgments=None, truth=None)]
    empty = make_folder(tmp_path / "results", bare, predicted=lambda _: False)
    page = Page(page_of(ppl.Evaluation.load(empty.path), "one"))
    assert (page.all("table"), len(page.all("img"))) == ([], 1)


def test_goals_that_were_answered_or_are_true_always_have_a_row(tmp_path: Path) -> None:
    event = events()[0]
    wide = ppl.Prediction("one", {"goal_red": [0.0] * 6 + [1 / 30] * 30}, {"goal_red": GOALS[0]})
    folder = ResultsFolder.create(tmp_path / "results", {"model": "simple", "seed": 0}, [event])
    folder.add(wide)
    shown = [one for one in ppl.Evaluation.load(folder.path).answers if one.kind == "model"]
    rows = rows_of("goal_red", shown, event)
    assert len(rows) == MAX_ROWS
    assert {GOALS[0], RED} <= set(rows)
    assert rows_of("relation", shown, event) == ["friendly", "neutral", "adversarial"]


def test_an_event_that_is_not_there_and_a_damaged_posterior_are_named(
    evaluation: Path, tmp_path: Path
) -> None:
    with pytest.raises(UnknownNameError, match="unknown event 'onn'; did you mean 'one'"):
        page_of(ppl.Evaluation.load(evaluation.parent), "onn")
    damaged = make_folder(tmp_path / "results")
    (damaged.folder_of("one") / POSTERIOR).write_bytes(b"no NetCDF")
    with pytest.raises(InvalidEventError, match=r"posterior\.nc"):
        page_of(ppl.Evaluation.load(damaged.path), "one")
