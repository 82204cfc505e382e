"""Predicate inverse planning, the paper's physics-agnostic variant of SIMPLE."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phase_ppl.evaluation.prediction import Prediction, independent, pairs_of
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.scene import PHASE, Scene, World
from phase_ppl.world.space import space_of

if TYPE_CHECKING:
    from phase_ppl.models.predicate import PredicateSettings
    from phase_ppl.models.world_priors import Masses


@dataclasses.dataclass(frozen=True, eq=False)
class PredicateInversePlanning:
    """The model with its options, ready to be asked."""

    prior: str  # name of the prior over pairs of effective goals
    log_prior: NDArray[np.float64]  # (goal of red, goal of green)
    given: PredicateSettings

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Prediction:
        """Return the marginals of the effective goals and of the relations; nothing is random."""
        from phase_ppl.models.predicate import ForwardModel, posterior, symbolic_trajectory

        trajectory = symbolic_trajectory(scene, observation, self.given)
        likelihood = ForwardModel(scene, self.given).log_likelihood(trajectory)
        if scene.world != PHASE:
            prior = prior_in(scene.world, self.prior)
            return Prediction("", marginals(likelihood, prior, scene.world), world=scene.world)
        return Prediction("", posterior(likelihood, self.log_prior))

    def settings(self) -> dict[str, Any]:
        """Return what determines the answers."""
        return {"prior": self.prior, **dataclasses.asdict(self.given)}


@functools.lru_cache(16)
def prior_in(world: World, name: str) -> Masses:
    """Return what the prior of that name is as one of own goals and ways to help or hinder.

    InvalidSettingError: it is of PHASE only, and the world another.
    """
    from phase_ppl.models import priors, world_priors
    from phase_ppl.models.predicate import INDEPENDENT

    alone = functools.partial(world_priors.uniform, social=0.0)
    prior = alone if name == INDEPENDENT else priors.named(name)
    asks = world_priors.role_prior(prior, world)
    return world_priors.masses_of(world_priors.WorldPrior(prior, asks, world, arguments=(world,)))


def marginals(
    log_likelihood: NDArray[np.float64], prior: Masses, world: World
) -> dict[str, NDArray[np.float64]]:
    """Return the probabilities of all effective goals and relations in any world.

    Args:
        log_likelihood: (agent, goal) log P(trajectory | goal).
        prior: over own goals, and over the ways to help or hinder.
        world: whose agents and goals.
    """
    ways = range(len(space_of(world).ways))
    found = [_given_way(way, log_likelihood, prior.goals, world) for way in ways]
    log_mass = prior.alpha + np.array([log_evidence for log_evidence, _ in found])
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    return {
        question: np.sum(
            [m * shares[question] for m, (_, shares) in zip(mass, found, strict=True)], 0
        )
        for question in found[0][1]
    }


def _given_way(
    way: int,
    log_likelihood: NDArray[np.float64],
    log_prior: NDArray[np.float64],
    world: World,
) -> tuple[float, dict[str, NDArray[Any]]]:
    """Return log evidence and marginals, given who helps or hinders whom.

    An agent that pursues its own goal, and those who act on it, depend on nobody else.
    """
    from phase_ppl.analysis.weights import log_sum_exp

    n_goals, space = len(world.goals), space_of(world)
    # agent -> own goal of its owner -> what the agent acts on
    owner, effective = space.owner[way].tolist(), space.becomes[way]
    log_evidence, of_owner = 0.0, {}
    for head in set(owner):
        group = [agent for agent, one in enumerate(owner) if one == head]
        log_p = log_prior[head] + sum(log_likelihood[agent, effective[agent]] for agent in group)
        # -1 stands for what its owner cannot have, or its helper cannot act on
        log_p[(effective[group] < 0).any(axis=0)] = -np.inf
        total = log_sum_exp(log_p)
        log_evidence += total
        of_owner[head] = np.exp(log_p - total) if np.isfinite(total) else np.zeros(n_goals)
    goals = [
        np.bincount(np.maximum(effective[agent], 0), of_owner[one], n_goals)
        for agent, one in enumerate(owner)
    ]
    found = independent(np.array(goals), world)
    for question, pair in pairs_of(world).items():
        one, other = map(world.agent, pair)
        if owner[one] == owner[other]:
            codes = space.relations[one, other][effective[one], effective[other]]
            found[question] = np.bincount(codes, of_owner[owner[one]], len(RELATIONS))
    return log_evidence, found


@register_model("predicate", any_world=True)
def predicate(
    *, prior: str | None = None, preset: str | None = None, **options: Any
) -> PredicateInversePlanning:
    """Predicate inverse planning: goals and relation from symbols alone, without physics.

    Args:
        prior: name of a prior over hypotheses, as SIMPLE takes it, "uniform" by default; or
            "independent", under which all pairs of effective goals are alike.
        preset: of :func:`phase_ppl.preset`; other arguments override it. The paper's have
            its uniform P(g), "independent", and the thresholds of SIMPLE's planner.
        **options: fields of :class:`~phase_ppl.models.predicate.PredicateSettings`.
    """
    from phase_ppl.inference.settings import preset as check_preset
    from phase_ppl.models.predicate import AS_THE_PAPER, PredicateSettings, log_prior_of_pairs

    if preset is not None:
        check_preset(preset)
    known = [field.name for field in dataclasses.fields(PredicateSettings)]
    for name in options:
        if name not in known:
            raise InvalidSettingError(
                f"{name} is no option of model 'predicate': allowed are "
                f"{', '.join(['prior', 'preset', *known])}"
            )
    usual = AS_THE_PAPER if preset in ("as_printed", "as_intended") else {"prior": "uniform"}
    asked = {**usual, **options}
    named = asked.pop("prior") if prior is None else prior
    asked.pop("prior", None)
    return PredicateInversePlanning(named, log_prior_of_pairs(named), PredicateSettings(**asked))
