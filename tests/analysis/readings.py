"""Readings made by hand, as the tests of posteriors of the closed loop need them."""

from __future__ import annotations

import functools
import itertools
import json
from typing import Any

import numpy as np
import xarray as xr

import phase_ppl as ppl
from phase_ppl.agents.config import PlannerConfig
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.closed_loop_table import SCHEMA
from phase_ppl.models.sites import SELF_REFERRING
from phase_ppl.physics.actions import ACTION_NAMES
from phase_ppl.world.goals import GOALS, N_GOALS, goal_index
from phase_ppl.world.hypothesis import ALPHAS
from phase_ppl.world.names import AGENTS, ENTITIES
from tests.agents.scenes import scene

LEVELS = (300.0, 600.0)
STRENGTHS = ("strength_red", "strength_green")
DIMENSIONS = {
    "log_likelihood": ("time", "read"),
    "log_likelihood_without": ("planner_seed", "time", "read"),
    "strengths": ("time", "combination"),
    "log_prior": ("stated_goal_red", "stated_goal_green", "alpha", *STRENGTHS),
    "actions": ("time", "agent", "action"),
    "held": ("time", "agent"),
    "unexplained": ("time",),
    "log_peak": ("time",),
    "trajectory": ("time", "entity", "coord"),
}
BLUE_TO_RED = goal_index("Get blue item to red lm")
BLUE_NOT_TO_RED = goal_index("Get blue item away from red lm")


def by_pairs(planner_seeds: int = 3) -> dict[str, Any]:
    """Return what four frames say, which come to speak for one pair of goals and against another.

    Each of the sets of searches, left out, makes some difference to the rest.
    """
    n, rng = 4, np.random.default_rng(0)
    likelihood = np.zeros((n, N_GOALS, N_GOALS))
    likelihood[1:] = rng.normal(0, 0.1, (n - 1, N_GOALS, N_GOALS))
    likelihood[1:, BLUE_TO_RED, BLUE_TO_RED] += 4.0
    likelihood[2, BLUE_NOT_TO_RED, BLUE_TO_RED] += 6.0
    n_sets = planner_seeds if planner_seeds > 1 else 0
    without = likelihood + rng.normal(0, 0.1, (n_sets, *likelihood.shape))
    without[:, 0] = 0
    strengths = np.full((n, 2, 2), 0.25)
    strengths[2:] = [[0.1, 0.2], [0.3, 0.4]]
    prior = np.full((N_GOALS, N_GOALS, len(ALPHAS), 2, 2), 1.0)
    prior[:, :, 1:] = 0.25
    red, green = SELF_REFERRING
    prior[red] = prior[:, green] = 0.0
    with np.errstate(divide="ignore"):
        log_prior = np.log(prior / prior.sum())
    return {
        "log_likelihood": likelihood,
        "log_likelihood_without": without.astype(np.float32),
        "strengths": strengths,
        "log_prior": log_prior,
        "actions": np.full((n, 2, len(ACTION_NAMES)), 1 / len(ACTION_NAMES)),
        "held": np.full((n, 2), -1),
        "unexplained": np.zeros(n),
        "log_peak": np.zeros(n),
        "trajectory": np.repeat(scene().start[None], n, axis=0),
    }


def reading(planner_seeds: int = 3, **changes: Any) -> xr.Dataset:
    """Return :func:`by_pairs`, with some other columns, as the closed loop keeps it."""
    where, found = scene(), {**by_pairs(planner_seeds), **changes.pop("columns", {})}
    n = len(found["trajectory"])
    for name in ("log_likelihood", "log_likelihood_without"):
        found[name] = found[name].reshape(*found[name].shape[:-2], N_GOALS**2)
    found["strengths"] = found["strengths"].reshape(n, -1)
    goals = ("stated_goal_red", "stated_goal_green")
    return xr.Dataset(
        {
            **{name: (DIMENSIONS[name], values) for name, values in found.items()},
            "goals": (("read", "agent"), np.indices((N_GOALS, N_GOALS)).reshape(2, -1).T),
            "combinations": (("combination", "agent"), list(itertools.product(LEVELS, repeat=2))),
            "start": (("entity", "coord"), where.start),
            "radius": ("entity", where.radius),
            "walls": (("wall", "end", "axis"), where.walls),
            "landmark_centres": (("landmark", "axis"), where.landmark_centres),
            "arena": ("border", np.array(where.arena)),
        },
        coords={
            "time": ("time", np.arange(n) / 12, {"units": "s"}),
            **{name: list(GOALS) for name in goals},
            "alpha": [str(alpha) for alpha in ALPHAS],
            **{name: list(LEVELS) for name in STRENGTHS},
            "agent": list(AGENTS),
            "action": list(ACTION_NAMES),
            "entity": list(ENTITIES),
            "coord": ["x", "y", "angle"],
        },
        attrs={
            "schema": SCHEMA,
            "event_id": "by hand",
            "weight": 0.5,
            "settings": json.dumps({"seed": 0}),
            "cost": json.dumps({"searches": 12, "seconds": 1.0, "video_seconds": 0.75}),
            "turning": "both",
            "landmark_half_width": 2.5,
            **changes,
        },
    )


CAST = ppl.World(
    ["red agent", "green agent", "purple agent"],
    ["blue ball"],
    {"home": (4.0, 4.0), "field": (30.0, 12.0)},
    arena=(0.0, 36.0, 0.0, 24.0),
    touchable=["green agent"],
    name="three",
)
"""Three agents with a score of goals, of which all hypotheses are soon summed over."""

QUICK = PlannerConfig(simulations=4, particles=6)


@functools.cache
def of_three() -> ClosedLoopPosterior:
    """Return what is read of eight frames in which purple hinders red."""
    poses = {"red agent": (4, 8), "green agent": (30, 18), "purple agent": (9, 3)}
    event = ppl.simulate(
        CAST.scene({**poses, "blue ball": (6, 5)}),
        goals={"red agent": "blue ball to home", "green agent": "blue ball to field"},
        relation={("purple agent", "red agent"): "hinder"},
        frames=8,
        planner=QUICK,
        seed=2,
    )
    model = ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=2), planner=QUICK)
    found = ppl.infer(event, model, workers=1, progress=False)
    assert isinstance(found, ClosedLoopPosterior)
    return found
