"""The little films of the introduction show what their pages say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.study.clips import CLIPS, make_clips
from phase_ppl.study.settings import KINDS, Settings, template
from phase_ppl.world.scene import check_inside
from tests.study.studies import EMPTY, NURSERY, STILL

RED, GREEN, BLUE, PINK = range(4)
TRACKS = {name: clip.trajectory(clip.scene()) for name, clip in CLIPS.items()}


def way(name: str, entity: int) -> float:
    """How far an entity gets."""
    return float(np.linalg.norm(np.diff(TRACKS[name][:, entity, :2], axis=0), axis=1).sum())


def test_everybody_stays_in_the_arena() -> None:
    for name, clip in CLIPS.items():
        check_inside(TRACKS[name], clip.scene(), name)


def test_agents_move_and_turn() -> None:
    for agent in (RED, GREEN):
        assert way("moving", agent) > 3
        assert np.ptp(TRACKS["moving"][:, agent, 2]) > 0.5
    for item in (BLUE, PINK):
        assert way("moving", item) == 0


def test_nothing_passes_through_a_wall() -> None:
    assert 14 < TRACKS["walls"][:, RED, 0].max() < 16, "it tried"


def test_an_item_that_is_let_go_stays() -> None:
    track = TRACKS["carrying"]
    assert way("carrying", BLUE) > 3
    assert np.linalg.norm(track[-1, BLUE, :2] - track[-1, RED, :2]) > 4
    assert way("carrying", PINK) < 0.1


def test_the_larger_item_is_harder_to_move() -> None:
    assert way("weight", BLUE) > 1.5 * way("weight", PINK) > 0.5


def test_every_page_has_a_film_that_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phase_ppl.study.clips.CLIPS", dict.fromkeys(CLIPS, STILL))
    make_clips(tmp_path / "clips")
    for kind in KINDS:
        for _, clip in Settings.parse(template(kind, "x")).tutorial:
            assert not clip or (tmp_path / "clips" / f"{clip}.mp4").stat().st_size > 500


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

    monkeypatch.setattr("phase_ppl.study.clips.render.video", film)
    make_clips(tmp_path, world)
    assert shown == {
        "moving.mp4": {"fields_of_view": False}, "sight.mp4": {"fields_of_view": True}
    }  # fmt: skip
