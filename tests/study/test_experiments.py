"""People's labels and ratings of likeness: read, summed up, tested and drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_study.experiments import LABELS, Likeness, Tags

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
    tags = Tags.load(tags_file)
    assert tags.viewers.to_dict() == {"a": 3, "b": 2, "c": 1}
    assert tags.shares.loc["a", "helping"] == pytest.approx(2 / 3)
    found = tags.summary()
    assert found.loc["helping", "percent"] == pytest.approx(100 / 3)
    assert found.loc["chasing", "percent"] == pytest.approx(100 / 3), "exactly half is enough"
    assert found.loc["collaborating", ["percent", "used"]].tolist() == [0, 1]
    assert found.index[-1] == "dancing", "labels of others come last"
    assert tags.counts().to_numpy().tolist() == [[4, 23], [3, 18]]
    figure = tags.plot(tmp_path / "tags.png")
    assert "Labels used: 4, in the paper 23" in figure.get_supxlabel().replace("\n", " ")
    (axes,) = figure.axes
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
        (Tags.load, "participant,video\np,a\n", "no table with .* label"),
        (Tags.load, f"{LABELLED}p,a,x,y\n", "Length of header"),
        (Tags.load, f"{LABELLED},a,x\n", "line 2: participant '' must not be empty"),
        (Tags.load, f"{LABELLED}p,a,x\np,a,x\n",
         "line 3: label 'x' is there for that video a second time"),
        (Likeness.load, f"{RATED}p,a,g,6\n", "line 2: rating '6' is not 1 to 5"),
        (Likeness.load, f"{RATED}p,a,g,4\np,a,g,4\n",
         "line 3: video 'a' is there for that participant a second time"),
        (Likeness.load, f"{RATED}p,a,g,4\np,b,h,4\n",
         "line 2: participant 'p' is in two groups"),
        (Likeness.load, f"{RATED}p,a,g,4\nq,a,g,4\n", r"groups are \['g'\], expected two"),
    ]  # fmt: skip
    file = tmp_path / "said.csv"
    for load, text, message in mistakes:
        file.write_text(text, "utf-8")
        with pytest.raises(InvalidEventError, match=f"said.csv.*{message}"):
            load(file)
    # other columns of other people's files do not matter
    file.write_text("age,label,video,participant\n33,helping,a,p\n", "utf-8")
    assert Tags.load(file).table.values.tolist() == [["p", "a", "helping"]]


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
    found = Likeness.load(file).summary()
    assert list(found.index) == ["played", "generated"]
    assert found.loc["played", ["videos", "participants", "ratings"]].tolist() == [5, 30, 150]
    assert (found["sd_participants"] > 0).all()
    assert found.loc["played", ["paper_mean", "paper_sd"]].tolist() == [4.06, 0.36]
    low, mean, high = found.loc["played", ["ci_low", "mean", "ci_high"]]
    assert low < mean < high
    figure = Likeness.load(file).plot(tmp_path / "likeness.pdf")
    shares, means = figure.axes
    assert sum(bar.get_height() for bar in shares.patches) == pytest.approx(2)
    note = figure.get_supxlabel().replace("\n", " ")
    assert "equivalence within 0.5 is shown" in note
    assert "In the paper: played 4.06 ± 0.36; generated 3.98 ± 0.42." in note
    assert not figure.get_suptitle()
    scripted = rated({"scripted-a": [[4], [3]], "scripted-b": [[4], [3]]})
    assert scripted.plot().get_suptitle().startswith("A rehearsal")
    assert [t.get_text().split("\n")[0] for t in means.get_xticklabels()] == ["played", "generated"]
    with pytest.raises(InvalidSettingError, match="margin"):
        Likeness.load(file).equivalence(0)
