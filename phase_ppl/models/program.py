"""A model of one event as NumPyro programs: prior, likelihood, and both together."""

from __future__ import annotations

import contextlib
import math
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax import random
from numpyro import handlers
from numpyro.primitives import _PYRO_STACK

from phase_ppl.models.bridge import Request, called_back, no_gradient
from phase_ppl.models.density import NO_DENSITY, Sites, draw, latent_sites, log_density, tracing
from phase_ppl.models.effective import space_of_prior
from phase_ppl.models.model import Model
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.space import ALPHA_SITE, HypothesisSpace

MAX_SEED: Final = 2**31 - 1  # simulator seeds lie below this
SEED_SITE: Final = "sim_seed"

_NEVER: Final = {
    "enumerate": "never: a simulation has no gradient, and no seeds to sum over. Take a kernel of "
    "phase_ppl.kernels, or SA or AIES on program.uniform"
}
"""Message of NumPyro's HMC, NUTS, SA and AIES when they refuse the site."""

HOW_TO_CONDITION: Final = (
    "to condition, ask the posterior, as in post.query('P(relation | goal_red=...)'), or take "
    "NumPyro's DiscreteGibbs(handlers.condition(program, {...})), or a prior that allows only what "
    "is given: post.with_prior(prior), ppl.Model(prior)"
)

_GIVERS: Final = (handlers.condition, handlers.substitute, handlers.do)


class SimulatorSeed(dist.DiscreteUniform):
    """Uniform distribution of the simulator's seed; too many values to enumerate."""

    has_enumerate_support = False

    def __init__(self) -> None:
        super().__init__(0, MAX_SEED - 1)


class Lookup(NamedTuple):
    """The closed loop's table of a video, as errors in place of a simulation's.

    A frame's error is the log likelihood of the best pair of goals minus the pair's own, in nats,
    times the likelihood's weight. A strength is rounded to the nearest level in the table.
    """

    # (time, goal of the first agent, of the second, ...) nats, or by levels of strength too; inf:
    # impossible
    frames: jax.Array
    strengths: jax.Array  # (level of the first agent, ...) nats, of the first frame
    edges: jax.Array  # (level - 1,) newtons, between the levels

    def errors(self, goals: jax.Array, strengths: jax.Array) -> jax.Array:
        """Return (time,) errors of effective goals (agent,) with strengths (agent,) in newtons."""
        levels = tuple(jnp.searchsorted(self.edges, strengths))
        found = self.frames[:, *goals]
        found = found if found.ndim == 1 else found[:, *levels]
        return found.at[0].add(self.strengths[levels])


