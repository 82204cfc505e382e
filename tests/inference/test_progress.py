"""The progress bar of a run."""

from __future__ import annotations

import pytest

from phase_ppl.inference.progress import WARMING_UP, Progress


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


def test_a_hidden_bar_writes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(1, shown=False) as bar:
        bar.one_more()
    assert capsys.readouterr().err == ""
