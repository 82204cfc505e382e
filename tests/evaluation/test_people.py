"""What people got right."""

from __future__ import annotations

from typing import Any

import pytest

from phase_ppl.evaluation.metrics import human_accuracy, participant_accuracy
from tests.evaluation.judged import (
    BLUE_TO_RED,
    COLLABORATIVE,
    COMPETING,
    INDEPENDENT,
    PINK_TO_BLUE,
    make_event,
)


def responses(**rows: dict[str, str]) -> dict[str, Any]:
    return {"responses": [{"participant": who, **row} for who, row in rows.items()]}


def test_shares_and_majorities_of_votes() -> None:
    events = [
        make_event("a", COLLABORATIVE, [6, 4, 0]),
        make_event("b", COMPETING, [6, 0, 4]),
        make_event("c", INDEPENDENT, [5, 5, 0]),
        make_event("d", COLLABORATIVE),
        make_event("e", None, [9, 1, 0]),
    ]
    found = human_accuracy(events)
    assert found["n_events"] == 3
    assert found["relation_accuracy"]["value"] == pytest.approx((0.6 + 0.4 + 0.5) / 3)
    assert found["majority"]["relation_accuracy"]["value"] == pytest.approx(1 / 3)
    assert found["ties"] == {"goal_red": None, "goal_green": None, "relation": 1}
    competing = found["by_scenario"]["competing"]
    assert competing["relation_accuracy"]["value"] == pytest.approx(0.4)
    assert competing["n"] == 1
    assert found["majority"]["by_scenario"]["competing"]["relation_accuracy"]["value"] == 0
    assert found["goal_accuracy"] is None
    assert found["by_participant"] is None
    assert found["confusion"] is None


def test_an_agent_whose_goal_nobody_named_does_not_count() -> None:
    votes = {"goal_counts": {"red agent": {BLUE_TO_RED: 1, PINK_TO_BLUE: 3}}}
    found = human_accuracy([make_event("a", COLLABORATIVE, judgments=votes)])
    assert found["goal_accuracy"]["value"] == 0.25
    assert found["majority"]["goal_accuracy"]["value"] == 0


def test_responses_tell_what_each_participant_got_right() -> None:
    both = {"goal_red": BLUE_TO_RED, "goal_green": BLUE_TO_RED, "relation": "friendly"}
    events = [
        make_event(
            "a",
            COLLABORATIVE,
            judgments=responses(
                p=both, q={"goal_red": BLUE_TO_RED, "goal_green": PINK_TO_BLUE}, r={}
            ),
        ),
        make_event("b", COMPETING, judgments=responses(p=both)),
    ]
    found = human_accuracy(events)
    by_participant = found["by_participant"]
    assert by_participant == participant_accuracy(events)
    assert by_participant["n_participants"] == 2
    assert by_participant["goal_accuracy"]["value"] == pytest.approx((3 / 4 + 1 / 2) / 2)
    assert by_participant["relation_accuracy"]["value"] == 1 / 2
    assert by_participant["by_scenario"]["collaborative"]["n"] == 2
    # by events it is another mean: 3 of 4 in one, 1 of 2 in the other
    assert found["goal_accuracy"]["value"] == pytest.approx((3 / 4 + 1 / 2) / 2)
    assert found["relation_accuracy"]["value"] == 1 / 2
    assert found["confusion"]["collaborative"] == {
        "collaborative": 1,
        "independent": 1,
        "competing": 0,
        "opposing": 0,
    }
    assert found["confusion"]["competing"]["collaborative"] == 1


def test_nobody_has_no_accuracy() -> None:
    for events in ([], [make_event("a")], [make_event("a", None, [1, 0, 0])]):
        found = human_accuracy(events)
        assert found["n_events"] == 0
        assert found["goal_accuracy"] is None
        assert found["by_scenario"]["opposing"]["n"] == 0
    assert participant_accuracy([])["goal_accuracy"] is None
