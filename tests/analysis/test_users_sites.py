"""Further sites of a prior in the closed loop: summed over, or drawn with Monte-Carlo errors."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.models.sites import OneOf
from phase_ppl.world.errors import InvalidSettingError, QueryError
from phase_ppl.world.goals import GOALS
from tests.analysis.readings import reading

FOUND = reading()
HOSTILE = 0.3
BY_MOOD = jnp.array([[0.4, 0.25, 0.25, 0.05, 0.05], [0.2, 0.05, 0.05, 0.35, 0.35]])
SPARSE = np.array([0.9, *[0.025] * 4])  # alpha under ``sparse_social``


def moody() -> None:
    hostile = numpyro.sample("hostile", dist.Bernoulli(HOSTILE))
    numpyro.sample("alpha", dist.Categorical(probs=BY_MOOD[hostile]))
    ppl.sites.goals()
    ppl.sites.strengths()


def friendly() -> None:
    """Sites above alpha and beside everything."""
    spared = numpyro.sample("spared ones", dist.DiscreteUniform(1, 4))
    numpyro.sample("hits", dist.Binomial(5 - spared, 0.5))  # has other values each time
    friendliness = numpyro.sample("friendliness", dist.Beta(2.0, 2.0))
    shares = [jnp.array(0.25), *[0.375 * friendliness] * 2, *[0.375 * (1 - friendliness)] * 2]
    numpyro.sample("alpha", dist.Categorical(probs=jnp.stack(shares)))
    ppl.sites.goals()
    ppl.sites.strengths()


def tired() -> None:
    """Strengths come first, and what is seen of them afterwards is a further site."""
    red, _ = ppl.sites.strengths()
    numpyro.sample("effort", dist.Normal(red, 30.0))
    ppl.sites.goals()
    ppl.sites.alpha()


def tired_of_five() -> None:
    """The same with few strengths, three of them nearest to one level."""
    red = numpyro.sample("strength_red", OneOf((150.0, 250.0, 300.0, 350.0, 600.0)))
    numpyro.sample("strength_green", dist.Uniform(150.0, 600.0))
    numpyro.sample("effort", dist.Normal(red, 30.0))
    ppl.sites.goals()
    ppl.sites.alpha()


def of_alpha(post: ClosedLoopPosterior, prior: np.ndarray) -> np.ndarray:
    """Return (alpha,) likelihoods, of a posterior under a prior that depends on alpha alone."""
    return np.asarray(post.marginal("alpha").values) / prior


@pytest.fixture(scope="module")
def post() -> ClosedLoopPosterior:
    return ClosedLoopPosterior(FOUND).with_prior(moody)


@pytest.fixture(scope="module")
def drawn() -> ClosedLoopPosterior:
    return ClosedLoopPosterior(FOUND).with_prior(friendly)


def test_a_site_with_few_values_is_summed_over_exactly(post: ClosedLoopPosterior) -> None:
    by_mood, prior = np.asarray(BY_MOOD, float), np.array([1 - HOSTILE, HOSTILE])
    for at in (post, post.at(0), post.at(2)):
        plain = ClosedLoopPosterior(FOUND, at.frame).with_prior("sparse_social")
        joint = (prior[:, None] * by_mood) * of_alpha(plain, SPARSE)
        joint /= joint.sum()
        assert at.query("P(hostile=1)") == pytest.approx(joint[1].sum(), abs=1e-5)
        assert at.mean("hostile") == pytest.approx(joint[1].sum(), abs=1e-5)
        given = at.query("P(hostile=1 | alpha=(1, 0))")
        assert given == pytest.approx(joint[1, 1] / joint[:, 1].sum(), abs=1e-5)
        alpha = at.query("P(alpha=(0, -1) | hostile > 0)")
        assert alpha == pytest.approx(joint[1, 4] / joint[1].sum(), abs=1e-5)
    assert post.sites.summed
    assert post.at(0).mean("hostile").error == pytest.approx(0, abs=1e-9)
    assert 0 < post.mean("hostile").error < 0.1  # of the searches
    # what does not name it is answered as ever, and says the same
    assert post.query("P(alpha)").identical(post.marginal("alpha"))
    np.testing.assert_allclose(post.at(0).marginal("alpha"), prior @ by_mood, atol=1e-5)
    np.testing.assert_allclose(post.marginal("alpha"), post.sites.marginal("alpha"), atol=1e-5)


def test_other_sites_are_drawn_with_their_monte_carlo_error(drawn: ClosedLoopPosterior) -> None:
    post = drawn
    flat = ClosedLoopPosterior(FOUND).with_prior("sparse_social")
    shares = np.array([0.25, *[0.1875] * 4]) * of_alpha(flat, SPARSE)
    shares /= shares.sum()
    helping, hindering = shares[1:3].sum(), shares[3:].sum()
    # a Beta(2, 2) after nothing, one success, one failure
    expected = shares[0] / 2 + helping * 3 / 5 + hindering * 2 / 5
    found = post.query("E[friendliness]")
    assert not post.sites.summed
    assert 0 < found.error < 0.01
    assert abs(found - expected) < 4 * found.error
    helps = post.query("E[friendliness | alpha in {(1, 0), (0, 1)}]")
    assert abs(helps - 3 / 5) < 4 * helps.error
    share = post.query("P(alpha=(0, 0) | friendliness > 0.5 or friendliness <= 0.5)")
    assert abs(share - shares[0]) < 4 * share.error
    assert post.query("E[friendliness]") == found  # seeded


@pytest.mark.parametrize("condition", ["hostile=1", "friendliness > 0.5"])
def test_what_depends_on_strengths_has_no_error_beside_sites_either(
    condition: str, post: ClosedLoopPosterior, drawn: ClosedLoopPosterior
) -> None:
    post = post if "hostile" in condition else drawn
    for asked in ("E[strength_red", "P(strength_red > strength_green", "hdi[strength_green"):
        found = post.query(f"{asked} | {condition}{']' if '[' in asked else ')'}")
        assert np.isnan(found.error).all(), asked
    assert post.query(f"P(goal_red=Get blue item to red lm | {condition})").error > 0
    assert np.isnan(post.query(f"P({condition} | strength_red > 300)").error)


def test_sites_that_depend_on_another_or_on_strengths_are_drawn(drawn: ClosedLoopPosterior) -> None:
    start, post = drawn.at(0), ClosedLoopPosterior(FOUND).with_prior(tired)
    for at, question, exact, most in (
        (start, "E[hits]", 1.25, 0.02),
        (start, "P('spared ones'=4)", 0.25, 0.02),
        (start, "P(hits=4)", 1 / 64, 0.02),
        (post.at(0), "E[effort]", 375, 5),  # evenly between 150 and 600 N
        (post.at(0).with_prior(tired_of_five), "E[effort]", 330, 5),
    ):
        found = at.query(question)
        assert 0 < found.error < most
        assert abs(found - exact) < 4 * found.error
    assert start.mean("spared ones") == start.query("E['spared ones']")
    # within the cells of strengths
    assert abs(post.query("E[effort | strength_red > 500]") - 525) < 4
    seen, share = post.query("E[effort]"), post.probability(strength_red=(500, 600))
    assert abs(seen - (525 * share + 300 * (1 - share))) < 4 * seen.error
    assert seen.error < 5


def leaning(world: ppl.World) -> None:
    strong = numpyro.sample("strong", dist.Bernoulli(0.3))
    ppl.roles.goals(world)
    ppl.roles.alpha(world)
    numpyro.sample("strength_red", dist.Uniform(150.0 + 300 * strong, 600.0))


def test_so_may_sites_in_another_world_whose_hypotheses_are_few() -> None:
    scene = ppl.worlds.SOLO.random_scene(0)
    with ppl.watch(scene, ppl.Model(prior=leaning)) as watch:
        post = watch.update(scene.start)
    assert post.query("P(strong=1)") == pytest.approx(0.3, abs=1e-3)
    assert post.query("P(strength_red > 400 | strong=1)") == pytest.approx(1)
    weak = post.query("P(strength_red > 400 | strong=0)")
    assert weak == pytest.approx(1 / 2, abs=0.01)  # of levels 450 and 600, from 375 N on
    with pytest.raises(InvalidSettingError, match="outside of PHASE goals, alpha and strengths"):
        ppl.Model(prior=leaning).in_world(ppl.worlds.TRIO)


def test_few_draws_do_not_make_what_is_drawn_sure(drawn: ClosedLoopPosterior) -> None:
    post, goals = drawn, drawn.sites.table.values
    never = post.probability(friendliness=(0.99999, 1.0))
    assert (never, never.error > 0) == (0, True)
    pairs, counts = np.unique(goals["goal_red"] * 36 + goals["goal_green"], return_counts=True)
    red, green = divmod(int(pairs[np.argmin(np.abs(counts - 4))]), 36)
    given = {"goal_red": GOALS[red], "goal_green": GOALS[green]}
    assert post.probability(friendliness=(0.7, 1.0), given=given).error > 0.1


def test_definitions_and_what_is_missing(tmp_path: Path, post: ClosedLoopPosterior) -> None:
    post.define("grim", "hostile=1, not alpha=(0, 0)").define("same", "goal_red = goal_green")
    both = post.query("P(grim=True, same=True)")
    assert 0 < both < post.query("P(hostile=1)")
    at = post.at(2)
    assert at.query("P(grim=True)") == pytest.approx(at.query("P(hostile=1, alpha != (0, 0))"))
    assert post.quantities["hostile"] == ("0", "1")
    post.define("once", "goal_red = goal_green").define("once", "hostile=1")
    assert post.query("P(once=True)") == post.query("P(hostile=1)")
    for ask, said, *asked in (
        (post.define, "the prior has a site 'hostile'", "hostile", "goal_red = goal_green"),
        (post.why, "frames speak of hypotheses", "hostile=1"),
        (post.query, "unknown hostile 'maybe'", "P(hostile=maybe)"),
        (post.query, "unknown quantity 'hostil'; allowed: .*, hostile", "E[hostil]"),
    ):
        with pytest.raises((InvalidSettingError, QueryError), match=said):
            ask(*asked)

    again = ppl.load_posterior(post.save(tmp_path / "x.nc"))
    assert again.query("P(same=True)") == post.query("P(same=True)")
    with pytest.raises(InvalidSettingError, match=r"moody, which a file cannot hold.*with_prior"):
        again.query("E[hostile]")
    known = again.with_prior(moody)
    assert known.mean("hostile") == post.mean("hostile")
    assert known.settings == post.settings  # it is the same prior again
    with pytest.raises(QueryError, match="unknown quantity 'hostile'"):
        again.with_prior("uniform").query("E[hostile]")
