"""The closed loop reads with a simulator of one's own: exactly by its density, or by samples."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest

import phase_ppl as ppl
from phase_ppl.closed_loop import users_simulator
from phase_ppl.closed_loop.kernel_density import log_density
from phase_ppl.inference.table_run import ReadTable
from phase_ppl.models import prior_masses, sites, world_priors
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, SimulationError
from phase_ppl.world.hypothesis import Hypothesis, all_ways
from tests.inference.toy import (
    GREEN_GOALS,
    GREEN_MASS,
    RED_GOALS,
    all_of_few_goals,
    few_goals,
    walkers,
)

SPREAD = 0.3
N_FRAMES = 4


class Draws:
    """Agents drift in a direction of their goal's own, the faster the stronger; items rest."""

    def expected(self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray) -> FloatArray:
        found = seen[-1].copy()
        for agent, goal in enumerate(hypothesis.effective_goals):
            pace = 0.2 + hypothesis.strengths[agent] / 1200
            found[agent, :2] += pace * np.array([np.cos(goal), np.sin(goal)])
        return found

    def next_frames(
        self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray, rng: Any, n: int
    ) -> FloatArray:
        frames = np.repeat(self.expected(scene, hypothesis, seen)[None], n, axis=0)
        frames[:, :, :2] += rng.normal(0, SPREAD, frames[:, :, :2].shape)
        return frames


class Knows(Draws):
    """The same, which knows how probable a frame is."""

    def log_prob_next(
        self, scene: ppl.Scene, hypothesis: Any, seen: FloatArray, frame: FloatArray
    ) -> float:
        off = (frame - self.expected(scene, hypothesis, seen))[:, :2] / SPREAD
        return float(-0.5 * (off**2).sum() - off.size * np.log(SPREAD * np.sqrt(2 * np.pi)))


def model(simulator: Any, prior: Any = few_goals, **options: Any) -> ppl.Model:
    return ppl.Model(
        prior=prior, simulator=simulator, likelihood=ppl.ClosedLoopLikelihood(**options)
    )


def simulated(scene: ppl.Scene, hypothesis: Any, seed: int = 3) -> ppl.Event:
    rng, frames = np.random.default_rng(seed), [scene.start]
    for _ in range(N_FRAMES):
        seen = np.array(frames)
        frames.append(Draws().next_frames(scene, hypothesis, seen, rng, 1)[0])
    return ppl.Event(scene, ppl.Observation(np.array(frames)), id="drift")


EVENT = simulated(
    ppl.load_event("collaborate").scene, Hypothesis(RED_GOALS[1], GREEN_GOALS[1], (0, 0), 300, 450)
)


def infer(simulator: Any, event: ppl.Event = EVENT, **options: Any) -> ppl.ClosedLoopPosterior:
    given = {name: options.pop(name) for name in ("seed", "workers") if name in options}
    given = {"workers": 1, "progress": False, **given}
    return ppl.infer(event, model(simulator, **options), **given)


def log_likelihood(event: ppl.Event, hypothesis: Any, until: int | None = None) -> float:
    frames = event.observation.trajectory[:until]
    given = event.scene, hypothesis.effective()
    return sum(Knows().log_prob_next(*given, frames[:t], frames[t]) for t in range(1, len(frames)))


@pytest.fixture(scope="module")
def exact() -> ppl.ClosedLoopPosterior:
    return infer(Knows())


