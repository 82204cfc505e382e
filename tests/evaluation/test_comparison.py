"""Models compared with each other and with people, on figures that can be worked out by hand."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.cells import WIDTH
from phase_ppl.evaluation.comparison import holm
from phase_ppl.evaluation.figures.frame import DRAWINGS
from phase_ppl.evaluation.folder import ResultsFolder
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.event import Event, Observation
from phase_ppl.world.files import write_json
from tests.analysis.pages import texts_apart
from tests.evaluation.judged import (
    BLUE_TO_GREEN,
    BLUE_TO_RED,
    COLLABORATIVE,
    COMPETING,
    answers,
    by_id,
    differences,
    make_event,
    shares,
)

WRITTEN = {"name": "x", "kind": "model", "predictions": [], "settings": {}, "failures": {},
           "folder": None}  # fmt: skip
"""A model in comparison.json."""

STORED = {"theirs": {"relation": "friendly"}, "right": {"relation": "neutral"}}


def judged_events(n: int = 12, wrong: int = 1) -> list[Event]:
    """Return events, every third competing, of which ``wrong`` of 20 people are wrong."""
    made = []
    for i in range(n):
        competing = i % 3 == 0
        votes = (wrong, 0, 20 - wrong) if competing else (20 - wrong, 0, wrong)
        goals = COMPETING if competing else COLLABORATIVE
        made.append(make_event(f"event {i}", goals, votes, predictions=STORED))
    return made


EVENTS = judged_events()


def evaluation(
    name: str = "right",
    relation: str | None = None,
    goals: Sequence[str] = (),
    of: Sequence[Event] = EVENTS,
    **more: Any,
) -> ppl.Evaluation:
    """Return an evaluation of a model that gives the same answer always, or else the truth."""
    made: dict[str, ppl.Prediction] = {}
    for event in of:
        assert event.truth is not None
        made[event.id] = answers(event.id, *goals, relation=relation or event.truth.relation)
    made = more.pop("predictions", costing(made, seconds=2.0, cpu_seconds=1.5))
    return ppl.Evaluation(of, made, {}, {"model": name, "seed": 0}, **more)


def costing(predictions: Mapping[str, ppl.Prediction], **cost: float) -> dict[str, ppl.Prediction]:
    return {i: dataclasses.replace(p, cost=cost) for i, p in predictions.items()}


def kept(path: Path, found: ppl.Evaluation) -> Path:
    folder = ResultsFolder.create(path, found.settings, found.events)
    for prediction in found.predictions.values():
        folder.add(prediction)
    return path


def compare(*models: Any, **more: Any) -> ppl.ModelComparison:
    given = models[0] if len(models) == 1 and isinstance(models[0], Mapping) else list(models)
    return ppl.compare_models(given, **{"resamples": 400, **more})


def row(rows: Sequence[Mapping[str, Any]], **wanted: Any) -> Mapping[str, Any]:
    (found,) = [r for r in rows if all(r[name] == value for name, value in wanted.items())]
    return found


@pytest.fixture(scope="module")
def three() -> ppl.ModelComparison:
    """Return a comparison of one that is right, with two that always say the same."""
    return compare(evaluation(), evaluation("friend", "friendly"), evaluation("foe", "adversarial"))


def test_differences_are_of_pairs_and_p_is_corrected(three: ppl.ModelComparison) -> None:
    for one, other, scenario, value, n in (
        ("right", "friend", None, 1 / 3, 12),  # all competing ones
        ("friend", "foe", None, 1 / 3, 12),
        ("friend", "foe", "competing", -1, 4),
    ):
        place = {"measure": "relation_accuracy", "scenario": scenario}
        found = row(three.differences, one=one, other=other, **place)
        assert (found["value"], found["n_events"]) == pytest.approx((value, n))
        assert found["ci_low"] <= found["value"] <= found["ci_high"]
    relation = [r for r in three.differences if r["measure"] == "relation_accuracy"]
    for of_scenarios, n in ((False, 3), (True, 6)):
        family = [r for r in relation if (r["scenario"] is not None) == of_scenarios]
        assert len(family) == n
        expected = holm(pd.Series([r["p"] for r in family])).tolist()
        assert [r["p_holm"] for r in family] == pytest.approx(expected)
    assert holm(pd.Series([0.01, 0.04, 0.03])).tolist() == pytest.approx([0.03, 0.06, 0.06])
    against = compare(*(evaluation(name) for name in "abc"), against="b").differences
    assert {(r["one"], r["other"]) for r in against} == {("a", "b"), ("c", "b")}
    alone = compare(*(evaluation(n) for n in ("a", "b")))
    equal = row(alone.differences, measure="relation_accuracy", scenario=None)
    assert (equal["value"], equal["p"], equal["p_holm"]) == (0, 1, 1)


def test_each_pair_is_compared_as_if_it_were_the_only_one() -> None:
    """Also where models leave different events, or different questions, unanswered."""
    every = evaluation("every", goals=COLLABORATIVE)
    kept = {i: p for i, p in every.predictions.items() if i != "event 0"}
    some = by_id(
        *(answers(e.id, *(COLLABORATIVE if i % 5 else ()), relation="friendly")
          for i, e in enumerate(EVENTS))
    )  # fmt: skip
    models = [
        every,
        evaluation("twin", goals=COMPETING),
        evaluation("late", predictions=kept),
        evaluation("some", predictions=some),
        evaluation("foe", "adversarial"),
    ]
    together = compare(*models).differences
    assert {r["n_events"] for r in together if r["scenario"] is None} == {11, 12}

    def numbers(row: Mapping[str, Any]) -> dict[str, Any]:
        return {name: row[name] for name in ("value", "ci_low", "ci_high", "p", "n_events")}

    for one, other in itertools.combinations(models, 2):
        alone = differences(EVENTS, one.predictions, other.predictions, resamples=400)
        of_pair = [r for r in together if (r["one"], r["other"]) == (one.name, other.name)]
        found = {".".join(filter(None, (r["scenario"], r["measure"]))): numbers(r) for r in of_pair}
        assert found == {measure: numbers(row) for measure, row in alone.items()}


def test_equivalence_with_people_is_of_right_answers_event_by_event() -> None:
    for margin, relation, wrong, verdict in (
        (0.1, None, 0, "undecided"),  # twenty events that agree are too few to show it
        (0.3, None, 0, "equivalent"),
        (0.02, None, 1, "undecided"),  # one more event could make up for it
        (0.1, None, 2, "undecided"),  # the margin itself is no equivalence
        (0.1, None, 8, "higher"),
        (0.1, "neutral", 1, "lower"),
        (0.1, "friendly", 13, "undecided"),
    ):
        c = compare(evaluation(relation=relation, of=judged_events(wrong=wrong)), margin=margin)
        found = row(c.equivalence, model="right", measure="relation_accuracy", scenario=None)
        share = {None: 1, "neutral": 0, "friendly": 2 / 3}[relation]
        assert found["value"] == pytest.approx(share - (20 - wrong) / 20)
        assert found["verdict"] == verdict, (margin, relation, wrong)
        if verdict == "equivalent":
            assert found["p_equivalent"] <= 0.05
            assert -margin < found["low"] <= found["high"] < margin
        # people said nothing about goals
        assert {r["measure"] for r in c.equivalence} == {"relation_accuracy"}
        assert c.people["relation_accuracy"]["value"] == pytest.approx((20 - wrong) / 20)
    few = judged_events(n=9, wrong=0)
    c = compare(evaluation(of=few), evaluation("other", of=few))
    assert {(r["p_equivalent"], r["verdict"]) for r in c.equivalence} == {(None, "undecided")}


def test_what_is_not_there_is_none_and_never_a_guess() -> None:
    part = {i: p for i, p in evaluation().predictions.items() if i != "event 3"}
    half = evaluation("half", predictions=part)
    c = compare(half, evaluation("friend", "friendly"))
    assert c.metrics["half"]["n_events"] == 11
    assert c.metrics["half"]["goal_accuracy"] is None
    assert c.metrics["half"]["cpu_seconds"]["value"] == 1.5
    assert math.isnan(c.table.loc["half", ("goal_accuracy", "value")])
    assert c.table.loc["half", ("relation_accuracy", "value")] == 1
    assert not [r for r in c.differences if r["measure"].startswith("goal")]
    assert row(c.differences, measure="relation_accuracy", scenario=None)["n_events"] == 11
    assert "half predicts 11 of 12 events" in str(c)
    c = compare(evaluation("free", predictions=costing(part)))
    assert c.metrics["free"]["cpu_seconds"] is None


def test_evaluations_must_be_of_the_same_events() -> None:
    one, other = evaluation(of=EVENTS[:8]), evaluation("b", of=EVENTS[2:])
    with pytest.raises(InvalidEventError, match=r"different events: 6, such as 'event 0', are in"):
        compare(one, other)
    c = compare(one, other, common=True)
    assert [e.id for e in c.events] == [f"event {i}" for i in range(2, 8)]
    assert "on the 6 events that all share, of up to 10" in str(c)
    with pytest.raises(InvalidEventError, match="no event that right, b share"):
        compare(evaluation(of=EVENTS[:2]), evaluation("b", of=EVENTS[4:]), common=True)

    # the same id does not make the same event
    moved = Observation(EVENTS[0].observation.trajectory + 0.01)
    changed = [dataclasses.replace(EVENTS[0], observation=moved), *EVENTS[1:]]
    models = evaluation(), evaluation("b", of=changed)
    with pytest.raises(
        InvalidEventError,
        match="different events: 1, such as 'event 0', are in one only, or differ",
    ):
        compare(*models)
    assert len(compare(*models, common=True).events) == 11

    # other truth or judgments are told
    unjudged = [dataclasses.replace(e, judgments=None) for e in EVENTS]
    c = compare(evaluation(), evaluation("b", of=unjudged))
    assert "truth or judgments of 12 events" in str(c)
    assert c.people["n_events"] == 12


def test_models_are_called_by_their_names_or_their_folders_or_as_one_likes(tmp_path: Path) -> None:
    one, other = (kept(tmp_path / "all" / n, evaluation("same")) for n in ("one", "other"))
    third = kept(tmp_path / "third", evaluation("b", "friendly"))
    assert compare(one, other, third).models == ["one", "other", "b"]
    assert compare(tmp_path / "all", third).models == ["one", "other", "b"]
    assert compare({"x": one, "y": evaluation("b")}).models == ["x", "y"]


def test_bad_input_is_named() -> None:
    one, two = evaluation(), {"theirs": evaluation(), "theirs (stored)": evaluation()}
    cases: tuple[tuple[Any, Any, str], ...] = (
        ((), {}, "no evaluations"),
        ((3,), {}, "3 is neither an evaluation nor the folder"),
        (("nowhere",), {}, "nowhere: no such folder"),
        ((one,), {"margin": "x"}, "margin='x'"),
        ((one,), {"stored": ["thers"]}, "'theirs'"),
        (({"people": one},), {}, "called 'people', as people are"),
        (({1: one},), {}, "called 1, expected a name"),
        ((one, one), {}, "two models are called 'right'"),
        ((two,), {"stored": "all"}, r"two models are called 'theirs \(stored\)'"),
    )
    for models, more, message in cases:
        with pytest.raises(PhasePPLError, match=message):
            compare(*models, **more)


def test_models_in_the_events_are_compared_by_name() -> None:
    c = compare(evaluation(), stored="all")
    assert c.models == ["right", "theirs", "right (stored)"]
    assert c.metrics["theirs"]["relation_accuracy"]["value"] == pytest.approx(2 / 3)
    assert c.metrics["right (stored)"]["relation_accuracy"]["value"] == 0
    assert c.metrics["theirs"]["cpu_seconds"] is None
    for stored in (["theirs"], "theirs"):
        assert compare(evaluation(), stored=stored).models == ["right", "theirs"]
    of = [dataclasses.replace(e, predictions={"people": STORED["theirs"]}) for e in EVENTS]
    assert compare(evaluation(of=of), stored="all").models == ["right", "people (stored)"]


NAMES = (
    *("simple", "last_frame", "a_lesion_of_simple_without_physics", "predicate"),
    *("another_lesion_that_sees_everything", "vlm", "$y$"),
)


def many(of: Sequence[Event]) -> ppl.ModelComparison:
    """Return a comparison of many models, with long names, that answer everything."""
    models = {}
    for k, name in enumerate(NAMES):
        made = []
        for i, event in enumerate(of):
            p = 0.05 + 0.9 * ((7 * k + 3 * i) % 10) / 10
            goals = {BLUE_TO_RED: p, BLUE_TO_GREEN: 1 - p}
            made.append(shares(event.id, goal_red=goals, goal_green=goals, relation=[p, 0, 1 - p]))
        costed = costing(by_id(*made), cpu_seconds=10.0**k / 1e4)
        models[name] = evaluation(name, predictions=costed, of=of)
    return compare(models, stored=["theirs"], resamples=200)


@pytest.fixture(scope="module")
def crowd() -> ppl.ModelComparison:
    goals = {"red agent": {BLUE_TO_RED: 15}, "green agent": {BLUE_TO_RED: 9, BLUE_TO_GREEN: 6}}
    of = []
    for i, event in enumerate(judged_events(6)):
        counts = {"friendly": 5 + 2 * i, "neutral": 3, "adversarial": 12 - 2 * i}
        judgments = {"relation_counts": counts, "goal_counts": goals}
        of.append(dataclasses.replace(event, judgments=judgments))
    return many(of)


def test_it_fits_a_terminal_and_is_read_again(crowd: ppl.ModelComparison, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    lines = str(crowd).splitlines()
    assert max(map(len, lines)) <= WIDTH == 100
    for words in ("right answers", "competing (2)", "r given truth", "equivalence with people",
                  "more pairs", "CPU s/event", "people, majority",
                  "doubt about relations"):  # fmt: skip
        assert any(words in line for line in lines), words
    crowd.save(folder)
    again = ppl.ModelComparison.load(folder)
    assert str(again) == str(crowd)
    assert again.differences == crowd.differences
    record = json.loads((folder / "comparison.json").read_text())
    assert record["metrics"]["simple"]["n_events"] == 6
    assert len(record["differences"]) == len(crowd.differences)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    compare(evaluation(of=EVENTS[:2]), resamples=5).save(tmp_path)
    whole = json.loads((tmp_path / "comparison.json").read_text())
    for field, value, message in (
        ("schema", "other", "its schema is 'other'"),
        ("models", [{"name": "x"}], "missing required field 'kind'"),
        ("models", [WRITTEN | {"predictions": [{"event": 3}]}], "event of a prediction is 3"),
        ("models", [WRITTEN, WRITTEN], "two models are called 'x'"),
        ("settings", whole["settings"] | {"margin": 2}, "margin=2"),
    ):
        write_json(tmp_path / "comparison.json", {**whole, field: value})
        with pytest.raises(InvalidEventError, match=message):
            ppl.ModelComparison.load(tmp_path)
    with pytest.raises(InvalidEventError, match="holds no comparison"):
        ppl.ModelComparison.load(tmp_path / "nowhere")


def test_no_text_of_a_figure_leaves_the_page_or_covers_another(crowd: ppl.ModelComparison) -> None:
    for name in DRAWINGS.keys() - {"over_time"}:
        texts_apart(DRAWINGS[name].draw(crowd))
