"""Diagnostics against hand-worked chains, and the verdict in words."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from phase_ppl.analysis.posterior import Posterior
from phase_ppl.analysis.with_arviz import ess, mcse, r_hat
from phase_ppl.world.goals import GOALS
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.names import LANDMARKS

from .factory import (
    BLUE_TO_RED,
    PINK_TO_BLUE,
    Simulation,
    hypothesis,
    make_tree,
    posterior_of,
    random_tree,
    with_densities,
    with_log_weight,
    with_prior,
)


def proposed(h: Hypothesis, seed: int, **options: object) -> Simulation:
    return Simulation(h, seed, iteration=1, **options)  # type: ignore[arg-type]


A, B = hypothesis(BLUE_TO_RED), hypothesis(PINK_TO_BLUE)


def test_two_chains_worked_out_by_hand() -> None:
    simulations = [
        Simulation(A, 0),
        proposed(A, 1),
        proposed(B, 2),
        Simulation(A, 3),
        proposed(B, 4, completed=False, frames=2),
        proposed(B, 5, completed=False, failed=True, frames=1),
    ]
    found = Posterior(make_tree(simulations, [[1, 2], [3, 3]], n_frames=5)).diagnostics()
    assert (found["particles"], found["iterations"]) == (2, 2)
    assert found["acceptance_by_iteration"] == [0.5, 0.5]
    assert found["acceptance_rate"] == found["move_rate"] == 0.5
    assert found["distinct_hypotheses"] == found["distinct_goal_pairs"] == 2
    assert found["simulations"] == {"total": 6, "completed": 4, "aborted": 1, "failed": 1}
    assert found["frames_saved"] == 3
    assert found["frames_saved_share"] == pytest.approx(3 / 25)
    # red's marginals: chain 0 half A half B, chain 1 all A
    assert found["between_chain_tv"]["goal_red"] == {"mean": 0.5, "max": 0.5}
    assert found["between_chain_tv"]["goal_green"] == {"mean": 0.0, "max": 0.0}
    assert found["monte_carlo_error"]["goal_red"] == pytest.approx(0.25)
    assert found["effective_rows"] == pytest.approx(4)
    # green's goal is the same in all; chain 0 is tied, its first label is A's
    assert found["agreement"] == {"goal_red": 1.0, "goal_green": 1.0}
    assert found["leading_goals"]["goal_red"] == {BLUE_TO_RED: 2}
    assert "1 of 6 simulations failed" in found["verdict"]


def test_weighted_draws_are_judged_by_their_weights() -> None:
    tree = posterior_of((A, B), [[0] * 5, [1] * 5, [1] * 5, [0] * 5]).tree
    log_weight = np.repeat(np.log([[3.0], [1.0], [1.0], [1.0]]), 5, axis=1)
    post = Posterior(with_log_weight(tree, log_weight), "count")
    found = post.diagnostics()
    assert found["weighted_draws_ess"] == pytest.approx(36 / 12 / 4)
    assert found["monte_carlo_error"]["goal_red"] == post.top("goal_red", 1)[0][1].error
    checks = {one["name"]: one["value"] for one in found["checks"]}
    assert checks["weighted draws"] == "worth 75%, 15.0 of 20"
    assert "proposals accepted" not in checks
    for entry in (found["scalars"]["log_joint"], *found["categories"]["goal_red"].values()):
        assert {entry[name] for name in entry if "probab" not in name and name != "share"} == {None}


def verdict(
    draws: list[list[int]], simulations: list[Simulation], weights: str = "count", **options: str
) -> str:
    tree = make_tree(simulations, draws, **options)  # type: ignore[arg-type]
    return str(Posterior(tree, weights).diagnostics()["verdict"])


@pytest.mark.parametrize("simulator", ["joint", "mine.glide"])
def test_fit_is_of_positions_and_bodies_that_lie_on_each_other_come_first(simulator: str) -> None:
    """A simulator of a user's own may know no collisions."""
    apart = np.zeros((3, 4, 3))
    apart[..., 0] = [2.0, 8.0, 14.0, 18.0]
    apart[..., 1] = 5.0
    meeting = apart.copy()
    meeting[1, 1] = meeting[1, 0]
    for seen, frames in ((apart, []), (meeting, [1])):
        predicted = np.stack([seen + np.array(shift) for shift in ((3, 4, 9), (0, 1, 9))])
        tree = posterior_of([A, A], [[0], [1]], observed=seen, predicted=predicted).tree
        tree.attrs["settings"] = json.dumps({"model": {"simulator": simulator}})
        found, frames = Posterior(tree).diagnostics(), frames if simulator == "joint" else []
        assert found["best_error_per_frame"] == pytest.approx(2)  # one unit each of four entities
        assert found["overlapping_frames"] == frames
        assert found["verdict"].startswith("Bodies lie on each other or in a wall") == bool(frames)


