"""Moving one site of a hypothesis while the others stay.

Changing a site also changes the prior of the sites below it in a hierarchy. That part is in the
prior's ratio, which the caller has; the corrections returned here are those of the proposal
alone, Hastings' log q(z | z') - log q(z' | z).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import random
from numpyro import handlers

from phase_ppl.models.density import Program, Sites

SiteMove = Callable[[jax.Array, Mapping[str, Any]], tuple[jax.Array, jax.Array | float]]
"""``(key, site) -> (new value, Hastings' correction)``, where the site is that of a trace."""


def redrawn(key: jax.Array, site: Mapping[str, Any]) -> tuple[jax.Array, jax.Array | float]:
    """Draw a site from its prior, given those above it in the program."""
    prior, value = site["fn"], site["value"]
    new = prior.sample(key, site["kwargs"].get("sample_shape", ()))
    return new, jnp.sum(prior.log_prob(value)) - jnp.sum(prior.log_prob(new))


def moved_site(
    prior: Program,
    key: jax.Array,
    sites: Sites,
    names: Sequence[str],
    moves: Mapping[str, SiteMove] | None = None,
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Move one site, chosen by chance.

    Args:
        prior: program over the sites.
        key: of all that is random.
        sites: all latent sites.
        names: of those that may move, each as likely.
        moves: how sites move; those not named are :func:`redrawn`.

    Returns:
        The sites after it, and Hastings' correction.
    """
    trace = handlers.trace(handlers.substitute(prior, data=dict(sites))).get_trace()
    key_which, *keys = random.split(key, 1 + len(names))
    which = random.randint(key_which, (), 0, len(names))
    proposed, corrections = dict(sites), []
    for index, (name, key_site) in enumerate(zip(names, keys, strict=True)):
        new, correction = ({} if moves is None else moves).get(name, redrawn)(key_site, trace[name])
        old = jnp.asarray(sites[name])
        proposed[name] = jnp.where(which == index, jnp.asarray(new, old.dtype), old)
        corrections.append(correction)
    return proposed, jnp.stack([jnp.asarray(c, jnp.float32) for c in corrections])[which]
