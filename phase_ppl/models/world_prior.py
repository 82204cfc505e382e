"""A prior over the hypotheses of a world other than PHASE, as a program without arguments."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import HypothesisSpace, space_of


@dataclasses.dataclass(frozen=True)
class WorldPrior:
    """A NumPyro program of a world (:mod:`phase_ppl.models.roles`), bound to one.

    Attributes:
        given: what the user gave: a program of a world, or a ready-made prior of PHASE.
        program: the program of a world that it stands for.
        world: whose agents and goals.
    """

    given: Callable[..., Any]
    program: Callable[[World], Any]
    world: World

    def __call__(self) -> None:
        self.program(self.world)


def as_given(prior: Callable[..., Any]) -> Callable[..., Any]:
    """Return a prior as the user gave it, without its world."""
    return prior.given if isinstance(prior, WorldPrior) else prior


def space_of_prior(prior: object) -> HypothesisSpace:
    """Return the hypotheses that a prior is over: those of PHASE, unless it is bound to a world."""
    return space_of(prior.world if isinstance(prior, WorldPrior) else PHASE)
