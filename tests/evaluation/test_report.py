"""The report: one page that holds everything, fetches nothing and believes no file."""

from __future__ import annotations

import html
import html.parser
import itertools
import re
from pathlib import Path

import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation.folder import SETTINGS
from phase_ppl.evaluation.report import answers_table
from phase_ppl.world.errors import InvalidEventError, OutputError
from phase_ppl.world.files import write_json
from phase_ppl.world.goals import GOALS
from tests.conftest import nothing_painted

from .small import GREEN, HOSTILE, RED, events, make_folder


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
    write_json(folder.path / "failures.json", {"four": "<b>SimulationError</b>: no"})
    with nothing_painted():
        assert ppl.report(folder.path) == folder.path / "report.html"
    return folder.path / "report.html"


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_folder(tmp_path_factory.mktemp("compared") / "one")
    sources = {HOSTILE: folder.path, "<i>second</i>": folder.path}
    found = ppl.compare_models(sources, stored="all", resamples=50)
    with nothing_painted():
        return ppl.report(found.save(folder.path.parent / "both"), progress=False)


def test_the_report_of_an_evaluation_has_all_its_parts(evaluation: Path) -> None:
    page = Page(evaluation.read_text("utf-8"))
    for words in ("Evaluation of SIMPLE", "3 of 3 events", "Summary", "Figures", "failures",
                  "Settings", "Goals right, by true scenario", "people", "<b>other</b>",
                  "competing \N{MIDDLE DOT} right in all they answered: nobody",
                  "collaborative \N{MIDDLE DOT} right in all they answered: SIMPLE",
                  f"{RED} (true)", f"{GREEN} (true)", "adversarial (true)",
                  "0.90", "0.60", "0.40", "0.70"):  # fmt: skip
        assert words in page.text
    titles = re.findall("<summary>(.*?) <span", evaluation.read_text("utf-8"))
    assert [html.unescape(title) for title in titles] == ["one", HOSTILE, "three"]


@pytest.mark.parametrize("which", ["evaluation", "comparison"])
def test_pages_fetch_nothing_and_take_no_html(which: str, request: pytest.FixtureRequest) -> None:
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
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("h1")) == len(page.all("main")) == len(page.all("title")) == 1
    assert all(image["alt"] for image in page.all("img"))
    levels = [int(name[1]) for name, _ in page.elements if re.fullmatch("h[1-6]", name)]
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


@pytest.mark.usefixtures("unpainted")
def test_an_unfinished_evaluation_compares_what_is_finished(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "results", predicted=lambda name: name == "one")
    page = Page(ppl.report(folder.path).read_text("utf-8"))
    assert "1 of 3 events predicted; not finished" in page.text
    assert page.text.count("no prediction") == 2


@pytest.mark.usefixtures("unpainted")
def test_an_evaluation_without_truth_and_judgments_is_reported_too(tmp_path: Path) -> None:
    bare = events(truth=None, judgments=None, predictions=None)
    folder = make_folder(tmp_path / "results", bare, predicted=lambda _: False)
    page = Page(ppl.report(folder.path).read_text("utf-8"))
    assert "nothing to compare" in page.text
    assert "Not drawn." in page.text
    assert len(page.all("img")) == 3


@pytest.mark.usefixtures("unpainted")
def test_the_command_writes_the_report_and_bad_folders_and_places_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InvalidEventError, match="nowhere holds no evaluation"):
        ppl.report(tmp_path / "nowhere")
    with pytest.raises(InvalidEventError, match="holds no evaluation: it has no settings"):
        ppl.report(tmp_path)
    folder = make_folder(tmp_path / "results")
    with pytest.raises(OutputError, match=r"expected a name in \.html"):
        ppl.report(folder.path, tmp_path / "report.txt")
    target = tmp_path / "a new folder" / "a report.html"
    assert main(["report", str(folder.path), "--out", str(target)]) == 0
    assert capsys.readouterr().out.strip().endswith(str(target))
    (folder.path / SETTINGS).write_text('{"model": ')
    assert main(["report", str(folder.path)]) == 2
    assert SETTINGS in capsys.readouterr().err
    assert list(tmp_path.glob("**/*.html")) == [target]


def test_goals_that_were_answered_or_are_true_always_have_a_row() -> None:
    event = events()[0]
    wide = ppl.Prediction("one", {"goal_red": [0.0] * 6 + [1 / 30] * 30}, {"goal_red": GOALS[0]})
    table = answers_table("goal_red", {"wide": wide}, event)
    assert set(table.index) == {GOALS[0], f"{RED} (true)"}
