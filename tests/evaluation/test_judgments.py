"""People's judgments: studies in CSV files, and votes in event files."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.judgments import load_judgments, with_judgments
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, PhasePPLError
from phase_ppl.world.goals import GOALS
from tests.evaluation.judged import (
    AWAY_FROM_RED,
    BLUE_TO_RED,
    COLLABORATIVE,
    COMPETING,
    TO_GREEN,
    make_event,
)

HEADER = "participant,video,goal_red,goal_green,relation,response_time"
STUDY = f"""{HEADER}
p01,a,{BLUE_TO_RED},{BLUE_TO_RED},friendly,12.4
p01,b,{TO_GREEN},{AWAY_FROM_RED},adversarial,8.1
p02,a,{BLUE_TO_RED},,friendly,
p03,a,,,neutral,3
p03,b,,,,20
"""
EVENTS = [make_event("a", COLLABORATIVE), make_event("b", COMPETING), make_event("c")]


def write(folder: Path, content: str | bytes, name: str = "study.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_study_holds_what_the_file_says_and_shares_of_those_who_answered(tmp_path: Path) -> None:
    study = ppl.load_judgments(write(tmp_path, STUDY), EVENTS)
    tidy = ["participant", "event", "question", "answer", "value", "at", "response_time"]
    assert list(study.table.columns) == tidy
    of_one = study.table[study.table["event"] == "a"].groupby("participant")
    assert of_one["question"].apply(list).to_dict() == {
        "p01": ["goal_red", "goal_green", "relation"],
        "p02": ["goal_red", "relation"],  # an empty cell is no answer
        "p03": ["relation"],
    }
    first = ["p01", "a", "goal_red", BLUE_TO_RED, 1.0]
    assert study.table.loc[0].tolist()[:5] == first
    assert (study.table["at"].isna()).all()
    np.testing.assert_equal(of_one["response_time"].first().tolist(), [12.4, math.nan, 3.0])
    assert str(study).splitlines() == [
        "2 events, 3 participants, 9 answers (goal_red 3, goal_green 2, relation 4)",
        "rows left out: 1 without an answer",
    ]
    judgments = study.judgments["a"]
    assert judgments.counts["relation"].tolist() == [2, 1, 0]
    assert judgments.distribution("relation") == pytest.approx([2 / 3, 1 / 3, 0])
    # two of three said what red wants, one what green wants
    red = judgments.distribution("goal_red")
    assert red.shape == (36,)
    assert red[GOALS.index(BLUE_TO_RED)] == 1


CHANGES: list[Callable[[str], str]] = [
    lambda text: "\ufeff" + text,
    lambda text: text.replace("\n", "\r\n"),
    lambda text: text.replace("\n", "\r"),
    lambda text: text.replace("\n", "\n\n") + ",,,,,\n",
    lambda text: text.replace(",", " , "),
    lambda text: text.replace("friendly", "Friendly").replace("Get", "get"),
    lambda text: text.replace("p01", '"p01"').rstrip(),
    # a European Excel, and Excel's text in Unicode
    lambda text: text.replace(".", "#").replace(",", ";").replace("#", ","),
    lambda text: text.replace(",", "\t"),
    lambda text: text.replace(",,", ",NA,").replace(",\n", ",n/a\n"),
]


def test_what_spreadsheets_make_of_it_is_read_alike(tmp_path: Path) -> None:
    expected = load_judgments(write(tmp_path, STUDY)).table
    for change in CHANGES:
        assert load_judgments(write(tmp_path, change(STUDY))).table.equals(expected)


ROW = f"p01,a,{BLUE_TO_RED},{BLUE_TO_RED},friendly,12.4"
SLIDERS = "participant,video,friendly,neutral,adversarial"


WRONG: list[tuple[str | bytes, str]] = [
    (HEADER, "study.csv: holds no judgments"),
    (HEADER.replace("goal_red", "goal_rde"), "line 1: unknown column.*'goal_red'"),
    (HEADER.replace("goal_red", "video"), "line 1: names the column video twice"),
    (f"{HEADER}\n{ROW}\np02,a,,Get blu item to red lm,,",
     "line 3: goal_green: unknown goal.*did you mean 'Get blue item to red lm'"),
    ("participant,video,response_time", "line 1: names none of the columns goal_red"),
    (f"{HEADER}\n{ROW}\n{ROW}",
     "line 3: has participant 'p01', video 'a' a second time, after line 2; repeated="),
    (f"{HEADER}\n{ROW}\np02,a,,,friendly", "line 3: has 5 cells, expected 6"),
    (f"{HEADER}\np\x1b[2J,a,,,friendly,", "line 2: participant is 'p.*printable"),
    (f"{HEADER}\np01,a,,,friendly,soon", "line 2: response_time is 'soon', expected"),
    (f'{HEADER}\n\n{ROW}\np02,a,,,"friendly,\n', "line 4: is no CSV: unexpected end of data"),
    (b"PK\x03\x04\x00\x00", "is no CSV file in UTF-8: it holds zero bytes"),
    (f'{HEADER}\np01,a,"Get blue item\nto red lm",,,\np02,a,,,foe,',
     "line 4: relation: unknown relation 'foe'"),
    # of graded answers, and of further columns
    (f"{SLIDERS}\np1,a,70,-3,0",
     "line 2: neutral is '-3', expected a number of 0 or more, such as 70"),
    (f"{SLIDERS}\np1,a,70,1e308,0", "neutral is '1e308', expected a number of 0 or more"),
    (f"{SLIDERS},rating\np1,a,7,2,1,3", "line 1: names the column rating, a reserved name"),
    (f"{SLIDERS},relation\np1,a,7,2,1,friendly", "has an answer and ratings of relation"),
    (f"{SLIDERS},Friendly\np1,a,7,2,1,3", "columns friendly and Friendly mean the same"),
    ("participant,video,question\np,a,relation",
     "names a column question, but no column answer"),
    ("participant,video,relation_why\np,a,so", r"unknown column.*'relation_why': None. leaves"),
    ("participant,video,question,answer\np,a,relation,neutral\np,a,relation,friendly",
     "line 3: has participant 'p', video 'a', question 'relation' a second time"),
]  # fmt: skip


def test_what_is_wrong_is_told_with_file_and_line(tmp_path: Path) -> None:
    for content, message in WRONG:
        path = write(tmp_path, content)
        with pytest.raises(PhasePPLError, match=message) as caught:
            load_judgments(path)
        assert str(caught.value).startswith(str(path))
        assert len(str(caught.value)) < len(str(path)) + 250
    for options, message in (
        ({"na": "-99"}, "na='-99', expected a list of texts"),
        ({"names": ["friendly"]}, "names=.*, expected a mapping"),
    ):
        with pytest.raises(InvalidSettingError, match=message):
            load_judgments(write(tmp_path, STUDY), **options)  # type: ignore[arg-type]


def test_all_that_is_wrong_with_a_file_is_said_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, f"{HEADER}\n{ROW}\np02,a,flee,,foe,soon\n{ROW}\n{ROW}")
    with pytest.raises(PhasePPLError) as caught:
        load_judgments(path)
    said = str(caught.value)
    assert said.startswith(f"{path}, line ")
    assert "\n" not in said
    for message in ("; goal_red: unknown goal 'flee'", "; relation: unknown relation 'foe'",
                    "line 3: response_time is 'soon'", "; line 4: has participant 'p01'",
                    "; line 5: has"):  # fmt: skip
        assert message in said


def test_unknown_video_is_refused_where_events_are_given(tmp_path: Path) -> None:
    events = [make_event("aa"), make_event("b")]
    path = write(tmp_path, STUDY)
    with pytest.raises(PhasePPLError, match="line 2: unknown video 'a'; did you mean 'aa'"):
        load_judgments(path, events)
    assert set(load_judgments(path).judgments) == {"a", "b"}
    with pytest.raises(PhasePPLError, match=r"^the table, line 2: .*give all events of the study"):
        load_judgments(pd.read_csv(path), events)


LEFT: dict[str, tuple[str, dict[str, Any], str]] = {
    "pandas, index": (",participant,video,relation\n0,p,a,friendly\n", {}, ""),
    "a further column": (
        "participant,video,relation,condition\np,a,friendly,A\n", {}, "kept as they are: condition"
    ),
    "Excel, empty columns": ("participant,video,relation,,\np,a,friendly,,\n", {}, ""),
    "R, names of rows": ('"participant","video","relation"\n"1","p","a","friendly"\n', {}, ""),
    "a reload": (
        "participant,video,relation\np,a,friendly\np,a,neutral\n", {"repeated": "first"},
        "rows left out: 1 repeated (the first counts)",
    ),
    "a reload, the last": (
        "participant,video,relation\np,a,neutral\np,a,friendly\n", {"repeated": "last"},
        "rows left out: 1 repeated (the last counts)",
    ),
    "jsPsych": (
        'rt,stimulus,response,trial_type,participant\n812,,"{""agree"":true}",text,p\n'
        '12400,a,"{""relation"":""friendly""}",page,p\n',
        {"names": {"stimulus": "video", "trial_type": None}},
        "response_time was read as milliseconds, as its median is 12400; milliseconds=False reads "
        "it as seconds\nrows left out: 1 without an answer",
    ),
    "Qualtrics, a row per person": (
        'ResponseId,Status,a_relation\nResponse ID,Status,How do they stand?\n'
        '"{""ImportId"":""_id""}","{""ImportId"":""st""}","{""ImportId"":""QID1""}"\np,0,Friends\n',
        {"names": {"ResponseId": "participant", "Friends": "friendly"}}, "kept as they are: Status",
    ),
    "a row per answer": (
        "subject,event,question,answer\np,a,Relation,friendly\n",
        {"names": {"subject": "participant"}}, "",
    ),
    "codes": (
        "participant,video,relation,goal_red\np,7,1,-99\n",
        {"names": {"7": "a", "1": "friendly"}, "na": ["-99"]}, "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", LEFT)
def test_tables_are_read_as_other_programs_leave_them(tmp_path: Path, kind: str) -> None:
    content, options, said = LEFT[kind]
    study = load_judgments(write(tmp_path, content), EVENTS, **options)
    assert study.table[["participant", "event", "question", "answer", "value"]].values.tolist() == [
        ["p", "a", "relation", "friendly", 1.0]
    ]
    assert study.summary == said
    if kind == "jsPsych":
        assert study.table["response_time"].tolist() == [12.4]
    if kind == "a further column":
        assert study.table["condition"].tolist() == ["A"]


def test_times_are_milliseconds_where_that_is_said_and_a_data_frame_is_a_table() -> None:
    table = pd.DataFrame({"participant": ["p"], "video": ["a"], "relation": ["friendly"]})
    table["response_time"] = 250.0
    for said, seconds in ((None, 250.0), (True, 0.25), (False, 250.0)):
        found = load_judgments(table, milliseconds=said).table
        assert found["response_time"].tolist() == [seconds]


def test_sliders_are_distributions(tmp_path: Path) -> None:
    rows = ["p1,a,70,20,10", "p2,a,50,,50", "p3,a,0,0,0", "p1,b,0,0,80"]
    file = write(tmp_path, "\n".join([SLIDERS, *rows]))
    study = load_judgments(file)
    assert study.summary.splitlines() == [
        "ratings were divided by their sum, answer by answer",
        "rows left out: 1 graded answers of zeros only",
    ]
    judgments = study.judgments["a"]
    assert judgments.counts["relation"] == pytest.approx([1.2, 0.2, 0.6])
    assert judgments.distribution("relation") == pytest.approx([0.6, 0.1, 0.3])
    assert study.judgments["b"].responses == {"p1": {"relation": "adversarial"}}
    softmax = load_judgments(file, graded="softmax", temperature=20.0).judgments["a"]
    shares = softmax.responses["p1"]["relation"]
    masses = np.exp(np.array([70, 20, 10]) / 20)
    assert list(shares.values()) == pytest.approx(masses / masses.sum())
    # one and the same in the three forms of a table
    long = "\n".join(
        f"p1,a,relation,{label},{rating}"
        for label, rating in zip(SLIDERS.split(",")[2:], (70, 20, 10), strict=True)
    )
    for text in (
        f"participant,video,question,answer,value\n{long}",
        "participant,a_friendly,a_neutral,a_adversarial\np1,70,20,10",
        "participant;video;relation: friendly;Relation Neutral;relation..adversarial\n"
        "p1;a;70,0;20%;10",
    ):
        one = load_judgments(write(tmp_path, text)).judgments["a"].responses["p1"]["relation"]
        assert one == pytest.approx({"friendly": 0.7, "neutral": 0.2, "adversarial": 0.1})


def test_temperature_is_fitted_to_what_others_chose() -> None:
    """Those who choose alike are believed; the scale of the ratings does not matter."""
    rng = np.random.default_rng(0)

    def study(noise: float, scale: float = 1.0) -> ppl.Study:
        logs = rng.normal(0, 1.0, (30, 1, 3)) + noise * rng.gumbel(size=(30, 8, 3))
        ratings = scale * np.clip(50 + 8 * logs, 0, None).reshape(-1, 3)
        table = pd.DataFrame(ratings, columns=SLIDERS.split(",")[2:])
        table["participant"] = [f"p{n % 8}" for n in range(240)]
        table["video"] = [f"v{n // 8}" for n in range(240)]
        return load_judgments(table, graded="softmax")

    def temperature(of: ppl.Study) -> float:
        return float(re.search(r"temperature ([\d.]+) \(fitted", of.summary)[1])  # type: ignore[index]

    certain, doubtful = temperature(study(0.3)), temperature(study(1.0))
    assert certain < 8 < doubtful
    rng = np.random.default_rng(1)
    one = study(1.0)
    rng = np.random.default_rng(1)
    other = study(1.0, scale=3.0)
    assert temperature(other) == pytest.approx(3 * temperature(one), rel=0.01)
    np.testing.assert_allclose(one.table["value"], other.table["value"], atol=0.002)
    with pytest.raises(InvalidSettingError, match="temperature=20 sets it"):
        sliders([1, 2, 3])


def sliders(*ratings: list[float | None]) -> ppl.Study:
    rows = [[f"p{who}", "a", *given] for who, given in enumerate(ratings)]
    return load_judgments(pd.DataFrame(rows, columns=SLIDERS.split(",")), graded="softmax")


def test_a_label_without_a_number_is_not_fitted_to() -> None:
    """Others' answers with it say nothing of the temperature, as it has no share at any."""
    rated: list[list[float | None]] = 2 * [[70, 50, 30], [45, 60, 30], [50, 40, 30], [60, 20, 30]]
    found, expected = (
        re.search(r"temperature ([\d.]+) \(fitted", sliders(*given).summary)[1]  # type: ignore[index]
        for given in ([*rated, [None, 50, 60]], [*rated, [0, 50, 60]])
    )
    # a rating of 0 has a share, and so is wrong about the others
    assert float(found) < float(expected)
    shares = sliders([70, 20, None], [60, 30, 10]).judgments["a"].responses["p0"]["relation"]
    assert set(shares) == {"friendly", "neutral"}


