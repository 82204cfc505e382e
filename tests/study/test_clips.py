"""The little films of the introduction show what their pages say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phase_ppl.physics.actions import Action
from phase_ppl.study.clips import CLIPS, Clip, make_clips
from phase_ppl.study.settings import Settings, template
from phase_ppl.world.scene import check_inside

RED, GREEN, BLUE, PINK = range(4)


def way(name: str, entity: int) -> float:
    """How far an entity gets."""
    track = CLIPS[name].trajectory()[:, entity, :2]
    return float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())


@pytest.mark.parametrize("name", CLIPS)
def test_everybody_stays_in_the_arena(name: str) -> None:
    clip = CLIPS[name]
    check_inside(clip.trajectory(), clip.scene, name)


def test_agents_move_and_turn() -> None:
    for agent in (RED, GREEN):
        assert way("moving", agent) > 3
        assert np.ptp(CLIPS["moving"].trajectory()[:, agent, 2]) > 0.5
    for item in (BLUE, PINK):
        assert way("moving", item) == 0


def test_nothing_passes_through_a_wall() -> None:
    track = CLIPS["walls"].trajectory()
    assert track[:, RED, 0].max() < 16
    assert track[:, RED, 0].max() > 14, "it tried"


def test_an_item_that_is_let_go_stays() -> None:
    track = CLIPS["carrying"].trajectory()
    assert way("carrying", BLUE) > 3
    assert np.linalg.norm(track[-1, BLUE, :2] - track[-1, RED, :2]) > 4
    assert way("carrying", PINK) < 0.1


def test_the_larger_item_is_harder_to_move() -> None:
    assert way("weight", BLUE) > 1.5 * way("weight", PINK) > 0.5


def test_every_page_has_a_film_that_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = [(Action.NO_FORCE, 1)]
    still = Clip(CLIPS["moving"].start, short, short)
    monkeypatch.setattr("phase_ppl.study.clips.CLIPS", dict.fromkeys(CLIPS, still))
    make_clips(tmp_path / "clips")
    for kind in ("judgment", "tagging", "likeness", "play"):
        for _, clip in Settings.parse(template(kind, "x")).tutorial:
            assert not clip or (tmp_path / "clips" / f"{clip}.mp4").stat().st_size > 500
