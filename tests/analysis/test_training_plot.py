"""The figure of a training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import OutputError


def report(variant: str = "extended", networks: int = 2) -> dict[str, Any]:
    """Return a report with curves that end at different epochs."""
    names = ["training", "validation", "relation"] + ["goals"] * (variant == "extended")
    return {
        "settings": {"variant": variant},
        "data": {"events": {"train": 320, "validation": 80, "test": 100}},
        "members": [
            {
                "best_epoch": 2,
                "curves": {name: [0.3 + 0.1 * i, 0.5, 0.4][: 2 + i] for name in names},
            }
            for i in range(networks)
        ],
    }


@pytest.mark.parametrize(("variant", "lines"), [("extended", 4), ("original", 3)])
def test_every_network_has_its_curves_and_the_epoch_that_was_kept(variant: str, lines: int) -> None:
    figure = ppl.plot.training_curves(report(variant))
    drawn = [line for axes in figure.axes for line in axes.lines]
    assert len([line for line in drawn if line.get_marker() == "None"]) == 2 * lines
    kept = [line for line in drawn if line.get_marker() == "o"]
    assert [line.get_xdata()[0] for line in kept] == [2] * 2 * (lines - 1)
    assert [line.get_ydata()[0] for line in kept] == [0.5] * 2 * (lines - 1)
    labels = [text.get_text() for axes in figure.axes for text in axes.get_legend().get_texts()]
    assert len(labels) == lines


def test_it_says_what_was_trained_on_what_and_is_written(tmp_path: Path) -> None:
    figure = ppl.plot.training_curves(report(networks=1), tmp_path / "curves.pdf")
    title = figure.texts[0].get_text()
    assert title == "SocialGNN, extended: 1 network, 320 training and 80 validation events"
    assert (tmp_path / "curves.pdf").stat().st_size > 1000
    with pytest.raises(OutputError, match=r"curves\.txt"):
        ppl.plot.training_curves(report(), tmp_path / "curves.txt")
