"""Kernels against each other: the same event, the same budget, several seeds.

And against a reference, such as the posterior of goals by enumeration, where every pair g of
effective goals is simulated. Its mass is the mean over strengths s ~ P(s) and simulator seeds w of

    P(g | s) L(g, s, w)

which needs a few simulations of each of the pairs that have prior mass, some 1150 under the
paper's prior, and no Markov chain. Where the log likelihood of a pair varies by several nats from
seed to seed, the mean of a few of them is a poor estimate of what it stands for: the tables of
halves of the simulations say how poor.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import random
from numpy.typing import NDArray

from phase_ppl.analysis.comparison import (
    CURVE_COLUMNS,
    DISTANCES,
    RUN_COLUMNS,
    Comparison,
    Marginals,
    accuracy,
    curve,
    distances,
    efficiency,
    marginals,
    of_truth,
)
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.quantities import relation_codes
from phase_ppl.analysis.weights import WEIGHTINGS
from phase_ppl.inference.entries import Entry, Spec, entries, entry_of
from phase_ppl.inference.infer import CHAINS, infer
from phase_ppl.inference.run import check_event
from phase_ppl.inference.settings import BUDGETS, Budget, SimpleSettings, simulations
from phase_ppl.models.density import on_cpu
from phase_ppl.models.effective import log_prior_of_effective
from phase_ppl.models.likelihood import is_stepwise
from phase_ppl.models.model import Model
from phase_ppl.models.program import MAX_SEED, EventProgram, event_salt
from phase_ppl.models.sites import ALPHA_SITE, GOAL_SITES, SELF_REFERRING, STRENGTH_SITES
from phase_ppl.simulator.processes import slots_of
from phase_ppl.simulator.runner import Runner
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    SimulationError,
    instance_of,
    shown,
    unknown_name,
    whole_number,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import locked
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import RELATIONS, Hypothesis
from phase_ppl.world.identity import stable, versions, versions_so_far
from phase_ppl.world.picture import plain
from phase_ppl.world.progress import Bar
from phase_ppl.world.scene import PHASE, check_is_phase

if TYPE_CHECKING:
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

PER_PAIR: Final = 4  # simulations of each pair, unless more are asked for
SPLITS: Final = 3  # ways in which the simulations of a pair are parted into halves
_POOL: Final = 32  # draws of strengths, of which each pair takes a few
_NO_MASS: Final = -60.0  # log probability below which a pair is not simulated


class Enumeration(NamedTuple):
    """Posterior of the effective goals."""

    probability: FloatArray  # (goal_red, goal_green), sum 1
    # (split, 2, goal_red, goal_green) the same from either half of the simulations of each pair
    halves: FloatArray
    simulations: int  # how many were made


class Plan(NamedTuple):
    """What an enumeration is going to simulate."""

    pairs: NDArray[np.int64]  # (pair, 2) effective goals of red and green that have prior mass
    strengths: FloatArray  # (draw, 2) newtons, from the prior
    log_prior: FloatArray  # (pair, draw) log P(pair | strengths)


def plan_enumeration(model: Model, seed: int = 0) -> Plan:
    """Return the pairs of goals that a model's prior allows, with their probabilities."""
    program = EventProgram(model, 0, 1)
    keys = random.split(random.key(seed), _POOL)
    drawn = jax.jit(jax.vmap(program.draw_prior))(keys)
    strengths = np.stack([np.asarray(drawn[name], float) for name in STRENGTH_SITES], axis=1)
    possible = np.argwhere(~SELF_REFERRING[0][:, None] & ~SELF_REFERRING[1][None, :])
    repeated = dict(zip(STRENGTH_SITES, np.tile(strengths.T, len(possible)), strict=True))
    log_joint = log_prior_of_effective(model.prior, np.repeat(possible, _POOL, axis=0), repeated)
    log_joint = log_joint.reshape(len(possible), _POOL)
    log_prior = log_joint - np.logaddexp.reduce(log_joint, axis=0)
    kept = log_prior.max(axis=1) > _NO_MASS
    return Plan(possible[kept], strengths, log_prior[kept])


