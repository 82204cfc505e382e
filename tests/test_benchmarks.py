"""The benchmarks run and write what they say; their figures are not judged here."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from tests.analysis.readings import reading

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
VIDEOS = Path(os.environ.get("PHASE_TEST") or BENCHMARKS.parents[1] / "shared" / "phase-test")

REAL = pytest.mark.skipif(
    not VIDEOS.exists(), reason="the real videos are not at ../shared/phase-test"
)

Figures = Callable[..., dict[str, Any]]
Run = Callable[..., str]


@pytest.fixture
def figures(tmp_path: Path, run_script: Run) -> Figures:

    def run(script: str, *options: str) -> dict[str, Any]:
        file = tmp_path / "figures.json"
        run_script(BENCHMARKS / script, *options, "--json", str(file))
        report: dict[str, Any] = json.loads(file.read_text())
        return report

    return run


Report = dict[str, Any]
SLOW = pytest.mark.slow

RUNS: dict[str, tuple[Callable[[Report], bool], list[pytest.MarkDecorator]]] = {
    "behaviour.py --only chase --seeds 1 --set simulations=60": (
        lambda r: r["planner"]["simulations"] == 60 and r["behaviours"]["chase"]["n"] == 1, []),
    "validity.py --only prior_mh --simulations 1200": (
        lambda r: 0 < r["kernels"]["prior_mh"]["tv"] < 0.5, []),
    "budgets.py --only prior_mh --budget 60 --chains 4": (
        lambda r: 60 <= r["kernels"]["prior_mh"]["simulations"] < 64, []),
    "simulator.py --only transitions": (lambda r: r["transition_speedup"] > 0, [SLOW]),
    "worlds.py --events 1 --frames 40 --workers 1 --out out": (
        lambda r: all(r[m]["n_events"] == 1 for m in ("closed_loop", "predicate")), []),
    "large_sets.py --events 8 --frames 34": (lambda r: r["events"] == 8, [SLOW]),
    "attack.py --inputs 12 --kills 2": (lambda r: r["bad"] == [], [SLOW]),
    "calibration.py --events 2 --iterations 8 --kernel prior_mh --figure ranks.png": (
        lambda r: {*map(len, r["ranks"].values())} == {2} and Path("ranks.png").exists(), [SLOW]),
    "closed_loop.py calibration --events 2": (lambda r: 0 <= r["4, 1"]["goals"] <= 1, [SLOW]),
    "realism.py replay": (
        lambda r: 0 < r["median_error_row5"] < r["median_error_row10"] < 0.2, [REAL]),
    "realism.py ahead --half first --steps 5": (
        lambda r: max(row["median_error"] for row in r["by_situation"].values()) < 0.2, [REAL]),
    "realism.py hypotheses --truth-only --limit 4 --noise-seeds 2 --set simulations=20": (
        lambda r: r["log_likelihood"]["value"] < 0 < r["mean_error_per_frame"]["value"], [REAL]),
    "strength.py --limit 4 --draws 1": (
        lambda r: {row["estimator"] for row in r["rows"]} == {"analytic", "network"}, [REAL]),
    "proposals.py --limit 8 --forms learned paper": (
        lambda r: {*r} >= {"learned", "paper"}, [REAL]),
    "film.py --limit 1": (lambda r: r["refused"] == {} and r["position"][0] < 0.08, [REAL, SLOW]),
    "filters.py": (lambda r: r["filters"]["all"]["first"]["share"] == 1, [REAL, SLOW]),
    "closed_loop.py replays --limit 4": (lambda r: r["alike"] > 0.85, [REAL, SLOW]),
    "closed_loop.py fit --limit 4 --keep kept": (
        lambda r: len(list(Path("kept").glob("*.pkl"))) >= 4, [REAL, SLOW]),
    "predicate.py --limit 4 --workers 1": (
        lambda r: len(r["first"]) == len(r["settings"]), [REAL, SLOW]),
}  # fmt: skip
"""A benchmark and its options, what holds for the figures that it writes, and what it needs."""


@pytest.mark.parametrize(
    ("command", "holds"), [pytest.param(c, h, marks=marks, id=c) for c, (h, marks) in RUNS.items()]
)
def test_it_runs_and_writes_its_figures(
    command: str, holds: Callable[[Report], bool], figures: Figures
) -> None:
    report = figures(*command.split())
    assert holds(report), report


def test_a_server_that_is_killed_loses_no_answer_that_it_has_confirmed(figures: Figures) -> None:
    pytest.importorskip("uvicorn", reason="the extra 'study' is not installed")
    sizes = {"videos": 4, "trials": 2, "raters": 4, "at-once": 4, "kills": 1, "drop-outs": 0}
    options = (part for name, value in sizes.items() for part in (f"--{name}", str(value)))
    report = figures("study_people.py", *options)
    assert report["kills"] == 1
    assert report["outcomes"]["finished"] >= 8
    assert report["confirmed"] >= 8 * 7
    assert (report["lost"], report["doubled"], report["unconfirmed"]) == (0, 0, 0)
    assert report["integrity"] == "ok"
    assert min(map(int, report["raters"])) >= 4


def test_decided_answers_are_compared_with_the_truth(tmp_path: Path, figures: Figures) -> None:
    post = ClosedLoopPosterior(reading())
    leaders = {name: one["label"] for name, one in post.leaders().items()}
    assert leaders["goal_red"] == leaders["goal_green"] == "Get blue item to red lm"
    truth = ppl.Truth(leaders["goal_red"], "Get pink item to red lm")
    seen = ppl.Observation(post.observed())
    event = ppl.Event(post.scene, seen, id=post.event_id, truth=truth)
    ppl.save_event(event, tmp_path / "event.json")
    post.save(tmp_path / "some.nc")
    events = str(tmp_path / "event.json")
    report = figures("decided.py", str(tmp_path), "--events", events)[str(tmp_path)]
    assert report["all"]["answers"] == 3
    assert report["goals"]["right"]["value"] == 0.5
    assert report["all"]["decided"] == sum(one["sure"] for one in post.leaders().values())


def test_missing_videos_are_reported(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "realism.py"), "replay"]
    environment = {**os.environ, "PHASE_TEST": str(tmp_path)}
    result = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert result.returncode == 1
    assert "PHASE_TEST" in result.stderr
