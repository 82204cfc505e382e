"""The figures of an evaluation: what they show, and which are left out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy import stats

import phase_ppl as ppl
from phase_ppl.evaluation import figures
from phase_ppl.evaluation.experiments import LABELS, Likeness
from phase_ppl.evaluation.figures.frame import NothingToDrawError
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    OutputError,
)
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

    of_people = {"correlation", "scatter_goals", "people"}
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


def test_scatter_has_a_column_per_scenario_and_one_for_the_unknown(folder: Path) -> None:
    figure = figures.scatter_goals(folder)
    texts_apart(figure)
    shown = shown_in(figure)
    assert "competing" in shown
    assert "scenario not known" in shown
    assert "collaborative" not in shown  # nobody judged it


# --- what people said -----------------------------------------------------------------------------

TAGS = """participant,video,label
p1,a,helping
p1,a,collaborating
p2,a,Helping
p3,a,
p1,b,chasing
p2,b,
p2,c,dancing
"""


@pytest.fixture
def tags_file(tmp_path: Path) -> Path:
    file = tmp_path / "tags.csv"
    file.write_text(TAGS, "utf-8")
    return file


def test_a_video_has_a_category_that_half_of_its_viewers_see(
    tags_file: Path, tmp_path: Path
) -> None:
    tags = ppl.load_tags(tags_file)
    assert tags.viewers.to_dict() == {"a": 3, "b": 2, "c": 1}
    assert tags.shares.loc["a", "helping"] == pytest.approx(2 / 3)
    found = tags.summary()
    assert found.loc["helping", "percent"] == pytest.approx(100 / 3)
    assert found.loc["chasing", "percent"] == pytest.approx(100 / 3), "exactly half is enough"
    assert found.loc["collaborating", ["percent", "used"]].tolist() == [0, 1]
    assert found.index[-1] == "dancing", "labels of others come last"
    (axes,) = ppl.figures.tags(tags_file, tmp_path / "tags.png").axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["dancing", *reversed(LABELS)]
    assert len(set(names)) == 1 + 23
    widths = dict(zip(names, [bar.get_width() for bar in axes.patches], strict=True))
    assert [widths["helping"], widths["stalking"]] == pytest.approx([100 / 3, 0])
    assert len(axes.lines) == 1, "collaborating was chosen by somebody"
    assert (tmp_path / "tags.png").stat().st_size > 1000


LABELLED = "participant,video,label\n"
RATED = "participant,video,group,rating\n"


def test_mistakes_in_files_are_named(tmp_path: Path) -> None:
    mistakes: list[tuple[Any, str, str]] = [
        (ppl.load_tags, "participant,video\np,a\n", "expected a column label"),
        (ppl.load_tags, f"{LABELLED},a,x\n", "line 2: participant is empty"),
        (ppl.load_tags, f"{LABELLED}p,a,x\np,a,x\n", "line 3: has .* a second time"),
        (ppl.load_likeness, f"{RATED}p,a,g,6\n", "line 2: rating is '6', expected 1 to 5"),
        (ppl.load_likeness, f"{RATED}p,a,g,4\np,a,g,4\n",
         "line 3: has participant 'p', video 'a' a second time"),
        (ppl.load_likeness, f"{RATED}p,a,g,4\np,b,h,4\n",
         "line 3: participant 'p' is in two groups"),
        (ppl.load_likeness, f"{RATED}p,a,g,4\nq,a,g,4\n", r"groups are \['g'\], expected two"),
    ]  # fmt: skip
    file = tmp_path / "said.csv"
    for load, text, message in mistakes:
        file.write_text(text, "utf-8")
        with pytest.raises(InvalidEventError, match=f"said.csv.*{message}"):
            load(file)
    # other columns of other people's files do not matter
    file.write_text("age,label,video,participant\n33,helping,a,p\n", "utf-8")
    assert ppl.load_tags(file).table.values.tolist() == [["p", "a", "helping"]]


def ratings(played: float, generated: float, n: int = 30, noise: float = 0.4) -> Likeness:
    """Return ratings of five videos by each of ``n`` participants of a group."""
    rng = np.random.default_rng(0)
    return rated(
        {
            group: np.clip(rng.normal(mean, noise, (n, 5)).round(), 1, 5).astype(int).tolist()
            for group, mean in (("generated", generated), ("played", played))
        }
    )


def rated(given: dict[str, list[list[int]]]) -> Likeness:
    """Return ratings from group -> participant -> rating of each video."""
    rows = [
        {"participant": f"{group}{who}", "video": f"{group}-{video}", "group": group, "rating": one}
        for group, of_group in given.items()
        for who, of_one in enumerate(of_group)
        for video, one in enumerate(of_one)
    ]
    return Likeness(pd.DataFrame(rows))


def test_equivalence_is_shown_by_two_one_sided_tests() -> None:
    same = ratings(4.0, 4.0)
    found = same.equivalence()
    assert found["equivalent"]
    assert -0.5 < found["ci_low"] < found["difference"] < found["ci_high"] < 0.5
    first, second = same.means("participants").values()
    low, high = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.9)
    assert (found["ci_low"], found["ci_high"]) == pytest.approx((low, high))
    # TOST rejects exactly where the 90 % interval lies within the margin
    reach = max(abs(low), abs(high))
    assert same.equivalence(reach * 1.001)["equivalent"]
    assert not same.equivalence(reach * 0.999)["equivalent"]
    assert same.equivalence(reach)["p"] == pytest.approx(0.05)
    apart = ratings(4.0, 3.4).equivalence()
    assert not apart["equivalent"]
    assert apart["difference"] > 0


def test_ratings_without_any_difference_show_nothing() -> None:
    found = rated(dict.fromkeys(("played", "generated"), [[4]] * 3)).equivalence()
    assert (found["difference"], found["equivalent"], found["p"]) == (0, False, None)


def test_the_figure_of_ratings_says_whether_equivalence_is_shown(tmp_path: Path) -> None:
    file = tmp_path / "likeness.csv"
    ratings(4.0, 4.0).table.to_csv(file, index=False)
    found = ppl.load_likeness(file).summary()
    assert list(found.index) == ["played", "generated"]
    assert found.loc["played", ["videos", "participants", "ratings"]].tolist() == [5, 30, 150]
    assert (found["sd_participants"] > 0).all()
    figure = ppl.figures.likeness(file, tmp_path / "likeness.pdf")
    shares, means = figure.axes
    assert sum(bar.get_height() for bar in shares.patches) == pytest.approx(2)
    assert "equivalence within 0.5 is shown" in figure.get_supxlabel().replace("\n", " ")
    assert [t.get_text().split("\n")[0] for t in means.get_xticklabels()] == ["played", "generated"]
    with pytest.raises(InvalidSettingError, match="margin"):
        ppl.load_likeness(file).equivalence(0)
