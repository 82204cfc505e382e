"""Comparisons of kernels: measures of one posterior, table, file, figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from phase_ppl.analysis import figures as plots
from phase_ppl.analysis.comparison import (
    CURVE_COLUMNS,
    MEASURES,
    RUN_COLUMNS,
    Comparison,
    accuracy,
    curve,
    marginals,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import InvalidEventError, OutputError, UnknownNameError
from phase_ppl.world.event import Truth

from .factory import (
    BLUE_TO_RED,
    PINK_TO_BLUE,
    Simulation,
    hypothesis,
    make_tree,
    posterior_of,
    random_tree,
)

TRUTH = Truth(BLUE_TO_RED, PINK_TO_BLUE)


def two_goals(share: int) -> Posterior:
    """A posterior of ten draws, ``share`` of which have the true pair, in the others red helps."""
    pairs = [hypothesis(), hypothesis(BLUE_TO_RED, BLUE_TO_RED)]
    return posterior_of(pairs, [[0] * share + [1] * (10 - share)], "count")


def test_accuracy_is_against_reference_and_truth() -> None:
    reference = marginals(two_goals(2))
    found = accuracy(two_goals(7), reference, TRUTH)
    assert found["tv_goals"] == pytest.approx(0.25)  # green's goal only: 0.5
    assert found["tv_relation"] == pytest.approx(0.5)
    assert found["p_pair"] == found["p_relation"] == pytest.approx(0.7)
    assert found["p_goals"] == pytest.approx(0.85)
    assert found["map_goals"] == found["map_relation"] == 1
    assert accuracy(two_goals(2), reference, TRUTH)["map_goals"] == 0.5
    assert np.isnan(accuracy(two_goals(2), reference, None)["p_pair"])


def test_curve_is_what_a_shorter_run_would_have_said() -> None:
    tree = random_tree(2, n_chains=3, n_draws=5)
    post, wanted = Posterior(tree), marginals(two_goals(5))
    found = curve(post, wanted, TRUTH)
    assert found["simulations"].tolist() == [6, 9, 12, 15, 18]
    apart = 0.0
    for name in ("goal_red", "goal_green"):
        codes = tree["posterior"][name].values[:, :2].ravel()
        apart += np.abs(np.bincount(codes, minlength=36) / 6 - wanted[name]).sum()
    assert found["tv_goals"][1] == pytest.approx(apart / 4)
    frames = tree["simulations"]["frames_simulated"].values
    assert found["frames"].iloc[-1] == frames.sum()
    assert found["frames"][0] == frames[tree["simulations"]["iteration"].values < 2].sum()
    last = accuracy(post, wanted, TRUTH)
    assert found.iloc[-1].drop(["simulations", "frames"]).to_dict() == pytest.approx(last)
    # one that keeps its last population only is a point
    simulations = [Simulation(hypothesis(), i, iteration=i) for i in range(4)]
    found = curve(Posterior(make_tree(simulations, [[3]])), wanted, TRUTH)
    assert found["simulations"].tolist() == [4]


def made_up(
    kernels: dict[str, float], repeats: int = 3, points: int = 8, error: float | None = None
) -> Comparison:
    """A comparison in which a kernel's measures shrink towards its number."""
    rng = np.random.default_rng(0)
    runs, rows = [], []
    for name, level in kernels.items():
        for repeat in range(repeats):
            at = np.linspace(1, 1, 1) * 500 if level < 0 else np.linspace(30, 500, points)
            value = np.clip(abs(level) + 5 / at + rng.normal(0, 0.01), 0, 1)
            which = {"kernel": name, "repeat": repeat, "seed": repeat, "validity": "exact"}
            measures = dict.fromkeys(MEASURES, float(value[-1])) | {"moves": np.nan}
            runs.append({**which, **measures})
            rows += [
                {**which, **dict.fromkeys(MEASURES, v), "simulations": x, "frames": 12 * x}
                for x, v in zip(at, value, strict=True)
            ]
    settings: dict[str, Any] = {
        "event": "made-up",
        "kernels": {name: {} for name in kernels},
        "budget": "500 simulations",
        "chains": 15,
        "proposals": {},
        "reference": {
            "description": "made-up",
            "marginals": {"relation": [0.2, 0.3, 0.5]},
            "truth": {"p_goals": 0.3},
        },
    }
    if error is not None:
        settings["reference"]["error"] = {"tv_goals": error, "tv_relation": error}
    return Comparison(
        pd.DataFrame(runs)[list(RUN_COLUMNS)], pd.DataFrame(rows)[list(CURVE_COLUMNS)], settings
    )


FOUR = {"one": 0.2, "two": 0.201, "the third of them": 0.21, "four": 0.6}


def test_table_has_means_and_standard_errors_where_there_are_repeats() -> None:
    c = made_up(FOUR)
    values = c.runs[c.runs["kernel"] == "two"]["tv_goals"]
    error = values.std(ddof=1) / np.sqrt(3)
    found = c.table.loc["two", "tv_goals"]
    assert (found["mean"], found["se"]) == pytest.approx((values.mean(), error))
    assert list(c.table.index) == list(FOUR)
    assert (c.table["runs", "n"] == 3).all()
    assert f"{values.mean():.3f} ±{error:.3f}" in str(c)
    assert "moves" not in str(c)
    c = made_up(FOUR, repeats=1)
    assert np.isnan(c.table.loc["one", ("tv_goals", "se")])
    assert "±0" not in str(c)


