"""Runs with a simulator that fails under some hypotheses."""

from __future__ import annotations

import itertools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import phase_ppl as ppl
from phase_ppl.inference.reference import enumerate_goals, plan_enumeration
from phase_ppl.world.errors import SimulationError
from phase_ppl.world.goals import GOALS
from tests.inference.runs import EVENT, OPTIONS, assert_same_draws
from tests.inference.toy import walkers
from tests.simulator.toys import LIMITS


def fragile(scene: Any, hypothesis: Any, rng: np.random.Generator) -> Iterator[Any]:
    """Fail always for a weak red agent, for every other seed for a weak green one."""
    if hypothesis.strength_red < 220:
        raise ValueError("too weak")
    if hypothesis.strength_green < 350 and rng.integers(2):
        raise ValueError("slipped")
    yield from walkers(scene, hypothesis, rng)


MODEL = ppl.Model(simulator=fragile)


def infer(**options: Any) -> ppl.Posterior:
    return ppl.infer(EVENT, MODEL, **{**OPTIONS, **options})


def failed(post: ppl.Posterior) -> Any:
    return post.tree["simulations"]["failed"].values


def words(post: ppl.Posterior) -> str:
    return " ".join(str(post).split())


def test_rejected_simulations_have_no_likelihood_and_are_counted() -> None:
    post = infer()
    n = int(failed(post).sum())
    assert post.cost["failures"] == n > 0
    assert post.cost["retries"] == 0
    log_likelihood = post.tree["simulations"]["log_likelihood"].values
    assert np.isneginf(log_likelihood[failed(post)]).all()
    assert np.isfinite(post.tree["sample_stats"]["log_joint"]).all()
    assert post.settings["on_failure"] == "reject"
    assert f"{n} failed" in words(post)


