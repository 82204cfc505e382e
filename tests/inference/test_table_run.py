"""Kernels on what the closed loop has read: the exact posterior is known, nothing is simulated."""

from __future__ import annotations

import functools
import itertools
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.inference import run, table_run
from phase_ppl.inference.table_run import model_of
from phase_ppl.models import priors
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from tests.inference.runs import assert_same_draws
from tests.inference.tables import EXACT, NAMES, OPTIONS, made_up, sampled, skewed
from tests.inference.toy import few_goals, walkers

WEAK = (150.0, 450.0)  # strengths that count as the lower of the two levels that were followed


@functools.cache
def draws() -> ppl.Posterior:
    return sampled()


def apart(one: Any, other: Any) -> float:
    """The largest difference: of the marginals, as total variation, or of weak agents' mass."""
    of_goals = [np.abs(one.marginal(n).values - other.marginal(n).values).sum() / 2 for n in NAMES]
    weak = [
        abs(one.probability(**{name: WEAK}) - other.probability(**{name: WEAK}))
        for name in ("strength_red", "strength_green")
    ]
    return float(max(*of_goals, *weak))


LONG: dict[str, dict[str, Any]] = {
    "enumerate": {"iterations": None, "strengths": [300.0, 600.0]},
    "gibbs": {"iterations": 1200},
    "sa": {"iterations": 1500},
    "smc": {"chains": 4000, "iterations": 10},
}
QUICK = ("prior_mh", "single_site_mh")
"""Kernels that are soon compiled."""

NEAR = 0.06
"""How near long chains come, as :func:`apart`."""


@pytest.mark.parametrize(
    "kernel",
    [
        pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow])
        for name in ppl.available_kernels()
    ],
)
def test_long_chains_reach_the_exact_posterior(kernel: str) -> None:
    post = draws() if kernel == "prior_mh" else sampled(kernel=kernel, **LONG.get(kernel, {}))
    assert apart(post, EXACT) < (2 if kernel in ("gibbs", "sa") else 1) * NEAR
    assert (post.cost["frames"], post.cost["failures"]) == (0, 0)
    if kernel == "enumerate":
        assert apart(post, EXACT) < 1e-4


def test_another_prior_table_or_frame_would_be_noticed() -> None:
    for other in (EXACT.with_prior(skewed), made_up(noise=2.0), EXACT.at(2), EXACT.at(1)):
        assert apart(draws(), other) > 2 * NEAR


def test_a_posterior_is_sampled_as_of_its_frame_and_under_the_prior_that_is_given() -> None:
    early = sampled(EXACT.at(1))
    assert apart(early, EXACT.at(1)) < NEAR
    assert len(early.observed()) == 2
    assert early.event_id == EXACT.event_id
    model = ppl.Model(prior=skewed)
    changed = sampled(EXACT, model)
    assert apart(changed, EXACT.with_prior(skewed)) < NEAR
    assert changed.settings["model"]["prior"].endswith("skewed")


def test_the_same_seed_gives_the_same_draws() -> None:
    assert_same_draws(sampled(iterations=7).tree, sampled(iterations=7, workers=2).tree)
    other = sampled(iterations=7, seed=2).tree["posterior"]["strength_red"]
    assert not np.array_equal(sampled(iterations=7).tree["posterior"]["strength_red"], other)


def test_a_video_of_another_world_is_sampled_likewise() -> None:
    solo, planner = ppl.worlds.SOLO, ppl.PlannerConfig(simulations=14, particles=6)
    event = ppl.simulate(solo.random_scene(1), ppl.roles.draw(solo, 1), frames=6, planner=planner)
    exact = ppl.infer(event, ppl.Model(planner=planner), workers=1, progress=False)
    post = sampled(exact)
    for name in ("goal_red", "strength_red"):
        if name.startswith("goal"):
            one, other = (each.marginal(name).values for each in (post, exact))
            assert np.abs(one - other).sum() / 2 < NEAR
        else:
            one, other = (each.probability(**{name: (150, 375)}) for each in (post, exact))
            assert abs(one - other) < NEAR


