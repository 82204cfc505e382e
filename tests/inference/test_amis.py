"""Adaptive importance sampling against enumeration, and in whole runs."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jax import random
from numpyro.infer import MCMC

import phase_ppl as ppl
from phase_ppl.inference import sampler
from phase_ppl.inference.checkpoint import Checkpoint
from phase_ppl.inference.kernels.amis import AMIS, first_proposal
from phase_ppl.inference.kernels.weighted import hypothesis_grid
from phase_ppl.models.world_priors import log_prior_of_effective
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.goals import N_GOALS
from phase_ppl.world.hypothesis import Hypothesis
from phase_ppl.world.scene import PHASE, Scene, World
from phase_ppl.world.space import ALPHA_SITE, space_of
from phase_ppl.world.worlds import TRIO
from tests.inference.runs import assert_same_draws, stops_at
from tests.inference.tables import EXACT as READ
from tests.inference.toy import SCENE, never_called, total_variation

CAST = World(
    ["red agent", "green agent", "blue agent"], [], {"home": (12, 8)}, touchable=[], name="cast"
)
N_FRAMES = 6


def away(scene: Scene, acts: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Each agent goes its own way, by its goal, the farther the stronger it is."""
    frame = scene.start.copy()
    goals, strengths = np.array(acts.effective_goals), np.array(acts.strengths)
    step = moves(goals, strengths, scene.world)
    while True:
        yield frame.copy()
        frame[: len(step), :2] += step


def moves(goals: Any, strengths: Any, world: World) -> FloatArray:
    """Return (..., 2) what agents go in a frame, units."""
    angle = 2 * np.pi * np.asarray(goals) / len(world.goals)
    return np.asarray(np.stack([np.cos(angle), np.sin(angle)], -1) * strengths[..., None] / 600)


def event_of(scene: Scene, acts: Any) -> Event:
    frames = away(scene, acts, np.random.default_rng(0))
    return Event(scene, Observation(np.array([next(frames) for _ in range(N_FRAMES)])), id="away")


TRUTH = Hypothesis(5, 9, (0, 0), 400.0, 300.0)
EVENT = event_of(SCENE, TRUTH)
SHARP = ppl.RadialLikelihood(1.0)
MODEL = ppl.Model(simulator=away, likelihood=SHARP)
OPTIONS: dict[str, Any] = {"chains": 50, "seed": 2, "workers": 1, "progress": False}


def infer(event: Event = EVENT, kernel: Any = "amis", **options: Any) -> ppl.Posterior:
    given = {"model": MODEL, "kernel": kernel, "iterations": 30, **OPTIONS, **options}
    return ppl.infer(event, **given)


@functools.cache
def found() -> ppl.Posterior:
    return infer()


@functools.cache
def exact() -> FloatArray:
    """Return (red, green) the posterior of effective goals, strengths summed on a grid."""
    grid = hypothesis_grid(ppl.Model(), np.linspace(150, 600, 13).tolist())
    goals = space_of(PHASE).effective(grid.sites)
    strengths = np.stack([grid.sites[f"strength_{key}"] for key in ("red", "green")], axis=1)
    mass = np.zeros((N_GOALS, N_GOALS))
    np.add.at(mass, tuple(goals.T), np.exp(grid.log_prior + fit(EVENT, goals, strengths)))
    return mass / mass.sum()


def fit(event: Event, goals: Any, strengths: Any) -> FloatArray:
    """Return (row,) log likelihoods of goals (row, agent) and strengths, beside the best."""
    n = np.shape(goals)[1]
    seen = event.observation.positions
    apart = moves(goals, strengths, event.scene.world) - (seen[-1] - seen[0])[:n] / (N_FRAMES - 1)
    errors = np.linalg.norm(apart.reshape(len(apart), -1), axis=1)[:, None] * np.arange(N_FRAMES)
    by_row = SHARP.log_prob(errors).sum(axis=1)
    return np.asarray(by_row - by_row.max())


def effective_size(post: ppl.Posterior) -> float:
    log_weight = post.tree["sample_stats"]["log_weight"].values
    weight = np.exp(log_weight - log_weight.max())
    return float(weight.sum() ** 2 / (weight**2).sum())


def test_it_finds_the_exact_posterior_with_few_simulations() -> None:
    for axis, key in ((1, "red"), (0, "green")):
        expected = exact().sum(axis=axis)
        assert 0.1 < expected.max() < 0.5
        assert total_variation(found().marginal(f"goal_{key}").values, expected) < 0.08
    # the first proposal alone makes some three of a thousand count
    assert effective_size(found()) > 0.3 * found().cost["simulations"]


def test_strata_need_densities() -> None:
    with pytest.raises(InvalidSettingError, match=r"density of each proposal, .* 'amis' does"):
        ppl.Posterior(found().tree, "stratified")


def test_proposals_that_mislead_are_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    def misled(suggested: Any, prior: Any) -> Any:
        wrong = np.full((2, N_GOALS), -20.0)
        wrong[:, 0] = 0.0
        return first_proposal(wrong, prior)

    monkeypatch.setattr("phase_ppl.inference.run.first_proposal", misled)
    post = infer()
    for axis, key in ((1, "red"), (0, "green")):
        expected = exact().sum(axis=axis)
        assert total_variation(post.marginal(f"goal_{key}").values, expected) < 0.12


