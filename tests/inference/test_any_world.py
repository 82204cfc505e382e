"""Inference by simulations in worlds of other casts, against enumeration of what can be listed."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import random

import phase_ppl as ppl
from phase_ppl.analysis.comparison import distances, of_truth
from phase_ppl.inference.guide import bottom_up_guide
from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.metropolis import through
from phase_ppl.inference.registry import kernel_info
from phase_ppl.inference.tables import BottomUpTables, window_count
from phase_ppl.models import world_priors
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.compiled import Compiled
from phase_ppl.models.likelihood import RadialLikelihood
from phase_ppl.models.model import Model
from phase_ppl.models.program import EventProgram
from phase_ppl.models.world_priors import drawn_stated, log_prior_of_effective
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import InvalidSettingError, PhasePPLError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.goals import goal_literal
from phase_ppl.world.hypothesis import RELATION_OF_SCENARIO, Hypothesis, scenario
from phase_ppl.world.names import PredicateKind
from phase_ppl.world.scene import Scene, World
from phase_ppl.world.space import ALPHA_SITE, space_of
from phase_ppl.world.worlds import SOLO, TRIO
from tests.inference.toy import (
    N_FRAMES,
    SEEDS,
    SETTINGS,
    TableRunner,
    never_called,
    total_variation,
)

CAST = World(
    ["red agent", "green agent", "blue agent"], [], {"home": (12, 8)}, touchable=[], name="cast"
)
"""Three agents with six goals: each of them to or away from home."""

SPACE = space_of(CAST)
GOALS = ({0: 0.5, 3: 0.3, 4: 0.2}, {1: 0.6, 2: 0.4}, {5: 0.7, 0: 0.3})
ALPHA = {0: 0.4, 3: 0.3, 9: 0.2, 20: 0.1}
CHAINS = 45  # a step of many takes hardly longer than of few


def few(world: World) -> None:
    """A prior with mass on 48 combinations, unequal ones."""
    for name, masses in zip(space_of(world).goal_sites, GOALS, strict=True):
        _one_of(name, masses, len(world.goals))
    _one_of("alpha", ALPHA, len(SPACE.ways))
    world_priors.strengths(world)


def _one_of(name: str, masses: dict[int, float], n: int) -> None:
    probs = jnp.zeros(n).at[jnp.array(list(masses))].set(jnp.array(list(masses.values())))
    numpyro.sample(name, dist.Categorical(probs=probs))


@pytest.mark.parametrize("world", [CAST, SOLO, TRIO])
def test_sites_stand_for_the_roles_that_have_their_effective_goals(world: World) -> None:
    space, rng = space_of(world), np.random.default_rng(0)
    columns = {
        name: rng.choice(np.flatnonzero(~space.impossible[agent]), 50)
        for agent, name in enumerate(space.goal_sites)
    }
    columns[ALPHA_SITE] = rng.integers(len(space.ways), size=50)
    columns |= {name: rng.uniform(150, 600, 50) for name in space.strength_sites}
    assert space.in_support(columns).all()
    for row, effective in enumerate(space.effective(columns).tolist()):
        one = space.hypothesis({name: values[row] for name, values in columns.items()})
        assert list(one.effective_goals) == effective


def test_of_what_cannot_be_nothing_is_simulated() -> None:
    space, own = space_of(TRIO), TRIO.goals.index("get to green agent")
    sites = {name: np.zeros(3, int) for name in space.goal_sites}
    sites |= {"alpha": np.array([0, len(space.ways), 0]), "goal_green": np.array([0, 0, own])}
    sites |= {name: np.full(3, 300.0) for name in space.strength_sites}
    assert space.in_support(sites).tolist() == [True, False, False]


def test_prior_of_effective_goals_sums_over_what_leads_to_them() -> None:
    distinct, place = np.unique(EFFECTIVE, axis=0, return_inverse=True)
    strengths = {name: np.full(len(distinct), 300.0) for name in SPACE.strength_sites}
    found = np.exp(log_prior_of_effective(few_in_cast().prior, distinct, strengths))
    np.testing.assert_allclose(found * 450**3, np.bincount(place.ravel(), MASSES), rtol=1e-4)


def test_who_has_nothing_to_do_where_it_helps_has_no_part_in_it() -> None:
    # with nothing to touch but red, nobody can keep green away from it, or help green to it
    world = World(
        ["red agent", "green agent", "blue agent"], [], {"home": (12, 8)}, touchable=["red agent"]
    )
    space = space_of(world)
    even = [np.where(row, -np.inf, -np.log((~row).sum())) for row in space.impossible]
    log_goals, log_alpha = np.array(even), np.full(len(space.ways), -np.log(len(space.ways)))
    rows = np.array(list(itertools.product(range(space.n_goals), repeat=3)))
    found = np.exp(space.log_prior_of_effective(log_goals, log_alpha, rows)).sum()
    assert found == pytest.approx(space.possible_share(log_goals, log_alpha))
    assert found < 0.999


def test_simulations_of_given_goals_weigh_as_the_prior_has_them() -> None:
    # what is proposed otherwise than by the prior, here ways and strengths, P / Q makes up for
    n, bridge = 4000, SimulatorBridge(TableRunner(table()), N_FRAMES, SPACE)
    prior, n_windows = few_in_cast().prior, window_count(N_FRAMES, SETTINGS.window)
    ways = np.random.default_rng(2).normal(0.0, 3.0, (n_windows + 1, len(SPACE.ways)))
    estimate = np.full((n_windows + 1, 3), 300.0)
    tables = BottomUpTables(np.zeros((n_windows + 1, 3, 6)), estimate, estimate / 2, ways)
    guide = bottom_up_guide(prior, few_in_cast().sites, tables, prior_share=0.1)
    kernel = LocalMH(EventProgram(few_in_cast(), bridge.handle, N_FRAMES), guide, SETTINGS)
    goals, strengths = np.tile(COMMON, (n, 1)), np.full((n, 3), 375.0)
    stated, log_drawn = drawn_stated(prior, goals, strengths)
    names = (*SPACE.goal_sites, ALPHA_SITE)
    given = dict(zip(names, stated.T.astype(np.int32), strict=True))
    asked = Compiled(jax.vmap(kernel.request_given))
    bridge.answer(asked(random.split(random.key(3), n), given, log_drawn, np.full(n, -np.inf)))
    assert bridge.failure is None
    ratio = np.array([one.log_prior - one.log_proposal for one in bridge.records])
    weights = np.exp(ratio - ratio.max()) / np.exp(ratio - ratio.max()).sum()
    alike = (COMMON == EFFECTIVE).all(axis=1)
    for name, expected in (
        *((site, np.average(ROWS[:, i], weights=MASSES * alike)) for i, site in enumerate(names)),
        *((site, 375.0) for site in SPACE.strength_sites),
    ):
        values = np.array([float(one.sites[name]) for one in bridge.records])
        error = math.sqrt((weights**2 * (values - expected) ** 2).sum()) + 1e-6
        assert weights @ values == pytest.approx(expected, abs=4 * error)


ROWS = np.array(list(itertools.product(*GOALS, ALPHA)))
MASSES = np.prod(list(itertools.product(*[m.values() for m in (*GOALS, ALPHA)])), axis=1)
EFFECTIVE = SPACE.effective(dict(zip(SPACE.sites, ROWS.T, strict=False))).astype(np.int64)
"""(row, ...) all stated goals and ways with prior mass, their masses and effective goals."""

COMMON = max(EFFECTIVE.tolist(), key=EFFECTIVE.tolist().count)
"""The effective goals that most of these lead to."""


@functools.cache
def few_in_cast() -> Model:
    return Model(prior=few, simulator=never_called).in_world(CAST)


@functools.cache
def table() -> FloatArray:
    rng, shape = np.random.default_rng(0), (SPACE.n_goals,) * 3
    level = rng.gamma(2.0, 5.0, (*shape, 1, 1))
    return np.asarray(level * rng.gamma(3.0, 0.5, (*shape, SEEDS, N_FRAMES)))


@functools.cache
def exact() -> FloatArray:
    by_seed = RadialLikelihood(n_entities=3).log_prob(table()[tuple(EFFECTIVE.T)]).sum(axis=-1)
    found = MASSES * np.exp(by_seed - by_seed.max()).mean(axis=-1)
    return np.asarray(found / found.sum())


def visited(z: dict[str, Any]) -> FloatArray:
    rows = np.stack([np.ravel(z[name]) for name in (*SPACE.goal_sites, "alpha")], axis=1)
    return np.array([(rows == row).all(axis=1).mean() for row in ROWS])


def test_draws_visit_roles_as_often_as_the_posterior_says() -> None:
    model = few_in_cast()
    bridge = SimulatorBridge(TableRunner(table()), N_FRAMES, SPACE)
    n_windows, rng = window_count(N_FRAMES, SETTINGS.window), np.random.default_rng(1)
    nothing = np.full((n_windows + 1, 3), np.nan)
    tables = BottomUpTables(rng.normal(0.0, 1.0, (n_windows + 1, 3, 6)), nothing, nothing)
    guide = bottom_up_guide(model.prior, model.sites, tables, prior_share=0.1)
    program = EventProgram(model, bridge.handle, N_FRAMES)
    made = kernel_info("local_mh").make(program, guide=guide, settings=SETTINGS)
    starts, moves = ([Compiled(stage) for stage in made.stages(of)] for of in ("starts", "moves"))
    states = [through(starts, bridge.answer, random.split(random.key(0), CHAINS), None)]
    for _ in range(120):
        states.append(through(moves, bridge.answer, states[-1]))
    assert bridge.failure is None
    kept = {site: np.stack([state.z[site] for state in states[51:]]) for site in states[0].z}
    share = np.stack([visited({s: v[:, c] for s, v in kept.items()}) for c in range(CHAINS)])
    assert share.sum() == pytest.approx(CHAINS)
    # the total variation to be expected of so many independent chains
    expected = 0.5 * np.sqrt(2 / np.pi) * (share.std(axis=0, ddof=1) / np.sqrt(CHAINS)).sum()
    assert expected < 0.09
    assert total_variation(share.mean(axis=0), exact()) < 2 * expected


TRUE_GOAL = "ball to home"


def walkers(scene: Scene, roles: Hypothesis, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Each goal's entity goes straight to its target, the faster the stronger its agent."""
    frame = scene.start.copy()
    while True:
        yield frame.copy()
        for agent, goal in enumerate(roles.effective_goals):
            literal = goal_literal(goal, agent, scene.world)
            on = literal.predicate is PredicateKind.ON
            target = scene.landmark_centres[literal.target] if on else frame[literal.target, :2]
            way = (target - frame[literal.subject, :2]) * (1 if literal.positive else -1)
            frame[literal.subject, :2] += roles.strengths[agent] / 600 * way / np.hypot(*way)