def test_a_file_knows_a_registered_prior_by_its_name_and_asks_for_an_own_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = ppl.load_posterior(EXACT.save(tmp_path / "own.nc"))
    with pytest.raises(InvalidSettingError, match=r"few_goals is your own.*give the model, infer"):
        sampled(kept, iterations=5)
    expected = sampled(iterations=5)
    assert_same_draws(sampled(kept, ppl.Model(few_goals), iterations=5).tree, expected.tree)
    known = {**priors.PRIORS.entries, "few goals": few_goals}
    monkeypatch.setattr(priors.PRIORS, "entries", known)
    assert_same_draws(sampled(kept, iterations=5).tree, expected.tree)


def test_draws_are_kept_in_a_file_with_their_burn_in(tmp_path: Path) -> None:
    post = ppl.Posterior(sampled(iterations=30).tree, burn_in=11)
    back = ppl.load_posterior(post.save(tmp_path / "draws.nc"))
    assert back.burn_in == post.burn_in == 11
    assert str(back) == str(post)
    assert_same_draws(back.tree, post.tree)
    model, read = post.settings["model"], EXACT.settings
    assert post.settings["read"] == read
    assert model["prior"] == read["model"]["prior"]


def test_what_is_asked_of_draws_has_the_answer_of_the_table() -> None:
    over_time, exact = draws().over_time(), EXACT.over_time()
    assert over_time.attrs["weights"] == "count"
    for name in NAMES:
        np.testing.assert_allclose(over_time[name], exact[name], atol=0.06)
        np.testing.assert_allclose(over_time[name][-1], draws().marginal(name), atol=1e-9)
    assert draws().top("relation", 1)[0][0] == EXACT.top("relation", 1)[0][0]
    assert draws().query("P(relation = friendly)") == draws().probability(relation="friendly")
    assert draws().map().effective_goals == EXACT.map().effective_goals
    np.testing.assert_array_equal(draws().replay(), EXACT.observed())
    why = draws().why("relation=friendly", "relation=neutral")["log_odds"]
    expected = EXACT.why("relation=friendly", "relation=neutral")["log_odds"]
    np.testing.assert_allclose(why, expected, atol=0.3)


def friendly(post: Any) -> Any:
    return post.probability(relation="friendly")


def chains_alone(post: ppl.Posterior) -> ppl.Posterior:
    """The same draws, whose errors know nothing of the searches."""
    tree = post.tree.copy()
    stats = tree["sample_stats"].to_dataset().drop_vars("log_likelihood_without")
    tree["sample_stats"] = xr.DataTree(stats)
    return ppl.Posterior(tree)


def test_the_error_has_what_the_sets_of_searches_differ() -> None:
    tables = [made_up(seed, sets=4, noise=2.0) for seed in range(6)]
    found = [sampled(table, iterations=250) for table in tables]
    by_chance = [chains_alone(post) for post in found]
    for post, table, alone in zip(found, tables, by_chance, strict=True):
        assert friendly(post) == friendly(alone)
        expected = np.hypot(friendly(table).error, friendly(alone).error)
        assert friendly(post).error == pytest.approx(expected, rel=0.25)

    def agreeing(posts: list[ppl.Posterior]) -> float:
        """The share of pairs of tables whose answers lie within two errors of each other."""
        pairs = itertools.combinations(map(friendly, posts), 2)
        return float(np.mean([abs(a - b) < 2 * np.hypot(a.error, b.error) for a, b in pairs]))

    assert agreeing(by_chance) < 0.4
    assert agreeing(found) > 0.75


def test_of_a_single_set_the_error_is_not_known() -> None:
    table = made_up(sets=1)
    assert np.isnan(friendly(table).error)
    assert np.isnan(friendly(sampled(table, iterations=40)).error)


