"""Ready-made priors, and what a prior says before anything is seen.

The ready-made ones are in :mod:`phase_ppl.models.priors`.
"""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Callable, Mapping
from typing import Any, Final

import jax
import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.estimate import Jackknife
from phase_ppl.analysis.event_posterior import answer_lines, answers
from phase_ppl.analysis.hypotheses import Hypotheses
from phase_ppl.analysis.quantities import Vocabulary
from phase_ppl.analysis.weights import Rows
from phase_ppl.closed_loop.hidden_state import Tracking
from phase_ppl.models.density import compiled_quickly, draw, on_cpu
from phase_ppl.models.model import Model, for_table
from phase_ppl.models.prior_masses import MOST_HYPOTHESES, PriorMasses
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
from phase_ppl.models.stepwise import stepwise_prior
from phase_ppl.world.arrays import GOLDEN
from phase_ppl.world.errors import InvalidSettingError, instance_of
from phase_ppl.world.event import Event
from phase_ppl.world.identity import qualified_name
from phase_ppl.world.picture import plain, wrapped
from phase_ppl.world.scene import PHASE, World
from phase_ppl.world.space import ALPHA_SITE, space_of

_DRAWS: Final = 4000  # of a program's further sites

__all__ = [
    "Summary",
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


class Summary(Hypotheses):
    """What a prior says, to be asked like a posterior; :func:`summary` makes it.

    ``print`` shows the probable goals, relation, scenario and strengths, who helps or hinders, and
    the program's further sites; ``to_dict`` has goals, relations, scenario and strengths.
    """

    def __init__(
        self, title: str, prior: PriorMasses, further: Mapping[str, NDArray[Any]] | None = None
    ) -> None:
        space, words = prior.space, Vocabulary(prior.space)
        drawn = prior.are_many
        found = prior.drawn(np.exp(prior.log_goals)) if drawn else prior.enumerated()
        mass = np.exp(found.log_prior - found.log_drawn)
        kept = np.flatnonzero(mass)
        mass, of_strengths = mass[kept] / mass.sum(), prior.of_strengths
        apart = len(of_strengths) == 1  # any hypothesis has the same
        row = np.arange(len(kept))
        if apart and len(kept) * of_strengths.size > MOST_HYPOTHESES:  # one each, in proportion
            places = row * GOLDEN % 1
            combination = (places[:, None] > of_strengths.cumsum()[:-1]).sum(axis=1)
        else:
            masses = mass[:, None] * (of_strengths if apart else of_strengths[kept])
            row, combination = np.nonzero(masses)
            mass = masses[row, combination]
        columns: dict[str, Any] = {
            **dict(zip(space.stated_sites, found.stated[kept[row]].T, strict=True)),
            space.company_site: found.way[kept[row]],
            **dict(zip(space.goal_sites, found.goals[kept[row]].T, strict=True)),
            **dict(zip(space.strength_sites, prior.combinations[combination].T, strict=True)),
        }
        rows = Rows(words.completed(columns), mass, {"hypothesis": np.arange(len(row))})
        super().__init__(space, words.quantities, rows)
        self._title, self._is_summed = title, not drawn
        known = (*space.alpha_names, ALPHA_SITE)
        self._alphas = [name for name in known if name in words.quantities]
        self._further = further or {}

    def _jackknife(self, share: float) -> Jackknife | None:
        """Return one without error, where all hypotheses are summed."""
        return Jackknife(self._rows.weights[None], 0.0) if self._is_summed else None

    def to_dict(self) -> dict[str, Any]:
        """Return ``goals``, ``relation``, ``scenario``, ``strengths`` and ``errors`` of each."""
        return dict(plain(answers(self)))

    def __str__(self) -> str:
        lines = answer_lines(self)
        for name in self._alphas:
            masses = self.marginal(name).to_series()
            text = ", ".join(f"{label} {mass:.2f}" for label, mass in masses.items())
            signs = " (red to green, green to red: 1 helps, -1 hinders)"
            lines += wrapped(f"{name} ", text + signs * (name == ALPHA_SITE))
        for name, drawn in self._further.items():
            low, high = np.quantile(drawn, [0.025, 0.975])
            within = f"95 % in {low:.2f} to {high:.2f}; {len(drawn)} draws"
            lines += wrapped(f"{name} ", f"mean {drawn.mean():.2f} ({within})")
        return "\n".join([*wrapped("prior", self._title), "", *lines])

    def __repr__(self) -> str:
        return f"<prior {self._title}>"


@on_cpu()
def summary(
    prior: Callable[..., object] | str = uniform,
    event: Event | None = None,
    *,
    world: World | None = None,
) -> Summary:
    """Return what a prior says of goals, relation, scenario and strengths before a run.

    Goals are effective ones, so that it shows what a prior over stated goals and ``alpha`` comes
    to: help and harm of 3 : 1 in ``alpha`` come to less in the relation, since goals also agree
    and clash by chance. Strengths are at the closed loop's levels.

    Args:
        prior: NumPyro program over the sites of a hypothesis, or the name of a ready-made one.
        event: for a prior that looks at the video.
        world: whose agents and goals; by default the event's, or PHASE.

    Raises:
        InvalidSettingError: it cannot work, or looks at a video and there is no event; or event or
            world are none.
        UnknownNameError: there is no prior of that name.
    """
    instance_of("event", event, (Event, type(None)), "a phase_ppl.Event")
    instance_of("world", world, (World, type(None)), "a phase_ppl.World")
    if event is not None and world not in (None, event.scene.world):
        raise InvalidSettingError(f"world is not that of the event: {event.scene.world.name!r}")
    given, levels = Model(prior=prior).prior, Tracking().strengths
    title = qualified_name(given)
    if event is None:
        world = PHASE if world is None else world
        bound = for_table(given, world)
    else:
        world, title = event.scene.world, f"{title}, of the event {event.id}"
        bound = for_table(given, event.scene, event.observation)
    kept, attributes = stepwise_prior(bound, world, levels)
    sites = json.loads(attributes.get("sites", "[]"))
    keys = jax.random.split(jax.random.key(0), _DRAWS)
    drawn = compiled_quickly(jax.vmap(functools.partial(draw, bound)))(keys) if sites else {}
    every = np.array(list(itertools.product(levels, repeat=len(world.agents))))
    further = {name: np.asarray(drawn[name]) for name in sites}
    return Summary(title, PriorMasses(space_of(world), kept, every), further)


def __dir__() -> list[str]:
    return __all__