class EventProgram:
    """The model of one event as a NumPyro program. :func:`phase_ppl.program` makes one.

    The program can be traced, seeded, conditioned and sampled. :meth:`uniform` has the same
    distribution over hypotheses and seeds, without discrete sites. Kernels that need the prior
    density before they simulate call the other methods.

    The simulator is noisy, and its seed w is a latent site, ``sim_seed``. The target is
    P(h) p(w) L(e(h, w)) over the hypothesis h and w, where e are the errors of the simulation. The
    same h and w always have the same likelihood. So, under any exact kernel, the hypotheses of a
    chain follow the posterior under the mean likelihood over seeds (pseudo-marginal).

    Args:
        model: prior and likelihood, bound to the event's world (``Model.in_world``).
        bridge: handle of the :class:`~phase_ppl.models.bridge.SimulatorBridge` that simulates.
        n_frames: number of frames, the length of arrays (time,).
        observed: number of observed frames, if arrays (time,) are longer than that. It may be known
            only inside compiled code. Errors and log likelihoods of frames beyond it are 0.
        table: the closed loop's table of likelihoods, which then takes the simulator's place.
    """

    def __init__(
        self,
        model: Model,
        bridge: jax.Array | int,
        n_frames: int,
        observed: jax.Array | int | None = None,
        table: Lookup | None = None,
    ) -> None:
        self.model = model
        self.table = table
        self.space = space_of_prior(model.prior)
        self.likelihood = model.error_likelihood
        self.bridge = bridge
        self.n_frames = n_frames
        self.is_padded = observed is not None
        self.observed = n_frames if observed is None else observed

    def __call__(self) -> None:
        # before the hypothesis, so that samplers that cannot handle it refuse it at once
        seed = numpyro.sample(SEED_SITE, SimulatorSeed(), infer=_NEVER)
        with handlers.trace() as trace:
            self.model.prior()
        sites = {name: trace[name]["value"] for name in self.model.sites}
        errors = self.simulate(sites, self.log_prior(sites), seed)
        numpyro.deterministic("step_error", errors)
        numpyro.factor("trajectory", self.log_likelihood(errors).sum())

    def uniform(self) -> None:
        """Run the model as a NumPyro program of one site, ``uniform``: (dimension,) in [0, 1].

        It is for NumPyro's samplers that know no discrete sites: SA, AIES, ESS. Hypothesis and seed
        are deterministic sites, functions of the uniform numbers. Their distribution is that of the
        program itself.

        Raises:
            InvalidSettingError: a site of the prior has no inverse distribution function, or a
                handler gives a value to hypothesis or seed.
        """
        n = dimensions(self.model)
        u = in_steps(numpyro.sample("uniform", dist.Uniform().expand([n]).to_event(1)))
        with handlers.block():
            sites = sites_at(self.model, u)
        seed = self.seed_at(u[-1])
        _check_not_given({**sites, SEED_SITE: seed})
        errors = self.simulate(sites, self.log_prior(sites), seed)
        for name, value in {**sites, SEED_SITE: seed, "step_error": errors}.items():
            numpyro.deterministic(name, value)
        log_likelihood = self.log_likelihood(errors).sum()
        possible = jnp.isfinite(log_likelihood)
        numpyro.factor("trajectory", jnp.where(possible, log_likelihood, -IMPOSSIBLE_POTENTIAL))

    def draw_prior(self, key: jax.Array) -> dict[str, jax.Array]:
        """Return site -> value: a hypothesis, and any further sites, drawn from the prior."""
        return draw(self.model.prior, key)

    @tracing()
    def log_prior(self, sites: Sites) -> jax.Array:
        """Return the log prior density of ``sites`` (site -> value); -inf outside the support."""
        with handlers.block():  # where it is asked for within a program
            return log_density(self.model.prior, sites)

    def log_likelihood(self, step_error: jax.Array) -> jax.Array:
        """Return (time,) the log density of each frame, from its error ``step_error``, (time,)."""
        return self._within(self.likelihood.log_prob(step_error))

    def relative_log_likelihood(self, step_error: jax.Array) -> jax.Array:
        """Return the log density of the observation minus that at errors of 0.

        It is a sum over frames with errors ``step_error``, (time,), units. So the likelihood's
        large constant cancels without rounding.
        """
        none = self.likelihood.log_prob(jnp.zeros_like(step_error))
        return self._within(self.likelihood.log_prob(step_error) - none).sum()

    def _within(self, by_frame: jax.Array) -> jax.Array:
        """Return values by frame (time,), set to 0 beyond the observation."""
        if not self.is_padded:
            return by_frame
        return jnp.where(jnp.arange(self.n_frames) < self.observed, by_frame, 0.0)

    def simulate(
        self,
        sites: Sites,
        log_prior: jax.Array,
        seed: jax.Array,
        error_ceiling: jax.Array | float = np.inf,
        log_proposal: jax.Array | float = np.nan,
        log_bound: jax.Array | float = np.inf,
    ) -> jax.Array:
        """Return the error of each frame of one simulation, (time,), units, float32.

        It works inside compiled code. The bridge is a number there, so one compiled program serves
        many events. All errors are inf if the simulation failed, or if the hypothesis has no prior
        mass and so was not simulated. Errors are 0 beyond the observation.

        Args:
            sites: site -> value, the hypothesis and any further sites.
            log_prior: log prior density of ``sites``.
            seed: seed of the simulation.
            error_ceiling: sum of errors, units, beyond which the simulation is stopped. Errors are
                inf from there.
            log_proposal, log_bound: numbers to record with the simulation; see
                :class:`~phase_ppl.models.bridge.Record`.
        """
        if self.table is not None:
            strengths = jnp.stack([sites[name] for name in self.space.strength_sites])
            errors = self.table.errors(self.effective_goals(sites), strengths)
            return jnp.where(log_prior > NO_DENSITY, errors, jnp.inf)
        numbers = (error_ceiling, log_proposal, log_bound)
        asked = Request(dict(sites), log_prior, seed, *map(jnp.float32, numbers))
        return called_back(self.n_frames, *jax.tree.map(jnp.asarray, (self.bridge, asked)))

    def answer(self, request: Request) -> jax.Array:
        """Return the errors (..., time), units, of an array (...) of requests to simulate."""

        def one(request: Request) -> jax.Array:
            return self.simulate(*request)

        for _ in range(jnp.ndim(request.seed)):
            one = jax.vmap(one)
        return one(request)

    def simulator_seed(self, key: jax.Array) -> jax.Array:
        """Return a random seed of the simulator, int32."""
        return random.randint(key, (), 0, MAX_SEED, jnp.int32)

    def seed_at(self, uniform: jax.Array) -> jax.Array:
        """Return the seed for a number in [0, 1)."""
        number = jnp.floor(uniform * 2**SEED_BITS).astype(jnp.uint32)
        return self.simulator_seed(random.fold_in(random.key(0), number))

    def effective_goals(self, sites: Sites) -> jax.Array:
        """Return (agent,) the effective goals of ``sites``, indices into ``world.goals``."""
        return effective_goals(self.space, sites)


