"""The statistics of a set beside those of another, in words and as a figure."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import phase_ppl
from phase_ppl.analysis.figures.data_card import Row, data_table, goal_grid, rows, shares_differ
from phase_ppl.dataset.statistics import PHASE, standard_error, statistics
from phase_ppl.world.event import Event, Observation, Truth
from phase_ppl.world.goals import GOALS, is_self_referring
from phase_ppl.world.hypothesis import STRENGTH_LEVELS
from phase_ppl.world.scene import Scene

from .pages import texts_apart

SIZES = (0.8, 1.01, 1.2, 1.6)


def random_events(n: int, seed: int = 0) -> list[Event]:
    """Return events in which everybody wanders about."""
    rng = np.random.default_rng(seed)
    of_red, of_green = ([g for g in GOALS if not is_self_referring(g, agent)] for agent in (0, 1))
    events = []
    for number in range(n):
        steps = 0.4 * rng.normal(size=(int(rng.integers(30, 102)), 4, 3))
        track = np.clip(np.array([16.0, 12.0, 0.0]) + np.cumsum(steps, axis=0), 7, 21)
        goals = str(rng.choice(of_red)), str(rng.choice(of_green))
        red, green = (float(rng.choice(STRENGTH_LEVELS)) for _ in goals)
        truth = Truth(*goals, strength_red=red, strength_green=green)
        scene = Scene(track[0], rng.choice(SIZES, 4))
        events.append(Event(scene, Observation(track), id=f"event-{number}", truth=truth))
    return events


def manifest(events: list[Event]) -> dict[str, Any]:
    cells = ["help_blocked", "independent:LMA+LMA", "compete", "a_family_of_somebody_elses"]
    entries = [
        {"id": event.id, "group": event.id, "family": cell, "layout": layout, "split": split,
         "reflection": reflection, "measures": {"held": [0.25, 0.5]}}
        for event, cell, layout, split, reflection in zip(
            events, itertools.cycle(cells), itertools.cycle(range(18)),
            itertools.cycle(["train", "test"]), itertools.cycle(["none", "about y=-x"]),
        )
    ]  # fmt: skip
    reasons = {"the agents never come near each other": 12, "an agent is stuck": 3, "why " * 30: 1}
    kept = {**dict.fromkeys(cells, 10), "compete": 500}
    return {"entries": entries, "kept": kept, "rejected": dict.fromkeys(cells, reasons)}


@pytest.fixture(scope="module")
def generated() -> dict[str, Any]:
    events = random_events(40)
    return statistics(events, manifest(events), name="generated")


def named(found: list[Row], key: str) -> Row:
    return next(row for row in found if row.key == key)


# --- which differ ------------------------------------------------------------------------------


def test_shares_differ_where_the_interval_of_agresti_and_caffo_leaves_out_zero() -> None:
    # their table: 7 of 10 against 1 of 10 has 8/12 - 2/12 +- 1.96 sqrt(.2222/12 + .1389/12)
    assert 1.96 * np.sqrt(8 / 12 * 4 / 12 / 12 + 2 / 12 * 10 / 12 / 12) < 8 / 12 - 2 / 12
    assert shares_differ(0.7, 10, 0.1, 10)
    assert not shares_differ(0.5, 10, 0.1, 10)  # 4/12 +- 0.352
    assert not shares_differ(1.0, 1, 0.4, 500)
    assert shares_differ(0.5, 100, 0.3, 1000)
    assert not shares_differ(0.0, 100, 0.007, 500)


def test_few_equal_sets_are_told_apart_and_different_ones_are() -> None:
    first, second = (statistics(random_events(40, seed)) for seed in (1, 2))
    assert np.mean([row.stands_out for row in rows(first, second)]) < 0.15
    still = random_events(40, 3)
    for event in still:
        event.observation.trajectory.setflags(write=True)
        event.observation.trajectory[10:] = event.observation.trajectory[10]
    found = rows(statistics(still), second)
    for moves in ("speed_mean", "at_rest", "untrimmed"):
        assert named(found, moves).stands_out
    assert not any(row.stands_out for row in rows(first, first)), "it does not differ from itself"
    assert PHASE["name"] not in data_table(first, first)


def test_a_value_is_held_against_bounds_where_no_more_is_known() -> None:
    def at_rest(value: float, se: float | None, units: int = 50) -> Row:
        here = {"tables": {}, "values": {"at_rest": {"value": value, "se": se, "units": units}}}
        return named(rows(here), "at_rest")

    assert at_rest(0.25, 0.001).other == (0.19, 0.31)
    assert not at_rest(0.25, 0.001).stands_out
    assert at_rest(0.35, 0.01).stands_out
    # 0.04 beyond the bound; 1.96 sqrt(0.02^2 + 0.02^2 50/100) = 0.048
    assert not at_rest(0.35, 0.02).stands_out
    assert not at_rest(0.9, None).stands_out
    assert not at_rest(0.9, 0.01, units=9).stands_out


def test_margins_of_means_of_few_events_hold_as_often_as_they_say() -> None:
    rng, n, runs = np.random.default_rng(0), 10, 300
    inside, apart = 0, 0
    there = {"tables": {}, "values": {"at_rest": {"value": 0.0, "se": 0.0001, "units": 1000}}}
    for _ in range(runs):
        found = rng.normal(size=n)
        told = {"value": found.mean(), "se": standard_error(list(found[:, None]), np.mean)}
        here = {"tables": {}, "values": {"at_rest": {**told, "units": n}}}
        (row,) = rows(here, there)
        assert row.margin is not None
        inside, apart = inside + (abs(row.value) < row.margin), apart + row.stands_out
    assert inside / runs == pytest.approx(0.95, abs=0.025)
    assert apart == runs - inside


def test_labels_of_either_set_have_a_row() -> None:
    events = random_events(12)
    here = statistics(events, {"entries": [{"id": e.id, "split": "mine"} for e in events]})
    found = rows(here)
    assert named(found, "split/mine").other == 0
    assert named(found, "split/mine").stands_out
    assert (named(found, "split/train").n, named(found, "split/train").other_n) == (0, 320)
    assert named(found, "item_size/0.8").other is None


# --- in words ----------------------------------------------------------------------------------


def test_the_table_fits_a_terminal_and_has_every_part(generated: dict[str, Any]) -> None:
    text = data_table({**generated, "name": "a name of a set that goes on and on"})
    assert max(len(line) for line in text.splitlines()) <= 88
    words = "friendly,LMA-,600,a_family_of_somebody_elses,about y=-x,validation,median"
    words += ",agent holds an item,pink item away from,10    26   0.38"
    for word in words.split(","):
        assert word in text
    assert "estimated" not in text
    assert "* differs from PHASE" in text


def test_the_table_says_what_is_estimated_and_what_is_not_known() -> None:
    (event,) = random_events(1)
    unknown = Event(event.scene, event.observation)
    copies = {"entries": [{"id": "event", "group": "event-0"}]}
    text = data_table(statistics([event, unknown], copies))
    assert "2 events, 1 without copies, 1 without truth, 2 agents of unknown strength" in text
    assert "estimated" in text
    assert "draws" not in text
    assert "goals" not in data_table(statistics([unknown]))


def test_the_grid_has_every_goal_once() -> None:
    counts = {goal: number for number, goal in enumerate(GOALS)}
    landmarks = ["blue lm", "green lm", "red lm", "yellow lm"]
    found = goal_grid({"landmarks": landmarks, "tables": {"goal": {"counts": counts}}})
    row = "Get blue item away from"
    assert found.rows[row] == [counts[f"{row} {landmark}"] for landmark in landmarks]
    assert sorted([*np.ravel(list(found.rows.values())), *found.others.values()]) == list(range(36))


# --- the figure --------------------------------------------------------------------------------


def test_a_card_shows_shares_and_no_text_covers_another(generated: dict[str, Any]) -> None:
    large = {"events": 50000, "units": 25000, "without_truth": 300, "name": "a long name " * 9}
    figure = phase_ppl.plot.data_card({**generated, **large})
    assert len(figure.axes) == 10
    assert texts_apart(figure) > 150
    widths = [bar.get_width() for bar in figure.axes[0].patches]  # type: ignore[attr-defined]
    shares = generated["tables"]["relation"]["shares"]
    assert widths[:4] == pytest.approx([shares["friendly"], 0.4, shares["neutral"], 0.216])


def test_a_card_without_manifest_or_truth_leaves_out_what_they_tell() -> None:
    events = random_events(3)
    unknown = [Event(event.scene, event.observation, id=event.id) for event in events]
    figure = phase_ppl.plot.data_card(statistics(unknown))
    assert len(figure.axes) == 7
    assert texts_apart(figure) > 50
    assert sum(text.get_text() == "not known" for axes in figure.axes for text in axes.texts) == 3


def test_a_card_holds_any_set_beside_another(generated: dict[str, Any]) -> None:
    other = statistics(random_events(2, 5), name="two others")
    assert "two others" in phase_ppl.plot.data_card(generated, beside=other).get_supxlabel()
    assert "two others" in data_table(other, generated)
