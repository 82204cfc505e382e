"""The paper to the letter: the options in which its preset differs, and what each does."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from jax import lax, random

import phase_ppl as ppl
from phase_ppl.inference.guide import Guide, bottom_up_guide
from phase_ppl.inference.kernels.local_mh import LocalMH
from phase_ppl.inference.kernels.smc import SMC
from phase_ppl.inference.kernels.weighted import Importance
from phase_ppl.inference.tables import BottomUpTables, bottom_up_tables, window_count
from phase_ppl.models.density import compiled_quickly
from phase_ppl.models.model import Model
from phase_ppl.models.sites import SELF_REFERRING
from phase_ppl.world.errors import InvalidSettingError
from phase_ppl.world.goals import N_GOALS, goal_index
from tests.inference import toy

PRINTED = ppl.SimpleSettings(proposal="paper", sign="printed", unit="printed", prior_share=0.0)


def apart(one: Any, other: Any) -> set[str]:
    fields = [field.name for field in dataclasses.fields(one)]
    return {name for name in fields if getattr(one, name) != getattr(other, name)}


def test_the_preset_changes_these_options_and_no_others() -> None:
    printed, intended = ppl.preset("as_printed"), ppl.preset("as_intended")
    assert set(printed) == {
        *("kernel", "rule", "settings", "planner", "weights", "chains", "iterations")
    }
    assert printed["settings"] == PRINTED
    assert apart(PRINTED, ppl.SimpleSettings()) == {"proposal", "unit", "prior_share", "sign"}
    planner = ppl.PlannerConfig.named(printed["planner"])
    of_print = {"cost", "stops_when_done", "swivel"}
    assert apart(planner, ppl.PlannerConfig()) == of_print
    assert apart(planner, ppl.PlannerConfig.fast()) == of_print | {"simulations", "paired"}
    # without the two misprints; the exact ratio needs a share of the prior
    assert {name for name in printed if printed[name] != intended[name]} == {"rule", "settings"}
    assert apart(PRINTED, intended["settings"]) == {"prior_share", "sign"}


def test_a_small_search_keeps_all_else_that_is_printed() -> None:
    small = ppl.PlannerConfig.named("as_printed_fast")
    assert apart(small, ppl.PlannerConfig.named("as_printed")) == {"simulations", "paired"}
    assert small == ppl.PlannerConfig.fast().as_printed()


def test_logits_are_the_printed_formula() -> None:
    observation = toy.moving(21, _2=(20.0, 6.0))
    logits = np.asarray(bottom_up_tables(toy.SCENE, observation, PRINTED).goal_logits)
    first, last = toy.START[2, :2], np.array([20.0, 6.0])
    red_landmark = np.array(toy.SCENE.landmark_centres[2])
    d1, d2 = (np.linalg.norm(place - red_landmark) for place in (first, last))
    # gamma d(t2) + gamma (d(t2) - d(t1)), over the whole observation
    found = logits[-1, 0, goal_index("Get blue item to red lm")]
    assert found == pytest.approx(10 * d2 + 10 * (d2 - d1))
    arena = dataclasses.replace(PRINTED, unit="arena")
    divided = np.asarray(bottom_up_tables(toy.SCENE, observation, arena).goal_logits)
    possible = ~SELF_REFERRING
    np.testing.assert_allclose(logits[:, possible], divided[:, possible] * np.hypot(20, 20))


WIDE = (440.0, 700.0)
"""Strengths, newtons; proposals of windows end at 600."""


def strong() -> None:
    ppl.sites.goals()
    ppl.sites.alpha()
    for name in ("strength_red", "strength_green"):
        numpyro.sample(name, dist.Uniform(*WIDE))


def guide(prior_share: float) -> Guide:
    """Windows that take both agents for 450 N strong, give or take 40."""
    n = window_count(toy.N_FRAMES, toy.SETTINGS.window) + 1
    strength = np.full((n, 2), 450.0)
    tables = BottomUpTables(np.zeros((n, 2, N_GOALS)), strength, np.full((n, 2), 40.0))
    return bottom_up_guide(strong, Model(prior=strong).sites, tables, prior_share=prior_share)


def test_the_printed_ratio_leaves_what_no_window_suggests_and_never_goes_back() -> None:
    runner = toy.TableRunner(toy.table_errors())
    program, _bridge = toy.table_program(runner, strong)
    settings = dataclasses.replace(toy.SETTINGS, proposal="paper", prior_share=0.0)
    kernel = LocalMH(program, guide(0.0), settings, rule="paper")
    keys = random.split(random.key(1), 20)
    at = dict(goal_red=0, goal_green=3, alpha=0, strength_red=650.0, strength_green=500.0)
    start = {name: jnp.full(20, value) for name, value in at.items()}

    def whole(keys: jax.Array) -> Any:
        def advance(state: Any, _: None) -> tuple[Any, Any]:
            state = kernel.sample(state, (), {})
            return state, (state.z["strength_red"], state.accepted)

        return lax.scan(advance, kernel.init(keys, 0, start, (), {}), None, length=12)[1]

    red, accepted = map(np.asarray, jax.block_until_ready(compiled_quickly(whole)(keys)))
    left = np.cumsum(accepted, axis=0) > 0
    assert (red[~left] == 650).all()
    # what the prior excludes is proposed too, below 440 N, and rejected
    assert ((red[left] >= WIDE[0]) & (red[left] <= 600)).all()
    assert left[-1].mean() > 0.9
    asked = sum(len(batch) for batch in runner.batches)
    assert asked < 20 * 13, "what has no prior mass is not simulated"


def test_what_divides_by_q_refuses_to_do_without_a_share_of_the_prior() -> None:
    for kernel in [
        *(lambda *given, rule=rule: LocalMH(*given, rule=rule) for rule in ("exact", "window")),
        *(Importance, SMC),
    ]:
        settings = ppl.SimpleSettings(prior_share=0.0)
        program, _bridge = toy.table_program(toy.TableRunner(toy.table_errors()))
        with pytest.raises(InvalidSettingError, match=r"prior_share=0 for .*rule='paper'"):
            _ = kernel(program, guide(0.0), settings).guide
        assert LocalMH(program, guide(0.0), settings, rule="paper").guide