def test_graded_answers_are_kept_in_events_and_scored_as_shares(tmp_path: Path) -> None:
    """Two people who put 0.6 and 0.8 on the truth are right by 0.7."""
    rows = ["p1,a,60,40,0", "p2,a,80,0,20", "p1,b,0,50,50", "p2,b,10,0,90"]
    study = load_judgments(write(tmp_path, "\n".join([SLIDERS, *rows])))
    events = with_judgments(EVENTS[:2], study)
    ppl.save_events(events, tmp_path / "events.json")
    again = ppl.load_events(tmp_path / "events.json")
    for one, other in zip(events, again, strict=True):
        np.testing.assert_allclose(
            Judgments.of(one).counts["relation"], Judgments.of(other).counts["relation"]
        )
    assert Judgments.of(again[0]).responses["p2"]["relation"]["adversarial"] == 0.2
    found = study.accuracy(events)["relation_accuracy"]
    assert found["value"] == pytest.approx((0.6 + 0.5 + 0.8 + 0.9) / 4)
    given = {"a": [0.7, 0.2, 0.1], "b": [0.05, 0.25, 0.7]}
    made = {name: ppl.Prediction(name, {"relation": shares}) for name, shares in given.items()}
    metrics = ppl.evaluate_predictions(again, made)
    human, doubt = metrics["human"], metrics["doubt"]
    assert human["relation_r"]["value"] == pytest.approx(1.0)
    assert human["log_score"]["value"] < human["log_score_people"]["value"]
    one, two = [0.6, 0.4, 0, 0, 0.5, 0.5], [0.8, 0, 0.2, 0.1, 0, 0.9]
    assert human["split_half_r"]["value"] == pytest.approx(np.corrcoef(one, two)[0, 1])
    assert doubt["ceiling"]["one_out_r"] == pytest.approx(np.corrcoef(one + two, two + one)[0, 1])