@pytest.mark.parametrize(("limit", "state"), [(350, "fail"), (161, "doubt")])
def test_the_first_failure_is_told_and_kept(limit: float, state: str, tmp_path: Path) -> None:
    """Raised by some hypotheses, or by one in particular."""

    def mistaken(scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
        if hypothesis.strength_red < limit:
            len(scene.radius[0])
        yield from walkers(scene, hypothesis, rng)

    post = ppl.infer(EVENT, ppl.Model(simulator=mistaken), **OPTIONS)
    found = post.diagnostics()
    (check,) = (one for one in found["checks"] if one["name"] == "simulations succeeded")
    assert check["state"] == state
    assert "len()" in found["first_failure"]
    for one in (post, ppl.load_posterior(post.save(tmp_path / "post.nc"))):
        assert "TypeError: object of type 'numpy.float64' has no len() (test_failing" in words(one)
    if state == "fail":
        assert found["trust"] == "do not trust"
        assert found["next"].startswith("mend the simulator")


def test_a_run_with_failures_is_the_same_after_a_rest(tmp_path: Path) -> None:
    post, path = infer(), tmp_path / "run.ckpt"
    infer(iterations=1, checkpoint=path)
    longer = ppl.resume(path, EVENT, MODEL, iterations=4, workers=1, progress=False)
    assert_same_draws(post.tree, longer.tree)
    assert longer.settings == post.settings


class Disturbed:
    """Walks as the toy does, but for what ``disturb`` does to the n-th simulation and after."""

    def __init__(self, at: int, disturb: Callable[[int], None]) -> None:
        self.at, self.disturb, self.calls = at, disturb, 0

    def __call__(self, scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
        self.calls += 1
        if self.calls >= self.at:
            self.disturb(self.calls - self.at)
        yield from walkers(scene, hypothesis, rng)


def fails_once(later: int) -> None:
    if not later:
        raise ValueError("not today")


def hangs(later: int) -> None:
    time.sleep(1000)


def test_raise_keeps_what_was_done_and_can_go_on(tmp_path: Path) -> None:
    path = tmp_path / "run.ckpt"
    model = ppl.Model(simulator=Disturbed(10, fails_once))  # in the second iteration
    with pytest.raises(ppl.SimulationError, match=r"with seed \d+ failed.*not today") as caught:
        ppl.infer(EVENT, model, **OPTIONS, on_failure="raise", checkpoint=path)
    kept = caught.value.posterior
    assert kept.tree["posterior"].sizes["draw"] == 1
    assert kept.cost["interrupted"]
    resumed = ppl.resume(path, EVENT, model, workers=1, progress=False)
    assert_same_draws(ppl.infer(EVENT, model, **OPTIONS).tree, resumed.tree)
    model = ppl.Model(simulator=Disturbed(3, fails_once))
    with pytest.raises(ppl.SimulationError, match="not today") as caught:
        ppl.infer(EVENT, model, **OPTIONS, on_failure="raise")
    assert caught.value.posterior is None  # of the initial particles nothing is kept


def test_particles_start_anew_where_no_simulation_succeeds() -> None:
    def fail(calls: int) -> Callable[[int], None]:
        return lambda later: fails_once(0) if later < calls else None

    chains = OPTIONS["chains"]
    model = ppl.Model(simulator=Disturbed(1, fail(chains + 1)))
    post = ppl.infer(EVENT, model, **OPTIONS)
    assert post.cost["failures"] == chains + 1
    assert failed(post).sum() == chains + 1
    in_vain = Disturbed(1, fail(1000))
    with pytest.raises(SimulationError, match=r"all initial simulations failed; .*not today"):
        ppl.infer(EVENT, ppl.Model(simulator=in_vain), **OPTIONS)
    assert in_vain.calls == 4 * chains


def test_a_limit_of_seconds_makes_a_failure_of_what_hangs() -> None:
    options = {**OPTIONS, "iterations": 2, "weights": "count"}
    for limit in LIMITS:
        model = ppl.Model(simulator=Disturbed(13, hangs))  # the fifth is a repetition
        post = ppl.infer(EVENT, model, simulation_seconds=limit, **options)
        if post.cost["failures"] == 1:
            break
    assert post.cost["failures"] == int(failed(post).sum()) == 1
    assert post.settings["simulation_seconds"] == limit


def test_a_budget_of_seconds_holds_where_the_simulator_hangs() -> None:
    infer(iterations=1)  # what is compiled takes none of the seconds
    options = {**OPTIONS, "iterations": None}
    model = ppl.Model(simulator=Disturbed(11, hangs))
    post = ppl.infer(EVENT, model, budget=ppl.seconds(1), **options)
    assert post.tree["posterior"].sizes["draw"] == 1  # 4 to begin with, 4 of an iteration
    assert not post.cost["interrupted"]
    hanging = Disturbed(1, hangs)
    with pytest.raises(SimulationError, match=r"took longer than the 0\.3 s"):
        ppl.infer(EVENT, ppl.Model(simulator=hanging), budget=ppl.seconds(0.3), **options)
    assert hanging.calls == 1  # after it no time was left


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_ends_a_run_whose_only_worker_hangs() -> None:
    def interrupted(later: int) -> None:
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        hangs(later)

    with pytest.raises(ppl.Interrupted) as caught:
        ppl.infer(EVENT, ppl.Model(simulator=Disturbed(11, interrupted)), **OPTIONS)
    assert caught.value.posterior is not None
    assert caught.value.posterior.tree["posterior"].sizes["draw"] == 1


GOALS_ALIKE = 0, 5  # of red; with the first of them three simulations of four fail


def alike() -> None:
    half = jnp.zeros(len(GOALS)).at[jnp.array(GOALS_ALIKE)].set(0.5)
    numpyro.sample("goal_red", dist.Categorical(probs=half))
    numpyro.sample("goal_green", dist.Categorical(probs=jnp.eye(len(GOALS))[3]))
    numpyro.sample("alpha", dist.Categorical(probs=jnp.eye(5)[0]))
    ppl.sites.strengths()


def slipping(scene: Any, hypothesis: Any, rng: np.random.Generator) -> Iterator[Any]:
    if hypothesis.effective_goals[0] == GOALS_ALIKE[0] and rng.random() < 0.75:
        raise ValueError("slipped")
    yield from itertools.repeat(scene.start)


def test_what_fails_counts_as_impossible_in_all_weights() -> None:
    # both goals fit alike where they do not fail: 1/4 against 1
    model = ppl.Model(prior=alike, simulator=slipping)
    options = {**OPTIONS, "chains": 100, "iterations": 4, "weights": "count"}
    post = ppl.infer(EVENT, model, **options)
    for weights in ("stratified", "count"):
        found = ppl.Posterior(post.tree, weights).probability(goal_red=GOALS[GOALS_ALIKE[0]])
        assert found == pytest.approx(0.2, abs=3 * 0.02), weights
    plan = plan_enumeration(model)
    reference = enumerate_goals(EVENT, model, plan, per_pair=400, workers=1)
    assert reference.probability[GOALS_ALIKE[0]].sum() == pytest.approx(0.2, abs=3 * 0.02)