def test_file_keeps_everything(tmp_path: Path) -> None:
    c = made_up(FOUR)
    again = Comparison.load(c.save(tmp_path / "c.json"))
    pd.testing.assert_frame_equal(again.runs, c.runs)
    pd.testing.assert_frame_equal(again.curve, c.curve)
    assert (again.settings, str(again)) == (c.settings, str(c))
    with pytest.raises(InvalidEventError, match="nowhere"):
        Comparison.load(tmp_path / "nowhere.json")
    with pytest.raises(OutputError, match=r"\.json"):
        c.save(tmp_path / "c.nc")


def test_damaged_file_is_refused(tmp_path: Path) -> None:
    path = made_up(FOUR).save(tmp_path / "c.json")
    content = path.read_text()
    spoils: dict[str, Any] = {
        "other schema": lambda d: d.update(schema="x"),
        "no runs": lambda d: d.pop("runs"),
        "a column less": lambda d: d["runs"].pop("tv_goals"),
        "text": lambda d: d["runs"].update(tv_goals=["a"] * 12),
        "unequal": lambda d: d["curve"].update(tv_goals=[0.1]),
        "unnamed kernel": lambda d: d["settings"].update(kernels={}),
    }
    for spoil in spoils.values():
        spoil(record := json.loads(content))
        path.write_text(json.dumps(record))
        with pytest.raises(InvalidEventError, match="no comparison"):
            Comparison.load(path)


def places(c: Comparison) -> dict[str, tuple[int, int]]:
    ranks = c.ranks("tv_goals")
    return dict(zip(ranks.index, zip(ranks["best"], ranks["worst"], strict=True), strict=True))


def test_kernels_are_ranked_as_far_as_the_reference_can_tell() -> None:
    three = {"near": 0.2, "middle": 0.3, "far": 0.6}
    assert places(made_up(three, error=0.02)) == {"near": (1, 1), "middle": (2, 2), "far": (3, 3)}
    assert places(made_up(three, error=0.2)) == {"near": (1, 2), "middle": (1, 2), "far": (3, 3)}
    assert places(made_up(three, error=0.5)) == dict.fromkeys(three, (1, 3))
    printed = str(made_up(three, error=0.2))
    assert "rank by TV goals: 1 to 2: near, middle; 3: far" in printed
    assert "distance between its halves: TV goals 0.20" in printed
    assert "not told apart by this reference: near, middle, far" in str(made_up(three, error=0.5))
    # one between two that differ shares a rank with both
    c = made_up({**three, "far": 0.4}, error=0.13)
    assert places(c) == {"near": (1, 2), "middle": (1, 3), "far": (2, 3)}
    # two standard errors of the difference come on top of the reference's own
    (near, far), (one, other) = made_up(two := {"near": 0.2, "far": 0.3}).table["tv_goals"].values.T
    errors = 2 * np.hypot(one, other)
    for more, apart in ((1.1, True), (0.9, False)):
        c = made_up(two, error=far - near - more * errors)
        assert places(c) == (
            {"near": (1, 1), "far": (2, 2)} if apart else dict.fromkeys(two, (1, 2))
        )


def test_nothing_is_ranked_without_repeats_or_by_a_reference_of_unknown_error() -> None:
    two = {"near": 0.1, "far": 0.9}
    assert places(made_up(two, repeats=1, error=0.01)) == dict.fromkeys(two, (1, 2))
    assert "not told apart by a single run" in str(made_up(two, repeats=1, error=0.01))
    assert places(made_up(two)) == dict.fromkeys(two, (1, 2))
    assert "between its halves is not known" in str(made_up(two))
    with pytest.raises(UnknownNameError, match="tv_goals"):
        made_up(two).ranks("p_goals")


def test_lines_are_means_the_references_error_is_shaded(tmp_path: Path) -> None:
    c = made_up(FOUR, error=0.15)
    figure = plots.comparison(c, tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
    line = figure.axes[0].lines[0]
    ends = c.curve[(c.curve["simulations"] == 500) & (c.curve["kernel"] == "one")]["tv_goals"]
    assert line.get_ydata()[-1] == pytest.approx(ends.mean())  # type: ignore[index]
    assert line.get_xdata()[-1] == 500  # type: ignore[index]
    (shade,) = (patch for patch in figure.axes[0].patches if patch.get_height() == 0.15)  # type: ignore[attr-defined]
    assert shade.get_y() == 0  # type: ignore[attr-defined]
    assert not figure.axes[1].patches
    assert figure.axes[0].get_xlabel() == "simulations"
    frames = Comparison(c.runs, c.curve, {**c.settings, "budget": "6000 frames"})
    axes = plots.comparison(frames).axes[0]
    assert axes.get_xlabel() == "simulated frames"
    assert max(axes.lines[0].get_xdata()) == 6000  # type: ignore[arg-type]
