"""The progress bar of a run."""

from __future__ import annotations

import io

import numpy as np
import pytest

from phase_ppl.world import progress
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.progress import WARMING_UP, Progress


def test_the_bar_says_that_it_warms_up_until_the_first_simulation(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with Progress(2, shown=True) as bar:
        waiting = capsys.readouterr().err
        bar.one_more()
        bar.reach(2)
    done = capsys.readouterr().err
    assert WARMING_UP in waiting
    assert "simulating: 100%" in done
    with Progress(1, shown=False) as bar:
        bar.one_more()
    assert capsys.readouterr().err == ""


def test_without_a_console_there_is_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = io.StringIO()
    closed.close()
    for stream in (None, closed):
        monkeypatch.setattr(progress.sys, "stderr", stream)
        for shown in (None, True, False):
            with Progress(1, shown=shown) as bar:
                bar.one_more()


def test_the_rate_is_of_what_was_simulated_here_without_the_compiling(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(progress.Bar, "_time", lambda *_: now, raising=False)
    monkeypatch.setattr(progress.sys, "stderr", io.StringIO())
    with Progress(30, shown=True, done=20) as bar:
        bar._time = lambda: now
        now = 30.0  # compiling
        for _ in range(5):
            bar.one_more()
            now += 3.0
        bar.refresh()
        told = progress.sys.stderr.getvalue().split("\r")[-1]  # type: ignore[attr-defined]
        assert "25/30" in told
        assert "3.75s/sim" in told
        bar.expect(40)
        bar.reach(40)
        assert bar.n == 40


def test_whether_there_is_a_bar_is_yes_or_no() -> None:
    for odd in ("no", np.array([1, 2]), [True]):
        with pytest.raises(InvalidSettingError, match="expected True, False or None"):
            progress.progress_is_shown(odd)  # type: ignore[arg-type]
