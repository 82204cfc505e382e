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
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.dataset.generation.making import NEAR
from tests.analysis.readings import reading

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
VIDEOS = Path(os.environ.get("PHASE_TEST") or BENCHMARKS.parents[1] / "shared" / "phase-test")

REAL = pytest.mark.skipif(
    not VIDEOS.exists(), reason="the real videos are not at ../shared/phase-test"
)

Figures = Callable[..., dict[str, Any]]
Run = Callable[..., str]
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def figures(tmp_path: Path, run_script: Run) -> Figures:
    """Run a benchmark with options and return the figures that it writes."""

    def run(script: str, *options: str) -> dict[str, Any]:
        file = tmp_path / "figures.json"
        run_script(BENCHMARKS / script, *options, "--json", str(file))
        report: dict[str, Any] = json.loads(file.read_text())
        return report

    return run


def fails(run_script: Run, capsys: Capture, script: str, *options: str) -> str:
    """Return what a benchmark says that ends with an error."""
    with pytest.raises(SystemExit) as stop:
        run_script(BENCHMARKS / script, *options)
    assert stop.value.code not in (0, None)
    return f"{stop.value.code} {capsys.readouterr().err}"


@pytest.mark.slow
def test_speed_of_one_transition(figures: Figures) -> None:
    report = figures("simulator.py", "--only", "transitions")
    us = report["transition_us_pymunk"], report["transition_us_compiled"]
    assert report["transition_speedup"] == pytest.approx(us[0] / us[1])


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="reads /proc")
def test_memory_that_sets_take(figures: Figures) -> None:
    (row,) = figures("large_sets.py", "--events", "2", "--frames", "34")["sets"]
    assert row["made"] > row["opened"] > 0
    assert row["events"] == 2


def test_sizes_of_the_folders_of_a_package(tmp_path: Path, figures: Figures) -> None:
    package = tmp_path / "thing"
    (package / "part").mkdir(parents=True)
    (package / "__init__.py").write_text('"""Two lines,\nno code."""\n\nX = 1  # one\n"""of X"""\n')
    (package / "part" / "a.py").write_text(
        "def f():\n    # why\n    raise ValueError(\n        1)\n"
    )
    report = figures("house.py", str(package))
    assert report["__init__.py"] == {"files": 1, "lines": 5, "code": 1, "docs": 3}
    assert report["part"] == {"files": 1, "lines": 4, "code": 3, "docs": 0}
    assert report["all"] == {"files": 2, "lines": 9, "code": 4, "docs": 3}


def test_one_behaviour_with_a_changed_planner(figures: Figures) -> None:
    options = ["--only", "chase", "--seeds", "1", "--set", "simulations=60"]
    report = figures("behaviour.py", *options)
    assert report["planner"]["simulations"] == 60
    ((name, found),) = report["behaviours"].items()
    assert (name, found["n"]) == ("chase", 1)
    assert found["successes"] == [bool(found["rate"])]


def test_validity_of_one_kernel(figures: Figures) -> None:
    report = figures("validity.py", "--only", "prior_mh", "--simulations", "1200")
    (name, found), *others = report["kernels"].items()
    assert (name, found["validity"], others) == ("prior_mh", "exact", [])
    assert 0 < found["tv"] < 0.5
    assert 800 < found["simulations"] <= 1200


def test_budget_of_one_kernel(figures: Figures) -> None:
    options = ["--only", "prior_mh", "--budget", "60", "--chains", "4"]
    (name, found), *others = figures("budgets.py", *options)["kernels"].items()
    assert (name, others) == ("prior_mh", [])
    assert 60 <= found["simulations"] < 64
    assert found["frames"] <= 14 * found["simulations"]


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


def test_reference_beside_what_it_says_of_itself(figures: Figures) -> None:
    rows = figures("budgets.py", "--reference", "--trials", "3")["reference"]
    assert {(row["sd"], row["per_pair"]) for row in rows} >= {(0.3, 4), (5.8, 16)}
    for row in rows:
        assert 0 < row["true"] < 1
        assert row["ranked_wrong"] <= row["ranked"]


@REAL
@pytest.mark.slow
def test_one_video_is_filmed_and_read(figures: Figures) -> None:
    report = figures("film.py", "--limit", "1")
    assert report["refused"] == {}
    assert report["position"][0] < 0.08
    assert report["position"][1] < 0.4


def test_answers_called_decided_are_compared_with_the_truth(
    tmp_path: Path, figures: Figures
) -> None:
    post = StepwisePosterior(reading())
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


@pytest.mark.slow
def test_a_few_attacks_of_each_kind_are_withstood(figures: Figures) -> None:
    report = figures("attack.py", "--inputs", "12", "--kills", "2")
    assert report["bad"] == []
    assert sum(report["counts"].values()) == 14
    assert {name.split()[0] for name in report["counts"]} == {
        *("commands", "calls", "flips", "hostile", "kills")
    }