def enumerate_goals(
    event: Event,
    model: Model,
    plan: Plan,
    *,
    per_pair: int = PER_PAIR,
    seed: int = 0,
    workers: int | None = None,
    executor: Executor | None = None,
) -> Enumeration:
    """Return the posterior of the effective goals by simulating all pairs of a plan.

    ``per_pair`` times each, with strengths and a simulator seed of their own; an even number, at
    most 32.
    """
    rng = np.random.default_rng(seed)
    which = np.stack([rng.permutation(_POOL)[:per_pair] for _ in plan.pairs])
    hypotheses = [
        Hypothesis(int(red), int(green), (0, 0), *(float(s) for s in plan.strengths[draw]))
        for (red, green), draws in zip(plan.pairs, which, strict=True)
        for draw in draws
    ]
    seeds = _seeds(event, model, hypotheses, seed)
    place = model.build_simulator(), event.scene, event.observation
    with Runner(*place, workers=workers, executor=executor) as runner:
        results = runner.run(hypotheses, seeds)
    errors = np.array([result.errors for result in results])
    usable = np.array([result.completed for result in results])
    if not usable.any():
        raise SimulationError(f"no simulation was completed; the first: {results[0].failure}")
    by_frame = model.error_likelihood.log_prob(np.where(usable[:, None], errors, 0.0))
    log_likelihood = np.asarray(by_frame).sum(axis=1)
    log_mass = np.where(usable, log_likelihood, -np.inf).reshape(which.shape)
    log_mass += np.take_along_axis(plan.log_prior, which, axis=1)
    return of_masses(plan.pairs, log_mass)


def of_masses(pairs: NDArray[np.int64], log_mass: FloatArray) -> Enumeration:
    """Return the posterior, whole and from halves, of what was simulated.

    ``log_mass`` is (pair, repeat), -inf where a simulation failed.
    """
    weight = np.exp(log_mass - log_mass.max())
    rng = np.random.default_rng(0)
    halves = []
    for split in range(SPLITS):
        order = rng.permutation(log_mass.shape[1]) if split else np.arange(log_mass.shape[1])
        halves.append([_table(pairs, weight[:, order[h::2]]) for h in (0, 1)])
    return Enumeration(_table(pairs, weight), np.array(halves), log_mass.size)


def _table(pairs: NDArray[np.int64], weight: FloatArray) -> FloatArray:
    """Return (goal_red, goal_green) the mean weights of simulations, failed ones 0, of sum 1."""
    table = np.zeros((N_GOALS, N_GOALS))
    table[tuple(pairs.T)] = weight.mean(axis=1)
    total = table.sum()
    return table / total if total > 0 else table  # of a half in which nothing was completed


def _seeds(event: Event, model: Model, hypotheses: list[Hypothesis], seed: int) -> list[int]:
    """Return the simulator seeds; with fixed noise, those that a kernel would take."""
    if model.noise == "fresh":
        drawn = np.random.default_rng([seed, 1]).integers(0, MAX_SEED, len(hypotheses))
        return [int(value) for value in drawn]
    salt = event_salt(event.scene, event.observation)
    program = EventProgram(model, 0, event.observation.n_frames, salt)
    goals = jnp.array([h.effective_goals for h in hypotheses])
    strengths = jnp.array([h.strengths for h in hypotheses], jnp.float32)
    sites = dict(zip(GOAL_SITES, goals.T, strict=True))
    sites |= dict(zip(STRENGTH_SITES, strengths.T, strict=True))
    sites[ALPHA_SITE] = jnp.zeros(len(hypotheses), jnp.int32)
    seeds = jax.jit(jax.vmap(program.simulator_seed, in_axes=(None, 0)))(random.key(0), sites)
    return [int(value) for value in np.asarray(seeds)]


Halves: TypeAlias = tuple[Marginals, Marginals]  # what two halves of the same simulations say
ENUMERATION: Final = "enumeration"
NONE: Final = "none"  # in place of a reference: there is none
LONG: Final = 10  # how many times the budget a reference may take
LONG_RUN: Final = "smc"  # kernel of the reference where enumeration takes too much
POPULATIONS: Final = 4  # independent ones of that kernel; how they differ is its error
_LARGER: Final = 4  # times as many particles as a kernel that is compared
_FEW: Final = 3  # iterations that a population goes on for at least


