"""Ready-made priors, and what a prior says before anything is seen.

The ready-made ones are in :mod:`phase_ppl.models.priors`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from phase_ppl.models.density import on_cpu
from phase_ppl.models.model import Model, for_table
from phase_ppl.models.priors import (
    available,
    named,
    no_social_goals,
    register_prior,
    relation_first,
    sparse_social,
    strength_levels,
    uniform,
)
from phase_ppl.world.errors import InvalidSettingError, instance_of
from phase_ppl.world.event import Event
from phase_ppl.world.scene import PHASE, World

if TYPE_CHECKING:
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior

__all__ = [
    "available",
    "named",
    "no_social_goals",
    "register_prior",
    "relation_first",
    "sparse_social",
    "strength_levels",
    "summary",
    "uniform",
]


@on_cpu()
def summary(
    prior: Callable[..., object] | str = uniform,
    event: Event | None = None,
    *,
    world: World | None = None,
) -> ClosedLoopPosterior:
    """Return what a prior says before a run: the closed loop's posterior at the start of a video.

    Goals are effective ones, so that it shows what a prior over stated goals and ``alpha`` comes
    to: help and harm of 3 : 1 in ``alpha`` come to less in the relation, since goals also agree
    and clash by chance. Strengths are at the closed loop's levels,
    of three agents and more in some combinations only.

    Args:
        prior: NumPyro program over the sites of a hypothesis, or the name of a ready-made one.
        event: for a prior that looks at the video.
        world: whose agents and goals; by default the event's, or PHASE.

    Raises:
        InvalidSettingError: it cannot work, or looks at a video and there is no event; or event or
            world are none.
        UnknownNameError: there is no prior of that name.
    """
    from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
    from phase_ppl.inference.closed_loop import Watch
    from phase_ppl.models.closed_loop import ClosedLoopLikelihood

    instance_of("event", event, (Event, type(None)), "a phase_ppl.Event")
    instance_of("world", world, (World, type(None)), "a phase_ppl.World")
    if event is not None and world not in (None, event.scene.world):
        raise InvalidSettingError(f"world is not that of the event: {event.scene.world.name!r}")
    # with two sets of searches errors are known
    model = Model(prior=prior, likelihood=ClosedLoopLikelihood(planner_seeds=2))
    if event is None:
        world = PHASE if world is None else world
        bound, scene, seen = for_table(model.prior, world), world.random_scene(0), None
    else:
        scene, seen = event.scene, event.observation
        bound = for_table(model.prior, scene, seen)
    with Watch(scene, model, observation=seen, event_id="the prior") as watching:
        watching.take(scene.start)
        return ClosedLoopPosterior(watching.dataset(), prior=bound)


def __dir__() -> list[str]:
    return __all__
