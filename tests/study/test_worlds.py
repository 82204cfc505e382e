"""Studies of events of other worlds than PHASE: what is asked, refused, and comes out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'study' is not installed")

import phase_ppl as ppl
from phase_ppl.evaluation.prediction import pairs_of, questions_of
from phase_ppl.evaluation.table import true_answers
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError
from phase_ppl.world.goals import goal_literal, possible_goals
from phase_study import plan
from phase_study.clips import clips_of
from phase_study.settings import Settings, template
from phase_study.simulate import simulate
from phase_study.study import Study, counterparts
from tests.study.studies import (
    EMPTY,
    NURSERY,
    PHASE,
    Person,
    edit,
    make_study,
    serving,
    still_events,
    sure_of,
    table,
)

SOLO, TRIO = ppl.worlds.SOLO, ppl.worlds.TRIO

every_world = pytest.mark.parametrize(
    "world", [PHASE, SOLO, TRIO, NURSERY, EMPTY], ids=lambda world: world.name
)
other_worlds = pytest.mark.parametrize("world", [SOLO, TRIO, NURSERY], ids=lambda world: world.name)


@pytest.fixture(autouse=True)
def _no_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phase_study.server.Site.allow", lambda *args: True)


def asked(world: ppl.World, **given: Any) -> list[dict[str, Any]]:
    settings = Settings.parse('kind = "judgment"', world)
    return plan.questions(dataclasses.replace(settings, **given), "trial-1")


@every_world
def test_every_goal_that_an_agent_can_have_is_offered_once(world: ppl.World) -> None:
    questions = asked(world)
    assert [question["name"] for question in questions] == list(questions_of(world))
    for agent, question in enumerate(questions[: len(world.agents)]):
        offered = [goal for goal, _ in question["options"]]
        assert sorted(offered) == sorted(world.goals[g] for g in possible_goals(agent, world))
        cells = [g for one in question["tables"] for *_, row in one["rows"] for g in row if g]
        assert len(cells) == len(set(cells))
        assert set(cells) <= set(offered)
        for one in question["tables"]:
            assert {len(row) for *_, row in one["rows"]} == {2 * len(one["columns"])}
        assert len({words for _, words in question["options"]}) == len(offered)
    if world is PHASE:  # whose files have always had it so
        assert questions[-1]["name"] == "relation"
    relations = questions[len(world.agents) :]
    assert [one["name"] for one in relations] == list(pairs_of(world))
    for agent, question in enumerate(asked(world, self_goals=True)[: len(world.agents)]):
        literals = [goal_literal(goal, agent, world) for goal, _ in question["options"]]
        assert len(set(literals)) == len(literals)
        assert set(literals) == {goal_literal(g, agent, world) for g in world.goals}


def test_goals_are_asked_for_in_words() -> None:
    red, green, purple, *relations = asked(TRIO)
    assert red["legend"] == "What does the red agent want?"
    said = dict(red["options"])
    assert said["Get blue ball to home"] == "get the blue ball to the home"
    assert said["Get red agent away from pond"] == "get itself away from the pond"
    assert said["get away from green agent"] == "get away from the green agent"
    assert "get to red agent" in dict(green["options"])
    assert "get to purple agent" not in dict(purple["options"])
    between = "How do the red agent and the purple agent stand to each other?"
    assert relations[1]["legend"] == between
    red, anna, _ = asked(NURSERY)
    assert anna["legend"] == "What does Anna want?"
    assert dict(red["options"])["get to Anna"] == "get to Anna"
    assert dict(anna["options"])["not agents near"] == "not agents near"
    red, _, relation = asked(PHASE)
    assert red["options"][0] == [
        "Get blue item to blue lm", "get the blue item to the blue landmark"
    ]  # fmt: skip
    assert [name for name, *_ in red["tables"][0]["columns"]] == ["blue", "green", "red", "yellow"]
    assert [name for name, *_ in red["tables"][0]["rows"]] == [
        "the blue item", "the pink item", "itself", "the green agent"
    ]  # fmt: skip
    assert relation["legend"] == "How do they stand to each other?"


@other_worlds
def test_answers_are_goals_of_the_world(world: ppl.World) -> None:
    settings = Settings.parse('kind = "judgment"', world)
    right = true_answers(still_events(world, 1)[0])
    assert plan.checked(settings, "trial-1", right) == (right, None)
    for bad in ("Get blue item to red lm", "get to red agent", None, ""):
        with pytest.raises(plan.Unfit, match="goal_red"):
            plan.checked(settings, "trial-1", {**right, "goal_red": bad})
    with pytest.raises(plan.Unfit, match="expected answers to"):
        plan.checked(settings, "trial-1", {**right, "relation": "friendly"})


@every_world
@pytest.mark.parametrize("kind", ["judgment", "tagging"])
def test_the_template_is_of_the_world(world: ppl.World, kind: str) -> None:
    found = Settings.parse(template(kind, "x", world=world), world)
    assert {clip for _, clip in found.tutorial} - {""} <= set(clips_of(world))
    everything = " ".join(text for text, _ in found.tutorial)
    if world is not PHASE:
        for name in (*world.entities, *world.landmark_names):
            assert name in everything
        assert "blue" not in found.texts["consent"]
    quiz = " ".join(question for question, _, _ in found.quiz)
    assert ("stand to each other" in quiz) is (kind == "judgment" and len(world.agents) > 1)
    assert ("item is harder" in quiz) is bool(world.items)
    if kind == "judgment":
        assert all(one.name in everything for one in world.predicates)


def test_what_cannot_be_studied_of_other_worlds_is_named(tmp_path: Path) -> None:
    folder, events = tmp_path / "study", still_events(SOLO)
    with pytest.raises(
        InvalidSettingError, match="a study of play knows the world PHASE only, not"
    ):
        Study.new(folder, events, "play")
    with pytest.raises(InvalidSettingError, match="of the worlds 'solo', 'nursery', expected"):
        Study.new(folder, [*events, *still_events(NURSERY)])
    assert not folder.exists()


@pytest.mark.parametrize("world", [PHASE, SOLO, NURSERY], ids=lambda world: world.name)
def test_scripted_people_answer_as_a_model_believes_in_the_worlds_names(
    world: ppl.World, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    study, out = make_study(tmp_path / "study", world=world), tmp_path / "out"
    sure = sure_of(study)
    text = simulate(study, out, 3, predictions=sure, lapse=0, drop_outs=0, progress=False)
    assert "goal_accuracy: 1.00" in text
    assert ("relation_accuracy: 1.00" in text) == (len(world.agents) > 1)
    assert study.status().counts["entered"] == 0, "the study itself stays as it is"
    (note,) = capfd.readouterr().err.splitlines()
    assert "who is responsible" in note, "nothing of anybody is in a log"
    rows = table(out / "judgments.csv")
    columns = ["participant", "video", *questions_of(world), "response_time", "rehearsal"]
    assert [list(row) for row in rows] == [columns] * (3 * len(study.events))
    for row in rows:
        assert {q: row[q] for q in questions_of(world)} == dict(sure[row["video"]].answers)
    assert {row["video"] for row in rows} == set(study.events)
    text = (out / "README.md").read_text("utf-8")
    assert all(f"| `{column}` |" in text for column in columns)
    assert f"one of the {len(world.goals)} goals" in text
    for event in ppl.load_events(out / "events.json"):
        assert event.scene.world == world
        assert true_answers(event) == true_answers(study.events[event.id])


@pytest.mark.usefixtures("unpainted")
def test_likeness_is_asked_of_events_and_of_what_the_planner_makes_of_their_goals(
    tmp_path: Path,
) -> None:
    study = make_study(tmp_path / "study", "likeness", NURSERY)
    played, made = list(study.events.values())[:2], list(study.events.values())[2:]
    for one, other in zip(played, made, strict=True):
        assert other.id == f"{one.id}-generated"
        assert other.truth == one.truth
        assert np.array_equal(other.scene.start, one.scene.start)
    assert [event.id for event in counterparts(played, made[::-1])] == [one.id for one in made]
    elsewhere = [dataclasses.replace(made[0], truth=made[1].truth, scene=made[1].scene)]
    with pytest.raises(InvalidEventError, match="has no counterpart"):
        counterparts(played[:1], elsewhere)
    for world in (SOLO, NURSERY):
        *_, last = plan.questions(Settings.parse('kind = "likeness"', world), "trial-1")
        assert ("a person" in last["legend"]) is (world is SOLO)
    given: dict[str, Any] = {"lapse": 0, "drop_outs": 0, "progress": False}
    simulate(study, tmp_path / "out", 4, predictions=sure_of(study), **given)
    found = ppl.study.Likeness.load(tmp_path / "out" / "likeness.csv")
    assert found.table["group"].value_counts().to_dict() == {"played": 4, "generated": 4}


@pytest.mark.parametrize("accepted", ["friendly", "adversarial"])
def test_checks_are_of_questions_of_the_world(accepted: str, tmp_path: Path) -> None:
    check = f'[checks]\ntrio-1 = {{ relation_green_purple = ["{accepted}"] }}'
    study = edit(make_study(tmp_path / "study", world=TRIO), "[checks]", check)
    given = true_answers(still_events(TRIO, 1)[0])
    assert given["relation_green_purple"] == "adversarial"
    with serving(study) as client:
        person = Person(client)
        person.finish(study, given)
        films = [person.get(f"/clip/{name}.mp4").status_code for name in ("carrying", "sight")]
    assert films == [404, 200], "of this world there are fewer"
    (told,) = table(study.export(tmp_path / "out") / "participants.csv")
    assert told["checks_missed"] == str(int(accepted == "friendly"))
    assert [row["video"] for row in table(tmp_path / "out" / "judgments.csv")] == ["trio-0"]


@pytest.mark.usefixtures("unpainted")
def test_scripted_people_tag_events_of_any_world(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study", "tagging", TRIO)
    simulate(study, tmp_path / "out", 3, model="last_frame", drop_outs=0, progress=False)
    assert set(ppl.study.Tags.load(tmp_path / "out" / "tags.csv").viewers) == {3}