def test_events_get_the_judgments_of_the_study_alone_and_files_keep_them(tmp_path: Path) -> None:
    study = load_judgments(write(tmp_path, STUDY))
    before = [*EVENTS[:2], make_event("c", votes=[1, 2, 3])]
    events = with_judgments(before, study)
    assert [event.id for event in events] == ["a", "b", "c"]
    assert events[2].judgments is None
    assert before[0].judgments is None
    judgments = Judgments.of(events[0])
    assert judgments.responses == study.judgments["a"].responses
    assert judgments.responses["p02"] == {"goal_red": BLUE_TO_RED, "relation": "friendly"}
    ppl.save_events(events, tmp_path / "events.json")
    *read, silent = ppl.load_events(tmp_path / "events.json")
    assert Judgments.of(silent) is None
    for event, again in zip(events, read, strict=False):
        assert again.judgments == event.judgments
        one, other = study.judgments[event.id], Judgments.of(again)
        assert one.responses == other.responses
        np.testing.assert_equal(one.counts, other.counts)
    with pytest.raises(InvalidEventError, match="of none of the 1 events, but of 'a', 'b'"):
        with_judgments([EVENTS[2]], study)


def test_accuracy_is_of_each_participant_then_averaged(tmp_path: Path) -> None:
    """p01 has 3 of 4 goals, p02 all of 1; the four and one answers do not count alike."""
    text = STUDY.replace(f"{TO_GREEN},{AWAY_FROM_RED}", f"{BLUE_TO_RED},{BLUE_TO_RED}")
    found = load_judgments(write(tmp_path, text)).accuracy(EVENTS)
    assert found["n_participants"] == 3
    assert found["goal_accuracy"]["value"] == pytest.approx((3 / 4 + 1) / 2)
    assert found["relation_accuracy"]["value"] == pytest.approx((1 + 1 + 0) / 3)
    assert found["by_scenario"]["collaborative"]["goal_accuracy"]["value"] == 1
    competing = found["by_scenario"]["competing"]
    assert competing["goal_accuracy"] == {"value": 0.5, "ci_low": None, "ci_high": None}
    assert competing["n"] == 1
    assert found["by_scenario"]["opposing"]["relation_accuracy"] is None
    # two participants say little of others (p03 named no goal)
    assert found["goal_accuracy"]["ci_low"] < 0.5
    assert found["goal_accuracy"]["ci_high"] == pytest.approx(1)


