from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.tree import simulation_of_draw
from phase_ppl.inference import run, sampler
from phase_ppl.inference.kernels.metropolis import PriorMH
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from tests.inference import runs
from tests.inference.runs import EVENT, MODEL, Watched, assert_same_draws, stops_at
from tests.inference.toy import characters, never_called, walkers

CHAINS, ITERATIONS = 4, 2


def infer(**options: Any) -> ppl.Posterior:
    return runs.infer(**{"kernel": "local_mh", "iterations": ITERATIONS, **options})


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
    assert post.tree["simulated"].attrs == {"beta": ppl.RadialLikelihood().beta}
    np.testing.assert_allclose(stats["step_error"], errors, atol=1e-4)
    np.testing.assert_allclose(stats["total_error"], errors.sum(axis=-1), atol=1e-3)


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


def test_the_prior_of_a_simulation_is_that_of_all_simulated_alike(post: ppl.Posterior) -> None:
    found = post.tree["simulations"].dataset
    of_pairs = post.tree["constant_data"]["prior_of_pairs"].values
    mass = of_pairs[found["goal_red"], found["goal_green"]]  # strengths are even on 450 N
    np.testing.assert_allclose(found["log_prior_effective"], np.log(mass / 450**2), rtol=1e-5)
    assert (found["log_prior"] < found["log_prior_effective"] - 1e-3).any()


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


def test_progress_counts_simulations_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    made = infer(progress=True).cost["simulations"]
    captured = capsys.readouterr()
    assert f"{made}/{made}" in captured.err
    assert captured.out == ""


def test_only_scene_and_observation_change_the_posterior(
    post: ppl.Posterior, capsys: pytest.CaptureFixture[str]
) -> None:
    scrambled = dataclasses.replace(
        EVENT,
        id="other",
        truth=ppl.Truth("get away from green agent", "Get pink item to blue lm"),
        judgments={"friendly": 99},
        predictions={"someone": {"relation": "neutral"}},
    )
    compiled = run.compiled.cache_info().misses
    for event in (scrambled, dataclasses.replace(EVENT, id="", truth=None)):
        other = infer_event(event)
        assert other.settings == post.settings
        assert_same_draws(post.tree, other.tree)
    moved = np.array(EVENT.observation.trajectory)
    moved[3:, 0, 0] += 2.0
    other = infer_event(dataclasses.replace(EVENT, observation=ppl.Observation(moved)))
    errors = [found.tree["simulations"]["total_error"].values for found in (post, other)]
    assert not np.array_equal(*errors)
    assert run.compiled.cache_info().misses == compiled, "events share the compiled programs"
    assert capsys.readouterr().err == "", "no bar was asked for"


def test_an_event_may_be_given_by_its_name() -> None:
    options = {**runs.OPTIONS, "iterations": 1, "weights": "count"}
    post = ppl.infer("collaborate", MODEL, **options)
    event = ppl.load_event("collaborate")
    np.testing.assert_array_equal(post.observed(), event.observation.trajectory)
    with pytest.raises(InvalidEventError, match="collaborat: no such file, nor a bundled"):
        ppl.infer("collaborat")


def infer_event(event: ppl.Event) -> ppl.Posterior:
    return ppl.infer(
        event, MODEL, **{**runs.OPTIONS, "kernel": "local_mh", "iterations": ITERATIONS}
    )


def test_a_kernel_goes_by_name_or_function_and_room_for_more_frames_changes_no_draw() -> None:
    # of a function nobody knows how valid what it makes is, or whether it takes longer arrays
    kernels = ("prior_mh", lambda program: PriorMH(program))
    named, given = (infer(kernel=kernel, weights="count") for kernel in kernels)
    for found in (named, given):
        assert found.tree.attrs["validity"] == "exact"
        assert (found.tree["sample_stats"]["window"] == -1).all()
    assert_same_draws(named.tree, given.tree)


def test_draws_find_their_simulations_though_their_numbers_are_rounded_in_two_ways() -> None:
    found = runs.infer(kernel="smc", move="prior_mh")
    # what could have been stopped went by the likelihood at a temperature
    with pytest.raises(InvalidSettingError, match="use weights='count'"):
        ppl.Posterior(found.tree, "stratified")
    assert found.over_time().attrs["weights"] == "count"
    seeds = found.tree["sample_stats"]["sim_seed"].values
    assert set(seeds.ravel()) <= set(found.tree["simulations"]["seed"].values)
    drawn = found.tree["posterior"]["strength_red"].values
    assert np.isin(drawn, found.tree["simulations"]["strength_red"].values).all()