@pytest.mark.slow
def test_calibration_of_a_few_events(tmp_path: Path, figures: Figures) -> None:
    options = ["--events", "2", "--iterations", "8", "--kernel", "prior_mh"]
    image = tmp_path / "ranks.png"
    report = figures("calibration.py", *options, "--figure", str(image))
    ranks = report["ranks"]
    assert {len(values) for values in ranks.values()} == {2}
    assert all(0 <= rank <= 15 for v in ranks.values() for rank in v)
    assert image.stat().st_size > 1000


@pytest.mark.parametrize(
    ("options", "said"),
    [
        # no ranks among draws that are to be weighed
        *(
            (f"calibration.py --events 1 --kernel {kernel}", f"invalid choice: '{kernel}'")
            for kernel in ("importance", "smc", "enumerate")
        ),
        ("behaviour.py --only chase --seeds 1 --set simulation=60", "simulation"),
    ],
)
def test_what_cannot_be_asked_for_is_named(
    options: str, said: str, run_script: Run, capsys: Capture
) -> None:
    assert said in fails(run_script, capsys, *options.split())


def test_events_of_another_world_are_made_and_read(tmp_path: Path, figures: Figures) -> None:
    given = ["--events", "1", "--frames", "40", "--workers", "1", "--out", str(tmp_path / "out")]
    report = figures("worlds.py", *given)
    for name in ("stepwise", "predicate", "last_frame"):
        assert report[name]["n"]["truth"] == report[name]["n_events"] == 1
    assert 0 < report["last_frame"]["probability_of_true_goal"] <= 1
    assert report["stepwise"]["per_frame"]["searches"] > 0
    made = ppl.load_events(tmp_path / "out" / "set")
    assert not any(" away from " in goal for event in made for goal in event.truth.goals.values())


@REAL
def test_replay_of_recovered_actions(figures: Figures) -> None:
    report = figures("realism.py", "replay")
    assert 0 < report["median_error_row5"] < report["median_error_row10"] < 0.2


@REAL
def test_from_each_recorded_state_our_physics_goes_where_the_real_agents_went(
    figures: Figures,
) -> None:
    one, five = (
        figures("realism.py", "ahead", "--half", "first", "--steps", steps) for steps in ("1", "5")
    )
    for situation, row in five["by_situation"].items():
        assert row["only_ours_stuck"] < 0.02, situation
        assert row["median_error"] < 0.2, situation
        assert one["by_situation"][situation]["n"] >= row["n"]
    first, fifth = (found["by_situation"]["free"]["error_90"] for found in (one, five))
    assert first < fifth


@REAL
def test_strengths_of_a_few_videos(figures: Figures) -> None:
    report = figures("strength.py", "--limit", "4", "--draws", "1")
    rows = report["rows"]
    assert {row["estimator"] for row in rows} == {"analytic", "network"}
    assert all(row["share"] == 1 for row in rows if row["estimator"] == "network")


@REAL
def test_learned_proposals_find_the_truth_more_often_than_distances(figures: Figures) -> None:
    report = figures("proposals.py", "--limit", "8", "--forms", "learned", "paper")
    learned, paper = (report[form]["all"] for form in ("learned", "paper"))
    assert learned["log_proposal"]["value"] > paper["log_proposal"]["value"] + 1


@pytest.mark.slow
@REAL
def test_the_filters_keep_what_people_kept_and_no_more_the_stricter_they_are(
    tmp_path: Path, figures: Figures
) -> None:
    planner = PlannerConfig(particles=5, simulations=2, rollout_length=1)
    made = ppl.generate(tmp_path / "set", cells={"chasing": 1}, planner=planner, frames=40, seed=1,
                        keep_rejected=True, workers=1, progress=False)  # fmt: skip
    refused = len(made.rejected())
    assert refused > 0
    report = figures("filters.py", "--generated", str(tmp_path / "set"))
    kept = report["filters"]
    assert all(kept["all"][half]["share"] == 1 for half in ("first", "second"))
    assert kept["opposing"]["generated"] == {"n": 1 + refused, "share": 1 / (1 + refused)}
    assert sum(report["refused"]["generated"].values()) == refused
    nearness = [row for row in report["thresholds"] if row["rule"].startswith("nearest")]
    for half in ("first", "second"):
        shares = [row[half]["share"] for row in nearness]
        assert shares == sorted(shares)
        assert shares[0] < 1
    assert [row["value"] for row in nearness if row["filter"]] == [NEAR]


@pytest.mark.slow
@REAL
def test_what_a_reader_recovers(figures: Figures) -> None:
    report = figures("stepwise.py", "replays", "--limit", "4")
    assert report["alike"] > 0.85
    assert report["actions"] < report["alike"]


@pytest.mark.slow
@REAL
def test_conducts_are_compared_on_readings_that_are_kept(tmp_path: Path, figures: Figures) -> None:
    keep = tmp_path / "kept"
    options = ("--limit", "4", "--keep", str(keep))
    report = figures("stepwise.py", "fit", *options)
    assert len(list(keep.glob("*.pkl"))) >= 4
    steady, wavering = (report[f"4, 4, {lapse}, 1"]["half"] for lapse in (0.1, 0.3))
    assert wavering["relation_log_score"] > steady["relation_log_score"]
    assert figures("stepwise.py", "fit", *options) == report