def test_a_table_that_was_written_is_read_back(tmp_path: Path) -> None:
    rows = [["p1", "a", 70, 20, 10, 80], ["p2", "a", 50, None, 50, 60], ["p1", "b", 0, 0, 80, 90]]
    table = pd.DataFrame(rows, columns=[*SLIDERS.split(","), "confidence"])
    study = load_judgments(table, EVENTS, graded="softmax", temperature=20)
    study.table.to_csv(tmp_path / "kept.csv", index=False)
    again = load_judgments(tmp_path / "kept.csv", EVENTS)
    for name, judgments in study.judgments.items():
        np.testing.assert_allclose(
            again.judgments[name].counts["relation"], judgments.counts["relation"]
        )
    assert again.table["confidence"].tolist() == study.table["confidence"].tolist()


def test_a_label_without_a_number_beside_ratings_is_no_choice() -> None:
    rows = [
        ["p1", "a", "relation", "friendly", 60],
        ["p1", "a", "relation", "neutral", 20],
        ["p1", "a", "relation", "adversarial", None],
        ["p2", "a", "relation", "neutral", None],
    ]
    columns = ["participant", "video", "question", "answer", "value"]
    study = load_judgments(pd.DataFrame(rows, columns=columns), EVENTS)
    assert study.judgments["a"].counts["relation"] == pytest.approx([0.75, 1.25, 0])
    assert "1 of graded answers, without a number" in study.summary