def test_by_density_the_posterior_is_a_sum_over_hypotheses(exact: ppl.ClosedLoopPosterior) -> None:
    levels, masses = (150.0, 300.0, 450.0, 600.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    of_red = dict[str, float]()
    friendly = strength = early = total = total_early = 0.0
    strengths = list(zip(levels, masses, strict=True))
    for (p, goals), (k, u), (m, v) in itertools.product(all_of_few_goals(), strengths, strengths):
        strengths_of = {"strength_red": k, "strength_green": m}
        h = Hypothesis.from_dict({**goals.to_dict(), **strengths_of})
        prior = p * u * v
        mass = prior * np.exp(log_likelihood(EVENT, h))
        goal = ppl.GOALS[h.effective_goals[0]]
        of_red[goal] = of_red.get(goal, 0.0) + mass
        friendly += mass * (h.relation == "friendly")
        strength += mass * k
        total += mass
        mass = prior * np.exp(log_likelihood(EVENT, h, 3))
        early += mass * (h.relation == "friendly")
        total_early += mass
    for goal, mass in of_red.items():
        assert exact.probability(goal_red=goal) == pytest.approx(mass / total, abs=1e-6)
    found = exact.probability(relation="friendly")
    assert found == pytest.approx(friendly / total, abs=1e-6)
    assert found.error == 0
    assert exact.mean("strength_red") == pytest.approx(strength / total, abs=1e-3)
    over_time = exact.over_time()
    assert over_time["relation"].sel(relation_is="friendly").values[2] == pytest.approx(
        early / total_early, abs=1e-6
    )
    assert (over_time["relation_error"] == 0).all()
    assert exact.log_evidence == pytest.approx(np.log(total), abs=1e-5)
    assert exact.log_evidence.error == 0
    assert exact.tempering == ""
    assert "by the density of" in str(exact)


SMALL = ppl.World(
    ["red agent", "green agent", "purple agent"],
    ["ball"],
    {"home": (4.0, 4.0), "field": (30.0, 12.0)},
    arena=(0.0, 36.0, 0.0, 24.0),
    name="small",
)
OWN_GOALS = (0, 1, 3)
OWN_MASS = (0.5, 0.3, 0.2)
STRONG = (300.0, 600.0)
FEW = ppl.Tracking(strengths=STRONG)
"""Two levels of strength, so that fewer hypotheses are asked about."""


POSES = {name: (8.0 + 8 * i, 8.0, 0.0) for i, name in enumerate(SMALL.agents)}
EVENT_OF_THREE = simulated(
    SMALL.scene({**POSES, "ball": (20.0, 16.0)}),
    Hypothesis.coded(SMALL, (0, 1, None), (None, None, (0, 1)), (300.0, 600.0, 600.0)),
)


def of_three(world: ppl.World) -> None:
    for key in world.keys:
        probs = jnp.zeros(len(world.goals)).at[jnp.array(OWN_GOALS)].set(jnp.array(OWN_MASS))
        numpyro.sample(f"goal_{key}", dist.Categorical(probs=probs))
    world_priors.alpha(world, social=0.5)
    for key in world.keys:
        numpyro.sample(f"strength_{key}", sites.OneOf(STRONG, [0.25, 0.75]))


def test_in_another_world_goals_ways_and_strengths_are_summed_over() -> None:
    event, ways = EVENT_OF_THREE, all_ways(3)
    post = infer(Knows(), event, prior=of_three, tracking=FEW, weight=0.7)
    social, possible, total, helped, strength = 0.5 / (len(ways) - 1), 0.0, 0.0, 0.0, 0.0
    for way in ways:
        owners = [agent for agent, towards in enumerate(way) if towards is None]
        for own in itertools.product(range(len(OWN_GOALS)), repeat=len(owners)):
            stated: list[int | None] = [None] * 3
            prior = 0.5 if way == ways[0] else social
            for owner, goal in zip(owners, own, strict=True):
                stated[owner] = OWN_GOALS[goal]
                prior *= OWN_MASS[goal]
            if not Hypothesis.coded(SMALL, tuple(stated), way, (300.0,) * 3).is_possible:
                continue
            for strengths in itertools.product(STRONG, repeat=3):
                h = Hypothesis.coded(SMALL, tuple(stated), way, strengths)
                of_strengths = np.prod([0.25 if one == STRONG[0] else 0.75 for one in strengths])
                mass = prior * of_strengths * np.exp(0.7 * log_likelihood(event, h))
                total += mass
                helped += mass * (way[2] == (0, 1))
                strength += mass * strengths[2]
                possible += prior * of_strengths
    assert possible < 1
    found = post.probability(alpha_purple_red="1")
    assert found == pytest.approx(helped / total, abs=1e-6)
    assert post.mean("strength_purple") == pytest.approx(strength / total, abs=1e-3)
    assert post.tempering == "tempered: a frame counts 0.7 for goals and 0.7 for strengths"


def test_by_samples_it_comes_to_the_same_the_nearer_the_more() -> None:
    known, apart = infer(Knows(), tracking=FEW), []
    for samples, most in ((30, 0.25), (480, 0.06)):
        off = []
        for seed in range(3):
            post = infer(Draws(), samples=samples, seed=seed, tracking=FEW)
            for name in ("goal_red", "goal_green"):
                off.append(np.abs(post.marginal(name) - known.marginal(name)).sum() / 2)
        apart.append(float(np.mean(off)))
        assert apart[-1] < most
    assert apart[1] < 0.6 * apart[0]
    assert f"by {samples} samples of" in str(post)


def test_errors_by_samples_are_what_seeds_differ_by() -> None:
    alike = ppl.Tracking(strengths=(450.0,))
    posts = [infer(Draws(), seed=seed, tracking=alike) for seed in range(24)]
    for name in ("goal_red", "goal_green"):
        found = [post.marginal(name) for post in posts]
        spread = np.var(found, axis=0, ddof=1).sum()
        stated = np.mean([one["error"].values ** 2 for one in found], axis=0).sum()
        # stated errors are widened, as by Student's t of five parts
        assert 0.7 < 2.776 / 1.96 * np.sqrt(spread / stated) < 1.5


@pytest.mark.slow
def test_watching_says_the_same_as_reading_and_processes_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(users_simulator, "WORTH_PROCESSES", 0.0)
    given = model(Draws(), samples=20, tracking=FEW)
    whole = infer(Draws(), samples=20, tracking=FEW)
    with ppl.watch(EVENT.scene, given, threads=2) as watch:
        posts = [watch.update(frame) for frame in EVENT.observation.trajectory]
    for t, post in enumerate(posts):
        for name in ("log_likelihood", "log_likelihood_without"):
            found = post.dataset[name], whole.at(t).dataset[name].isel(time=slice(t + 1))
            np.testing.assert_array_equal(*found)
        np.testing.assert_array_equal(post.marginal("goal_red"), whole.at(t).marginal("goal_red"))
    assert posts[-1].cost["calls"] == N_FRAMES * 11 * 4  # no hypothesis without prior mass


def narrower() -> None:
    """Red wants what it wants most under ``few_goals``; the rest is as there."""
    red = jnp.zeros(36).at[RED_GOALS[1]].set(1.0)
    numpyro.sample("goal_red", dist.Categorical(probs=red))
    green = jnp.zeros(36).at[jnp.array(GREEN_GOALS)].set(jnp.array(GREEN_MASS))
    numpyro.sample("goal_green", dist.Categorical(probs=green))
    numpyro.sample("alpha", dist.Categorical(probs=jnp.array([1.0, 0, 0, 0, 0])))
    sites.strengths()


def test_another_prior_is_another_run_and_a_file_says_the_same(
    exact: ppl.ClosedLoopPosterior, tmp_path: Path
) -> None:
    changed, anew = exact.with_prior(narrower), infer(Knows(), prior=narrower)
    np.testing.assert_allclose(changed.marginal("goal_green"), anew.marginal("goal_green"))
    assert changed.probability(goal_red=ppl.GOALS[RED_GOALS[1]]) == 1
    with pytest.raises(InvalidSettingError, match=r"mass on .* hypotheses that the simulator was"):
        anew.with_prior(few_goals)
    kept = ppl.load_posterior(exact.save(tmp_path / "own.nc"))
    assert str(kept) == str(exact)
    question = "P(strength_red > strength_green | relation=neutral)"
    assert kept.query(question) == exact.query(question)
    odds = exact.why("strength_red > strength_green")
    assert (odds["error"] == 0).all()
    assert odds["log_odds"].values[-1] == pytest.approx(
        np.log(1 / exact.query("P(not strength_red > strength_green)") - 1)
    )


def test_a_frame_that_no_sample_comes_near_is_called_out() -> None:
    torn = EVENT.observation.trajectory.copy()
    torn[2:, 2, 0] += 9.0
    event = dataclasses.replace(EVENT, observation=ppl.Observation(torn))
    post = infer(Draws(), event, tracking=FEW)
    assert post.diagnostics()["unexplained_frames"] == [2]
    assert "No sample of the simulator comes near frame 2" in post.diagnostics()["verdict"]


def test_what_cannot_be_read_is_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InvalidSettingError, match=r"add a method log_prob_next.* or next_frames"):
        infer(walkers)
    with pytest.raises(InvalidSettingError, match="expected a generator function"):
        ppl.Model(simulator=Knows())  # whole videos take more
    monkeypatch.setattr(prior_masses, "MOST_READ", 100)
    with pytest.raises(InvalidSettingError, match="11 combinations of goals times 16 of strengths"):
        infer(Knows())
    with pytest.raises(InvalidSettingError, match=r"3.17e\+04 combinations of goals times 8"):
        infer(Knows(), EVENT_OF_THREE, prior="uniform", tracking=FEW)