def test_scalars_have_their_convergence_but_not_with_fewer_than_four_draws() -> None:
    tree = random_tree(2, n_chains=4, n_draws=12)
    found = Posterior(tree).diagnostics()
    values = tree["sample_stats"]["log_joint"].values
    assert found["scalars"]["log_joint"]["r_hat"] == pytest.approx(r_hat(values))
    assert found["scalars"]["log_joint"]["ess_bulk"] == pytest.approx(ess(values, "bulk"))
    assert set(found["scalars"]) == {"log_joint", "total_error", "strength_red", "strength_green"}

    few = Posterior(random_tree(2, n_draws=3)).diagnostics()
    assert set(few["scalars"]["log_joint"].values()) == {None}
    assert "need 4 draws per particle; there are 3" in few["verdict"]
    assert "need 4 draws" not in found["verdict"]


def test_categories_worked_out_by_hand() -> None:
    # A in three of the four particles, and in half of the other's draws
    draws = [[0] * 4] * 3 + [[0, 0, 1, 1]]
    found = posterior_of((A, B), draws).diagnostics()["categories"]
    assert list(found["goal_red"]) == [BLUE_TO_RED, PINK_TO_BLUE]
    red, indicator = found["goal_red"][BLUE_TO_RED], (np.array(draws) == 0).astype(float)
    assert red["probability"] == red["share"] == pytest.approx(14 / 16)
    # means of the particles: 1, 1, 1, 0.5; standard error 0.25 / sqrt(4)
    assert red["mcse"] == pytest.approx(0.125) == pytest.approx(mcse(indicator))
    assert red["ess"] == pytest.approx(indicator.var(ddof=1) / 0.125**2)
    assert red["r_hat"] is None  # it changes between halves of chains only
    assert not np.isfinite(r_hat(indicator, "split"))
    # green's goal is always the same
    assert found["goal_green"][PINK_TO_BLUE] == {
        **{"probability": 1.0, "share": 1.0},
        **dict.fromkeys(("ess", "mcse", "r_hat")),
    }


def test_categories_are_those_of_the_weighting_and_of_the_draws() -> None:
    simulations = [
        proposed(A, 0, log_likelihood=-50.0),
        proposed(B, 1, log_likelihood=0.0),  # never accepted
    ]
    tree = with_densities(make_tree(simulations, [[0] * 4] * 2), 0.0)
    post = Posterior(with_prior(tree, [(A, 0.5), (B, 0.5)]), "stratified")
    found = post.diagnostics()
    assert found["effective_rows"] == pytest.approx(1)
    red = found["categories"]["goal_red"]
    assert list(red) == [PINK_TO_BLUE, BLUE_TO_RED]
    assert (red[PINK_TO_BLUE]["share"], red[BLUE_TO_RED]["share"]) == (0, 1)
    assert red[PINK_TO_BLUE]["probability"] == pytest.approx(1)
    assert f"another goal of red first, '{PINK_TO_BLUE}'" in found["verdict"]


def rivals_of(h: Hypothesis) -> list[Hypothesis]:
    """Return those with which one agent wants its item at another landmark."""
    found = []
    for name in ("goal_red", "goal_green"):
        goal = GOALS[getattr(h, name)]
        for landmark in LANDMARKS:
            other = f"{goal.rsplit(' to ', 1)[0]} to {landmark}"
            if other in GOALS and other != goal:
                found.append(Hypothesis.from_dict({**h.to_dict(), name: other}))
    return found


def test_an_answer_is_decided_only_where_all_its_rivals_were_simulated() -> None:
    rivals = rivals_of(A)
    assert len(rivals) > 2
    lead = [Simulation(A, seed, iteration=1, log_likelihood=-5.0) for seed in range(12)]
    lost = [Simulation(h, 99, iteration=1, log_likelihood=-60.0) for h in rivals]
    draws = [[place] for place in range(12)]

    def diagnose(simulations: list[Simulation]) -> dict[str, Any]:
        return Posterior(with_prior(make_tree(simulations, draws), prior)).diagnostics()

    prior = np.zeros((len(GOALS), len(GOALS)))
    for one in (A, *rivals):
        prior[one.effective_goals] = 1 / (1 + len(rivals))
    found = diagnose(lead + lost)
    assert found["untried_rivals"] == 0
    assert found["decided"]
    assert "rivals" not in found["verdict"]
    found = diagnose(lead + lost[1:])
    assert found["untried_rivals"] == 1
    assert not found["decided"]
    assert "1 rival of the leading goals" in found["verdict"]
    failed = dataclasses.replace(lost[0], failed=True, completed=False)
    assert diagnose([*lead, failed, *lost[1:]])["untried_rivals"] == 1
    untold = Posterior(make_tree(lead + lost[1:], draws), "count").diagnostics()
    assert untold["untried_rivals"] == 0, "a file without the prior cannot tell"
    assert not untold["decided"]