def test_columns_of_one_video_are_about_it_alone() -> None:
    row = {"participant": "p", "a_relation": "friendly", "b__relation": "neutral"}
    row |= {"a_confidence": 10, "b_confidence": 90, "b_rt": 7}
    for events in (EVENTS, None):
        table = load_judgments(pd.DataFrame([row]), events).table.set_index("event")
        assert table["confidence"].to_dict() == {"a": 10, "b": 90}
        assert table["response_time"].tolist() == pytest.approx([math.nan, 7], nan_ok=True)


def test_shares_that_are_none_are_refused() -> None:
    for shares in ({"friendly": math.nan, "neutral": 1}, {"friendly": 1.5, "neutral": -0.5},
                   {"friendly": "1"}):  # fmt: skip
        with pytest.raises(InvalidEventError, match=r"relation has the share .* of friendly"):
            Judgments.of_responses({"p": {"relation": shares}})


PAGE = Path(__file__).parents[2] / "docs" / "judgments.md"


def test_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def example(language: str) -> str:
        # the first; another one needs the public study's files
        block, *_ = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
        return str(block)

    monkeypatch.chdir(tmp_path)
    write(tmp_path, example("csv"))
    ppl.save_events([ppl.load_event("collaborate"), ppl.load_event("oppose")], "videos.json")
    names: dict[str, Any] = {}
    exec(compile(example("py"), str(PAGE), "exec"), names)
    accuracy = names["study"].accuracy(names["events"])
    assert accuracy["goal_accuracy"]["value"] == 1
    assert len(names["events"][0].judgments["responses"]) == 2
    judgments = Judgments.from_record(json.loads(example("json")))
    assert set(judgments.responses) == {"p01", "p02"}


