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


def test_uneven_simulations_give_a_steady_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(progress, "clock", lambda: now)
    # rounds of four: two stopped at once, the others in one burst after ten seconds
    with Progress(40, shown=False, batch=4) as bar:
        estimates = []
        now = 30.0  # compiling
        for done in range(1, 10):
            bar.one_more()
            bar.one_more()
            estimates.append(bar.seconds_left())
            now += 10.0
            bar.one_more()
            bar.one_more()
            estimates.append(bar.seconds_left())
            if done > 2:  # what comes before still has the compiling in it
                left = 10.0 * (10 - done)
                before, after = estimates[-2:]
                assert after == pytest.approx(left, rel=0.35)
                assert before == pytest.approx(left + 10, rel=0.5)
    assert estimates[0] is None
    # what was done before is counted, but not its time
    with Progress(30, shown=False, done=20, batch=2) as bar:
        for _ in range(4):
            now += 3.0
            bar.one_more()
        assert bar.seconds_left() == pytest.approx(18.0)
        bar.expect(40)
        assert bar.seconds_left() == pytest.approx(48.0)
        bar.reach(40)
        assert bar.seconds_left() == 0


def test_whether_there_is_a_bar_is_yes_or_no() -> None:
    for odd in ("no", np.array([1, 2]), [True]):
        with pytest.raises(InvalidSettingError, match="expected True, False or None"):
            progress.is_shown(odd)  # type: ignore[arg-type]