@dataclasses.dataclass(frozen=True)
class Reference:
    """The reference that was asked for: one of these, or none."""

    budget: Budget  # what it may take
    weights: str  # of the draws of a run
    given: Posterior | None = None
    enumeration: bool = False  # whether goals are enumerated, if the budget suffices
    at_any_cost: bool = False  # whether they are even if it does not
    kernel: Entry | None = None  # of a run
    per_pair: int = PER_PAIR  # simulations of each pair of goals, where these are enumerated

    @classmethod
    def asked_for(
        cls,
        reference: Posterior | Spec | None,
        event: Event,
        budget: Budget,
        chains: int,
        settings: SimpleSettings,
        weights: str,
        compared: Sequence[Entry],
    ) -> Reference:
        """Return what the argument ``reference`` of a comparison means.

        It is none of the kernels that are compared, which it would favour.
        """
        if isinstance(reference, Posterior):
            if not np.array_equal(reference.observed(), event.observation.trajectory):
                raise InvalidEventError(
                    f"the reference is of {reference.event_id}, another event than {event.id}"
                )
            return cls(budget, weights, given=reference)
        if reference == NONE:
            return cls(budget, weights)
        given = reference if isinstance(reference, tuple) else (reference, {"per_pair": PER_PAIR})
        if given[:1] == (ENUMERATION,):
            what = 'a reference by enumeration (the kernel "enumerate" is another)'
            check_is_phase(event.scene.world, what)
            each = _per_pair(given)
            return cls(budget, weights, enumeration=True, at_any_cost=True, per_pair=each)
        long = dataclasses.replace(budget, amount=LONG * budget.amount)
        particles = _particles(long, chains, event.observation.n_frames)
        spec = (LONG_RUN, {"chains": particles}) if reference is None else reference
        run = entry_of("reference", spec, chains, settings, own_length=True)
        same = [
            one.label
            for one in compared
            if one.info.factory is run.info.factory and one.options == run.options
        ]
        if same and reference is not None:
            raise InvalidSettingError(
                f"the reference is {same[0]!r}, which is compared, and which it would favour: "
                f"expected {ENUMERATION!r}, {NONE!r}, a posterior or a kernel that is not compared"
            )
        if not run.length:
            run = dataclasses.replace(run, own={**run.own, "budget": long})
        enumerated = reference is None and event.scene.world == PHASE
        return cls(long, weights, enumeration=enumerated, kernel=None if same else run)

    def record(self) -> Any:
        """Return what was asked for, as a file keeps it."""
        if self.given is not None:
            digest = hashlib.sha256()
            for probabilities in marginals(self.given).values():
                digest.update(probabilities.round(9).tobytes())
            return {"posterior": digest.hexdigest()[:16]}
        if self.at_any_cost:
            more = {} if self.per_pair == PER_PAIR else {"per_pair": self.per_pair}
            return [ENUMERATION, more] if more else ENUMERATION
        run = NONE if self.kernel is None else self.kernel.record()
        return {"enumeration if affordable": True, "else": run} if self.enumeration else run


def _particles(budget: Budget, chains: int, n_frames: int) -> int:
    """Return how many particles each population of the default reference has.

    Where the budget is small no more than can go on for a few iterations.
    """
    each = budget.amount / POPULATIONS / (n_frames if budget.unit == "frames" else 1)
    most = math.inf if budget.unit == "seconds" else each // (1 + _FEW)
    return int(max(2, min(_LARGER * chains, most)))


def _per_pair(reference: tuple[Any, ...]) -> int:
    """Return what ``("enumeration", {"per_pair": n})`` asks for."""
    options = reference[1] if len(reference) == 2 else None
    if not isinstance(options, Mapping) or set(options) != {"per_pair"}:
        raise InvalidSettingError(
            f'reference={shown(reference)}, expected ("enumeration", {{"per_pair": n}})'
        )
    number = whole_number("per_pair", options["per_pair"])
    if number % 2 or number > _POOL:
        raise InvalidSettingError(
            f"per_pair={number}, expected an even number of at most {_POOL}, for there to be halves"
        )
    return number


