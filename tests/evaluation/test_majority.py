"""The baseline that does not look."""

from __future__ import annotations

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.models.baselines import goal_shares
from phase_ppl.world.goals import GOALS, is_self_referring
from tests.evaluation.toys import several


def test_it_says_the_same_of_every_event() -> None:
    found = ppl.evaluate(several(3), "majority", progress=False)
    for given in found.predictions.values():
        assert given.answers["relation"] == "friendly"
        assert given.answers["goal_red"] == given.answers["goal_green"] == GOALS[0]
        assert given.probabilities["relation"] == pytest.approx([0.4, 0.216, 0.384])
        assert given.ties("goal_red") == 8


@pytest.mark.parametrize("agent", [0, 1])
def test_goals_are_as_frequent_as_their_types_in_the_original_events(agent: int) -> None:
    shares = dict(zip(GOALS, goal_shares(agent), strict=True))
    assert sum(shares.values()) == pytest.approx(1)
    to_landmark = [goal for goal in GOALS if goal.startswith("Get blue item to")]
    assert [shares[goal] for goal in to_landmark] == pytest.approx([0.584 / 8] * 4)
    other = "green agent" if agent == 0 else "red agent"
    assert shares[f"get to {other}"] == pytest.approx(0.063)
    assert not np.any([shares[g] for i, g in enumerate(GOALS) if is_self_referring(i, agent)])
