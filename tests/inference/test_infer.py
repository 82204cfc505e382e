from __future__ import annotations

import _thread
import dataclasses
import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.tree import simulation_of_draw
from phase_ppl.inference import run, sampler
from phase_ppl.inference.kernels.generic_mh import PriorMH
from phase_ppl.simulator.contract import Cancelled, SimulationResult
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from tests.inference import runs
from tests.inference.runs import EVENT, MODEL, Watched, assert_same_draws
from tests.inference.toy import never_called, walkers

CHAINS, ITERATIONS = 4, 2


def infer(**options: Any) -> ppl.Posterior:
    return runs.infer(**{"kernel": None, "iterations": ITERATIONS, **options})


@pytest.fixture(scope="module")
def post() -> ppl.Posterior:
    return infer()


def test_every_draw_rests_on_a_simulation_of_its_own_chain(post: ppl.Posterior) -> None:
    tree = post.tree
    simulations = tree["simulations"].dataset
    rows = simulation_of_draw(tree)
    assert (rows >= 0).all()
    chain = np.broadcast_to(np.arange(CHAINS)[:, None], rows.shape)
    np.testing.assert_array_equal(simulations["chain"].values[rows], chain)
    joint = (simulations["log_prior"] + simulations["log_likelihood"]).values[rows]
    np.testing.assert_allclose(tree["sample_stats"]["log_joint"], joint)
    for name in ("goal_red", "goal_green", "stated_goal_red", "alpha", "strength_green"):
        np.testing.assert_array_equal(tree["posterior"][name], simulations[name].values[rows])


def test_errors_are_the_distances_of_the_stored_trajectories(post: ppl.Posterior) -> None:
    predicted = post.tree["simulated"]["trajectory"].values[..., :2]
    difference = predicted - EVENT.observation.positions
    errors = np.linalg.norm(difference.reshape(*difference.shape[:3], -1), axis=-1)
    stats = post.tree["sample_stats"]
    np.testing.assert_allclose(stats["step_error"], errors, atol=1e-4)
    np.testing.assert_allclose(stats["total_error"], errors.sum(axis=-1), atol=1e-3)


def test_arviz_gets_what_could_have_been_observed(post: ppl.Posterior) -> None:
    assert post.tree["simulated"].attrs == {"beta": MODEL.likelihood.beta}  # type: ignore[attr-defined]
    data = ppl.Posterior(post.tree, "count").arviz
    noisy = data["posterior_predictive"]["trajectory"].values
    assert noisy.shape == post.tree["simulated"]["trajectory"].shape
    assert not np.allclose(noisy[..., :2], post.tree["simulated"]["trajectory"].values[..., :2])


def test_the_frames_of_a_simulation_add_up_to_its_likelihood(post: ppl.Posterior) -> None:
    simulations = post.tree["simulations"].dataset
    by_frame = simulations["step_log_likelihood"].values
    completed = simulations["completed"].values
    frames = np.isfinite(by_frame).sum(axis=1)
    np.testing.assert_array_equal(frames, simulations["frames_simulated"].values)
    total = simulations["log_likelihood"].values[completed]
    np.testing.assert_allclose(by_frame[completed].sum(axis=1), total)
    found, weighed = post.over_time(), ppl.Posterior(post.tree, "stratified")
    for name in ("goal_red", "goal_green", "relation", "scenario"):
        np.testing.assert_allclose(found[name][-1], weighed.marginal(name), atol=1e-9)


def test_every_simulation_is_kept_and_counted(post: ppl.Posterior) -> None:
    simulations = post.tree["simulations"].dataset
    assert len(simulations["seed"]) == post.cost["simulations"] > CHAINS * (1 + ITERATIONS)
    assert post.tree.attrs["rivals_from"] == 3
    np.testing.assert_array_equal(np.bincount(simulations["iteration"])[:3], [CHAINS] * 3)
    frames = simulations["frames_simulated"].values
    assert frames.sum() == post.cost["frames"]
    by_iteration = simulations["frames_simulated"].groupby(simulations["iteration"]).sum()
    paid = post.tree["sample_stats"]["frames_simulated"].sum("chain")
    np.testing.assert_array_equal(paid, by_iteration[1:3])
    aborted = ~simulations["completed"].values
    assert (frames[~aborted] == EVENT.observation.n_frames).all()