def reference_of(
    asked: Reference,
    event: Event,
    model: Model,
    read: StepwisePosterior | None,
    seed: int,
    workers: int | None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Return the reference: ``description``, ``marginals``, ``simulations``, ``error``.

    The last says how far the marginals can be trusted: the total variation between what two halves
    of the simulations, of the populations or of the chains say; ``tv_goals`` (mean of both agents)
    and ``tv_relation``. The whole is nearer than this to what it estimates: at half of it
    where errors are small, and at three quarters where single simulations decide. It knows nothing
    of what all of them have in common, such as what none has found. None where there are no
    halves; marginals are None where there is no reference. ``read`` is what the closed loop has
    read, where its table is what kernels sample: then the reference is exact.
    """

    def said(
        description: str,
        found: Mapping[str, Any] | None,
        simulations: int,
        halves: Sequence[Halves],
        exact: bool = False,
    ) -> dict[str, Any]:
        return {
            "description": description,
            "marginals": None if found is None else dict(found),
            "simulations": simulations,
            "error": dict.fromkeys(DISTANCES, 0.0) if exact else error_of(halves),
        }

    if asked.enumeration and read is not None:
        exact = read.with_prior(model.prior)
        words = "the exact sum over the table that the closed loop has read"
        return said(words, marginals(exact), 0, [], exact=True)
    if asked.enumeration:
        plan, each = plan_enumeration(model, seed), asked.per_pair
        if asked.at_any_cost or _affordable(plan, asked, event):
            options: dict[str, Any] = {"seed": seed, "workers": workers, "executor": executor}
            found = enumerate_goals(event, model, plan, per_pair=each, **options)
            words = f"enumeration of {len(plan.pairs)} pairs of goals, {each} simulations each"
            halves = [(of_pairs(one), of_pairs(two)) for one, two in found.halves]
            return said(words, of_pairs(found.probability), found.simulations, halves)
    if asked.given is not None:
        post = asked.given
        words = f"a given posterior ({post.tree.attrs['kernel']}, weights {post.weights})"
        return said(words, marginals(post), int(post.cost["simulations"]), _halves_of(post))
    if asked.kernel is None:
        return said("none", None, 0, [])
    seeds = np.random.SeedSequence([seed, 2**31]).generate_state(POPULATIONS).tolist()
    length = ", ".join(str(value) for value in asked.kernel.length.values())
    words = f"{asked.kernel.info.name}, {length}, weights {asked.weights}"

    def run(entry: Entry, number: int) -> Posterior:
        of_run = model, asked.budget, number, workers, executor
        return Posterior(entry.run(event if read is None else read, *of_run).tree, asked.weights)

    if asked.kernel.info.keeps != "last":
        post = run(asked.kernel, seeds[0])
        words += "; its error is known as far as its chains have mixed"
        return said(words, marginals(post), int(post.cost["simulations"]), _halves_of(post))
    # chains of one population depend on each other, whole populations do not
    whole = asked.kernel.length.get("budget", asked.budget)
    amount = whole.amount / POPULATIONS
    in_seconds = whole.unit == "seconds"
    share = dataclasses.replace(whole, amount=amount if in_seconds else max(1, int(amount)))
    own = asked.kernel.own if "iterations" in asked.kernel.own else {"budget": share}
    posts = [run(dataclasses.replace(asked.kernel, own=own), number) for number in seeds]
    evidence = np.array([_log_evidence(post) for post in posts])
    weight = np.exp(evidence - evidence.max())
    parts = [marginals(post) for post in posts]

    def together(chosen: Sequence[int]) -> dict[str, FloatArray]:
        shares = weight[list(chosen)] / weight[list(chosen)].sum()
        return {
            name: sum(w * parts[k][name] for w, k in zip(shares, chosen, strict=True))
            for name in parts[0]
        }

    pairs = [((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2))]
    halves = [(together(one), together(two)) for one, two in pairs]
    simulations = sum(int(post.cost["simulations"]) for post in posts)
    words += f", as {POPULATIONS} independent populations weighed by their evidence"
    return said(words, together(range(POPULATIONS)), simulations, halves)


def _log_evidence(post: Posterior) -> float:
    """Return the log evidence that a population has estimated; 0 of a kernel without one."""
    stats = post.tree["sample_stats"].dataset
    return float(stats["log_evidence"].values[0, -1]) if "log_evidence" in stats else 0.0


def _affordable(plan: Plan, asked: Reference, event: Event) -> bool:
    simulations = len(plan.pairs) * asked.per_pair
    frames = simulations * event.observation.n_frames
    needed = {"simulations": simulations, "frames": frames, "seconds": math.inf}
    return needed[asked.budget.unit] <= asked.budget.amount


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

    def of(chains: slice) -> Marginals:
        part = post.tree.isel(chain=chains, missing_dims="ignore")
        return marginals(Posterior(part, post.weights))

    middle = n_chains // 2
    halves = (slice(middle), slice(middle, None)), (slice(0, None, 2), slice(1, None, 2))
    return [(of(one), of(other)) for one, other in halves]


def error_of(halves: Sequence[Halves]) -> dict[str, float] | None:
    """Return the mean distances between halves, as :func:`reference_of` says."""
    if not halves:
        return None
    apart = [distances(one, other) for one, other in halves]
    return {name: float(np.mean([one[name] for one in apart])) for name in apart[0]}


BUDGET: Final = simulations(500)
REPEATS: Final = 8

_MOST_REPEATS: Final = 10**6
_MAY_DIFFER: Final = ("kernels", "proposals", "repeats", "reference", "event", "versions")


class ComparisonInterrupted(KeyboardInterrupt):
    """The comparison was interrupted; the runs that were finished are kept.

    Attributes:
        comparison: of the finished runs; None where there are none.
    """

    def __init__(self, comparison: Comparison | None) -> None:
        kept = "no run was finished yet" if comparison is None else "see .comparison"
        super().__init__(f"the comparison was interrupted; {kept}")
        self.comparison = comparison


@on_cpu()
def compare(
    event: Event | StepwisePosterior,
    model: Model | None = None,
    *,
    kernels: Iterable[Spec] | Mapping[str, Spec] = ("local_mh", "prior_mh"),
    budget: Budget = BUDGET,
    repeats: int = REPEATS,
    chains: int = CHAINS,
    seed: int = 0,
    reference: Posterior | Spec | None = None,
    weights: str = "count",
    settings: SimpleSettings | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Return how kernels do on one event under the same budget.

    Repeat r of every kernel runs with the same seed, so that the first repeats of two
    comparisons of equal settings are equal. Everything is refused before the first simulation
    if one of the kernels cannot run.

    Args:
        event: what to explain. Its truth, where it has one, is used to judge the results. Or what
            the closed loop has read of one, ``compare(infer(event), kernels=[...])``: kernels then
            sample its table, of which the exact posterior is known, and ten thousand draws take
            seconds. The same holds where the model's likelihood is a ``StepwiseLikelihood``: the
            video is read once, for all kernels and repeats.
        model: prior, simulator and likelihood; by default the paper's.
        kernels: names, or label -> name; instead of a name also ``(name, options)``, a kernel
            class, or a function that makes a kernel; or a preset of SIMPLE such as "as_printed",
            which is kept whole, its planner and length included. Options are the kernel's own, and
            ``chains`` and ``settings``, as in
            ``{"as printed": ("local_mh", {"rule": "paper"})}``. Kernels that take bottom-up
            proposals get the same ones, unless such options say otherwise; the table shows which.
        budget: of every single run; ``phase_ppl.simulations(n)`` or ``phase_ppl.frames(n)``,
            the initial ones included, or ``phase_ppl.seconds(t)``, compiling included. A run ends
            with the iteration that spends it, whatever its kernel declares that one may cost.
        repeats: runs of every kernel.
        chains: particles M.
        seed: a whole number >= 0.
        reference: what the results are compared with: a posterior of the same event and model,
            "enumeration" in PHASE (:mod:`phase_ppl.inference.compare`), with more than 4
            simulations of each pair of goals as ``("enumeration", {"per_pair": 16})``, "none", or a
            kernel as in ``kernels`` that is not compared, whose options may have a ``budget`` or
            ``iterations``; without, it has ten times the budget. By default enumeration, if ten
            times the budget suffices for it, else four populations of ``smc`` that share that
            budget, and none where ``smc`` is compared. A reference has an error of its own, which
            is measured and printed; kernels are not ranked within it.
        weights: of the draws; "count" is the only valid one for judging kernels.
        settings: of SIMPLE; by default the paper's numbers, with bottom-up proposals of goals.
            Where these take a reading of the video, its time counts, also if it was read before.
        workers: processes; by default one per usable core. With an ``executor``, how many
            simulations to give it at a time; by default all.
        executor: any PEP 3148 executor to simulate in, as for :func:`phase_ppl.infer`.
        progress: whether to show a bar on stderr; by default where that is a terminal.
        checkpoint: a .json file that is rewritten after every run. If it exists, the runs in it
            are not repeated; more kernels and more repeats may be asked for. It is a comparison
            in itself.

    Raises:
        InvalidSettingError, UnknownNameError: a setting or kernel that cannot be used, or a
            checkpoint of other settings.
        InvalidEventError: ``event`` is no event, or the checkpoint is damaged.
        SimulationError: all initial simulations of a run failed, or the executor takes no more
            work.
        ComparisonInterrupted: Ctrl-C; it carries what was finished.
    """
    from phase_ppl.analysis.stepwise_posterior import StepwisePosterior

    read = event if isinstance(event, StepwisePosterior) else None
    if read is not None:
        from phase_ppl.inference.table_run import event_of, model_of

        event, model = event_of(read), model_of(read, model)
    event = check_event(event)
    model = (Model() if model is None else model).for_sampling()
    repeats = whole_number("repeats", repeats, maximum=_MOST_REPEATS)
    seed = whole_number("seed", seed, minimum=0)
    slots_of(workers, executor)
    if weights not in WEIGHTINGS:
        raise unknown_name("weights", weights, WEIGHTINGS)
    instance_of("budget", budget, Budget, BUDGETS)
    settings = SimpleSettings() if settings is None else settings
    chosen = entries(kernels, chains, settings)
    wanted = Reference.asked_for(reference, event, budget, chains, settings, weights, chosen)
    for entry in chosen if wanted.kernel is None else (*chosen, wanted.kernel):
        entry.check(event, model, budget)
    runs = [(repeat, entry) for repeat in range(repeats) for entry in chosen]
    with locked(checkpoint):
        record = _Record(
            {
                "versions": versions(),
                "event": event.id,
                "observed": event_salt(event.scene, event.observation),
                "model": model.fingerprint(),
                "kernels": {entry.label: entry.record() for entry in chosen},
                "proposals": {entry.label: entry.proposals(event.scene.world) for entry in chosen},
                "budget": str(budget),
                "chains": chains,
                "repeats": repeats,
                "seed": seed,
                "weights": weights,
                "reference": {"asked": wanted.record()},
                **({} if read is None else {"read": read.settings}),
            },
            checkpoint,
        )
        done = {(run["repeat"], run["kernel"]) for run in record.runs}
        waiting = [(repeat, entry) for repeat, entry in runs if (repeat, entry.label) not in done]
        if waiting and checkpoint is not None:
            versions_so_far([record.settings["versions"]], checkpoint)
        try:
            with Bar(len(waiting) + 1, 0, progress, "run", "reference") as bar:
                to_do = bool(waiting) or record.reference is None
                if read is None and to_do and is_stepwise(model.likelihood):
                    read = infer(event, model, seed=seed, workers=workers, progress=progress)
                if record.reference is None:
                    found = reference_of(wanted, event, model, read, seed, workers, executor)
                    if found["marginals"] is not None:
                        found["truth"] = of_truth(found["marginals"], event.truth)
                    record.keep_reference(found)
                bar.update()
                known = record.reference["marginals"]
                marginals = known and {name: np.array(p) for name, p in known.items()}
                for repeat, entry in waiting:
                    bar.set_description(f"{entry.label}, repeat {repeat + 1}")
                    run_seed = int(np.random.SeedSequence([seed, repeat]).generate_state(1)[0])
                    source = event if read is None else read
                    post = entry.run(source, model, budget, run_seed, workers, executor)
                    post = Posterior(post.tree, entry.own.get("weights", weights))
                    columns = {
                        "kernel": entry.label,
                        "repeat": repeat,
                        "seed": run_seed,
                        "validity": str(post.tree.attrs["validity"]),
                        **accuracy(post, marginals, event.truth),
                        **efficiency(post),
                    }
                    rows = curve(post, marginals, event.truth)
                    record.keep(columns, rows.assign(kernel=entry.label, repeat=repeat))
                    bar.update()
        except KeyboardInterrupt as stopped:
            finished = record.comparison() if record.runs else None
            raise ComparisonInterrupted(finished) from stopped
        return record.comparison()


class _Record:
    """What is finished, and the file that keeps it, if there is one."""

    def __init__(self, settings: Mapping[str, Any], path: str | os.PathLike[str] | None) -> None:
        self.settings: dict[str, Any] = _stable(settings)
        self.runs: list[dict[str, Any]] = []
        self.curves: list[pd.DataFrame] = []
        self._path = None if path is None else Path(path)
        if self._path is not None and self._path.exists():
            self._take_up(Comparison.load(self._path))
        elif self._path is not None:
            self.comparison().save(self._path)  # where it cannot be written is said now

    @property
    def reference(self) -> Any:
        """The reference with its marginals; None where it is still to be made."""
        entry = self.settings["reference"]
        return entry if "marginals" in entry else None

    def keep_reference(self, found: Mapping[str, Any]) -> None:
        self.settings["reference"] |= _stable(found)
        self._save()

    def keep(self, run: dict[str, Any], rows: pd.DataFrame) -> None:
        self.runs.append(run)
        self.curves.append(rows[list(CURVE_COLUMNS)])
        self._save()

    def comparison(self) -> Comparison:
        runs = pd.DataFrame(self.runs, columns=list(RUN_COLUMNS))
        empty = pd.DataFrame(columns=list(CURVE_COLUMNS))
        curves = pd.concat(self.curves, ignore_index=True) if self.curves else empty
        return _in_order(runs, curves, self.settings)

    def _save(self) -> None:
        if self._path is not None:
            self.comparison().save(self._path)

    def _take_up(self, stored: Comparison) -> None:
        """Go on from a checkpoint."""
        old, new = dict(stored.settings), self.settings
        pairs = [(name, old.get(name), new[name]) for name in new
                 if name not in _MAY_DIFFER]  # fmt: skip
        pairs.append(("reference", old["reference"].get("asked"), new["reference"]["asked"]))
        shared = old["kernels"].keys() & new["kernels"].keys()
        pairs += [(f"kernel {k!r}", old["kernels"][k], new["kernels"][k]) for k in sorted(shared)]
        for name, was, given in pairs:
            if was != given:
                raise InvalidSettingError(
                    f"checkpoint {self._path} was made with another {name}: {shown(was)}, not "
                    f"{shown(given)}; name another file, or delete this one"
                )
        new["versions"] = old.get("versions", {})
        for name in ("kernels", "proposals"):  # files did not always have the latter
            new[name] = {**old.get(name, {}), **new[name]}
        new["repeats"] = max(old["repeats"], new["repeats"])
        new["reference"] = old["reference"]
        self.runs = stored.runs.to_dict("records")
        self.curves = [stored.curve] if len(stored.curve) else []


def _in_order(runs: pd.DataFrame, curves: pd.DataFrame, settings: Mapping[str, Any]) -> Comparison:
    """Return a comparison of runs in any order."""
    order = {label: place for place, label in enumerate(settings["kernels"])}
    runs, curves = (
        frame.sort_values(
            ["kernel", "repeat"],
            key=lambda c: c.map(order) if c.name == "kernel" else c,
            kind="stable",
            ignore_index=True,
        )
        for frame in (runs, curves)
    )
    return Comparison(runs, curves, settings)


def _stable(value: Any) -> Any:
    """Return ``value`` as a file keeps it; kernels stay in order."""
    return stable(plain(value), sort_keys=False)
