"""The programs of one inference: prior, likelihood and proposal over the same sites.

They are separate because a kernel needs the prior of a proposal before it pays for simulating
it, and the data-driven proposal never simulates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpyro
from numpyro import handlers
from numpyro.infer.util import log_density

from phase_ppl.inference.proposals import Proposals
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.sites import SITES

Sites = dict[str, jax.Array]


@dataclasses.dataclass(frozen=True, eq=False)
class Program:
    """What kernels work on; called, it is the whole model as one NumPyro program.

    Attributes:
        prior: the user's program.
        bridge: to the simulator.
        likelihood: of summed errors.
        proposals: bottom-up tables of this event.
        n_frames: T.
        own_sites: sites of the prior that are not the hypothesis'.
    """

    prior: Callable[[], object]
    bridge: SimulatorBridge
    likelihood: RadialLikelihood
    proposals: Proposals
    n_frames: int
    own_sites: tuple[str, ...] = ()

    def __call__(self, seed: jax.Array) -> None:
        """Sample a hypothesis and weigh it by the simulation with this seed."""
        trace = handlers.trace(self.prior).get_trace()
        for site in trace.values():
            if site["type"] == "sample":
                numpyro.sample(site["name"], site["fn"], obs=None)
        self.trajectory({name: trace[name]["value"] for name in SITES}, seed)

    def trajectory(
        self, sites: Sites, seed: jax.Array, error_ceiling: jax.Array | float = jnp.inf
    ) -> None:
        """Weigh a hypothesis by one simulation: the likelihood as a NumPyro program."""
        hypothesis = {name: sites[name] for name in SITES}
        errors = self.bridge(hypothesis, seed, jnp.asarray(error_ceiling, jnp.float32))
        numpyro.deterministic("step_error", errors)
        numpyro.factor("trajectory", self.likelihood.log_prob(errors.sum(), self.n_frames))

    def log_likelihood(
        self, sites: Sites, seed: jax.Array, error_ceiling: jax.Array | float = jnp.inf
    ) -> tuple[jax.Array, jax.Array]:
        """Simulate once; return the log likelihood and the errors per frame."""
        value, trace = log_density(self.trajectory, (sites, seed, error_ceiling), {}, {})
        return value, trace["step_error"]["value"]

    def log_prior(self, sites: Sites) -> jax.Array:
        """Return the log density of the prior."""
        return log_density(self.prior, (), {}, sites)[0]

    def sample_prior(self, key: jax.Array) -> Sites:
        """Draw all sites of the prior."""
        return _sampled(self.prior, key)

    def sample_local(self, key: jax.Array, window: jax.Array) -> Sites:
        """Draw the hypothesis sites from the bottom-up proposal of one interval."""
        return _sampled(self.proposals.guide, key, window)

    def log_local(self, sites: Sites, windows: jax.Array) -> jax.Array:
        """Return the log density of the bottom-up proposal for each of ``windows``."""
        hypothesis = {name: sites[name] for name in SITES}
        return jax.vmap(lambda w: log_density(self.proposals.guide, (w,), {}, hypothesis)[0])(
            windows
        )


def _sampled(program: Callable[..., object], key: jax.Array, *arguments: jax.Array) -> Sites:
    trace = handlers.trace(handlers.seed(program, key)).get_trace(*arguments)
    return {
        name: site["value"]
        for name, site in trace.items()
        if site["type"] == "sample" and not site["is_observed"]
    }
