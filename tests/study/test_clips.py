"""The little films of the introduction show what their pages say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.world.scene import check_inside
from phase_study.clips import CLIPS, make_clips
from tests.study.studies import EMPTY, NURSERY, STILL

RED, GREEN, BLUE, PINK = range(4)
TRACKS = {name: clip.trajectory(clip.scene()) for name, clip in CLIPS.items()}


def way(name: str, entity: int) -> float:
    return float(np.linalg.norm(np.diff(TRACKS[name][:, entity, :2], axis=0), axis=1).sum())


def test_films_show_what_their_pages_say() -> None:
    for name, clip in CLIPS.items():
        check_inside(TRACKS[name], clip.scene(), name)
    for agent in (RED, GREEN):
        assert way("moving", agent) > 3
        assert np.ptp(TRACKS["moving"][:, agent, 2]) > 0.5
    for item in (BLUE, PINK):
        assert way("moving", item) == 0
    assert 14 < TRACKS["walls"][:, RED, 0].max() < 16, "it tried to pass through the wall"
    track = TRACKS["carrying"]
    assert way("carrying", BLUE) > 3
    assert np.linalg.norm(track[-1, BLUE, :2] - track[-1, RED, :2]) > 4, "what is let go of stays"
    assert way("carrying", PINK) < 0.1
    assert way("weight", BLUE) > 1.5 * way("weight", PINK) > 0.5, "the larger item is harder"


def test_films_are_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phase_study.clips.CLIPS", {"moving": STILL})
    make_clips(tmp_path / "clips")
    assert (tmp_path / "clips" / "moving.mp4").stat().st_size > 500


@pytest.mark.parametrize("world", [ppl.worlds.SOLO, ppl.worlds.TRIO, NURSERY, EMPTY])
def test_films_of_other_worlds_show_their_agents_move(
    world: ppl.World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = {}

    def film(observed: ppl.Observation, path: Path, scene: ppl.Scene, **given: Any) -> None:
        shown[path.name] = given
        assert scene.world == world
        track = observed.trajectory[:, : len(world.agents), :2]
        assert (np.linalg.norm(np.diff(track, axis=0), axis=-1).sum(axis=0) > 1).all()

    monkeypatch.setattr("phase_ppl.render.video", film)
    make_clips(tmp_path, world)
    assert shown == {
        "moving.mp4": {"fields_of_view": False}, "sight.mp4": {"fields_of_view": True}
    }  # fmt: skip