def test_cost_is_kept_apart_from_the_settings(post: ppl.Posterior) -> None:
    assert {"seconds", "seconds_simulating", "seconds_overhead", "workers", "host"} <= set(
        post.cost
    )
    assert post.settings["seed"] == 3
    assert post.settings["model"]["simulator"].endswith("walkers")
    assert not {"workers", "host", "seconds"} & set(json.dumps(post.settings).split('"'))


def test_one_and_two_workers_give_the_same_draws(post: ppl.Posterior) -> None:
    other = infer(workers=2)
    assert other.cost["workers"] == 2
    assert other.settings == post.settings
    assert_same_draws(post.tree, other.tree)


def test_more_iterations_continue_the_same_chains(post: ppl.Posterior) -> None:
    longer = infer(iterations=ITERATIONS + 1).tree["sample_stats"].isel(draw=slice(ITERATIONS))
    np.testing.assert_array_equal(longer["sim_seed"], post.tree["sample_stats"]["sim_seed"])


def test_events_of_one_length_share_the_compiled_programs(post: ppl.Posterior) -> None:
    compiled = run.compiled.cache_info().misses
    infer(seed=12)
    assert run.compiled.cache_info().misses == compiled


def test_progress_counts_simulations_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    made = infer(progress=True).cost["simulations"]
    captured = capsys.readouterr()
    assert f"{made}/{made}" in captured.err
    assert captured.out == ""
    infer(progress=False)
    assert capsys.readouterr().err == ""


# --- what of an event counts -------------------------------------------------------------------


def test_scrambling_truth_judgments_id_and_predictions_changes_no_byte(
    post: ppl.Posterior,
) -> None:
    scrambled = dataclasses.replace(
        EVENT,
        id="other",
        truth=ppl.Truth("get away from green agent", "Get pink item to blue lm"),
        judgments={"friendly": 99},
        predictions={"someone": {"relation": "neutral"}},
    )
    for event in (scrambled, dataclasses.replace(EVENT, id="", truth=None)):
        other = infer_event(event)
        assert other.settings == post.settings
        assert_same_draws(post.tree, other.tree)


def test_another_observation_does_change_the_posterior(post: ppl.Posterior) -> None:
    moved = np.array(EVENT.observation.trajectory)
    moved[3:, 0, 0] += 2.0
    other = infer_event(dataclasses.replace(EVENT, observation=ppl.Observation(moved)))
    errors = [found.tree["simulations"]["total_error"].values for found in (post, other)]
    assert not np.array_equal(*errors)


def infer_event(event: ppl.Event) -> ppl.Posterior:
    return ppl.infer(event, MODEL, **{**runs.OPTIONS, "kernel": None, "iterations": ITERATIONS})


# --- other kernels and models ------------------------------------------------------------------


def test_a_kernel_goes_by_name_or_instance_and_room_for_more_frames_changes_no_draw() -> None:
    named, given = (infer(kernel=kernel, weights="count") for kernel in ("prior_mh", PriorMH()))
    for found in (named, given):
        assert found.tree.attrs["validity"] == "exact"
        assert (found.tree["sample_stats"]["window"] == -1).all()
    assert_same_draws(named.tree, given.tree)


def test_draws_find_their_simulations_though_their_numbers_are_rounded_in_two_ways() -> None:
    found = runs.infer(kernel="smc", move="prior_mh")
    # what could have been stopped went by the likelihood at a temperature
    with pytest.raises(InvalidSettingError, match="'count' counts its draws"):
        ppl.Posterior(found.tree, "stratified")
    assert found.over_time().attrs["weights"] == "count"
    seeds = found.tree["sample_stats"]["sim_seed"].values
    assert set(seeds.ravel()) <= set(found.tree["simulations"]["seed"].values)
    drawn = found.tree["posterior"]["strength_red"].values
    assert np.isin(drawn, found.tree["simulations"]["strength_red"].values).all()


