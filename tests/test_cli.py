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
from typing import Any

import pytest

import phase_ppl
from phase_ppl.cli import main
from phase_ppl.world.goals import GOALS
from tests.inference.toy import walkers, walking_event

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
    assert not (out / "run.ckpt").exists()
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
    assert main(["infer", "collaborate", *tiny, "--out", str(tmp_path), "--keep-checkpoint"]) == 0
    one, two = (json.loads((p / "summary.json").read_text()) for p in (results, tmp_path))
    for summary in (one, two):
        del summary["cost"]
    assert one == two

    assert (tmp_path / "run.ckpt").exists()


def test_resume_extends_a_run_beside_its_file_and_then_deletes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(phase_ppl.Model, "build_simulator", lambda self: walkers)
    event, out = tmp_path / "walk.json", tmp_path / "out"
    phase_ppl.save_event(walking_event(), event)
    tiny = ["--workers", "1", "--quiet"]
    kernel = ["--kernel", "prior_mh", "--option", "early_reject=false", "--chains", "4"]
    length = ["--budget", "8", "--keep-checkpoint"]
    assert main(["infer", str(event), *tiny, *kernel, *length, "--out", str(out)]) == 0
    assert "unfinished run" in fails(capsys, "infer", str(event), "--out", str(out))
    file = out / "run.ckpt"
    assert "too small" in fails(capsys, "resume", str(file), "--budget", "4", *tiny)
    assert main(["resume", str(file), "--iterations", "2", *tiny]) == 0
    assert not file.exists()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["settings"]["iterations"] == 2
    assert summary["settings"]["kernel"] == {"name": "prior_mh", "early_reject": False}
    assert summary["cost"]["calls"] == 2


def test_a_failed_simulation_that_ends_the_run_leaves_results_and_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []

    def fails_later(*given: Any) -> Any:
        calls.append(1)
        if len(calls) == 6:
            raise ValueError("not today")
        yield from walkers(*given)

    monkeypatch.setattr(phase_ppl.Model, "build_simulator", lambda self: fails_later)
    event, out = tmp_path / "walk.json", tmp_path / "out"
    phase_ppl.save_event(walking_event(), event)
    tiny = ["--workers", "1", "--quiet"]
    more = ["--kernel", "prior_mh", "--chains", "4", "--on-failure", "raise", "--out", str(out)]
    assert main(["infer", str(event), *tiny, *more]) == 2
    written = capsys.readouterr()
    assert "not today" in written.err
    assert "Go on with: phase-ppl resume" in written.out
    assert (out / "posterior.nc").exists()
    assert main(["resume", str(out / "run.ckpt"), "--iterations", "1", *tiny]) == 0


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


@pytest.mark.parametrize(
    "command", [[], ["infer"], ["resume"], ["simulate"], ["render"], ["compare"], ["describe"]]
)
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

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--budget", "60m"], "seconds, as in 60s"),
            (["--budget", "0s"], "seconds, as in 60s"),
            (["--budget", "29"], "need 30"),
            (["--budget", "60s", "--iterations", "2"], "not allowed"),
            (["--option", "rule"], "NAME=VALUE"),
            (["--option", "chains=3"], "no option of a kernel"),
            (["--option", "rule=paper", "--option", "rule=exact"], "given twice"),
            (["--option", "rule=papr"], "'paper'"),
            (["--retries", "2"], "on_failure='retry'"),
        ],
    )
    def test_settings_of_a_run(
        self, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert message in fails(capsys, "infer", "collaborate", "--quiet", *arguments)

    def test_a_file_that_is_no_run(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        (tmp_path / "run.ckpt").write_bytes(b"PK\x03\x04 and no more")
        assert "no checkpoint" in fails(capsys, "resume", str(tmp_path / "run.ckpt"))

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
    assert (tmp_path / "run.ckpt").exists()
    assert "Go on with: phase-ppl resume" in output
    assert _is_gone_within(run.pid, seconds=15)