def test_votes_on_the_film_without_names_stand_beside_names_at_moments() -> None:
    said = [{"participant": who, "at": 1, "relation": "friendly"} for who in ("a", "b")]
    record = {"counts": {"relation": {"neutral": 3}}, "responses": said}
    found = Judgments.from_record(record)
    assert found.counts["relation"].tolist() == [0, 3, 0]
    assert not found.responses
    assert found.moments[1].counts["relation"].tolist() == [2, 0, 0]
    assert Judgments.from_record(found.to_record()).to_record() == found.to_record()
    with pytest.raises(InvalidEventError, match="counts of relation contradict the responses"):
        Judgments.from_record({**record, "responses": [*said, *ONE["responses"]]})


def test_record_of_nobody_is_none() -> None:
    nobody = {"relation_counts": {"friendly": 0, "neutral": 0, "adversarial": 0}, "n_raters": 0}
    none = {"relation_counts": None, "n_raters": None}
    for record in ({}, nobody, none, {"responses": []}, {"majority": "friendly"}):
        assert Judgments.from_record(record) is None
    assert Judgments.of(make_event("a")) is None


ONE = {"responses": [{"participant": "a", "relation": "friendly"}]}


BAD_VOTES: list[tuple[dict[str, Any], str]] = [
    ({"relation_count": {"friendly": 3}}, "has .'relation_count'., expected one of"),
    ({"relation_counts": {"friendly": -1}}, "relation_counts.*Expected 'int' >= 0"),
    ({"relation_counts": {"friendly": 10**12}}, "relation_counts.*<= 999999999"),
    ({"relation_counts": {"freindly": 1}}, "unknown relation 'freindly'; did you mean"),
    ({"goal_counts": {"blue agent": {}}}, "unknown agent in goal_counts 'blue agent'"),
    ({"responses": {}}, "responses: Expected 'array"),
    ({"responses": [{"relation": "friendly"}]}, "responses.0. has the participant ''"),
    ({"responses": [{"participant": "a", "mood": "x"}]}, "unknown question 'mood'"),
    ({"responses": [{"participant": "a"}] * 2}, "names the participant 'a' twice"),
    ({**ONE, "relation_counts": {"neutral": 1}}, "counts of relation contradict the responses"),
]


def test_bad_votes_are_refused_and_the_event_is_named() -> None:
    for record, message in BAD_VOTES:
        event = dataclasses.replace(make_event("film 7"), judgments=record)
        with pytest.raises(PhasePPLError, match=f"event film 7: judgments: .*{message}"):
            Judgments.of(event)
