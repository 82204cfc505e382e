"""Evaluations of events of worlds of other casts than PHASE's, worked out by hand."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation.figures.frame import NothingToDrawError
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.evaluation.table import kinds_of
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, PhasePPLError
from phase_ppl.world.event import Observation
from phase_ppl.world.hypothesis import Hypothesis
from tests.evaluation.judged import values

TRIO, SOLO = ppl.worlds.TRIO, ppl.worlds.SOLO
PAIRS = ("red & green", "red & purple", "green & purple")
HOME, FIELD = "Get blue ball to home", "Get blue ball to field"
ONE_PROCESS: dict[str, Any] = {"workers": 1, "progress": False}


def moved(
    world: ppl.World, number: int, roles: Hypothesis | None, **ends: tuple[float, float]
) -> Any:
    """Return an event of two frames, in which some (by name, "_" for spaces) go somewhere."""
    scene = world.random_scene(number)
    end = scene.start.copy()
    for name, place in ends.items():
        end[world.entity(name.replace("_", " ")), :2] = place
    frames = np.stack([scene.start, end])
    return ppl.Event(scene, Observation(frames), id=f"{world.name}-{number}", truth=roles)


@pytest.fixture(scope="module")
def events() -> list[ppl.Event]:
    """Two events of the trio: red helps green, and all for themselves."""
    helps = {("red agent", "green agent"): "help"}
    goals = {"green agent": HOME, "purple agent": FIELD}
    alone = {"red agent": HOME, "green agent": "get to red agent", "purple agent": FIELD}
    return [
        moved(TRIO, 1, Hypothesis.of(TRIO, goals, helps), blue_ball=(4, 4)),
        moved(TRIO, 2, Hypothesis.of(TRIO, alone), blue_ball=(4, 4)),
    ]


def always_home(scene: ppl.Scene, observation: Observation, seed: int) -> dict[str, Any]:
    """Red and green want the ball home, purple rather to the field; all are friends."""
    return {
        "goal_red": {HOME: 1.0},
        "goal_green": {HOME: 0.9, FIELD: 0.1},
        "goal_purple": {HOME: 0.4, FIELD: 0.6},
        **{f"relation_{pair}": "friendly" for pair in ("red_green", "red_purple", "green_purple")},
    }


def test_goals_and_relations_are_scored_by_agent_and_pair(events: list[ppl.Event]) -> None:
    found = ppl.evaluate(events, always_home, **ONE_PROCESS)
    metrics = found.metrics
    agents, pairs = metrics["by_agent"], metrics["by_pair"]
    assert (list(agents), list(pairs)) == (list(TRIO.agents), list(PAIRS))
    assert values(agents, *(f"{name}.goal_accuracy" for name in agents)) == [1.0, 0.5, 1.0]
    assert values(pairs, *(f"{name}.relation_accuracy" for name in pairs)) == [0.5, 0.0, 0.0]
    assert metrics["goal_accuracy"]["value"] == pytest.approx(5 / 6)
    assert metrics["n"]["truth"] == 2
    with_lapse = 0.99 * np.array([1.0, 1.0, 0.9, 0.0, 0.6, 0.6]) + 0.01 / len(TRIO.goals)
    assert metrics["goal_log_score_truth"]["value"] == pytest.approx(np.log(with_lapse).mean())
    assert metrics["relation_log_score_truth"] is None
    assert metrics["human"]["goal_r"] is metrics["doubt"] is None
    assert "by_scenario" not in metrics
    text = str(found)
    for word in ("purple agent", "red & purple"):
        assert word in text
    sure = metrics["calibration"]["goal"]  # of sure answers, the share that is true
    assert [one["n"] for one in sure.values()] == [6, 6, 4, 2]
    assert [one["accuracy"]["value"] for one in sure.values()] == [5 / 6, 5 / 6, 0.75, 1.0]
    assert sure["0.8"]["probability"] == pytest.approx(0.95)


def test_what_came_true_is_what_the_last_frame_says(events: list[ppl.Event]) -> None:
    found = ppl.evaluate(events, "last_frame", **ONE_PROCESS)
    first = found.predictions["trio-1"]
    came_true = dict(zip(TRIO.goals, first.probabilities["goal_red"], strict=True))
    assert came_true[HOME] == 1.0
    assert first.answers["relation_red_green"] == "friendly"
    # where nothing came true all goals that can be had are alike
    still = moved(TRIO, 3, None)
    found = ppl.evaluate([still], "last_frame", **ONE_PROCESS)
    shares = found.predictions["trio-3"].probabilities["goal_red"]
    of = dict(zip(TRIO.goals, shares, strict=True))
    assert of["get to green agent"] == of[HOME] > of["get to red agent"] == 0


def test_worlds_are_not_mixed(events: list[ppl.Event]) -> None:
    with pytest.raises(InvalidSettingError, match="of the worlds 'trio', 'solo', expected those"):
        ppl.evaluate([*events, moved(SOLO, 1, None)], "closed_loop", **ONE_PROCESS)
    with pytest.raises(InvalidEventError, match="of the world 'PHASE', not 'trio'"):
        Prediction.of(Prediction("", answers={}), "", TRIO)


def test_models_are_compared_by_agent_and_pair(events: list[ppl.Event], tmp_path: Path) -> None:
    sources = {
        "home": ppl.evaluate(events, always_home, **ONE_PROCESS),
        "last": ppl.evaluate(events, "last_frame", **ONE_PROCESS),
    }
    compared = ppl.compare_models(sources, resamples=100)
    assert compared.people["n_events"] == 0
    assert compared.equivalence == []
    rows = {row["measure"]: row for row in compared.differences}
    for measure, value in (
        ("by_agent.green agent.goal_accuracy", 0.0),
        ("by_agent.purple agent.goal_accuracy", 1.0),
        ("by_pair.red & green.relation_accuracy", 0.0),
    ):
        assert rows[measure]["value"] == value
    text = str(compared)
    for word in ("goals right, by agent", "relations right, by pair", "green & purple", "p: boot"):
        assert word in text
    assert "people" not in text
    assert str(ppl.ModelComparison.load(compared.save(tmp_path / "kept"))) == text


def test_what_is_of_phase_is_refused_before_a_model_is_asked(
    events: list[ppl.Event], study_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def never(scene: ppl.Scene, observation: Observation, seed: int) -> dict[str, Any]:
        raise AssertionError("the model was asked")

    for name in ("majority", "vlm", "socialgnn"):
        with pytest.raises(InvalidSettingError, match=f"'{name}' knows the world PHASE only, not"):
            ppl.evaluate(events, name, **ONE_PROCESS)
    of_people = "an observer of people knows the world PHASE only, not 'trio'"
    with pytest.raises(InvalidSettingError, match=of_people):
        ppl.evaluate(events, never, observer="people", **ONE_PROCESS)
    for given in (never, None):
        with pytest.raises(InvalidSettingError, match=of_people):
            ppl.evidence_from(events, given)
    with pytest.raises(InvalidSettingError, match="fit_people knows the world PHASE only"):
        ppl.fit_people(events, ppl.load_judgments(study_file, events))
    file = tmp_path / "events.json"
    ppl.save_events(events, file)
    command = ["fit-people", str(file), "--judgments", str(study_file)]
    assert main([*command, "--out", str(tmp_path / "people.json")]) != 0
    assert of_people in capsys.readouterr().err
    with pytest.raises(InvalidSettingError, match="reproduce knows the world PHASE only"):
        ppl.reproduce(tmp_path / "paper", videos=file, progress=False)
    ppl.generate(tmp_path / "set", n=1, world=SOLO, frames=24, seed=0, **ONE_PROCESS)
    with pytest.raises(InvalidSettingError, match="SocialGNN knows the world PHASE only"):
        ppl.train_socialgnn(tmp_path / "set", tmp_path / "gnn")


def test_a_lesion_of_simple_is_asked_about_any_world() -> None:
    scene = SOLO.random_scene(0)
    event = ppl.simulate(scene, goals={"red agent": "get to ball"}, frames=4, id="solo")
    quick = {"kernel": "prior_mh", "chains": 2, "iterations": 1}
    found = ppl.evaluate([event], "no_social_goals", **quick, **ONE_PROCESS)
    assert found.predictions["solo"].probabilities["goal_red"].sum() == pytest.approx(1)


STUDY = f"""participant,video,goal_red,goal_green,goal_purple,relation_red_green,relation_red_purple
p1,trio-1,{HOME},{HOME},{FIELD},friendly,neutral
p2,trio-1,{HOME},get to red agent,{FIELD},friendly,friendly
p1,trio-2,{HOME},get to red agent,{HOME},neutral,neutral
p2,trio-2,{HOME},{HOME},,neutral,
"""


@pytest.fixture(scope="module")
def study_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("study") / "study.csv"
    file.write_text(STUDY)
    return file


def test_people_are_scored_by_agent_and_pair_beside_a_model(
    events: list[ppl.Event], study_file: Path, tmp_path: Path
) -> None:
    study = ppl.load_judgments(study_file, events)
    shares = study.judgments["trio-1"].distribution("goal_green")
    assert shares is not None
    assert shares[TRIO.goals.index(HOME)] == 0.5
    found = study.accuracy(events)
    # p1 errs about purple's goal in the second, p2 about green's in both
    of_agents = [f"by_agent.{name} agent.goal_accuracy" for name in ("green", "purple")]
    of_pairs = [f"by_pair.red & {name}.relation_accuracy" for name in ("green", "purple")]
    # red and purple compete
    assert values(found, *of_agents, *of_pairs) == pytest.approx([0.5, 0.75, 1.0, 0.0])
    # judgments are kept with their event
    file, out = tmp_path / "events.json", tmp_path / "out"
    ppl.save_events(ppl.with_judgments(events, study), file)
    assert ppl.load_judgments(study_file, file).table.equals(study.table)
    for event in ppl.load_events(file):
        judged = Judgments.of(event)
        assert judged is not None
        assert judged.responses == study.judgments[event.id].responses

    evaluation = ppl.evaluate(events, always_home, judgments=study, out=out, **ONE_PROCESS)
    for one in (evaluation, ppl.Evaluation.load(out)):
        people, human = one.metrics["people"], one.metrics["human"]
        assert people["goal_accuracy"]["value"] == pytest.approx((5 / 6 + 1 / 2) / 2)
        # the goals of three agents in two events: the model's probabilities beside people's shares
        assert human["goal_r"]["value"] == pytest.approx(r_of_goals(events, study))
        assert human["goal_log_score_people"]["value"] == pytest.approx(-np.log(2) / 3)
        assert one.metrics["doubt"] is None
    assert "people, majority" in str(evaluation)


def r_of_goals(events: list[ppl.Event], study: ppl.Study) -> float:
    """Return the correlation of what ``always_home`` says of goals with people's shares."""
    told = always_home(events[0].scene, events[0].observation, 0)
    given = [(event, question) for event in events for question in kinds_of(TRIO)["goal"]]
    said = [told[question].get(goal, 0.0) for _, question in given for goal in TRIO.goals]
    shares = [study.judgments[event.id].distribution(question) for event, question in given]
    return float(np.corrcoef(said, np.concatenate(shares))[0, 1])  # type: ignore[arg-type]


