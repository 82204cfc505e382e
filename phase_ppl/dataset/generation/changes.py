"""The same situation elsewhere: in a layout of the same kind, or with sizes and strengths moved.

A family is asked to draw once more, and gets the choices of the earlier draw, in the other layout
or with every size and strength one id further. Where it was not offered such a choice, its rules do
not hold, and there is no such situation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.dataset.generation.families import Family
from phase_ppl.dataset.generation.situation import (
    LAYOUTS_OF_A_KIND,
    NUMBER,
    SIZES,
    SPOTS,
    CannotDraw,
    Draw,
    Situation,
)
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.hypothesis import STRENGTH_LEVELS

STEPS: Final = {"up": 1, "down": -1}
"""How far ids of sizes and strengths are moved; ids are not turned over at the ends."""

MOST_CHANGES: Final = max(map(len, LAYOUTS_OF_A_KIND)) - 1 + len(STEPS)
"""Changes that any situation has at most."""


class Change(NamedTuple):
    """What differs from the situation that was drawn first."""

    layout: int  # number of the layout
    ids: int = 0  # by how much all ids of sizes and strengths are moved: 0, 1 or -1

    @property
    def name(self) -> str:
        """A short name, such as "layout-17" or "ids-up"."""
        ways = {step: way for way, step in STEPS.items()}
        return f"ids-{ways[self.ids]}" if self.ids else f"layout-{self.layout}"


def changed(
    family: Family, variant: str | None, situation: Situation
) -> list[tuple[Change, Situation]]:
    """Return all situations that are a situation in another layout, or with ids moved by one.

    Goals, alpha and all places and angles at the start are those of the first.
    """
    kinds = [kind for kind in LAYOUTS_OF_A_KIND if situation.layout in kind]
    changes = [
        *(Change(layout) for kind in kinds for layout in kind
          if layout != situation.layout and layout in family.layouts),
        *(Change(situation.layout, step) for step in STEPS.values()),
    ]  # fmt: skip
    found = ((change, _redrawn(family, variant, situation, change)) for change in changes)
    return [(change, other) for change, other in found if other is not None]


def _redrawn(
    family: Family, variant: str | None, situation: Situation, change: Change
) -> Situation | None:
    sizes = _moved(situation.scene.radius.tolist(), SIZES, change.ids)
    strengths = _moved(situation.hypothesis.strengths, STRENGTH_LEVELS, change.ids)
    if sizes is None or strengths is None:
        return None
    try:
        found = family.drawn_with(_Redraw(situation, change), variant)
    except CannotDraw:
        return None
    # what a family fixes is not moved, and what it draws elsewhere than from a Draw is drawn anew
    before, after = situation.hypothesis, found.hypothesis
    same = (
        (before.goal_red, before.goal_green, before.alpha)
        == (after.goal_red, after.goal_green, after.alpha)
        and np.array_equal(found.scene.start, situation.scene.start)
        and found.scene.radius.tolist() == sizes
        and list(after.strengths) == strengths
    )
    return found if same else None


def _moved(values: Sequence[float], levels: Sequence[float], by: int) -> list[float] | None:
    """Return values so many ids further; None where one is not a level, or there is none."""
    if not by:
        return list(values)
    ids = [levels.index(value) + by if value in levels else -1 for value in values]
    return [levels[i] for i in ids] if all(0 <= i < len(levels) for i in ids) else None


class _Redraw(Draw):
    """A draw that makes the choices of an earlier one, but for a change."""

    def __init__(self, earlier: Situation, change: Change) -> None:
        super().__init__(np.random.default_rng(0), change.layout, earlier.scene.turning)
        self._left = deque(earlier.choices)
        self._start = earlier.scene.start
        self._ids = change.ids

    def _value(self, kind: str, options: Sequence[int]) -> int:
        if not self._left or self._left[0].kind != kind:
            raise CannotDraw
        value = self._left.popleft().value + (0 if kind == NUMBER else self._ids)
        if value not in options:
            raise CannotDraw
        return value

    def _arrangements(
        self, rooms: Sequence[int], at: Mapping[int, tuple[float, float]]
    ) -> Iterator[FloatArray]:
        for entity, room in enumerate(rooms):
            places = (at[entity],) if entity in at else SPOTS[room]
            if tuple(self._start[entity, :2]) not in places:
                return
        yield self._start


def described(change: Change, situation: Situation) -> dict[str, Any]:
    """Return as plain data how a change differs from the situation that was drawn first."""
    if change.ids:
        return {"ids_moved_by": change.ids}
    return {"layout_before": situation.layout}