def moody() -> None:
    """A hierarchy, of one number above alpha, and sites on which nothing depends."""
    numpyro.sample("mood", dist.Bernoulli(0.5))
    numpyro.sample("traits", dist.Normal().expand([2]).to_event(1))
    share = numpyro.sample("social", dist.Uniform(0.0, 1.0))
    probs = jnp.stack([1 - share, *[share / 4] * 4])
    numpyro.sample("alpha", dist.Categorical(probs=probs))
    ppl.sites.goals()
    ppl.sites.strengths()


def test_sites_of_ones_own_are_inferred_and_stored() -> None:
    model = ppl.Model(prior=moody, simulator=walkers, noise="fixed")
    options = {**runs.OPTIONS, "iterations": ITERATIONS, "weights": "count"}
    found = ppl.infer(EVENT, model, **options)
    assert found.tree["posterior"]["mood"].shape == (CHAINS, ITERATIONS)
    assert found.tree["posterior"]["traits"].shape == (CHAINS, ITERATIONS, 2)
    n_simulations = found.cost["simulations"]
    assert n_simulations == CHAINS * (1 + ITERATIONS)
    assert found.tree["simulations"]["traits"].shape == (n_simulations, 2)
    assert sum(found.marginal("mood").values) == pytest.approx(1)
    assert 0 < found.mean("social") < 1


# --- what goes wrong ---------------------------------------------------------------------------

Results = list[SimulationResult]
Change = Callable[[int, Any, Results], Any]
"""(number of the call, runner, results) -> other results, or nothing."""


def disturb(monkeypatch: pytest.MonkeyPatch, change: Change) -> None:
    """Let ``change`` act on what the runner gives back from its n-th call, counted from 0."""

    class Disturbed(Watched):
        cancelled = False

        def cancel(self) -> None:
            self.cancelled = True
            super().cancel()

        def after(self, call: int, results: Results) -> Results:
            return change(call, self, results) or results

    monkeypatch.setattr(sampler, "Runner", Disturbed)


def interrupt_in(call: int) -> Change:
    def change(number: int, runner: Any, results: Results) -> None:
        if number == call:
            _thread.interrupt_main()
            deadline = time.monotonic() + 10
            while not runner.cancelled and time.monotonic() < deadline:
                time.sleep(0.02)
            assert runner.cancelled
            raise Cancelled("the run was cancelled")

    return change


def test_interrupt_keeps_the_iterations_that_were_done(
    monkeypatch: pytest.MonkeyPatch, post: ppl.Posterior
) -> None:
    disturb(monkeypatch, interrupt_in(2))
    with pytest.raises(ppl.Interrupted) as caught:
        infer()
    kept = caught.value.posterior
    assert kept is not None
    assert kept.tree["posterior"].sizes["draw"] == 1
    first = post.tree["sample_stats"]["sim_seed"].isel(draw=[0])
    np.testing.assert_array_equal(kept.tree["sample_stats"]["sim_seed"], first)
    assert kept.settings == {**post.settings, "iterations": 1}
    assert kept.cost["interrupted"]


def test_interrupt_keeps_the_initial_particles_or_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    disturb(monkeypatch, interrupt_in(1))
    with pytest.raises(KeyboardInterrupt) as caught:
        infer()
    kept = caught.value.posterior  # type: ignore[attr-defined]
    assert not kept.tree["sample_stats"]["accepted"].any()
    assert (kept.tree["simulations"]["iteration"] == 0).all()
    disturb(monkeypatch, interrupt_in(0))
    with pytest.raises(ppl.Interrupted) as caught:
        infer()
    assert caught.value.posterior is None


