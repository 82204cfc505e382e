"""The form of a file of a posterior of the closed loop: its variables, and those of older versions.

Attributes: ``schema``, ``event_id``, ``settings`` and ``cost`` (JSON), ``weight`` (what a frame
counts); ``samples``, of a simulator of one's own (0: it has a density); and those of the scene
(:func:`phase_ppl.analysis.tree.scene_dataset`).
"""

from __future__ import annotations

import itertools
from typing import Any, Final

import numpy as np
import xarray as xr

from phase_ppl.analysis.tree import kept_world
from phase_ppl.models.prior_masses import APART
from phase_ppl.physics.actions import ACTION_NAMES, N_ACTIONS
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.space import HypothesisSpace, space_of

SCHEMA: Final = "phase_ppl/stepwise/3"
_OF_PAIRS: Final = "phase_ppl/stepwise/2"  # in PHASE, log likelihoods by pair of goals
SCHEMAS: Final = (SCHEMA, _OF_PAIRS)
"""Of files of posteriors of the closed loop; the second is of version 0.1.0."""

_ATTRS: Final = ("event_id", "settings", "cost", "weight")
_ALWAYS: Final = {
    "combinations": ("combination", "agent"),
    "unexplained": ("time",),
    "trajectory": ("time", "entity", "coord"),
}
_BY_AGENTS: Final = {
    "strengths": ("time", "combination"),
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "log_peak": ("time",),
}
_POLICIES: Final = {
    "density": ("time", "joint_action"),
    "policies": ("time", "agent", "policy", "planner_seed", "action"),
    "policy_of": ("time", "agent", "standpoint"),
    "shift": ("time", "table"),  # jackknife replicates
}
_READ: Final = {
    "goals": ("read", "agent"),
    "log_likelihood": ("time", "read", "combination"),
    "log_likelihood_without": ("part", "time", "read", "combination"),
}
_MARGINALS: Final = {"marginals": ("time", "agent", "goal")}


def dimensions(space: HypothesisSpace) -> dict[str, tuple[str, ...]]:
    """Return variable of a file -> its dimensions, of all that a file can have.

    ``strengths`` are the probabilities of their combinations, whatever the goals, given the frames
    so far and equal ones before; ``actions`` those of what each agent did to come to a frame;
    ``unexplained`` says by how many nats the best joint action leaves the frame less probable than
    one that is exactly where an action puts it, whose log density is ``log_peak``.
    ``log_likelihood`` is the log density of a frame given those before it, by effective goals, NaN
    where a simulator was not asked; then ``unexplained`` is by how many nats the frame is less
    probable than on the nearest of its samples, NaN without. The rest is in
    :mod:`phase_ppl.closed_loop.goal_filter`.
    """
    apart = {**APART, **_MARGINALS, "log_prior": space.kept_columns}
    return {**_ALWAYS, **_BY_AGENTS, **_POLICIES, **_READ, **apart}


def labels(space: HypothesisSpace, levels: tuple[float, ...]) -> dict[str, list[Any]]:
    """Return dimension -> its labels, of those that have some."""
    ways = [str(tuple(one[1] if one else 0 for one in way)) for way in space.ways]
    return {
        "agent": list(space.world.agents),
        "action": list(ACTION_NAMES),
        "goal": list(space.world.goals),
        **{key: list(space.world.goals) for key in space.stated_sites},
        space.company_site: ways,
        **{key: list(levels) for key in space.strength_sites},
    }