@pytest.mark.slow
def test_confidence_is_compared_with_accuracy(figures: Figures) -> None:
    report = figures("stepwise.py", "calibration", "--events", "2")
    assert 0 <= report["4, 1"]["goals"] <= 1
    assert report["unexplained"]["0.5"] < report["unexplained"]["0.99"]
    assert 0 <= report["strengths"]["confidence"] <= 1


@pytest.mark.slow
@REAL
def test_predicates_are_chosen_on_the_first_half(figures: Figures) -> None:
    report = figures("predicate.py", "--limit", "4", "--workers", "1")
    scores = [found["log_score"] for found in report["first"]]
    assert len(scores) == len(report["settings"])
    assert report["chosen"] == scores.index(max(scores))
    assert 0 <= report["second"]["goal_accuracy"]["value"] <= 1


@pytest.mark.slow
@REAL
def test_misses_of_an_evaluation_are_judged_once(tmp_path: Path, figures: Figures) -> None:
    events = sorted(ppl.load_events(VIDEOS / "dev.json"), key=lambda e: e.observation.n_frames)
    tiny: dict[str, Any] = {"kernel": "prior_mh", "chains": 2, "budget": ppl.simulations(4)}
    out = tmp_path / "simple"
    quick = {"planner": PlannerConfig(simulations=20), "workers": 1, "progress": False}
    ppl.evaluate(events[:3], "simple", out=out, **quick, **tiny)
    kept = tmp_path / "judged"
    options = [str(out), "--judging-seeds", "1", "--keep", str(kept)]
    report = figures("accuracy.py", *options)
    found = report[str(out)]["weights"]["count"]["all"]
    assert found["n"] == 3
    judged = kept.read_text()
    # two particles of two draws miss something; then truth and answer are judged, and kept
    assert sum(found["misses"].values()) >= 1
    assert len(judged.splitlines()) >= 1 + 2
    assert figures("accuracy.py", *options) == report
    assert kept.read_text() == judged


@REAL
def test_simulations_of_the_truth_are_told_by_their_errors(figures: Figures) -> None:
    options = ["hypotheses", "--truth-only", "--limit", "4", "--noise-seeds", "2"]
    report = figures("realism.py", *options, "--set", "simulations=20")
    assert report["n_videos"] == len(report["videos"]) >= 4
    assert report["log_likelihood"]["value"] < 0 < report["mean_error_per_frame"]["value"]
    assert "true_best_rate" not in report


def hypotheses_report(file: Path, seeds: int = 2, **videos: tuple[list[float], int]) -> str:
    """Write a report of `realism.py hypotheses`: per video errors and wrong pairs above."""
    told = {
        name: {"errors": errors, "frames": 10, "better": [["a", "b", 0.0]] * n}
        for name, (errors, n) in videos.items()
    }
    content = {"true_best_rate": {}, "settings": {"seeds": seeds}, "videos": told}
    file.write_text(json.dumps(content))
    return str(file)


def test_reports_are_compared_video_by_video(tmp_path: Path, figures: Figures) -> None:
    new = hypotheses_report(tmp_path / "new", one=([100.0, 100.0], 0), two=([60.0, 60.0], 0))
    old = hypotheses_report(tmp_path / "old", one=([140.0], 3), two=([60.0], 0))
    report = figures("realism.py", "paired", new, old)
    means = {name: row["value"] for name, row in report.items() if name != "n_videos"}
    # the log-likelihood is -0.05 of the error; one video differs, by 40 units in ten frames
    assert means == pytest.approx(
        {"log_likelihood": 1.0, "mean_error_per_frame": -2.0, "true_best_rate": 0.5}
    )
    # rates of different numbers of seeds are not compared
    old = hypotheses_report(tmp_path / "old", seeds=1, one=([140.0], 3), two=([60.0], 0))
    report = figures("realism.py", "paired", new, old)
    assert set(report) == {"n_videos", "log_likelihood", "mean_error_per_frame"}


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ("{}", "no report"),
        ('{"videos": {}}', "no report"),
        ("[1", "no report"),
        (None, "different videos: two is in one of them"),
    ],
)
def test_reports_that_cannot_be_compared(
    tmp_path: Path, other: str | None, said: str, run_script: Run, capsys: Capture
) -> None:
    new = hypotheses_report(tmp_path / "new", one=([100.0], 0))
    old = hypotheses_report(tmp_path / "old", one=([100.0], 0), two=([60.0], 0))
    if other is not None:
        Path(old).write_text(other)
    assert said in fails(run_script, capsys, "realism.py", "paired", new, old)


def test_missing_videos_are_reported(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "realism.py"), "replay"]
    environment = {**os.environ, "PHASE_TEST": str(tmp_path)}
    result = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert result.returncode == 1
    assert "PHASE_TEST" in result.stderr