def failing(rows: Sequence[int]) -> Change:
    def change(number: int, runner: Any, results: Results) -> Results:
        return [
            SimulationResult.failed(r.hypothesis, r.seed, len(r.errors), "ValueError: no luck")
            if number == 0 and row in rows
            else r
            for row, r in enumerate(results)
        ]

    return change


def test_particle_whose_first_simulation_failed_starts_where_another_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    disturb(monkeypatch, failing([1, 2]))
    found = infer()
    assert np.isfinite(found.tree["sample_stats"]["log_joint"]).all()
    assert found.tree["simulations"]["failed"].sum() == 2
    assert found.diagnostics()["simulations"]["failed"] == 2


def test_it_is_an_error_if_all_initial_simulations_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    disturb(monkeypatch, failing(range(CHAINS)))
    with pytest.raises(ppl.SimulationError, match=r"seed \d+: ValueError: no luck"):
        infer()


def test_exception_from_the_runner_keeps_its_class(monkeypatch: pytest.MonkeyPatch) -> None:
    def change(number: int, runner: Any, results: Results) -> None:
        if number == 1:
            raise ZeroDivisionError("out of luck")

    disturb(monkeypatch, change)
    with pytest.raises(ZeroDivisionError, match="out of luck"):
        infer()


WRONG: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "kernel": ({"kernel": "local"}, UnknownNameError, "local_mh"),
    "no kernel": ({"kernel": 3}, InvalidSettingError, "kernel=3"),
    "no chains": ({"chains": 0}, InvalidSettingError, "chains=0"),
    "half a chain": ({"chains": 1.5}, InvalidSettingError, "chains=1.5"),
    "no iterations": ({"iterations": 0}, InvalidSettingError, "iterations=0"),
    "no workers": ({"workers": 0}, InvalidSettingError, "workers=0"),
    "seed": ({"seed": -1}, InvalidSettingError, "seed=-1"),
    "option": ({"speed": 3}, InvalidSettingError, "speed"),
    "rule": ({"rule": "papr"}, UnknownNameError, "paper"),
    "planner": ({"planner": "fast"}, InvalidSettingError, "joint simulator"),
    "budget": ({"budget": ppl.simulations(29)}, InvalidSettingError, "too small.*30"),
    "burn-in": ({"burn_in": 6}, InvalidSettingError, "burn_in=6, but there are 6 iterations"),
    "preset": ({"preset": "learned"}, InvalidSettingError, "stands for several arguments"),
    "both": ({"budget": ppl.simulations(90), "iterations": 3}, InvalidSettingError, "not both"),
}


@pytest.mark.parametrize(("wrong", "error", "message"), WRONG.values(), ids=WRONG)
def test_wrong_setting_is_refused_before_anything_is_simulated(
    wrong: dict[str, Any], error: type[Exception], message: str
) -> None:
    model = ppl.Model(simulator=never_called)
    with pytest.raises(error, match=message):
        ppl.infer(EVENT, model, **{"workers": 1, "progress": False, **wrong})


def test_what_is_no_event_is_refused() -> None:
    with pytest.raises(InvalidEventError, match=r"load_event"):
        ppl.infer("collaborate.json")  # type: ignore[arg-type]


def test_the_rivals_of_an_answer_are_simulated_before_it_is_given(post: ppl.Posterior) -> None:
    found = post.diagnostics()
    assert found["weights"] == "stratified"
    assert found["untried_rivals"] == 0
    counted = infer(weights="count")
    assert "rivals_from" not in counted.tree.attrs
    assert counted.cost["simulations"] == CHAINS * (1 + ITERATIONS)
    draws = ppl.Posterior(post.tree, "count").marginal("goal_red")
    np.testing.assert_array_equal(draws, counted.marginal("goal_red"))


def test_with_a_budget_no_rivals_come_on_top() -> None:
    found = infer(iterations=None, budget=ppl.simulations(12))
    assert found.cost["simulations"] == 12
    assert found.tree.attrs["weights"] == "stratified"
