"""A posterior by simulations and one of the closed loop answer the same questions."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.posterior import Posterior
from phase_ppl.world.errors import InvalidSettingError

from .factory import tree_by_frame
from .readings import reading

SAMPLED, READ = Posterior(tree_by_frame(2)), ClosedLoopPosterior(reading())

ONLY_SAMPLED = {
    "tree": "draws and simulations",
    "weights": "of draws and simulations; in another way read hypotheses have their masses",
    "burn_in": "of chains",
    "from_numpyro": "of a run by NumPyro",
}
ONLY_READ = {
    "prior": "the program, by which kernels sample from what was read",
    "dataset": "what was read, in place of a tree of draws",
    "frame": "the posterior is of the frames up to this one",
    "at": "at another frame: simulations are proposed from the whole video",
    "planner_seeds": "sets of searches",
    "sites": "of the prior beside a hypothesis; simulations have them in their table",
    "surprise": "of each frame, given those before it",
}


def names(post: Any) -> set[str]:
    return {name for name in dir(post) if not name.startswith("_")}


def test_what_only_one_kind_of_posterior_has_is_known_and_has_a_reason() -> None:
    assert names(SAMPLED) - names(READ) == set(ONLY_SAMPLED)
    assert names(READ) - names(SAMPLED) == set(ONLY_READ)


def test_both_take_the_same_arguments() -> None:
    methods = names(SAMPLED) & names(READ)
    for name in methods - {"load"}:  # of draws it can be said how to weigh them
        one, other = (
            inspect.getattr_static(kind, name, None) for kind in (Posterior, ClosedLoopPosterior)
        )
        assert type(one) is type(other) or {type(one), type(other)} <= {property}, name
        if callable(one):
            assert list(inspect.signature(one).parameters) == list(
                inspect.signature(other).parameters
            )


ANSWERS: dict[str, Callable[[Any], Any]] = {
    "summary": lambda post: set(post.summary()) - {"log_evidence", "frame"},
    "map_record": lambda post: set(post.map_record()) - {"log_joint", "relation", "scenario"},
    "quantities": lambda post: post.quantities,
    "table": lambda post: set(post.table.values),
    "leaders": lambda post: {name: set(one) for name, one in post.leaders().items()},
    "over_time": lambda post: {n: v.dims for n, v in post.over_time().items() if "_error" not in n},
    "why": lambda post: {n: v.dims for n, v in post.why("relation=neutral").items()},
    "observed": lambda post: post.observed().shape[1:],
    "scene": lambda post: type(post.scene),
    "tempering": lambda post: post.tempering.split(":")[0],
    "verdict": lambda post: type(post.diagnostics()["verdict"]),
    "decided": lambda post: type(post.diagnostics()["decided"]),
    "settings": lambda post: type(post.settings),
    "untried": lambda post: type(post.untried),
}


@pytest.mark.parametrize("asked", ANSWERS)
def test_both_give_answers_of_one_form(asked: str) -> None:
    assert ANSWERS[asked](SAMPLED) == ANSWERS[asked](READ)


def test_what_one_kind_cannot_have_it_says() -> None:
    assert READ.replay() is None
    assert SAMPLED.replay().shape == SAMPLED.observed().shape
    assert SAMPLED.by_frame() is None
    by_frame = READ.by_frame()
    assert by_frame is not None
    # frames and the prior make the posterior of pairs, but for what goals say of strengths
    total = np.exp(by_frame["log_likelihood"].sum("time") + by_frame["log_prior"])
    xr.testing.assert_allclose(
        (total / total.sum()).drop_vars(("goal_red", "goal_green")),
        READ.joint("goal_red", "goal_green").drop_vars(("error", "goal_red", "goal_green")),
        atol=1e-6,
    )
    with pytest.raises(InvalidSettingError, match="no chains"):
        _ = READ.chains


def test_odds_over_time_are_those_of_the_posterior_at_its_end() -> None:
    for post in (READ, SAMPLED):
        found = post.why("relation=neutral")
        share = post.over_time()["relation"].sel(relation_is="neutral")
        np.testing.assert_allclose(found["log_odds"], np.log(share / (1 - share)), rtol=1e-6)
        np.testing.assert_allclose(
            found["change"], np.diff(found["log_odds"], prepend=found["log_odds"][0])
        )
    assert "Hindsight" in SAMPLED.why("relation=neutral").attrs["hindsight"]
    with pytest.raises(InvalidSettingError, match="no simulation shows it"):
        SAMPLED.why("strength_red > 700")
    assert ppl.plot.why(SAMPLED, "relation=neutral") is not None