def test_sites_of_ones_own_are_inferred_and_stored() -> None:
    model = ppl.Model(prior=characters, simulator=walkers)
    options = {**runs.OPTIONS, "iterations": ITERATIONS, "weights": "count"}
    found = ppl.infer(EVENT, model, **options)
    n = found.cost["simulations"]
    assert n == CHAINS * (1 + ITERATIONS)
    assert found.tree["posterior"]["haste"].shape == (CHAINS, ITERATIONS)
    assert found.tree["posterior"]["outgoing"].shape == (CHAINS, ITERATIONS, 2)
    assert found.tree["simulations"]["outgoing"].shape == (n, 2)
    assert 0 < found.mean("sociability") < 1


def test_an_interrupt_keeps_the_iterations_that_were_done_or_nothing(
    monkeypatch: pytest.MonkeyPatch, post: ppl.Posterior
) -> None:
    kept = []
    for call in (2, 1, 0):
        monkeypatch.setattr(sampler, "Runner", stops_at(call))
        with pytest.raises(ppl.Interrupted) as caught:
            infer()
        assert isinstance(caught.value, KeyboardInterrupt)
        kept.append(caught.value.posterior)
    one, initial, nothing = kept
    assert nothing is None
    assert not initial.tree["sample_stats"]["accepted"].any()
    assert (initial.tree["simulations"]["iteration"] == 0).all()
    assert one.tree["posterior"].sizes["draw"] == 1
    first = post.tree["sample_stats"]["sim_seed"].isel(draw=[0])
    np.testing.assert_array_equal(one.tree["sample_stats"]["sim_seed"], first)
    assert one.settings == {**post.settings, "iterations": 1}
    assert one.cost["interrupted"]


def test_exception_from_the_runner_keeps_its_class(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Watched):
        def before(self, call: int, requests: int) -> None:
            _ = 0 // (1 - call)

    monkeypatch.setattr(sampler, "Runner", Broken)
    with pytest.raises(ZeroDivisionError, match="by zero"):
        infer()


REFUSED, UNKNOWN = InvalidSettingError, UnknownNameError
WRONG: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"kernel": "local"}, UNKNOWN, "local_mh"),
    ({"chains": 0}, REFUSED, "chains=0"),
    ({"seed": -1}, REFUSED, "seed=-1"),
    ({"speed": 3}, REFUSED, "speed"),
    ({"rule": "papr"}, UNKNOWN, "paper"),
    ({"planner": "fast"}, REFUSED, "joint simulator"),
    ({"budget": ppl.simulations(29)}, REFUSED, "too small.*30"),
    ({"budget": 60}, REFUSED, "budget=60, expected phase_ppl.simulations"),
    ({"preset": "learned"}, REFUSED, "stands for several arguments"),
    ({"budget": ppl.simulations(90), "iterations": 3}, REFUSED, "not both"),
]


@pytest.mark.parametrize(("wrong", "error", "message"), WRONG)
def test_wrong_setting_is_refused_before_anything_is_simulated(
    wrong: dict[str, Any], error: type[Exception], message: str
) -> None:
    model = ppl.Model(simulator=never_called)
    with pytest.raises(error, match=message):
        ppl.infer(EVENT, model, **{"kernel": "local_mh", "progress": False, **wrong})


def test_a_quarter_of_a_long_run_does_not_count() -> None:
    # a chain has as many draws as iterations
    assert (infer(iterations=19).burn_in, infer(iterations=20).burn_in) == (0, 5)


def test_the_rivals_of_an_answer_are_simulated_before_it_is_given(post: ppl.Posterior) -> None:
    found = post.diagnostics()
    assert (found["weights"], found["untried_rivals"]) == ("stratified", 0)
    simulations = post.tree["simulations"].dataset
    # none is so much worse that it is given up
    assert simulations["completed"].values[simulations["iteration"] >= 3].all()
    counted = infer(weights="count")
    assert "rivals_from" not in counted.tree.attrs
    assert counted.cost["simulations"] == CHAINS * (1 + ITERATIONS)
    draws = ppl.Posterior(post.tree, "count").marginal("goal_red")
    np.testing.assert_array_equal(draws, counted.marginal("goal_red"))
    limited = infer(iterations=None, budget=ppl.simulations(12))
    assert limited.cost["simulations"] == 12, "with a budget no rivals come on top"
    assert limited.tree.attrs["weights"] == "stratified"
