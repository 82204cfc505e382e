"""The terminal: what it writes, and one clear line with exit code 2 for bad input."""

from __future__ import annotations

import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from phase_ppl.cli import main
from phase_ppl.world.goals import GOALS

TINY = ["--chains", "2", "--iterations", "1", "--workers", "1", "--quiet"]


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the only line of an error with exit code 2."""
    try:
        code = main(list(arguments))
    except SystemExit as stop:
        code = stop.code
    written = capsys.readouterr()
    assert code == 2
    assert written.err.count("\n") == 1
    assert "Traceback" not in written.err
    return written.err


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    assert main(["infer", "collaborate", *TINY, "--out", str(out)]) == 0
    return out


def test_infer_writes_posterior_summary_figure_and_film(results: Path) -> None:
    for name in ("posterior.nc", "summary.json", "posterior.png", "replay.mp4"):
        assert (results / name).stat().st_size > 1000


def test_summary_has_all_its_parts(results: Path) -> None:
    summary = json.loads((results / "summary.json").read_text())
    assert set(summary) >= {
        *("goals", "relation", "scenario", "strengths", "map", "diagnostics", "settings", "cost"),
    }
    for agent in ("red agent", "green agent"):
        assert set(summary["goals"][agent]) == set(GOALS)
        assert sum(summary["goals"][agent].values()) == pytest.approx(1)
    assert set(summary["cost"]) >= {"simulations", "seconds", "workers", "host"}
    assert "workers" not in json.dumps(summary["settings"])


def test_the_same_seed_gives_the_same_summary_with_one_and_with_two_workers(
    results: Path, tmp_path: Path
) -> None:
    tiny = [*TINY]
    tiny[tiny.index("--workers") + 1] = "2"
    assert main(["infer", "collaborate", *tiny, "--out", str(tmp_path)]) == 0
    one, two = (json.loads((p / "summary.json").read_text()) for p in (results, tmp_path))
    for summary in (one, two):
        del summary["cost"]
    assert one == two


def test_compare_writes_table_and_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = ["--budget", "4", "--repeats", "1", "--chains", "2", "--workers", "1", "--quiet"]
    kernels = ["--kernels", "prior_mh", "--reference", "prior_mh"]
    assert main(["compare", "collaborate", *kernels, *tiny, "--out", str(tmp_path)]) == 0
    assert "TV goals" in capsys.readouterr().out
    assert (tmp_path / "comparison.png").stat().st_size > 1000
    record = json.loads((tmp_path / "comparison.json").read_text())
    assert record["runs"]["kernel"] == ["prior_mh"]


def test_simulate_and_render_write_files(tmp_path: Path) -> None:
    goals = ["--goal-red", "Get red agent to red lm", "--goal-green", "get to red agent"]
    event = tmp_path / "event.json"
    assert main(["simulate", "collaborate", *goals, "--frames", "4", "--out", str(event)]) == 0
    film = tmp_path / "film.mp4"
    assert main(["render", str(event), "--out", str(film)]) == 0
    assert film.stat().st_size > 1000


@pytest.mark.parametrize("command", [[], ["infer"], ["simulate"], ["render"], ["compare"]])
def test_help_gives_an_example(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    assert "example: phase-ppl" in capsys.readouterr().out


class TestBadInput:
    def test_unknown_goal_names_close_ones(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        error = fails(
            capsys,
            *("simulate", "collaborate", "--goal-red", "Get blue item to red landmark"),
            *("--goal-green", "get to red agent", "--out", str(tmp_path / "x.json")),
        )
        assert "Get blue item to red lm" in error

    def test_unknown_file(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert "nowhere.json" in fails(capsys, "infer", "nowhere.json")

    def test_unknown_video(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert "'other'" in fails(capsys, "infer", "collaborate", "--video", "other")

    def test_a_pickle_is_refused_unread(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        trap, path = tmp_path / "sprung", tmp_path / "event.json"

        class Trap:
            def __reduce__(self) -> tuple[object, tuple[object, ...]]:
                return Path.touch, (trap,)

        path.write_bytes(pickle.dumps(Trap()))
        assert "pickle" in fails(capsys, "infer", str(path))
        assert not trap.exists()

    def test_unknown_kernel(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert "'local_mh'" in fails(capsys, "infer", "collaborate", "--kernel", "local_hm")

    @pytest.mark.parametrize("option", ["--workers", "--chains", "--iterations"])
    def test_zero_of_something(self, option: str, capsys: pytest.CaptureFixture[str]) -> None:
        error = fails(capsys, "infer", "collaborate", option, "0")
        assert option in error
        assert "at least 1" in error

    def test_an_output_folder_that_cannot_be_written(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        (tmp_path / "file").write_text("")
        error = fails(capsys, "infer", "collaborate", "--out", str(tmp_path / "file" / "out"))
        assert "cannot write" in error

    def test_an_output_of_another_kind(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        assert ".mp4" in fails(capsys, "render", "collaborate", "--out", str(tmp_path / "x.avi"))

    def test_unknown_prior(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert "'uniform'" in fails(capsys, "infer", "collaborate", "--prior", "unifrom")

    @pytest.mark.parametrize(
        ("kernels", "message"),
        [
            ("local_mh,prior_hm", "'prior_mh'"),
            ("local_mh,", "different names"),
            ("local_mh:rule", "OPTION=VALUE"),
            ("local_mh:rule=papr", "'paper'"),
        ],
    )
    def test_kernels_that_cannot_be_compared(
        self, kernels: str, message: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert message in fails(capsys, "compare", "collaborate", "--kernels", kernels)

    def test_no_command(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert "COMMAND" in fails(capsys)


def _is_gone_within(group: int, seconds: float) -> bool:
    """Whether no process of a group is left after a while."""
    for _ in range(int(seconds * 10)):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.skipif(os.name != "posix", reason="sends a signal to a process group")
def test_ctrl_c_stops_soon_leaves_no_worker_and_keeps_what_was_done(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "phase_ppl.cli", "infer", "oppose", "--workers", "2"]
    run = subprocess.Popen(
        [*command, "--iterations", "500", "--chains", "2", "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert run.stderr is not None
    seen = ""
    # the bar counts simulations: past the two initial ones and the first iteration
    while not re.search(r"\b(5|6|7|8|9)/1002", seen) and run.poll() is None:
        seen += run.stderr.read(1)
    os.killpg(run.pid, signal.SIGINT)
    output, errors = run.communicate(timeout=60)
    assert run.returncode == 130, errors
    assert "interrupted" in errors
    assert "goal" in output.lower() or "red agent" in output
    assert (tmp_path / "posterior.nc").exists()
    assert _is_gone_within(run.pid, seconds=15)
