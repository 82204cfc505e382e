"""The progress bar of a run."""

from __future__ import annotations

import io

import pytest

from phase_ppl.world import progress
from phase_ppl.world.progress import WARMING_UP, Progress


def test_the_bar_warms_up_until_the_first_simulation(capsys: pytest.CaptureFixture[str]) -> None:
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