def test_more_is_needed_where_what_the_video_suggests_does_not_fit() -> None:
    others = [hypothesis(goal, 5) for goal in range(20) if goal != 0][:14]
    fits = np.arange(14.0)
    tried = [
        Simulation(one, place, iteration=1, log_likelihood=fit)
        for place, (one, fit) in enumerate(zip(others, fits, strict=True))
    ]

    def needed(suggested: Any, prior: Any) -> float | None:
        tree = with_densities(make_tree(tried, [[place] for place in range(14)]), suggested)
        found = Posterior(with_prior(tree, prior)).diagnostics()
        assert ("no better than chance" in found["verdict"]) == (
            found["effective_size_needed"] is None
        )
        size: float | None = found["effective_size_needed"]
        return size

    everywhere = np.full((len(GOALS), len(GOALS)), 1 / len(GOALS) ** 2)
    there = np.zeros((len(GOALS), len(GOALS)))
    for one in others:
        there[one.effective_goals] = 1 / 14
    assert needed(fits, everywhere) == 2.0, "it fits as suggested"
    assert needed(np.roll(fits, 2), everywhere) == 10.0, "it may be by chance"
    assert needed(-fits, everywhere) is None, "misled, and most was not tried"
    assert needed(-fits, there) == 10.0, "misled, but all was tried"
    assert needed([np.nan] * 14, everywhere) == 10.0, "nothing was suggested"


def test_leaders_say_by_how_much_they_lead() -> None:
    each = [[place] * 2 for place in range(20)]
    found = posterior_of([A] * 18 + [B] * 2, each).leaders()["goal_red"]
    assert (found["label"], found["next"]) == (GOALS[A.goal_red], GOALS[B.goal_red])
    assert (found["probability"], found["next_probability"]) == pytest.approx((0.9, 0.1))
    assert found["sure"]
    for unsure in (posterior_of([A] * 12 + [B] * 8, each), posterior_of([A], [[0]])):
        assert not unsure.leaders()["goal_red"]["sure"], "0.6 of twenty draws, or one draw"


def test_leading_goals_that_do_not_lead_together_are_said_to_lead_each_by_itself() -> None:
    both, red_alone = hypothesis(BLUE_TO_RED, BLUE_TO_RED), hypothesis(BLUE_TO_RED, PINK_TO_BLUE)
    greens = [hypothesis(red, BLUE_TO_RED) for red in (PINK_TO_BLUE, "Get pink item to red lm")]
    each = [[place] for place in range(20)]
    post = posterior_of([both] + [red_alone] * 7 + greens * 6, each)
    found, answer = post.leaders(), post.diagnostics()["answer"]
    assert (found["relation"]["label"], found["relation"]["of_leading_goals"]) == (
        "neutral",
        "friendly",
    )
    assert "neutral (0.95). Each is the most probable by itself." in answer
    assert "by itself" not in posterior_of([A] * 20, each).diagnostics()["answer"]


def test_goals_about_as_probable_as_the_first_are_named_or_counted() -> None:
    def of(n_goals: int) -> Posterior:
        some = [hypothesis(goal, "Get pink item to red lm") for goal in range(2, 2 + n_goals)]
        return posterior_of(some * 4, [[place] for place in range(4 * n_goals)])

    third, others = of(3).diagnostics()["verdict"], of(5)
    assert f"or '{GOALS[4]}' (0.333)" in third
    assert "or one of 3 others about as probable" in others.diagnostics()["verdict"]
    assert "2 other goals                       0.40 ±" in str(others)


# --- R-hat and effective sizes --------------------------------------------------------------------


def test_halves_of_a_single_chain_are_compared() -> None:
    trend = np.arange(40.0)[None]
    assert r_hat(trend) > 1.5
    assert r_hat(np.random.default_rng(0).normal(size=(1, 400))) < 1.05
    assert np.isnan(r_hat(trend[:, :6]))
    # means of the halves 1, 3, 1, 3: between 4/3; within 2, of two draws each
    split = r_hat(np.array([[0.0, 2, 2, 4], [0, 2, 2, 4]]), "split")
    assert split == pytest.approx(np.sqrt((4 / 3) / 2 + 1 / 2))


def test_short_chains_that_never_move_are_worth_as_many_draws_as_there_are_chains() -> None:
    rng = np.random.default_rng(0)
    stuck = np.repeat(rng.normal(size=(15, 1)), 6, axis=1)
    # the usual estimate would be 176, more than all 90 draws
    assert ess(stuck, "mean") == pytest.approx(15, rel=0.1)
    assert mcse(stuck) == pytest.approx(stuck[:, 0].std(ddof=1) / np.sqrt(15))
    assert r_hat(stuck, "split") == r_hat(stuck) == np.inf
    values = np.array([[0, 0, 0, 1], [1, 1, 1, 1], [0, 0, 1, 1], [1, 0, 0, 0]], float)
    error = np.std([0.25, 1, 0.5, 0.25], ddof=1) / 2
    assert mcse(values) == pytest.approx(error)
    assert ess(values, "mean") == pytest.approx(values.var(ddof=1) / error**2)
    # of independent draws about all count; one tail is as good as the other
    sizes = [ess(rng.normal(size=(15, 6)), "mean") for _ in range(100)]
    assert np.median(sizes) == pytest.approx(90, rel=0.2)
    assert max(sizes) <= 90 * np.log10(90) + 1e-9
    for values in rng.gamma(0.5, size=(20, 15, 6)):
        assert ess(values, "tail") == pytest.approx(ess(-values, "tail"))
