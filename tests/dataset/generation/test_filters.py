"""What is seen in recordings, and which of them are kept."""

from __future__ import annotations

import numpy as np
import pytest

from phase_ppl.dataset.generation.copies import AFTER_MOTION, SHORTEST, Recording, after_motion
from phase_ppl.dataset.generation.making import MAX_STUCK, longest_run, measures, reason_against
from tests.dataset.generation.recordings import START, recording


def verdict(made: Recording, scenario: str) -> str | None:
    return reason_against(scenario, made.hypothesis, measures(made))


def walk(entity: int, target: tuple[float, float], frames: int = 21) -> np.ndarray:
    trajectory = np.repeat(START[None], frames, axis=0)
    share = np.linspace(0, 1, frames)[:, None]
    trajectory[:, entity, :2] = (1 - share) * START[entity, :2] + share * np.array(target)
    return trajectory


def test_measures_of_a_walk() -> None:
    found = measures(recording())
    assert found["frames"] == 21
    assert found["at_start"] == [False, False]
    assert found["ever"] == found["at_end"] == [True, False]
    assert found["moved"] == pytest.approx([10, 0, 0, 0])
    assert found["closest"] == pytest.approx(np.hypot(16, 0) / 2.0)
    assert found["touched"] == [[], []]
    assert found["stuck"] == [0, 20]  # green pushes all the time and goes nowhere


def test_both_goals_must_be_true_in_the_end_where_each_minds_its_business() -> None:
    assert verdict(recording(), "independent") == "a goal is not reached"
    reached = recording(green="Get green agent to green lm")
    reached.trajectory[:, 1, 1] += np.linspace(0, 5, 21)
    assert verdict(reached, "independent") is None


def test_a_goal_that_was_true_from_the_start_shows_nothing() -> None:
    made = recording(walk(0, (8.5, 19.0)), green="Get blue item to blue lm")
    made.trajectory[:, 2, :2] = 9.0, 19.0
    assert verdict(made, "independent") == "a goal is true at the start"
    avoided = recording(green="get away from red agent", red="get to green agent")
    assert measures(avoided)["at_start"] == [False, True]
    assert verdict(avoided, "opposing") == "the agents never come near each other"


def test_opponents_must_meet() -> None:
    made = recording(walk(0, (22.0, 14.0)), red="get to green agent",
                     green="get away from red agent", layout=0)  # fmt: skip
    assert measures(made)["closest"] == pytest.approx(1.0)
    assert verdict(made, "opposing") is None


def test_rivals_must_both_touch_the_item() -> None:
    made = recording(walk(0, (14.0, 18.4)), red="Get blue item to yellow lm",
                     green="Get blue item to red lm", layout=0)  # fmt: skip
    assert measures(made)["touched"] == [["blue item"], []]
    assert verdict(made, "competing") == "not both touch the item"
    made.trajectory[10:, 1, :2] = 16.0, 20.0
    assert measures(made)["touched"] == [["blue item"], ["blue item"]]
    assert verdict(made, "competing") is None


def test_rivals_must_touch_the_item_that_they_want() -> None:
    track = walk(0, (16.4, 4.0))
    track[10:, 1, :2] = 20.0, 4.0
    made = recording(track, red="Get blue item to yellow lm", green="Get blue item to red lm",
                     layout=0)  # fmt: skip
    assert measures(made)["touched"] == [["pink item"], ["pink item"]]
    assert verdict(made, "competing") == "not both touch the item"


def test_partners_must_both_touch_the_item_that_they_want() -> None:
    both = "Get blue item to blue lm"
    track = walk(0, (14.0, 18.4))
    made = recording(np.concatenate([track, track[-1:]]), red=both, green=both, layout=0)
    assert verdict(made, "collaborative") == "not both touch the item"
    made.trajectory[10:, 1, :2] = 16.0, 20.0
    assert verdict(made, "collaborative") == "a goal is not reached"
    made.trajectory[-1, 2, :2] = 8.5, 19.5
    assert verdict(made, "collaborative") is None
    helped = recording(walk(1, (8.5, 19.0)), red="Get green agent to blue lm",
                       green="Get green agent to blue lm", layout=0)  # fmt: skip
    assert verdict(helped, "collaborative") is None


def test_an_agent_that_pushes_a_wall_for_long_is_stuck() -> None:
    frames = MAX_STUCK + 2
    made = recording(walk(0, (8.5, 19.0), frames), green="Get green agent to green lm")
    made.trajectory[:, 1, 1] += 5 * (np.arange(frames) > 0)
    assert measures(made)["stuck"] == [0, MAX_STUCK]
    assert verdict(made, "independent") is None
    made.trajectory[1, 1, 1] = START[1, 1]
    made.trajectory[2, 1, 1] = START[1, 1] + 5
    longer = recording(np.concatenate([made.trajectory, made.trajectory[-1:].repeat(2, 0)]),
                       green="Get green agent to green lm")  # fmt: skip
    assert verdict(longer, "independent") == "an agent is stuck"


@pytest.mark.parametrize(
    ("flags", "length"), [([], 0), ([0, 0], 0), ([1], 1), ([1, 1, 0, 1], 2), ([0, 1, 1, 1], 3)]
)
def test_longest_run(flags: list[int], length: int) -> None:
    assert longest_run(np.array(flags, bool)) == length


def test_recordings_end_soon_after_the_last_motion() -> None:
    assert after_motion(walk(0, (8.5, 19.0), 40)) == 40
    still = np.concatenate([walk(0, (8.5, 19.0), 40), walk(0, (8.5, 19.0))[-1:].repeat(60, 0)])
    assert after_motion(still) == 40 + AFTER_MOTION
    assert after_motion(np.repeat(START[None], 101, axis=0)) == SHORTEST