def test_a_study_of_another_world_is_read_by_its_questions(
    events: list[ppl.Event], study_file: Path, tmp_path: Path
) -> None:
    file = tmp_path / "study.csv"
    for text, message in (
        (STUDY.replace("goal_purple", "goal_blue"), "unknown column 'goal_blue'"),
        (STUDY.replace(f"{FIELD},friendly", "Get blue ball to blue lm,friendly"),
         "goal_purple: unknown goal"),
        (STUDY.replace("trio-2", "trio-3"), "unknown video 'trio-3'.*give all events"),
        ("participant,video,relation\np1,trio-1,friendly\n",
         r"'relation'.*\(the events are of the world 'trio'\)"),
    ):  # fmt: skip
        file.write_text(text)
        with pytest.raises(PhasePPLError, match=message):
            ppl.load_judgments(file, events)
    with pytest.raises(PhasePPLError, match="without its events a study is one of PHASE"):
        ppl.load_judgments(study_file)
    study = ppl.load_judgments(study_file, events)
    near = ppl.Predicate("near", "red agent", "green agent", within=4)
    elsewhere = [moved(dataclasses.replace(TRIO, predicates=[near]), 1, None)]
    with pytest.raises(InvalidEventError, match="the events are of another 'trio'"):
        ppl.with_judgments(elsewhere, study)
    with pytest.raises(InvalidEventError, match="is about the world 'trio', the events are of"):
        ppl.with_judgments([ppl.load_event("collaborate")], study)


