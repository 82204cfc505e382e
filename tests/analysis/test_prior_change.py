"""A finished run under another prior says what a new run would say, or is refused."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import phase_ppl as ppl
from phase_ppl.analysis.stepwise_posterior import StepwisePosterior
from phase_ppl.models.effective import strengths_apart
from phase_ppl.models.stepwise import prior_table
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.analysis.readings import LEVELS, reading
from tests.inference import runs

SIZE = {"kernel": "enumerate", "chains": 1, "iterations": None, "strengths": [300.0], "workers": 1}


def related(share: float) -> None:
    numpyro.sample("alpha", dist.Categorical(probs=jnp.array([1 - share] + [share / 4] * 4)))
    ppl.sites.goals()
    ppl.sites.strengths()


def strong_helpers() -> None:
    """Strengths hang on alpha, and alpha on a site of one's own."""
    kindness = numpyro.sample("kindness", dist.Beta(2.0, 2.0))
    shares = jnp.stack([0.2, *[0.4 * kindness] * 2, *[0.4 * (1 - kindness)] * 2])
    alpha = numpyro.sample("alpha", dist.Categorical(probs=shares / shares.sum()))
    ppl.sites.goals()
    for name in ("strength_red", "strength_green"):
        numpyro.sample(name, ppl.sites.OneOf(LEVELS, jnp.stack([1.0, 1.0 + alpha])))


def test_a_table_under_another_prior_is_that_of_a_run_with_it() -> None:
    post = StepwisePosterior(reading())
    post.define("same", lambda h: h.goal_red == h.goal_green)
    changed = post.with_prior("symmetric_alphas")
    prior = prior_table(ppl.priors.symmetric_alphas, LEVELS)
    anew = StepwisePosterior(reading(columns={"log_prior": prior}))
    assert float(changed.probability(relation="friendly")) == pytest.approx(
        float(anew.probability(relation="friendly")), abs=1e-9
    )
    assert changed.probability(relation="friendly").error > 0
    assert changed.at(2).query("P(same=True)") > 0
    assert changed.settings["model"]["prior"] == "phase_ppl.models.priors.symmetric_alphas"
    assert "symmetric_alphas, taken instead of" in str(changed)
    assert "taken instead of" not in str(post)


def test_strengths_that_hang_on_goals_are_not_taken_apart() -> None:
    assert strengths_apart(ppl.priors.correlated_strengths)
    assert not strengths_apart(strong_helpers)
    table = np.exp(prior_table(strong_helpers, LEVELS))
    assert table.sum() == pytest.approx(1)
    strong = table.sum(axis=(0, 1))[:, :, 1].sum(axis=1) / table.sum(axis=(0, 1, 3, 4))
    np.testing.assert_allclose(strong, [1 / 2, 2 / 3, 3 / 4, 4 / 5, 5 / 6], rtol=1e-4)


@pytest.fixture(scope="module")
def enumerated() -> ppl.Posterior:
    return runs.infer(**SIZE)


def test_draws_under_another_prior_are_weighted_as_in_a_run_with_it(
    enumerated: ppl.Posterior,
) -> None:
    model = ppl.Model(prior="relation_first", simulator=runs.MODEL.simulator)
    anew = ppl.infer(runs.EVENT, model, **{**runs.OPTIONS, **SIZE})
    changed = enumerated.with_prior("relation_first")
    for name in ("goal_red", "relation"):
        np.testing.assert_allclose(changed.marginal(name), anew.marginal(name), atol=1e-4)
    assert abs(changed.marginal("relation") - enumerated.marginal("relation")).max() > 0.01
    lone = enumerated.with_prior("no_social_goals")
    assert lone.probability(alpha="(0, 0)") == pytest.approx(1)
    assert lone.settings["reweighted"]["effective_size"] < 1155
    assert "equal draws" in str(lone)


def test_it_is_kept_in_the_file(enumerated: ppl.Posterior, tmp_path: Path) -> None:
    changed = enumerated.with_prior("relation_first").with_prior("uniform")
    again = ppl.Posterior.load(changed.save(tmp_path / "run.nc"))
    np.testing.assert_array_equal(again.marginal("relation"), changed.marginal("relation"))
    assert json.loads(again.tree.attrs["settings"])["reweighted"]["from"].endswith("uniform")


def test_own_sites_are_weighted_with_the_rest() -> None:
    def friendlier(low: float) -> None:
        kindness = numpyro.sample("kindness", dist.Uniform(low, 1.0))
        shares = jnp.stack([0.2, *[0.4 * kindness] * 2, *[0.4 * (1 - kindness)] * 2])
        numpyro.sample("alpha", dist.Categorical(probs=shares))
        ppl.sites.goals()
        ppl.sites.strengths()

    model = ppl.Model(prior=lambda: friendlier(0.0), simulator=runs.MODEL.simulator)
    options = {**runs.OPTIONS, "chains": 20, "iterations": 20}
    post = ppl.infer(runs.EVENT, model, **options)
    changed = post.with_prior(lambda: friendlier(0.5))
    kept = post.table.values["kindness"] >= 0.5
    weights = post.table.weights * kept
    expected = weights @ post.table.values["kindness"] / weights.sum()
    assert changed.mean("kindness") == pytest.approx(expected, rel=1e-4)
    assert "kindness" not in changed.with_prior("uniform").quantities


def test_what_was_not_simulated_is_refused() -> None:
    def only_away() -> None:
        logits = jnp.where(jnp.arange(36) == 35, 0.0, -1e30)
        numpyro.sample("goal_red", dist.Categorical(logits=logits[::-1]))
        numpyro.sample("goal_green", dist.Categorical(logits=logits[::-1]))
        numpyro.sample("alpha", dist.Categorical(probs=jnp.eye(5)[0]))
        ppl.sites.strengths()

    post = runs.infer()
    with pytest.raises(InvalidSettingError):
        post.with_prior(only_away)
    with pytest.raises(UnknownNameError, match="sparse_social"):
        post.with_prior("sparse_soziel")


def test_a_curve_against_an_argument_of_the_prior() -> None:
    post = StepwisePosterior(reading())
    curve = post.sensitivity("P(relation)", related, [0.1, 0.9])
    assert curve.dims == ("value", "relation")
    alone = post.with_prior(functools.partial(related, 0.9)).marginal("relation")
    np.testing.assert_allclose(curve.sel(value=0.9), alone, atol=1e-6)
    np.testing.assert_allclose(curve.sel(value=0.9)["error"], alone["error"], atol=1e-6)
    number = post.sensitivity("P(relation=friendly)", related, [0.1])
    np.testing.assert_allclose(number, curve.sel(relation="friendly")[:1])
    figure = ppl.plot.sensitivity(post, "P(relation)", related, [0.1, 0.9])
    assert [len(line.get_xdata()) for line in figure.axes[0].lines] == [2, 2, 2]
    with pytest.raises(InvalidSettingError, match="makes no curve"):
        post.sensitivity("top goal_red", related, [0.5])
    with pytest.raises(InvalidSettingError, match="empty"):
        post.sensitivity("P(relation)", related, [])
    with pytest.raises(InvalidSettingError, match="does not sample"):
        post.sensitivity("P(relation)", lambda p: None, [0.1, 0.2])