def _check_not_given(sites: Sites) -> None:
    """Raise InvalidSettingError if a handler gives a value to one of these deterministic sites.

    NumPyro would ignore it (``condition``, ``do``), or show another hypothesis than was simulated
    (``substitute``).
    """
    givers = [h for h in _PYRO_STACK if isinstance(h, _GIVERS)]
    for name, value in sites.items():
        site = {"name": name, "fn": dist.Unit(0.0), "value": value}
        site |= {"kwargs": {"rng_key": None}, "is_observed": True}
        for handler in givers:
            replays = isinstance(handler, handlers.substitute)  # Predictive's, which may skip this
            if not (replays and "uniform" in (handler.data or {})):  # else all follows from that
                site["type"] = "deterministic" if replays else "sample"
                handler.process_message(site)
        if site["value"] is not value:
            raise InvalidSettingError(
                f"a handler gives {name}, which follows from the other sites of this program and "
                f"cannot be set there: {HOW_TO_CONDITION}"
            )


def effective_goals(space: HypothesisSpace, sites: Sites) -> jax.Array:
    """Return (agent,) the codes of the goals that agents act on; inside compiled code."""
    way = sites[ALPHA_SITE]
    stated = jnp.stack([jnp.asarray(sites[name], jnp.int32) for name in space.goal_sites])
    owner, agents = jnp.asarray(space.owner)[way], np.arange(space.n_agents)
    return jnp.asarray(space.becomes)[way, agents, stated[owner]]


# --- as a function of uniform numbers -------------------------------------------------------------
# A model as a function of uniform numbers, for samplers that know no discrete sites.
#
# Every latent site of the prior is its inverse distribution function at a uniform number, one site
# after the other. The simulator's seed is a function of one more number. Such a model has no
# discrete site, and its prior is uniform.

IMPOSSIBLE_POTENTIAL: Final = 1e8
"""Potential of points without mass. It is finite: NumPyro's SA never leaves a point with infinite
potential."""

SEED_BITS: Final = 24  # bits of a uniform number in single precision that make a seed
_STEPS: Final = 2**16  # distinct values of a uniform number


def dimensions(model: Model) -> int:
    """Return how many numbers make a hypothesis and the seed."""
    return sum(map(math.prod, model.sites.values())) + 1


@jax.custom_jvp
def in_steps(uniform: jax.Array) -> jax.Array:
    """Return uniform numbers rounded to the middle of one of many steps.

    Compiled code rounds the same sum differently in different places. Steps let a simulation be
    recognised when the sampler has moved there. Once in some thousand iterations this fails, and
    the point is simulated again.
    """
    steps = jnp.minimum(jnp.floor(uniform * _STEPS), _STEPS - 1)
    return (steps + 0.5) / _STEPS


in_steps.defjvp(no_gradient)  # a gradient of 0 everywhere would be worse than an error


@tracing()
def sites_at(model: Model, uniform: jax.Array) -> dict[str, jax.Array]:
    """Return the hypothesis, with any further sites, for uniform numbers (dimension,).

    Raises:
        InvalidSettingError: a site of the prior has no inverse distribution function.
    """
    numbers: dict[str, jax.Array] = {}
    begin = 0
    for name, shape in model.sites.items():
        numbers[name] = uniform[begin : begin + math.prod(shape)].reshape(shape)
        begin += math.prod(shape)

    def value(site: dict[str, Any]) -> jax.Array | None:
        name = site["name"]
        free = name in numbers and site["value"] is None
        return _quantile(name, site["fn"], numbers[name]) if free else None

    prior = handlers.substitute(model.prior, substitute_fn=value)
    found = latent_sites(handlers.trace(prior).get_trace())
    return {name: site["value"] for name, site in found.items()}


def _quantile(name: str, distribution: Any, uniform: jax.Array) -> jax.Array:
    """Return the inverse distribution function at ``uniform``, element by element."""
    while isinstance(distribution, dist.Independent | dist.ExpandedDistribution):
        distribution = distribution.base_dist  # broadcasting gives the shape back
    if not distribution.event_shape:
        with contextlib.suppress(NotImplementedError, ImportError):
            if distribution.has_enumerate_support:
                return _discrete_quantile(distribution, uniform)
            value: jax.Array = distribution.icdf(uniform)
            return value
    raise InvalidSettingError(
        f"site {name!r} ({type(distribution).__name__}) has no inverse distribution function, "
        "which this kernel needs"
    )


def _discrete_quantile(distribution: Any, uniform: jax.Array) -> jax.Array:
    support = distribution.enumerate_support(expand=True)
    reached = jnp.cumsum(jnp.exp(distribution.log_prob(support)), axis=0)
    reached = reached / reached[-1]
    index = (uniform[None] > reached[:-1]).sum(axis=0)
    values = jnp.broadcast_to(support, (len(support), *uniform.shape))
    return jnp.take_along_axis(values, index[None], axis=0)[0]
