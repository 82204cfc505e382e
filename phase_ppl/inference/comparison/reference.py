"""What the kernels of a comparison are measured against."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from phase_ppl.analysis.measures import COMPARED, Marginals, distances, marginals
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.quantities import relation_codes
from phase_ppl.inference.comparison.contenders import Contender, Spec, contender
from phase_ppl.inference.comparison.enumeration import (
    PER_PAIR,
    Plan,
    check_per_pair,
    enumerate_goals,
    plan_enumeration,
)
from phase_ppl.inference.settings import (
    Budget,
    FrameBudget,
    SimpleSettings,
    described_budget,
)
from phase_ppl.models.model import Model
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, shown
from phase_ppl.world.event import Event
from phase_ppl.world.relations import RELATIONS

Halves: TypeAlias = tuple[Marginals, Marginals]
"""What two halves of the same simulations say."""

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
        per_pair: simulations of each pair of goals, where these are enumerated.
    """

    given: Posterior | None
    enumeration: bool
    kernel: Contender | None
    budget: Any
    weights: str
    per_pair: int = PER_PAIR

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
        if isinstance(reference, str) and reference == ENUMERATION:
            return cls(None, True, None, budget, weights)
        if isinstance(reference, tuple) and reference[:1] == (ENUMERATION,):
            return cls(None, True, None, budget, weights, _per_pair(reference))
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
            more = {} if self.per_pair == PER_PAIR else {"per_pair": self.per_pair}
            return [ENUMERATION, more] if more else ENUMERATION
        return {"enumeration if affordable": self.enumeration, "kernel": self.kernel.record()}


def _per_pair(reference: tuple[Any, ...]) -> int:
    """Return what ``("enumeration", {"per_pair": n})`` asks for."""
    options = reference[1] if len(reference) == 2 else None
    if not isinstance(options, Mapping) or set(options) != {"per_pair"}:
        raise InvalidSettingError(
            f'reference={shown(reference)}, expected ("enumeration", {{"per_pair": n}})'
        )
    check_per_pair(options["per_pair"])
    return int(options["per_pair"])


def reference_of(
    asked: Reference, event: Event, model: Model, seed: int, workers: int | None
) -> dict[str, Any]:
    """Return the reference: ``description``, ``marginals``, ``simulations``, ``error``.

    The last says how far the marginals can be trusted: the total variation between what two halves
    of the simulations, or of the chains, say; ``tv_goals`` (mean of both agents) and
    ``tv_relation``. The whole is nearer than this to what it estimates: at half of it
    where errors are small, and at three quarters where single simulations decide. It knows nothing
    of what all chains have in common, such as what none of them has found. None where there are no
    halves.
    """
    if asked.given is not None:
        post = asked.given
        words = f"a given posterior ({post.tree.attrs['kernel']}, weights {post.weights})"
        return _entry(words, marginals(post), int(post.cost["simulations"]), _halves_of(post))
    if asked.enumeration:
        plan = plan_enumeration(model, seed)
        if asked.kernel is None or _affordable(plan, asked, event):
            return _enumerated(event, model, plan, asked.per_pair, seed, workers)
    assert asked.kernel is not None
    run_seed = int(np.random.SeedSequence([seed, 2**31]).generate_state(1)[0])
    post = asked.kernel.run(event, model, asked.budget, run_seed, workers)
    post = Posterior(post.tree, asked.weights)
    length = ", ".join(described_budget(value) for value in asked.kernel.length.values())
    words = (
        f"{asked.kernel.info.name}, {length}, weights {asked.weights}; its error is known as far "
        "as its chains have mixed"
    )
    return _entry(words, marginals(post), int(post.cost["simulations"]), _halves_of(post))


def _affordable(plan: Plan, asked: Reference, event: Event) -> bool:
    simulations = len(plan.pairs) * asked.per_pair
    if isinstance(asked.budget, FrameBudget):
        return simulations * event.observation.n_frames <= asked.budget.frames
    return isinstance(asked.budget, Budget) and simulations <= asked.budget.simulations


def _enumerated(
    event: Event, model: Model, plan: Plan, per_pair: int, seed: int, workers: int | None
) -> dict[str, Any]:
    found = enumerate_goals(event, model, plan, per_pair=per_pair, seed=seed, workers=workers)
    words = f"enumeration of {len(plan.pairs)} pairs of goals, {per_pair} simulations each"
    halves = [(of_pairs(one), of_pairs(other)) for one, other in found.halves]
    return _entry(words, of_pairs(found.probability), found.simulations, halves)


def of_pairs(probability: FloatArray) -> dict[str, FloatArray]:
    """Return the marginals of a table (goal_red, goal_green)."""
    red, green = np.indices(probability.shape)
    relation = relation_codes(red.ravel(), green.ravel())["relation"]
    return {
        "goal_red": probability.sum(axis=1),
        "goal_green": probability.sum(axis=0),
        "relation": np.bincount(relation, probability.ravel(), len(RELATIONS)),
    }


def _halves_of(post: Posterior) -> list[Halves]:
    """Return the marginals of halves of the chains; none with fewer than two."""
    n_chains = post.tree["posterior"].sizes["chain"]
    if n_chains < 2 or post.weights != "count":
        return []
    table = post.to_dataframe()
    labels = {name: post.marginal(name)[name].values for name in COMPARED}
    chain = table["chain"].to_numpy()
    halves: list[Halves] = []
    for upper in (chain >= n_chains // 2, chain % 2 == 1):
        shares = []
        for chosen in (table[~upper], table[upper]):
            total = max(chosen["weight"].sum(), np.finfo(float).tiny)
            sums = {
                name: chosen.groupby(name)["weight"].sum().reindex(labels[name], fill_value=0.0)
                for name in COMPARED
            }
            shares.append({name: values.to_numpy() / total for name, values in sums.items()})
        halves.append((shares[0], shares[1]))
    return halves


def _entry(
    words: str, found: dict[str, FloatArray], simulations: int, halves: Sequence[Halves]
) -> dict[str, Any]:
    return {
        "description": words,
        "marginals": dict(found),
        "simulations": simulations,
        "error": error_of(halves),
    }


def error_of(halves: Sequence[Halves]) -> dict[str, float] | None:
    """Return the mean distances between halves, as :func:`reference_of` says."""
    if not halves:
        return None
    apart = [distances(one, other) for one, other in halves]
    return {name: float(np.mean([one[name] for one in apart])) for name in apart[0]}
