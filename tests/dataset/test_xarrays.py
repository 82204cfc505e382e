"""Events as xarray datasets: nothing is lost, and what is no event is refused."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings

from phase_ppl import event_dataset, event_from_dataset
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, UnknownNameError
from phase_ppl.world.event import Event
from phase_ppl.world.names import ENTITIES
from tests.dataset.test_events_json import assert_same, events
from tests.world.examples import make_event, make_trajectory


def test_a_dataset_has_the_trajectory_by_names_and_seconds() -> None:
    event = make_event(n_frames=13)
    dataset = event_dataset(event)
    assert dict(dataset["trajectory"].sizes) == {"time": 13, "entity": 4, "coord": 3}
    x = dataset["trajectory"].sel(entity="blue item", coord="x", time=1.0)
    assert x.item() == event.observation.trajectory[12, 2, 0]
    assert dataset["radius"].sel(entity="green agent").item() == 1.2
    assert dataset["goal_green"].item() == "Get blue item to green lm"
    assert (dataset["relation"].item(), dataset["scenario"].item()) == ("adversarial", "competing")
    assert dataset["strength_red"].item() == 300.0
    assert math.isnan(dataset["strength_green"].item())
    assert json.loads(dataset["judgments"].item()) == event.judgments
    assert dataset["event"].item() == "example"


@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(events)
def test_a_dataset_gives_the_same_event_back(event: Event) -> None:
    assert_same(event_from_dataset(event_dataset(event)), event)


def test_a_dataset_does_not_share_the_arrays_of_its_event() -> None:
    event = make_event()
    dataset = event_dataset(event)
    dataset["trajectory"][0, 0, 0] = 9.0
    assert event.observation.trajectory[0, 0, 0] == 8.0
    assert event_from_dataset(dataset).observation.trajectory[0, 0, 0] == 9.0


def test_dimensions_and_names_may_come_in_any_order() -> None:
    event = make_event()
    turned = event_dataset(event).transpose("xy", "coord", "end", "entity", ...)
    shuffled = turned.isel(
        entity=[2, 0, 3, 1], coord=[2, 0, 1], xy=[1, 0], landmark=[3, 1, 0, 2], bound=[3, 0, 2, 1]
    )
    assert_same(event_from_dataset(shuffled.assign(speed=("time", np.zeros(4)))), event)


def test_a_part_of_the_frames_is_an_event_too() -> None:
    part = event_dataset(make_event(n_frames=8)).isel(time=slice(3, 6))
    trajectory = event_from_dataset(part).observation.trajectory
    assert np.array_equal(trajectory, make_trajectory(8)[3:6])


def test_what_is_known_about_an_event_may_be_missing() -> None:
    known = ["goal_red", "goal_green", "relation", "scenario", "strength_red", "strength_green"]
    bare = event_dataset(make_event()).drop_vars([*known, "judgments", "predictions", "time"])
    event = event_from_dataset(bare)
    assert (event.truth, event.judgments, event.predictions) == (None, None, None)


def _dropped(*names: str) -> xr.Dataset:
    return event_dataset(make_event()).drop_vars(names)


def _with(**changes: Any) -> xr.Dataset:
    return event_dataset(make_event()).assign(changes)


WRONG: dict[str, tuple[Any, str]] = {
    "no_dataset": ({"trajectory": 3}, "{'trajectory': 3} is no xarray Dataset"),
    "no_trajectory": (_dropped("trajectory"), "has no variable trajectory"),
    "no_turning": (_dropped("turning"), "has no turning"),
    "no_id": (_dropped("event"), "has no event"),
    "no_names": (_dropped("entity"), "has no coordinate entity"),
    "dims": (_with(radius=((), 1.0)), "radius has dimensions (), expected (entity)"),
    "extra_dim": (event_dataset(make_event()).expand_dims("draw"), "trajectory has dimensions"),
    "nan": (_with(radius=("entity", [1.0, math.nan, 1.0, 1.0])), "radius[1] is nan"),
    "text": (_with(radius=("entity", ["a", "b", "c", "d"])), "scene.radius holds 'a'"),
    "outside": (_with(start=(("entity", "coord"), np.zeros((4, 3)))), "is at (0, 0)"),
    "number": (_with(turning=((), 7)), "turning is 7, expected a string"),
    "shown_time": (_with(time=np.arange(4) / 4), "time goes on by 0.25 s, expected 1/12 s"),
    "odd_time": (_with(time=["a", "b", "c", "d"]), "time holds 'a', expected numbers"),
    "json": (_with(judgments=((), "{")), "judgments: is not JSON: line 1"),
    "json_list": (_with(predictions=((), "[]")), "predictions: holds [], expected a JSON object"),
    "twice": (_with(entity=["red agent", "red agent", "x", "y"]), "has a label twice"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_dataset_that_is_no_event_is_refused(case: str) -> None:
    dataset, message = WRONG[case]
    with pytest.raises(InvalidEventError, match=re.escape(message)):
        event_from_dataset(dataset)


def test_a_strength_that_is_none_is_refused() -> None:
    with pytest.raises(InvalidSettingError, match=r"truth.strength_red=-1.0 is no positive force"):
        event_from_dataset(_with(strength_red=((), -1.0)))


@pytest.mark.parametrize(
    ("dataset", "message"),
    [
        (_with(entity=[*ENTITIES[:3], "pink ball"]), "coordinate entity 'pink ball'.*'pink item'"),
        (_with(goal_red=((), "Get blue ball to red lm")), "unknown goal 'Get blue ball"),
        (_with(turning=((), "left")), "unknown turning 'left'"),
    ],
)
def test_unknown_names_are_answered_with_those_there_are(dataset: xr.Dataset, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        event_from_dataset(dataset)