def _converted(found: xr.Dataset) -> xr.Dataset:
    """Return what version 0.1.0 wrote as this one does."""
    if found.attrs["schema"] == SCHEMA:
        return found
    levels = [found[name].values for name in ("strength_red", "strength_green")]
    pairs = np.indices((found.sizes["goal_red"], found.sizes["goal_green"])).reshape(2, -1).T
    with_pairs = {
        name: (("planner_seed", "time")[1 - many :], found[name].values)
        for many, name in enumerate(("log_likelihood", "log_likelihood_without"))
    }
    strengths = found["strengths"].values
    found = found.drop_dims(("goal_red", "goal_green")).drop_vars("strengths")
    found["combinations"] = _ALWAYS["combinations"], list(itertools.product(*levels))
    found["goals"] = _READ["goals"], pairs
    found["strengths"] = _BY_AGENTS["strengths"], strengths.reshape(len(strengths), -1)
    for name, (dims, values) in with_pairs.items():
        found[name] = (*dims, "read"), values.reshape(*values.shape[:-2], len(pairs))
    return found.assign_attrs(schema=SCHEMA)


def _check(found: xr.Dataset, space: HypothesisSpace) -> None:
    """Raise InvalidEventError, naming what is missing or wrong, unless ``found`` was read."""
    users_simulator = "samples" in found.attrs
    is_read = users_simulator or "log_likelihood" in found
    known = dimensions(space)
    names = {*_ALWAYS, *(() if users_simulator else _BY_AGENTS), *(_READ if is_read else _POLICIES)}
    apart = {*APART, *(() if users_simulator else _MARGINALS)}
    names |= {"log_prior"} if "log_prior" in found else apart
    missing = [name for name in _ATTRS if name not in found.attrs]
    if missing := sorted((*missing, *(name for name in names if name not in found.variables))):
        raise InvalidEventError(f"it lacks {', '.join(missing)}")
    if is_read and not users_simulator:  # goals and strengths apart
        known |= {"log_likelihood": ("time", "read")}
        known |= {"log_likelihood_without": ("planner_seed", "time", "read")}
    for name in names:
        if found[name].dims != known[name]:
            raise InvalidEventError(
                f"{name} has dimensions {found[name].dims}, expected {known[name]}"
            )
    sizes = {name: len(each) for name, each in labels(space, ()).items() if each}
    sizes |= {"way": len(space.ways), "joint_action": N_ACTIONS**space.n_agents}
    for name, size in sizes.items():
        if found.sizes.get(name, size) != size:
            raise InvalidEventError(f"{name} has {found.sizes[name]} entries, expected {size}")
    if is_read and not users_simulator and found.sizes["planner_seed"] == 1:
        raise InvalidEventError("planner_seed has 1 entry, expected none or several")
    for name, top in (("goals", space.n_goals), ("policy_of", found.sizes.get("policy", 0))):
        if name in names and not ((codes := found[name].values) >= 0).all() & (codes < top).all():
            raise InvalidEventError(f"{name} has a code outside 0 to {top - 1}")
    numbers = {
        **dict.fromkeys(("log_likelihood", "density", "log_prior_company"), "log densities"),
        **{"shift": "differences", "strengths": "probabilities", "trajectory": "positions"},
    }
    for name in names & {*numbers}:
        values = found[name].values
        # not asked, or not seen
        unknown = name == "trajectory" or (name == "log_likelihood" and users_simulator)
        if (np.isnan(values).any() and not unknown) or (values == np.inf).any():
            raise InvalidEventError(f"{name} has values that are no {numbers[name]}")


def as_written_now(found: xr.Dataset) -> xr.Dataset:
    """Return what the closed loop read, checked, with the variables of this version.

    Raises:
        InvalidEventError: ``found`` lacks something, or is of another kind; the message names it.
    """
    if found.attrs.get("schema") not in SCHEMAS:
        raise InvalidEventError(
            "this is no posterior of the closed loop: its schema is "
            f"{found.attrs.get('schema')!r}, expected {SCHEMA!r}, or an older one"
        )
    try:
        space = space_of(kept_world(found))
    except (ValueError, LookupError, TypeError, PhasePPLError) as error:
        raise InvalidEventError(f"its world cannot be read: {error}") from None
    try:
        found = _converted(found)
    except KeyError as error:
        raise InvalidEventError(f"it lacks {error.args[0]}") from None
    _check(found, space)
    return found
