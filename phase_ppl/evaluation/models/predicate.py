"""Predicate inverse planning, the paper's physics-agnostic variant of SIMPLE."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phase_ppl.evaluation.prediction import QUESTIONS, Prediction, pairs_of
from phase_ppl.evaluation.registry import register_model
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.hypothesis import RELATIONS, STRENGTH, company
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import PHASE, Scene, World

if TYPE_CHECKING:
    from phase_ppl.models.predicate import Rationality, Thresholds
    from phase_ppl.models.roles import Factors


@dataclasses.dataclass(frozen=True, eq=False)
class PredicateInversePlanning:
    """The model with its options, ready to be asked."""

    prior: str  # name of the prior over pairs of effective goals
    log_prior: NDArray[np.float64]  # (goal of red, goal of green)
    thresholds: Thresholds
    rationality: Rationality

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Prediction:
        """Return the marginals of the effective goals and of the relations; nothing is random."""
        from phase_ppl.models.predicate import ForwardModel, posterior, symbolic_trajectory

        trajectory = symbolic_trajectory(scene, observation, self.thresholds)
        likelihood = ForwardModel(scene, self.rationality).log_likelihood(trajectory)
        if scene.world != PHASE:
            prior = prior_in(scene.world, self.prior)
            return Prediction("", marginals(likelihood, prior, scene.world), world=scene.world)
        found = posterior(likelihood, self.log_prior)
        return Prediction("", {question: getattr(found, question) for question in QUESTIONS})

    def settings(self) -> dict[str, Any]:
        """Return what determines the answers."""
        return {
            "prior": self.prior,
            **dataclasses.asdict(self.thresholds),
            **dataclasses.asdict(self.rationality),
        }


@functools.lru_cache(16)
def prior_in(world: World, name: str) -> Factors:
    """Return what the prior of that name is in another world than PHASE.

    InvalidSettingError: it is of PHASE only.
    """
    from phase_ppl.models import priors, roles
    from phase_ppl.models.predicate import INDEPENDENT

    alone = functools.partial(roles.uniform, social=0.0)
    return roles.factors(alone if name == INDEPENDENT else priors.named(name), world, (STRENGTH,))


def marginals(
    log_likelihood: NDArray[np.float64], prior: Factors, world: World
) -> dict[str, NDArray[np.float64]]:
    """Return the probabilities of all effective goals and relations in any world.

    Given who helps or hinders whom, an agent that pursues its own goal and those who act on it
    depend on nobody else.

    Args:
        log_likelihood: (agent, goal) log P(trajectory | goal).
        prior: over own goals, and over the ways to help or hinder.
        world: whose agents and goals.
    """
    from phase_ppl.analysis.roles_table import of_owners, relation_tables

    acts_on, tables = of_owners(world), relation_tables(world)
    keys, n_goals = world.keys, len(world.goals)
    relations = {
        question: tuple(map(world.agent, pair)) for question, pair in pairs_of(world).items()
    }
    log_evidence, given = [], []
    for way, log_way in zip(company(len(keys)), prior.company, strict=True):
        effective: list[Any] = [None] * len(keys)  # agent -> own goal of its owner -> its own
        owner = [agent if one is None else one[0] for agent, one in enumerate(way)]
        for agent, one in enumerate(way):
            effective[agent] = np.arange(n_goals) if one is None else acts_on[agent, *one]
        total, shares = float(log_way), {}
        for head in sorted(set(owner)):
            log_p = np.array(prior.goals[head])
            for agent in range(len(keys)):
                if owner[agent] == head:
                    log_p = log_p + log_likelihood[agent, effective[agent]]
            highest = log_p.max()
            shares[head] = np.exp(log_p - highest)
            total += highest + np.log(shares[head].sum())
            shares[head] /= shares[head].sum()
        found = {
            f"goal_{key}": np.bincount(
                np.maximum(effective[agent], 0), shares[owner[agent]], n_goals
            )
            for agent, key in enumerate(keys)
        }
        for question, (one, other) in relations.items():
            if owner[one] == owner[other]:
                codes = tables[one, other][effective[one], effective[other]]
                weights = shares[owner[one]]
            else:
                codes = tables[one, other].ravel()
                weights = np.outer(found[f"goal_{keys[one]}"], found[f"goal_{keys[other]}"]).ravel()
            found[question] = np.bincount(codes, weights, len(RELATIONS))
        log_evidence.append(total)
        given.append(found)
    weight = np.exp(np.array(log_evidence) - max(log_evidence))
    weight /= weight.sum()
    return {
        question: sum(w * one[question] for w, one in zip(weight, given, strict=True))
        for question in given[0]
    }


def more_options(given: Mapping[str, Any]) -> list[str]:
    """Return the options beside the prior: thresholds and rationality, whatever is given."""
    from phase_ppl.models.predicate import Rationality, Thresholds

    return [field.name for kind in (Thresholds, Rationality) for field in dataclasses.fields(kind)]


@register_model("predicate", more_options=more_options, any_world=True)
def predicate(
    *, prior: str | None = None, preset: str = "default", **options: Any
) -> PredicateInversePlanning:
    """Predicate inverse planning: goals and relation from symbols alone, without physics.

    Args:
        prior: name of a prior over hypotheses, as SIMPLE takes it, "uniform" by default; or
            "independent", under which all pairs of effective goals are alike.
        preset: of :func:`phase_ppl.preset`; what else is given goes before it. The paper's have
            its uniform P(g), "independent", and the thresholds of SIMPLE's planner.
        **options: fields of :class:`~phase_ppl.models.predicate.Thresholds` and of
            :class:`~phase_ppl.models.predicate.Rationality`.
    """
    from phase_ppl.inference.settings import preset as check_preset
    from phase_ppl.models.predicate import AS_THE_PAPER, Rationality, Thresholds, log_prior_of_pairs

    check_preset(preset)
    usual = AS_THE_PAPER if preset != "default" else {}
    prior = usual.get("prior", "uniform") if prior is None else prior
    known = more_options(options)
    for name in options:
        if name not in known:
            raise InvalidSettingError(
                f"{name} is no option of model 'predicate': allowed are "
                f"{', '.join(['prior', 'preset', *known])}"
            )
    options = {**usual, **options}
    thresholds, rationality = (
        {field.name: options[field.name] for field in dataclasses.fields(kind)
         if field.name in options}
        for kind in (Thresholds, Rationality)
    )  # fmt: skip
    return PredicateInversePlanning(
        prior, log_prior_of_pairs(prior), Thresholds(**thresholds), Rationality(**rationality)
    )
