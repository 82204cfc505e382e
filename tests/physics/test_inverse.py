"""Trying all joint actions: the density of each, and the short cut where nobody meets anything."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from phase_ppl.physics import compiled, inverse
from phase_ppl.physics.actions import N_ACTIONS, Action
from phase_ppl.world.event import State
from phase_ppl.world.scene import Scene
from tests.agents.scenes import scene

APART = scene(red=(10.0, 18.0, 0.4), green=(22.0, 18.0, -1.0))
TOUCHING = scene(red=(14.0, 8.0, 0.0), blue=(14.0, 9.7), green=(22.0, 18.0, -1.0))
# one group each: nothing to grab; an item that both can grab, so that the first one moves it
NEAR = scene(red=(14.0, 18.0, 0.4), green=(16.0, 18.0, -1.0))
BOTH = scene(red=(14.0, 8.0, 0.0), blue=(14.0, 9.7), green=(14.1, 11.3, 3.0))
SCALE, ANGLE_SCALE, TAIL = 0.06, 0.05, 3.0


def tried(where: Scene, unseen: Any = ()) -> tuple[np.ndarray, np.ndarray, compiled.Params]:
    """Return (A, A) log densities of the frame after (up, turn left), and the frame.

    Some of its bodies, or the angle of one, may be unseen.
    """
    params = compiled.make_params(where, (450.0, 300.0), inner_steps=4)
    state = compiled.from_state(State.at_start(where), where.radius)
    trial, scratch = inverse.make_trial(), compiled.make_scratch()
    trial.actions[:] = Action.UP, Action.TURN_LEFT
    inverse.attempt(*state, params, scratch, trial)
    observed = trial.frame + 0.01
    if unseen:
        observed[unseen] = np.nan
    found = np.empty((1, N_ACTIONS**2))
    states = [part[None] for part in state]
    strengths = np.array([[450.0, 300.0]])
    scatter = inverse.Scatter(np.full(4, SCALE), np.full(4, ANGLE_SCALE), TAIL)
    inverse.try_all(*states, strengths, observed, scatter, params, scratch, trial, found)
    return found[0].reshape(N_ACTIONS, N_ACTIONS), observed, params


@pytest.mark.parametrize("unseen", [(), ([0, 2],), (1, 2)], ids=["all", "bodies", "angle"])
@pytest.mark.parametrize(
    "where", [APART, TOUCHING, NEAR, BOTH], ids=["apart", "touching", "near", "both"]
)
def test_every_pair_has_the_density_of_what_is_seen_of_its_own_frame(
    where: Scene, unseen: Any
) -> None:
    found, observed, params = tried(where, unseen)
    place = stats.multivariate_t(np.zeros(2), SCALE**2 * np.eye(2), df=TAIL)
    for red in range(N_ACTIONS):
        for green in range(N_ACTIONS):
            bodies, held, weld = compiled.from_state(State.at_start(where), where.radius)
            frame = np.empty((4, 3))
            compiled.step_mean(
                *(bodies, held, weld, np.array([red, green])),
                *(params, compiled.make_scratch(), frame),
            )
            away = observed - frame
            expected = np.nansum(place.logpdf(away[:, :2]))
            expected += np.nansum(stats.t.logpdf(away[:2, 2], TAIL, scale=ANGLE_SCALE))
            assert found[red, green] == pytest.approx(expected, abs=1e-9), (red, green)
    if not unseen:
        assert np.unravel_index(found.argmax(), found.shape) == (Action.UP, Action.TURN_LEFT)


def test_a_state_follows_what_was_seen_as_far_as_the_gains_say() -> None:
    params = compiled.make_params(APART, (450.0, 300.0), inner_steps=4)
    state = compiled.from_state(State.at_start(APART), APART.radius)
    trial, scratch = inverse.make_trial(), compiled.make_scratch()
    pair = np.array([[Action.UP, Action.STOP]])
    trial.actions[:] = pair[0]
    inverse.attempt(*state, params, scratch, trial)
    after, observed = trial.bodies.copy(), trial.frame + 0.1
    bodies, held, weld = np.empty((1, 4, 9)), np.empty((1, 2), np.int64), np.empty((1, 2, 3))
    inverse.follow(*(part[None] for part in state), np.array([[450.0, 300.0]]), np.array([0]), pair,
                   observed, np.full((4, 3), [0.5, 0.25, 1.0]), np.zeros(4, np.int64), params,
                   scratch, trial, bodies, held, weld)  # fmt: skip
    np.testing.assert_allclose(bodies[0, :, :2], after[:, :2] + 0.05, atol=1e-12)
    np.testing.assert_allclose(bodies[0, :2, 2], after[:2, 2] + 0.1, atol=1e-12)
    lag = inverse.FRAME_LAG * params.dt
    assert bodies[0, 0, 3] == pytest.approx(after[0, 3] + 0.25 * 0.1 / lag)
    # what lies still stays at rest: noise alone sets nothing in motion
    assert bodies[0, 1:, 3:5].tolist() == np.zeros((3, 2)).tolist()
    assert held.tolist() == [[-1, -1]]
