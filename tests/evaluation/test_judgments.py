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
import pytest

import phase_ppl as ppl
from phase_ppl.evaluation.judgments import load_judgments, with_judgments
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.world.errors import InvalidEventError, PhasePPLError, UnknownNameError
from phase_ppl.world.goals import GOALS
from tests.evaluation.judged import (
    AWAY_FROM_RED,
    BLUE_TO_GREEN,
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
    assert study.participants == ("p01", "p02", "p03")
    assert list(study.table.columns) == HEADER.split(",")
    first = ["p01", "a", BLUE_TO_RED, BLUE_TO_RED, "friendly", 12.4]
    assert study.table.loc[0].tolist() == first
    assert study.table.loc[2, "goal_green"] is None
    assert math.isnan(study.table.loc[2, "response_time"])
    judgments = study.judgments["a"]
    assert judgments.n_raters == 3
    assert judgments.counts["relation"].tolist() == [2, 1, 0]
    assert judgments.distribution("relation") == pytest.approx([2 / 3, 1 / 3, 0])
    # two of three said what red wants, one what green wants
    red = judgments.distribution("goal_red")
    assert red.shape == (36,)
    assert red[GOALS.index(BLUE_TO_RED)] == 1
    assert judgments.share("goal_green", BLUE_TO_RED) == 1
    assert judgments.share("goal_green", BLUE_TO_GREEN) == 0
    assert judgments.majority("relation") == "friendly"


def test_relations_alone_are_a_study(tmp_path: Path) -> None:
    file = write(tmp_path, "video,relation,participant\na,friendly,p\n")
    judgments = load_judgments(file).judgments["a"]
    assert list(judgments.counts) == ["relation"]
    assert judgments.distribution("goal_red") is None
    assert judgments.majority("goal_red") is None


CHANGES: list[Callable[[str], str]] = [
    lambda text: "\ufeff" + text,
    lambda text: text.replace("\n", "\r\n"),
    lambda text: text.replace("\n", "\r"),
    lambda text: text.replace("\n", "\n\n") + ",,,,,\n",
    lambda text: text.replace(",", " , "),
    lambda text: text.replace("friendly", "Friendly").replace("Get", "get"),
    lambda text: text.replace("p01", '"p01"').rstrip(),
]


def test_what_spreadsheets_make_of_it_is_read_alike(tmp_path: Path) -> None:
    expected = load_judgments(write(tmp_path, STUDY)).table
    for change in CHANGES:
        assert load_judgments(write(tmp_path, change(STUDY))).table.equals(expected)


ROW = f"p01,a,{BLUE_TO_RED},{BLUE_TO_RED},friendly,12.4"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "study.csv: is empty"),
        (HEADER, "study.csv: holds no judgments"),
        (HEADER.replace(",", ";"), "line 1: is 'participant;video.*separated by commas"),
        (HEADER.replace("goal_red", "goal_rde"), "line 1: unknown column.*'goal_red'"),
        (HEADER.replace("goal_red", "video"), "line 1: names the column video twice"),
        (HEADER.replace("participant,", ""), "line 1: names no column participant"),
        (
            f"{HEADER}\n{ROW}\np02,a,,Get blu item to red lm,,",
            "line 3: goal_green: unknown goal.*did you mean 'Get blue item to red lm'",
        ),
        ("participant,video,response_time", "line 1: names none of the columns goal_red"),
        (f"{HEADER}\n{ROW}\n{ROW}", "line 3: has participant 'p01', video 'a' a second time"),
        (f"{HEADER}\n{ROW}\np02,a,,,friendly", "line 3: has 5 cells, expected 6"),
        (f"{HEADER}\np\x1b[2J,a,,,friendly,", "line 2: participant is 'p.*printable"),
        *(
            (f"{HEADER}\np01,a,,,friendly,{time}", f"line 2: response_time is '{time}', expected")
            for time in ("-1", "soon", "1e999", "1_0")
        ),
        (f'{HEADER}\n\n{ROW}\np02,a,,,"friendly,\n', "line 4: is no CSV: unexpected end of data"),
        (f"{HEADER}\n{'x' * 200_000},a,,,friendly,", "line 2: is no CSV: field larger than"),
        (b"PK\x03\x04\x00\x00", "is no CSV file in UTF-8: it holds zero bytes"),
        (b"\x80\x04\x95\x10", "is no CSV file in UTF-8"),
        # cells with lines of their own
        (f'{HEADER}\n"p01",a,,,"friend\nly",', r"line 2: relation: unknown .* 'friend\\nly'"),
        (
            f'{HEADER}\np01,a,"Get blue item\nto red lm",,,\np02,a,,,foe,',
            "line 4: relation: unknown relation 'foe'",
        ),
        (HEADER.encode() + b"\np\xe4,a,,,friendly,", "is no CSV file in UTF-8"),
    ],
)
def test_bad_file_is_refused_with_its_line(
    tmp_path: Path, content: str | bytes, message: str
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(PhasePPLError, match=message) as caught:
        load_judgments(path)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < len(str(path)) + 250


@pytest.mark.parametrize(
    ("content", "messages"),
    [
        (
            "participant,video,relation,goal_rde,\n",
            ["line 1: unknown column 'goal_rde'", "; has a column without a name"],
        ),
        (
            f"{HEADER}\n{ROW}\np02,a,NA,,foe,soon\n{ROW}\n{ROW}",
            [
                "line 3: goal_red: NA, expected an empty cell",
                "; relation: unknown relation 'foe'",
                "; response_time is 'soon'",
                "; line 4: has participant 'p01', video 'a' a second time",
                "; line 5: has",
            ],
        ),
        ("\n".join([HEADER, *(f"p{k},a,,,foe," for k in range(11))]), ["line 9: ", "and 3 more"]),
    ],
)
def test_all_that_is_wrong_with_a_file_is_said_at_once(
    tmp_path: Path, content: str, messages: list[str]
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(PhasePPLError) as caught:
        load_judgments(path)
    said = str(caught.value)
    assert said.startswith(f"{path}, line ")
    assert "\n" not in said
    assert [message for message in messages if message not in said] == []


def test_what_is_no_file_or_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phase_ppl.data.documents.MAX_BYTES", 100)
    for path, message in (
        (tmp_path / "none.csv", "no such file"),
        (tmp_path, "the folder holds no raters' files"),
        (write(tmp_path, STUDY), "is larger than"),
    ):
        with pytest.raises(InvalidEventError, match=message):
            load_judgments(path)


def test_unknown_video_is_refused_where_events_are_given(tmp_path: Path) -> None:
    events = [make_event("aa"), make_event("b")]
    path = write(tmp_path, STUDY)
    with pytest.raises(UnknownNameError, match="line 2: unknown video 'a'; did you mean 'aa'"):
        load_judgments(path, events)
    assert set(load_judgments(path).judgments) == {"a", "b"}


# --- studies and events ------------------------------------------------------------------------


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
        assert (one.n_raters, one.responses) == (other.n_raters, other.responses)
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


PAGE = Path(__file__).parents[2] / "docs" / "judgments.md"


def test_examples_of_the_page_run_as_they_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert names["events"][0].judgments["n_raters"] == 2
    judgments = Judgments.from_record(json.loads(example("json")))
    assert set(judgments.responses) == {"p01", "p02"}


# --- votes in event files ----------------------------------------------------------------------


def test_counts_of_the_published_videos_are_read() -> None:
    counts = {"friendly": 1, "neutral": 2, "adversarial": 9}
    others = {"majority": "adversarial", "majority_is_tie": False}
    judgments = Judgments.from_record({"relation_counts": counts, "n_raters": 12, **others})
    assert judgments.n_raters == 12
    assert judgments.distribution("relation") == pytest.approx([1 / 12, 2 / 12, 9 / 12])
    assert not judgments.responses


def test_record_of_nobody_is_none() -> None:
    nobody = {"relation_counts": {"friendly": 0, "neutral": 0, "adversarial": 0}, "n_raters": 0}
    none = {"relation_counts": None, "n_raters": None}
    for record in ({}, nobody, none, {"responses": []}, {"majority": "friendly"}):
        assert Judgments.from_record(record) is None
    assert Judgments.of(make_event("a")) is None


ONE = {"responses": [{"participant": "a", "relation": "friendly"}]}


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"relation_count": {"friendly": 3}}, "has .'relation_count'., expected one of"),
        ({"relation_counts": {"friendly": -1}}, "relation_counts.*Expected 'int' >= 0"),
        ({"relation_counts": {"friendly": True}}, "relation_counts.*got 'bool'"),
        ({"relation_counts": {"friendly": 10**12}}, "relation_counts.*<= 999999999"),
        ({"relation_counts": {"freindly": 1}}, "unknown relation 'freindly'; did you mean"),
        (
            {"relation_counts": {"friendly": 3}, "n_raters": 2},
            "n_raters is 2, .* 3 votes on",
        ),
        ({"relation_counts": {"friendly": 3}, "n_raters": 5}, "n_raters is 5, .* 3 in all"),
        ({"n_raters": 4}, "n_raters is 4, .* 0 in all"),
        ({"goal_counts": {"blue agent": {}}}, "unknown agent in goal_counts 'blue agent'"),
        ({"goal_counts": 3}, "goal_counts: Expected 'object"),
        ({"responses": {}}, "responses: Expected 'array"),
        ({"responses": [{"relation": "friendly"}]}, "responses.0. has the participant ''"),
        ({"responses": [{"participant": "a", "mood": "x"}]}, "unknown question 'mood'"),
        ({"responses": [{"participant": "a"}] * 2}, "names the participant 'a' twice"),
        ({**ONE, "relation_counts": {"neutral": 1}}, "counts of relation contradict the responses"),
        (
            {**ONE, "goal_counts": {"red agent": {BLUE_TO_RED: 1}}},
            "the counts of goal_red contradict the responses",
        ),
    ],
)
def test_bad_votes_are_refused_and_the_event_is_named(record: dict[str, Any], message: str) -> None:
    event = dataclasses.replace(make_event("film 7"), judgments=record)
    with pytest.raises(PhasePPLError, match=f"event film 7: judgments: .*{message}"):
        Judgments.of(event)