LEVELS = (150.0, 300.0, 450.0, 600.0)
SHARES = (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # of the strengths from 150 to 600 N that are nearest to each


def walk(scene: Scene, roles: Hypothesis, n_frames: int) -> FloatArray:
    frames = walkers(scene, roles, np.random.default_rng(0))
    return np.array(list(itertools.islice(frames, n_frames)))


@functools.cache
def walking() -> Event:
    scene = SOLO.random_scene(3)
    truth = Hypothesis.of(SOLO, {"red agent": TRUE_GOAL}, strength=450.0)
    return Event(scene, Observation(walk(scene, truth, 14)), id="walk")


def inferred(event: Event, kernel: str, **options: Any) -> ppl.Posterior:
    given = {"chains": 8, "seed": 1, "workers": 1, "progress": False, **options}
    return ppl.infer(event, ppl.Model(simulator=walkers), kernel=kernel, **given)


@functools.cache
def enumerated() -> ppl.Posterior:
    return inferred(walking(), "enumerate")


@functools.cache
def fits() -> FloatArray:
    """Return (goal, level) likelihoods of the walk, by hand."""
    event, likelihood = walking(), RadialLikelihood(n_entities=3)
    found = np.empty((len(SOLO.goals), len(LEVELS)))
    for (i, goal), (j, force) in itertools.product(enumerate(SOLO.goals), enumerate(LEVELS)):
        one = Hypothesis.of(SOLO, {"red agent": goal}, strength=force)
        apart = (walk(event.scene, one, 14) - event.observation.trajectory)[..., :2]
        error = np.linalg.norm(apart.reshape(14, -1), axis=1)
        found[i, j] = np.exp(likelihood.log_prob(error).sum() + 14 * 26)
    return found


def test_a_solo_event_has_the_posterior_that_can_be_worked_out_by_hand() -> None:
    mass = SHARES * fits()
    mass /= mass.sum()
    post = enumerated()
    for goal, share in zip(SOLO.goals, mass.sum(axis=1), strict=True):
        assert float(post.probability(goal_red=goal)) == pytest.approx(share, rel=1e-3)
    expected = mass.sum(axis=0) @ LEVELS
    assert float(post.mean("strength_red")) == pytest.approx(expected, rel=1e-3)
    assert post.untried == pytest.approx(0.0, abs=1e-5)
    best = post.map()
    assert best.goals == {"red agent": SOLO.goals[SOLO.goal_index(TRUE_GOAL)]}
    assert best.strengths == (450.0,)


@functools.cache
def of_trio() -> Event:
    scene = TRIO.random_scene(2)
    truth = Hypothesis.of(
        TRIO,
        {"red agent": "blue ball to home", "purple agent": "pink ball to pond"},
        {("green agent", "red agent"): "hinder"},
    )
    return Event(scene, Observation(walk(scene, truth.effective(), 6)), id="three")


def test_a_posterior_of_three_agents_answers_is_kept_and_tells_of_itself(tmp_path: Path) -> None:
    path = tmp_path / "run.ckpt"
    whole = inferred(of_trio(), "prior_mh", iterations=2)
    inferred(of_trio(), "prior_mh", iterations=1, checkpoint=path)
    model = ppl.Model(simulator=walkers)
    post = ppl.resume(path, model=model, iterations=2, workers=1, progress=False)
    errors = [one.tree["simulations"]["total_error"] for one in (post, whole)]
    np.testing.assert_array_equal(*errors)
    assert set(post.goals_of) == set(post.summary()["goals"]) == set(TRIO.agents)
    assert float(post.query("P(goal_purple = get to red agent)")) >= 0
    assert float(post.marginal("relation_red_green").sum()) == pytest.approx(1)
    assert -1 <= float(post.query("E[alpha_green_red]")) <= 1
    assert 150 < float(post.mean("strength_purple")) < 600
    for row in post.to_dataframe().to_dict("records"):
        red, green = (TRIO.goals.index(row[f"goal_{key}"]) for key in ("red", "green"))
        word = RELATION_OF_SCENARIO[scenario(red, green, TRIO, (0, 1))]
        assert row["relation_red_green"] == word
    again = ppl.load_posterior(post.save(tmp_path / "post.nc"))
    assert (str(again), again.map()) == (str(post), post.map())
    assert all(words in str(post) for words in ("purple agent", "tempered: a frame's likelihood"))
    assert set(post.over_time()) >= {"goal_green", "relation_green_purple"}
    # what would have been, of who helps or hinders whom as it was found
    found = post.do(strength_red=600.0, n=3, seconds=0.1, workers=1, simulator=walkers)
    columns = [post.table.values[f"goal_{key}"].tolist() for key in TRIO.keys]
    assert set(found.goals) <= set(zip(*columns, strict=True))


def test_another_prior_weighs_what_was_simulated_anew() -> None:
    expected = enumerated().marginal("goal_red").values.copy()
    expected[0] *= 2.0
    found = enumerated().with_prior(biased).marginal("goal_red").values
    np.testing.assert_allclose(found, expected / expected.sum(), rtol=1e-3, atol=1e-6)


def biased(world: World) -> None:
    probs = jnp.ones(len(world.goals)).at[0].set(2.0)
    numpyro.sample("goal_red", dist.Categorical(probs=probs / probs.sum()))
    world_priors.alpha(world)
    world_priors.strengths(world)


def dependent(world: World) -> None:
    world_priors.goals(world)
    world_priors.alpha(world)
    strength = numpyro.sample("strength_red", dist.Uniform(150, 600))
    numpyro.sample("strength_green", dist.Uniform(150, strength))
    numpyro.sample("strength_purple", dist.Uniform(150, 600))


def taken(world: World) -> None:
    world_priors.uniform(world)
    numpyro.sample("alpha_red_green", dist.Normal())


CLOSED_LOOP = ppl.ClosedLoopLikelihood()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "enumerate"}, "'trio' has .* more than 50000"),
        ({"kernel": "prior_mh", "settings": ppl.SimpleSettings(proposal="learned")},
         "proposal='learned' was learned in PHASE and knows no other world, such as 'trio'"),
        ({"kernel": "local_mh", "settings": ppl.SimpleSettings(strength="network")},
         "strength='network' was learned in PHASE"),
        ({"kernel": "local_mh", "model": ppl.Model(likelihood=CLOSED_LOOP)},
         "of three agents and more, as in 'trio', only some combinations are followed"),
        ({"model": ppl.Model("relation_first")}, "relation_first"),
        ({"model": ppl.Model(dependent)}, "'strength_green' depend on strength_red"),
        ({"model": ppl.Model(taken)}, "'alpha_red_green', a reserved name"),
    ],
)  # fmt: skip
def test_what_does_not_know_a_world_says_so(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message) as found:
        ppl.infer(of_trio(), **{"kernel": "prior_mh", "progress": False, **options})
    assert "\n" not in str(found.value)


