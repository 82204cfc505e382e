"""Plans of data sets: numbers of events of each kind, splits, and looks.

A *slot* is one event to be made. It depends on the plan and its number only. So it is the same
whichever events are made before it or beside it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from phase_ppl.agents.config import PlannerConfig
from phase_ppl.data.generation.families import Family, cells_of, family_of
from phase_ppl.data.generation.situation import PHASE500, tables_of
from phase_ppl.simulator.joint import JointSimulator
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidSettingError,
    check_memory,
    check_name,
    instance_of,
    nonnegative_number,
    shown,
    whole_number,
)
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.identity import qualified_name, source_hash, stable
from phase_ppl.world.scene import PHASE, TURNINGS, Turning, World, world_in_files

SPLITS: Final[Mapping[str, int]] = {"train": 320, "validation": 80, "test": 100}
"""Shares of the splits, as in the paper."""

UNCHANGED: Final = "none"

REFLECTION_SHARES: Final[Mapping[str, float]] = {
    UNCHANGED: 0.25, "up-down": 0.12, "left-right": 0.18, "about y=x": 0.21, "about y=-x": 0.24,
}  # fmt: skip
"""How often the original test videos are reflected, and how."""

_EVENT_BYTES: Final = 20_000
_FRAME_BYTES: Final = 600
"""Bytes of memory for an event that is assembled, and for each of its frames."""

MOST_TRIES: Final = 1000  # in worlds other than PHASE, where each try has its own number

DrawRoles = Callable[[World, int], Hypothesis | None]
"""``(world, seed)`` -> hypothesis, as :func:`phase_ppl.roles.draw`; None: draw anew."""


def is_as_before(world: World) -> bool:
    """Whether numbers and files must equal those of versions that knew PHASE only."""
    return world_in_files(world) is None


class Look(NamedTuple):
    """The reflection and colours of a recording."""

    reflection: str  # a name of ``REFLECTION_SHARES``
    agents: bool  # whether the colours of the agents are exchanged; ``items``: of the items
    items: bool


class Slot(NamedTuple):
    """An event to be made, with its copies."""

    number: int  # from 0
    # FAMILY or FAMILY:VARIANT, or ``cell_of`` the world for random scenes
    cell: str
    split: str  # name of the split that it and its copies belong to

    @property
    def name(self) -> str:
        """The id of its event; those of copies have a dot and a number after it."""
        return f"{self.cell.replace(':', '-')}-{self.number:05d}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """The settings of :func:`phase_ppl.generate`."""

    cells: Mapping[str, int] = dataclasses.field(default_factory=lambda: dict(PHASE500))
    splits: Mapping[str, float] = dataclasses.field(default_factory=lambda: dict(SPLITS))
    copies: int = 0
    turning: Turning = "both"  # the original events have only "ccw", before any reflection
    frames: int = 101
    planner: str | PlannerConfig = "fast"
    seed: int = 0
    max_tries: int = 200
    world: World = PHASE
    roles: DrawRoles | None = None

    def __post_init__(self) -> None:
        for given in ("cells", "splits"):
            instance_of(given, getattr(self, given), Mapping, "a mapping from names to numbers")
        spread = Counter[str]()
        for cell, n in self.cells.items():
            of_each = dict.fromkeys(cells_of(cell, self.world), 1.0)
            spread.update(apportioned(whole_number(cell, n, 0), of_each))
        object.__setattr__(self, "cells", dict(spread))
        if self.roles is not None and not callable(self.roles):
            raise InvalidSettingError(
                f"roles={shown(self.roles)}, expected a function (world, seed) such as "
                "phase_ppl.roles.draw"
            )
        if not sum(self.cells.values()):
            raise InvalidSettingError("the plan holds no events")
        for name, share in self.splits.items():
            nonnegative_number(f"split {name}", share)
        if not sum(self.splits.values()) > 0:
            raise InvalidSettingError("the splits have no shares")
        check_name("turning", self.turning, TURNINGS)
        least = {"copies": 0, "frames": 2, "seed": 0, "max_tries": 1}
        for name, minimum in least.items():
            whole_number(name, getattr(self, name), minimum)
        if not is_as_before(self.world):
            whole_number("max_tries", self.max_tries, 1, MOST_TRIES)
        for family in self.families.values():  # errors of users' functions show now
            family.draw(self.world, np.random.default_rng(self.seed))
        n, each = sum(self.cells.values()), 1 + self.copies
        what = f"a plan of {n * each} events of {self.frames} frames"
        check_memory(what, n * each * (_EVENT_BYTES + _FRAME_BYTES * self.frames))
        object.__setattr__(self, "planner", PlannerConfig.named(self.planner))
        most = len(self.looks) - 1
        if self.copies > most:
            raise InvalidSettingError(
                f"copies={self.copies}, but an event of {self.world.name!r} has only {most} other "
                "looks"
            )

    @functools.cached_property
    def families(self) -> Mapping[str, Family]:
        """Cell -> family, with its variant; stored, as worker processes know no users' families."""
        own = cell_of(self.world)
        return {cell: family_of(cell, self.world) for cell in self.cells if cell != own}

    @functools.cached_property
    def looks(self) -> list[Look]:
        """The possible looks of events."""
        if not tables_of(self.world).has_looks:
            return [Look(UNCHANGED, agents=False, items=False)]
        swaps = (False, True)
        return [Look(*look) for look in itertools.product(REFLECTION_SHARES, swaps, swaps)]

    @functools.cached_property
    def shares(self) -> FloatArray:
        """The frequency of each look."""
        shares = np.array([REFLECTION_SHARES[look.reflection] for look in self.looks])
        return np.asarray(shares / shares.sum())

    def slots(self) -> list[Slot]:
        """Return the events to be made; each split has about the same shares of every cell."""
        rng = np.random.default_rng([self.seed, 1])
        row = [cell for cell, n in self.cells.items() for _ in range(n)]
        # neighbours are of one kind, so that dealing out the splits along the row stratifies them
        names = list(self.splits)
        counts = apportioned(len(row), self.splits)
        place = np.concatenate(
            [(np.arange(counts[name]) + rng.random()) / max(counts[name], 1) for name in names]
        )
        split_of_row = np.repeat(names, [counts[name] for name in names])[np.argsort(place)]
        order = rng.permutation(len(row))  # so that numbers do not reveal kinds
        return [Slot(number, row[one], str(split_of_row[one])) for number, one in enumerate(order)]

    def warm_up(self) -> None:
        """Compile the kernels that its simulations use."""
        JointSimulator(self.planner).warm_up()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, fit for JSON."""
        record = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        record["planner"] = self.planner.to_dict()  # type: ignore[union-attr]
        del record["world"], record["roles"]
        if self.roles is not None:
            record["roles"] = _function_record(self.roles)
        if not is_as_before(self.world):
            record["world"] = self.world.to_dict()
            if self.families:
                record["families"] = {
                    family.name: _function_record(family.function)
                    for family in self.families.values()
                }
        return dict(json.loads(json.dumps(record, default=dict)))


def _function_record(function: Callable[..., Any]) -> dict[str, Any]:
    """Return what identifies a function, and the functions inside a partial."""
    held = [function]
    if isinstance(function, functools.partial):
        held += [one for one in (*function.args, *function.keywords.values()) if callable(one)]
    found = {"function": qualified_name(function), "sources": [source_hash(one) for one in held]}
    return dict(stable(found))


def cell_of(world: World) -> str:
    """Return the cell of a world's random scenes."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", world.name).strip("-") or "world"


def apportioned(total: int, shares: Mapping[str, float]) -> dict[str, int]:
    """Return whole numbers of sum ``total`` in proportion to shares (largest remainders)."""
    exact = {name: total * share / sum(shares.values()) for name, share in shares.items()}
    counts = {name: int(value) for name, value in exact.items()}
    left = sorted(exact, key=lambda name: counts[name] - exact[name])
    for name in left[: total - sum(counts.values())]:
        counts[name] += 1
    return counts


def scaled(cells: Mapping[str, int], n: int) -> dict[str, int]:
    """Return numbers of events in the proportions of ``cells``, ``n`` in all."""
    instance_of("cells", cells, Mapping, "a mapping from names to numbers")
    return apportioned(whole_number("n", n, 1), cells)