def test_a_run_that_was_left_learns_again_what_it_had_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, again = tmp_path / "run.ckpt", {"model": MODEL, "workers": 1, "progress": False}
    with monkeypatch.context() as patch:
        patch.setattr(sampler, "Runner", stops_at(16))
        with pytest.raises(ppl.Interrupted):
            infer(checkpoint=path)
    assert 0 < Checkpoint(path).done < 30
    assert_same_draws(found().tree, ppl.resume(path, **again).tree)
    # complete, and then longer: old draws weigh less as proposals are better
    path.unlink()
    infer(iterations=10, checkpoint=path)
    assert_same_draws(found().tree, ppl.resume(path, iterations=30, **again).tree)
    assert str(ppl.load_posterior(found().save(tmp_path / "post.nc"))) == str(found())


def fails(scene: Scene, acts: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    if acts.effective_goals[0] % 2 == 0:
        raise ValueError("an even goal")
    yield from away(scene, acts, rng)


def test_simulations_that_fail_count_as_impossible() -> None:
    possible = exact().copy()
    possible[::2] = 0
    possible /= possible.sum()
    post = infer(model=dataclasses.replace(MODEL, simulator=fails))
    assert post.cost["failures"] > 0
    for axis, key in ((1, "red"), (0, "green")):
        expected = possible.sum(axis=axis)
        assert total_variation(post.marginal(f"goal_{key}").values, expected) < 0.12


def test_three_agents_are_learned_where_the_table_has_room() -> None:
    truth = {name: CAST.goals[at] for name, at in zip(CAST.agents, (1, 2, 5), strict=True)}
    start = [[8, 10, 0], [18, 8, 0], [12, 18, 0]]
    scene = Scene(start, np.ones(3), world=CAST)
    event = event_of(scene, Hypothesis.of(CAST, truth, strength=400.0))
    space, model = space_of(CAST), MODEL.in_world(CAST)
    goals = np.array(list(itertools.product(range(space.n_goals), repeat=3)))
    forces = np.array(list(itertools.product(np.linspace(172.5, 577.5, 10), repeat=3)))
    by_force = fit(event, np.repeat(goals, len(forces), 0), np.tile(forces, (len(goals), 1)))
    given = {name: np.full(len(goals), 300.0) for name in space.strength_sites}
    log_prior = log_prior_of_effective(model.prior, goals, given)
    mass = np.exp(log_prior) * np.exp(by_force).reshape(len(goals), -1).sum(axis=1)
    mass = (mass / mass.sum()).reshape([space.n_goals] * 3)
    post = infer(event, iterations=20)
    assert set(post.goals_of) == set(CAST.agents)
    for agent, name in enumerate(space.goal_sites):
        others = tuple(axis for axis in range(3) if axis != agent)
        assert total_variation(post.marginal(name).values, mass.sum(axis=others)) < 0.08


def test_nobody_is_drawn_to_help_or_hinder_who_cannot_act_on_it() -> None:
    # with nothing to touch but red, nobody can keep green away from it, or help green to it
    world = World(
        ["red agent", "green agent"], ["ball"], {"home": (12, 8)}, touchable=["red agent"]
    )
    space, prior = space_of(world), MODEL.in_world(world).prior
    codes = np.indices((len(space.ways), space.n_goals, space.n_goals))
    columns = dict(zip((ALPHA_SITE, *space.goal_sites), codes.reshape(3, -1), strict=True))
    possible = (space.effective(columns) >= 0).all(axis=1)
    own = ~space.impossible[0, columns["goal_red"]] & ~space.impossible[1, columns["goal_green"]]
    assert (own & ~possible).any()
    way, red, green = first_proposal(np.zeros((2, space.n_goals)), prior).goals
    mass = np.exp(way[:, None, None] + red[:, :, None] + green).ravel()
    assert mass[possible].sum() == pytest.approx(1, abs=1e-6)
    assert (mass[own & possible] > 0).all()


def test_a_table_without_room_is_refused_in_one_line() -> None:
    scene = TRIO.random_scene(2)
    event = Event(scene, Observation(np.repeat(scene.start[None], N_FRAMES, axis=0)))
    said = r"'amis' keeps a table .*'trio'.* take 'smc'"
    with pytest.raises(InvalidSettingError, match=said) as refused:
        ppl.infer(event, ppl.Model(simulator=never_called), kernel="amis")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kernel", ["amis", AMIS])
def test_what_was_read_is_summed_and_not_learned(kernel: Any) -> None:
    with pytest.raises(InvalidSettingError, match=r"'amis' learns .* summed exactly") as refused:
        ppl.infer(READ, kernel=kernel, progress=False)
    assert "\n" not in str(refused.value)
    with pytest.raises(InvalidSettingError, match=r"'amis' learns .* summed exactly") as refused:
        ppl.compare(READ, kernels={"one": "prior_mh", "two": kernel}, progress=False)
    assert "\n" not in str(refused.value)


def test_only_a_whole_run_has_proposals_that_learn() -> None:
    assert "AMIS" not in dir(ppl.kernels)
    with ppl.program(EVENT, MODEL, workers=1) as program:
        mcmc = MCMC(AMIS(program), num_warmup=0, num_samples=1, progress_bar=False)
        with pytest.raises(InvalidSettingError, match=r"phase_ppl.infer\(event, kernel='amis'\)"):
            mcmc.run(random.key(0))

    def made(program: Any, guide: Any, settings: Any) -> AMIS:
        return AMIS(program, guide, settings)

    with pytest.raises(InvalidSettingError, match="makes a AMIS, whose proposal learns"):
        infer(kernel=made)
