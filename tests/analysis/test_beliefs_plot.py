"""The figure of how a belief changes with what is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.figures.beliefs import beliefs_of, discovery
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.evaluation.toys import still

EVENT = ppl.load_event("collaborate")


def test_what_is_seen_is_as_it_is_in_all_particles_and_the_rest_differs() -> None:
    for frame, belief in enumerate(beliefs_of(EVENT, 0, 10)):
        truth = EVENT.observation.trajectory[frame]
        assert belief.observed[0], "an agent knows itself"
        seen = belief.particles[:, belief.observed, :2]
        np.testing.assert_allclose(seen, np.broadcast_to(truth[belief.observed, :2], seen.shape))
        for entity in np.flatnonzero(~belief.observed):
            assert np.ptp(belief.particles[:, entity, :2], axis=0).max() > 1
        if frame == 12:
            return


def test_it_shows_the_frame_in_which_something_new_is_seen(tmp_path: Path) -> None:
    file = tmp_path / "beliefs.png"
    figure = ppl.plot.beliefs(EVENT, path=file)
    assert file.stat().st_size > 20_000
    assert len(figure.axes) == 6
    said = figure.get_supxlabel()
    found = list(beliefs_of(EVENT, 0, 10))
    first = discovery(found)
    assert first is not None
    new = np.flatnonzero(found[first].observed & ~found[first - 1].observed)
    before = found[first - 1].particles[:, new, :2]
    assert np.ptp(before, axis=0).max() > 4, "it did not know where to look"
    assert discovery(found[:first]) is None, "it is the first"
    names = ("red agent", "green agent", "blue item", "pink item")
    assert all(names[entity] in said for entity in new)
    assert f"{first / 12:.2f} s" in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="agent 'red'"):
        ppl.plot.beliefs(EVENT, "red")
    with pytest.raises(InvalidSettingError, match="frame=0"):
        ppl.plot.beliefs(EVENT, frame=0)
    with pytest.raises(InvalidSettingError, match="sees nothing new"):
        ppl.plot.beliefs(still(n_frames=3))
    with pytest.raises(InvalidSettingError, match=r"expected a phase_ppl\.Event"):
        ppl.plot.beliefs("collaborate")  # type: ignore[arg-type]
