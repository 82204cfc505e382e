"""What the authors' agents imagine of holding: a rod that swivels, and a push at the origin."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phase_ppl.physics import compiled
from phase_ppl.physics.actions import NO_ACTION, Action
from phase_ppl.world.event import State

LENGTH = 1.6


def run(
    make_scene: Any, actions: list[Action], swivel: bool, item: tuple[float, float] = (16.0, 13.6)
) -> tuple[NDArray[np.float64], NDArray[np.int64], compiled.Params]:
    """Red at the centre heads up and does ``actions``; return bodies, holds and parameters."""
    scene = make_scene({0: (16, 12, 0.0), 2: item})
    params = compiled.make_params(scene, (600.0, 600.0), swivel=swivel)
    bodies, held, weld = compiled.from_state(State.at_start(scene), scene.radius)
    for action in actions:
        actions = np.array([action, NO_ACTION])
        compiled.step(bodies, held, weld, actions, params, compiled.make_scratch())
    return bodies, held, params


def origin(bodies: NDArray[np.float64], params: compiled.Params) -> NDArray[np.float64]:
    angle, cog = bodies[0, 2], params.cog[0]
    return bodies[0, :2] + cog * np.array([math.sin(angle), -math.cos(angle)])


def test_a_turn_leaves_a_swivelling_item_where_it_is_and_swings_a_welded_one(
    make_scene: Any,
) -> None:
    actions = [Action.ATTACH, *[Action.TURN_LEFT] * 3]
    loose, held, _ = run(make_scene, actions, swivel=True)
    welded, _, _ = run(make_scene, actions, swivel=False)
    assert held[0] == 2
    assert loose[0, 2] > 2.5
    assert loose[2, :2] == pytest.approx([16.0, 13.6], abs=0.15)
    assert welded[2, 0] < 15.5


def test_the_rod_keeps_its_length_while_it_is_pulled_about(make_scene: Any) -> None:
    rng = np.random.default_rng(1)
    pushes = [Action(int(a)) for a in rng.integers(Action.UP, Action.DOWN_RIGHT + 1, 30)]
    for n in range(1, len(pushes)):
        bodies, _, params = run(make_scene, [Action.ATTACH, *pushes[:n]], swivel=True)
        distance = np.linalg.norm(bodies[2, :2] - origin(bodies, params))
        assert distance == pytest.approx(LENGTH, abs=0.02)


def test_an_imagined_grab_takes_the_item_where_it_lies(make_scene: Any) -> None:
    beside = (16.9, 13.4)
    loose, held, _ = run(make_scene, [Action.ATTACH], swivel=True, item=beside)
    welded, _, _ = run(make_scene, [Action.ATTACH], swivel=False, item=beside)
    assert held[0] == 2
    assert loose[2, :2] == pytest.approx(beside, abs=1e-6)
    assert np.linalg.norm(welded[2, :2] - beside) > 0.1


def test_a_push_at_the_origin_turns_the_body_more(make_scene: Any) -> None:
    far = (8.0, 4.0)
    at_origin, _, _ = run(make_scene, [Action.LEFT], swivel=True, item=far)
    behind_it, _, _ = run(make_scene, [Action.LEFT], swivel=False, item=far)
    # torque over R: the push minus friction at R/6, or the push at R/12 minus friction at R/6
    expected = (600 / 6 - 100 / 6) / (600 / 12 - 100 / 6)
    assert at_origin[0, 2] / behind_it[0, 2] == pytest.approx(expected, rel=0.01)
