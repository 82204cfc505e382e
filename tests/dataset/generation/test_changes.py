"""The same situation in another layout, or with sizes and strengths moved by one."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.dataset.generation import families
from phase_ppl.dataset.generation.changes import MOST_CHANGES, Change, changed
from phase_ppl.dataset.generation.families import family_and_variant, register_family
from phase_ppl.dataset.generation.situation import (
    LAYOUTS_OF_A_KIND,
    SIZES,
    Draw,
    Situation,
    overlaps,
    walls_of,
)
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from tests.dataset.generation.test_situations import CELLS, FREE, rooms_of, situations

SIZE_ID = {size: number for number, size in enumerate(SIZES)}
STRENGTH_ID = {force: number for number, force in enumerate(STRENGTH_LEVELS)}


def changes(cell: str, situation: Situation) -> dict[str, Situation]:
    family, variant = family_and_variant(cell)
    found = changed(family, variant, situation)
    assert len(found) <= MOST_CHANGES
    return {change.name: other for change, other in found}


def ids(situation: Situation) -> list[int]:
    sizes = [SIZE_ID[size] for size in situation.scene.radius.tolist()]
    return sizes + [STRENGTH_ID[force] for force in situation.hypothesis.strengths]


@pytest.mark.parametrize("cell", CELLS)
def test_a_changed_situation_differs_in_one_thing(cell: str) -> None:
    for first in situations(cell):
        for name, other in changes(cell, first).items():
            assert np.array_equal(other.scene.start, first.scene.start)
            assert other.hypothesis.effective_goals == first.hypothesis.effective_goals
            assert other.hypothesis.alpha == first.hypothesis.alpha
            assert other.scene.turning == first.scene.turning
            assert np.array_equal(other.scene.walls, walls_of(other.layout))
            assert not overlaps(other.scene.start, other.scene.radius, other.scene.walls)
            if name.startswith("layout"):
                assert ids(other) == ids(first)
                assert name == f"layout-{other.layout}"
                (kind,) = (kind for kind in LAYOUTS_OF_A_KIND if first.layout in kind)
                assert other.layout in set(kind) - {first.layout}
            else:
                step = {"ids-up": 1, "ids-down": -1}[name]
                assert ids(other) == [number + step for number in ids(first)]
                assert other.layout == first.layout


@pytest.mark.parametrize("cell", CELLS)
def test_there_is_a_changed_situation_in_every_layout_of_the_kind(cell: str) -> None:
    seen = 0
    for first in situations(cell):
        kind = next((kind for kind in LAYOUTS_OF_A_KIND if first.layout in kind), ())
        found = {other.layout for name, other in changes(cell, first).items() if "layout" in name}
        assert found == set(kind) - {first.layout}
        seen += bool(found)
    assert seen > 3


def test_ids_are_moved_only_where_the_rules_of_the_family_hold() -> None:
    # all of them fix a size, or the strength of an agent
    for cell in ("help_blocked", "help_lift", "help_move"):
        for first in situations(cell):
            assert not any("ids" in name for name in changes(cell, first))
    moved = 0
    for first in situations("collab", 400):
        for name, other in changes("collab", first).items():
            if "ids" not in name:
                continue
            moved += 1
            red, green, item, _ = rooms_of(other)
            assert other.hypothesis.strength_red == other.hypothesis.strength_green
            for agent, room in ((0, red), (1, green)):
                if other.scene.radius[agent] > SIZES[0]:
                    assert tuple(sorted((room, item))) in FREE[other.layout]
    assert moved > 5


def test_places_have_to_be_in_the_rooms_of_the_family(monkeypatch: pytest.MonkeyPatch) -> None:
    available = families.available_families()
    monkeypatch.setattr(families.FAMILIES, "entries", dict(families.FAMILIES.entries))
    assert "elsewhere" not in available
    goal = "Get red agent to blue lm"

    @register_family("elsewhere", scenario="collaborative", layouts=[4, 8])
    def elsewhere(draw: Draw) -> Situation:
        red = 2 if draw.layout == 4 else 1
        return draw.situation((goal, goal), (0, 0), (red, 2, 3, 3), (0.8,) * 4, (300.0, 300.0))  # type: ignore[arg-type]

    @register_family("by_itself", scenario="collaborative", layouts=[4, 8])
    def by_itself(draw: Draw) -> Situation:
        size = float(draw.rng.uniform(0.5, 1.0))
        return draw.situation((goal, goal), (0, 0), (1, 2, 3, 3), (size,) * 4, (300.0, 300.0))  # type: ignore[arg-type]

    assert all(not changes("elsewhere", first) for first in situations("elsewhere"))
    assert all(not changes("by_itself", first) for first in situations("by_itself"))


def test_a_situation_that_no_draw_made_has_no_changes() -> None:
    first = situations("chasing", 1)[0]
    family, _ = family_and_variant("chasing")
    assert changed(family, None, Situation(first.scene, first.hypothesis, 8)) == []


def test_changes_are_named() -> None:
    assert [Change(17).name, Change(4, 1).name, Change(4, -1).name] == [
        "layout-17", "ids-up", "ids-down",
    ]  # fmt: skip