def n_draws(post: ppl.Posterior) -> int:
    return int(post.tree["posterior"].sizes["draw"])


def test_a_thousand_draws_are_the_default_and_a_budget_buys_lookups() -> None:
    assert n_draws(sampled(iterations=None)) == table_run.ITERATIONS == 1000
    for budget in (ppl.simulations(240), ppl.frames(960)):  # of videos of four frames
        post = sampled(iterations=None, budget=budget)
        assert n_draws(post) == 3, "after the initial ones"
        assert post.cost["simulations"] == 240
        assert post.cost["budget"] == str(budget)
    with pytest.raises(InvalidSettingError, match="too small"):
        sampled(iterations=None, budget=ppl.simulations(119))
    with pytest.raises(InvalidSettingError, match=r"would take .* GB of memory"):
        sampled(iterations=10**11)


def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count()
    for module in (run, table_run):
        monkeypatch.setattr(module, "clock", lambda: float(next(ticks)))


def test_a_budget_of_seconds_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    sampled(iterations=300)
    ticking(monkeypatch)
    post = sampled(iterations=None, budget=ppl.seconds(3.5))
    assert n_draws(post) == 3 * table_run._BLOCK
    ticking(monkeypatch)
    assert n_draws(sampled(iterations=None, budget=ppl.seconds(0.5))) == 1, "the initial ones"


def test_ctrl_c_keeps_what_was_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = table_run.particles_of

    def stopping(call: int) -> Any:
        calls = itertools.count()

        def particles_of(state: Any) -> Any:
            if next(calls) == call:
                raise KeyboardInterrupt
            return kept(state)

        return particles_of

    whole = sampled(iterations=200)
    monkeypatch.setattr(table_run, "particles_of", stopping(2))
    with pytest.raises(ppl.Interrupted) as stopped:
        sampled(iterations=200)
    post = stopped.value.posterior
    assert n_draws(post) == table_run._BLOCK
    assert post.cost["interrupted"]
    drawn, all_drawn = (p.tree["posterior"]["strength_red"].values for p in (post, whole))
    np.testing.assert_array_equal(drawn, all_drawn[:, : table_run._BLOCK])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"checkpoint": "run.ckpt"}, "checkpoint='run.ckpt' is for simulations"),
        ({"on_failure": "raise"}, "on_failure='raise' is for simulations"),
        ({"planner": "paper"}, "planner='paper' is for simulations"),
        ({"rule": "paper"}, "unexpected keyword argument 'rule'"),
        ({"model": ppl.Model(simulator=walkers)}, "simulator=.*a model can change the prior only"),
        (
            {"model": ppl.Model(likelihood=ppl.RadialLikelihood())},
            "likelihood=.*a model can change the prior only",
        ),
    ],
)
def test_what_is_of_no_use_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        ppl.infer(EXACT, **{**OPTIONS, **wrong})


def test_so_are_an_executor_and_another_likelihood() -> None:
    with (
        ThreadPoolExecutor(1) as executor,
        pytest.raises(InvalidSettingError, match=r"executor=.*is for simulations"),
    ):
        sampled(executor=executor)
    counted = {**ppl.ClosedLoopLikelihood().to_dict(), "weight": 0.2}  # as a reading keeps it
    settings = {**EXACT.settings, "likelihood": counted}
    known = EXACT.dataset.assign_attrs(settings=json.dumps(settings))
    read = ClosedLoopPosterior(known, prior=few_goals)
    model_of(read, ppl.Model(likelihood=ppl.ClosedLoopLikelihood()))
    with pytest.raises(InvalidSettingError, match=r"likelihood=.*the prior only"):
        model_of(read, ppl.Model(likelihood=ppl.ClosedLoopLikelihood(planner_seeds=8)))
    with pytest.raises(InvalidEventError, match=r"1 frame.*expected at least 2"):
        sampled(EXACT.at(0))