def test_what_a_simulator_does_wrong_is_said_with_the_frame() -> None:
    for method, given, message in [
        ("log_prob_next", lambda *_: "often", "returned 'often', expected a log density"),
        ("log_prob_next", lambda *_: np.nan, "returned nan, expected a log density"),
        ("log_prob_next", lambda *_: -np.inf, "frame 1 leaves no hypothesis possible"),
        ("next_frames", lambda *_: np.zeros((4, 3)), r"shape \(4, 3\), expected \(100, 4, 3\)"),
        ("next_frames", lambda *_: 1 / 0, "ZeroDivisionError"),
    ]:
        broken = type("Broken", (), {method: staticmethod(given)})()
        with pytest.raises(SimulationError, match=message) as refused:
            infer(broken, tracking=FEW)
        assert "frame 1" in str(refused.value)


def test_what_was_seen_cannot_be_changed_by_a_simulator() -> None:
    class Careless(Draws):
        def next_frames(self, scene: Any, hypothesis: Any, seen: Any, rng: Any, n: int) -> Any:
            seen[-1] += 1.0

    with pytest.raises(SimulationError, match="read-only"):
        infer(Careless(), tracking=FEW)


def test_kernels_are_told_what_was_read(exact: ppl.ClosedLoopPosterior) -> None:
    told = ReadTable(exact)
    hypotheses = [
        Hypothesis(RED_GOALS[0], GREEN_GOALS[0], (1, 0), 310, 590),  # of the levels 300 and 600
        Hypothesis(RED_GOALS[2], GREEN_GOALS[1], (0, 0), 150, 150),
        Hypothesis(RED_GOALS[0] + 1, GREEN_GOALS[0]),  # without prior mass
    ]
    goals = np.array([one.effective_goals for one in hypotheses])
    newtons = np.array([one.strengths for one in hypotheses])
    one, other, unread = told.errors_of(goals, newtons).sum(axis=1)
    of_level = Hypothesis(RED_GOALS[0], GREEN_GOALS[0], (1, 0), 300, 600)
    found = log_likelihood(EVENT, of_level) - log_likelihood(EVENT, hypotheses[1])
    assert other - one == pytest.approx(found)
    assert np.isinf(unread)
    assert told.log_likelihood_without(goals, newtons) is None, "a density of one's own is exact"


def test_what_never_moves_has_the_floor_and_noise_adds_to_it() -> None:
    still = np.zeros((1, 40, 4))
    at = np.array([0.0, 0.03, 0.0, 0.0])
    for noise in (0.0, 0.04):
        variance = 0.02**2 + noise**2
        found, far = log_density(still, at, 0.02, noise)
        expected = -0.5 * 0.03**2 / variance - 2 * np.log(2 * np.pi * variance)
        np.testing.assert_allclose(found, expected)
        assert far == pytest.approx(0.5 * 0.03**2 / variance)