def test_what_is_of_a_world_is_none_of_phase_and_the_other_way_round() -> None:
    with pytest.raises(PhasePPLError, match="in PHASE one takes none and samples goal_red"):
        ppl.infer(ppl.load_event("collaborate"), ppl.Model(world_priors.uniform), kernel="prior_mh")


def of_one_strength(world: World) -> None:
    world_priors.goals(world)
    world_priors.alpha(world)
    numpyro.sample("strength_red", ppl.sites.OneOf([LEVELS[2]]))


def test_a_reference_enumerates_the_goals_of_any_world_that_has_few() -> None:
    options: dict[str, Any] = {
        "model": ppl.Model(of_one_strength, simulator=walkers),
        "kernels": ["prior_mh"],
        "budget": ppl.simulations(40),
        "repeats": 1,
        "chains": 8,
        "workers": 1,
        "progress": False,
    }
    found = ppl.compare(walking(), reference="enumeration", **options).settings["reference"]
    assert found["simulations"] == 4 * len(SOLO.goals)
    exact = fits()[:, 2] / fits()[:, 2].sum()
    np.testing.assert_allclose(found["marginals"]["goal_red"], exact, rtol=1e-3)
    of_many = {**options, "model": ppl.Model(simulator=walkers)}
    with pytest.raises(InvalidSettingError, match="'trio' has too many combinations"):
        ppl.compare(of_trio(), reference="enumeration", **of_many)


def test_true_goals_and_relations_of_all_are_looked_up() -> None:
    goals = {"red agent": "Get blue ball to home", "green agent": "Get blue ball to field"}
    truth = Hypothesis.of(TRIO, goals, {("purple agent", "red agent"): "help"})
    space, codes = space_of(TRIO), np.array(truth.effective_goals)
    sure = dict(zip(space.goal_sites, np.eye(space.n_goals)[codes], strict=True))
    sure |= {name: np.eye(3)[code] for name, code in space.relation_codes(codes).items()}
    names = ("p_goals", "p_relation", "map_goals", "map_relation")
    assert of_truth(sure, truth) == dict.fromkeys(names, 1.0)
    none = {name: np.roll(masses, 1) for name, masses in sure.items()}
    assert set(of_truth(none, truth).values()) == {0.0}
    assert distances(sure, none) == {"tv_goals": 1.0, "tv_relation": 1.0}
