"""What the kernels of a comparison are measured against."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from phase_ppl.analysis.measures import marginals, total_variation
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.quantities import relation_codes
from phase_ppl.inference.comparison.contenders import Contender, Spec, contender
from phase_ppl.inference.comparison.enumeration import (
    PER_PAIR,
    Plan,
    enumerate_goals,
    plan_enumeration,
)
from phase_ppl.inference.settings import Budget, SimpleSettings, described_budget
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.event import Event
from phase_ppl.world.relations import RELATIONS

FloatArray = NDArray[np.float64]

ENUMERATION: Final = "enumeration"

LONG: Final = 10
"""How many times the budget a reference may take."""

LONG_RUN: Final = "local_mh"
"""Kernel of the reference where enumeration takes too much."""


@dataclasses.dataclass(frozen=True)
class Reference:
    """The reference that was asked for.

    Attributes:
        given: a posterior, or None.
        enumeration: whether goals may be enumerated.
        kernel: of a long run, or None.
        budget: what the reference may take.
        weights: of the draws of a long run.
    """

    given: Posterior | None
    enumeration: bool
    kernel: Contender | None
    budget: Any
    weights: str

    @classmethod
    def asked_for(
        cls,
        reference: Posterior | Spec | None,
        event: Event,
        budget: Any,
        chains: int,
        settings: SimpleSettings,
        weights: str,
    ) -> Reference:
        """Return what the argument ``reference`` of a comparison means.

        Raises:
            InvalidEventError: a posterior of another event.
            InvalidSettingError, UnknownNameError: a kernel that cannot be used.
        """
        if isinstance(reference, Posterior):
            if not np.array_equal(reference.observed(), event.observation.trajectory):
                raise InvalidEventError(
                    f"the reference is of {reference.event_id}, another event than {event.id}"
                )
            return cls(reference, False, None, budget, weights)
        if reference == ENUMERATION:
            return cls(None, True, None, budget, weights)
        long = budget
        if dataclasses.is_dataclass(budget) and not isinstance(budget, type):
            numbers = dataclasses.asdict(budget)
            long = dataclasses.replace(budget, **{k: LONG * v for k, v in numbers.items()})
        spec = LONG_RUN if reference is None else reference
        run = contender("reference", spec, chains, settings, own_length=True)
        if not run.length:
            run = dataclasses.replace(run, length={"budget": long})
        return cls(None, reference is None, run, long, weights)

    @property
    def contenders(self) -> list[Contender]:
        """The kernel that may have to run."""
        return [] if self.kernel is None else [self.kernel]

    def record(self) -> Any:
        """Return what was asked for, as a file keeps it."""
        if self.given is not None:
            digest = hashlib.sha256()
            for probabilities in marginals(self.given).values():
                digest.update(probabilities.round(9).tobytes())
            return {"posterior": digest.hexdigest()[:16]}
        if self.kernel is None:
            return ENUMERATION
        return {"enumeration if affordable": self.enumeration, "kernel": self.kernel.record()}


def reference_of(
    asked: Reference, event: Event, model: Model, seed: int, workers: int | None
) -> dict[str, Any]:
    """Return the reference: ``description`` and ``marginals``, ``simulations``, ``halves_apart``.

    The last is the total variation of the goals' marginals between two halves of its simulations
    (mean of both agents), which says how far it can be trusted; None for a given posterior.
    """
    if asked.given is not None:
        post = asked.given
        words = f"a given posterior ({post.tree.attrs['kernel']}, weights {post.weights})"
        return _entry(words, marginals(post), int(post.cost["simulations"]), None)
    if asked.enumeration:
        plan = plan_enumeration(model, seed)
        if asked.kernel is None or _affordable(plan, asked.budget):
            return _enumerated(event, model, plan, seed, workers)
    assert asked.kernel is not None
    run_seed = int(np.random.SeedSequence([seed, 2**31]).generate_state(1)[0])
    post = asked.kernel.run(event, model, asked.budget, run_seed, workers)
    post = Posterior(post.tree, asked.weights)
    length = ", ".join(described_budget(value) for value in asked.kernel.length.values())
    words = f"{asked.kernel.info.name}, {length}, weights {asked.weights}"
    return _entry(words, marginals(post), int(post.cost["simulations"]), _chains_apart(post))


def _affordable(plan: Plan, budget: Any) -> bool:
    return isinstance(budget, Budget) and len(plan.pairs) * PER_PAIR <= budget.simulations


def _enumerated(
    event: Event, model: Model, plan: Plan, seed: int, workers: int | None
) -> dict[str, Any]:
    found = enumerate_goals(event, model, plan, seed=seed, workers=workers)
    halves = [_of_pairs(half) for half in found.halves]
    words = f"enumeration of {len(plan.pairs)} pairs of goals, {PER_PAIR} simulations each"
    return _entry(
        words, _of_pairs(found.probability), found.simulations, _goals_apart(halves[0], halves[1])
    )


def _of_pairs(probability: FloatArray) -> dict[str, FloatArray]:
    """Return the marginals of a table (goal_red, goal_green)."""
    red, green = np.indices(probability.shape)
    relation = relation_codes(red.ravel(), green.ravel())["relation"]
    return {
        "goal_red": probability.sum(axis=1),
        "goal_green": probability.sum(axis=0),
        "relation": np.bincount(relation, probability.ravel(), len(RELATIONS)),
    }


def _chains_apart(post: Posterior) -> float | None:
    """Return how far the two halves of the chains are apart; None with fewer than two."""
    tree = post.tree
    n_chains = tree["posterior"].sizes["chain"]
    if n_chains < 2 or post.weights != "count":
        return None
    table = post.to_dataframe()
    halves = []
    for upper in (False, True):
        half = table[(table["chain"] >= n_chains // 2) == upper]
        shares = {}
        for name, values in marginals(post).items():
            labels = post.marginal(name)[name].values
            sums = half.groupby(name)["weight"].sum().reindex(labels, fill_value=0.0)
            shares[name] = sums.to_numpy() / max(sums.sum(), np.finfo(float).tiny)
            assert shares[name].shape == values.shape
        halves.append(shares)
    return _goals_apart(halves[0], halves[1])


def _goals_apart(one: dict[str, FloatArray], other: dict[str, FloatArray]) -> float:
    names = ("goal_red", "goal_green")
    return float(np.mean([total_variation(one[name], other[name]) for name in names]))


def _entry(
    words: str, found: dict[str, FloatArray], simulations: int, halves: float | None
) -> dict[str, Any]:
    apart = "" if halves is None else f"; its halves differ by a TV of {halves:.2f}"
    return {
        "description": words + apart,
        "marginals": dict(found),
        "simulations": simulations,
        "halves_apart": halves,
    }