def test_people_who_judge_a_single_agent_have_no_relations_to_judge(tmp_path: Path) -> None:
    goals = SOLO.goals[:2]
    alone = [moved(SOLO, number, Hypothesis.of(SOLO, {"red agent": goals[0]})) for number in (1, 2)]
    file = tmp_path / "study.csv"
    rows = [f"p{n},{event.id},{goals[n]}" for n in (0, 1) for event in alone]
    file.write_text("\n".join(["participant,video,goal_red", *rows]))
    study = ppl.load_judgments(file, alone)
    assert study.accuracy(alone)["relation_accuracy"] is None
    found = ppl.evaluate(alone, "last_frame", judgments=study, **ONE_PROCESS)
    assert found.metrics["people"]["goal_accuracy"]["value"] == 0.5
    assert found.metrics["human"]["goal_log_score_people"]["value"] == pytest.approx(-np.log(2))
    assert found.metrics["human"]["relation_r"] is None


@pytest.mark.usefixtures("unpainted")
def test_the_terminal_evaluates_and_reports_a_model_and_people_of_another_world(
    events: list[ppl.Event], study_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ppl.save_events(events, tmp_path / "events.json")
    out = tmp_path / "out"
    files = [str(tmp_path / "events.json"), "--judgments", str(study_file)]
    assert main(["evaluate", *files, "--model", "predicate", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    for words in ("relations right, by pair", "people, majority", "people on goals",
                  "people on relations"):  # fmt: skip
        assert words in printed
    with pytest.raises(NothingToDrawError, match="whose scenario is known"):
        ppl.figures.confusion(out)
    page = ppl.report(out).read_text("utf-8")
    for words in ("Goal of the purple agent", "Relation of red &amp; green", "red &amp; purple",
                  "Goals right, by agent", "Relations right, by pair"):  # fmt: skip
        assert words in page
