"""Raters' files of a public study of PHASE, made from their answers as they were recounted."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Mapping
from pathlib import Path

import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import InvalidEventError, PhasePPLError
from phase_ppl.world.hypothesis import RELATIONS
from tests.evaluation.judged import COLLABORATIVE, COMPETING, make_event
from tests.world.examples import DEV, needs_dev

CHECKS = {
    "friendly": "['LMO', 0, 2, 1]_['LMO', 0, 2, 1]",
    "neutral": "['LMO', 0, 2, 1]_['LMO', 1, 1, 1]",
    "adversarial": "['TE', 0, 1, 1]_['TE', 0, 1, -1]",
}
"""Relation -> goals, as names of films have them."""

ID = "D082020_18175{:02}_E8"
"""Of made-up videos, with stamps of 7 digits; ``ID_8`` has 8."""

ID_8 = "D082020_181759{:02}_E8.3"


def film(id: str, goals: str = CHECKS["neutral"]) -> str:
    stamp, place = id.rsplit("_", 1)
    return f"{stamp}_0_F8_{place}_G{goals}_ST3_0_L39.mp4"


def lines_of(answers: Mapping[str, str], wrong: str = "", american: bool = False) -> list[str]:
    """Return a file's lines: about the person, the checks, and answers to twenty videos."""
    checks = {
        film(ID.format(90 + i), goals).replace(".mp4", "_mm.mp4"): (
            "neutral" if right == wrong else right
        )
        for i, (right, goals) in enumerate(CHECKS.items())
    }
    others = (ID_8.format(n) for n in range(10, 40))
    unseen = {film(id): "friendly" for id in itertools.islice(others, 20 - len(answers))}
    lines = [json.dumps([["age", "33"], ["gender", "f"], ["ethnicity", "none of them"]])]
    said = {**checks, **{film(id): relation for id, relation in answers.items()}, **unseen}
    for n, (name, relation) in enumerate(said.items()):
        line = {
            "video_name": name,
            "time": f"{'9/16' if american else '16/9'}/2021 @ 14:{n}:5",
            "subjectID": "5d6f",
            "csv_name": "list_3.csv",
            "question_name": "relation",
            "likert_response": relation,
        }
        lines.append(json.dumps(list(line.items())))
    return lines


def write(folder: Path, name: str, lines: list[str]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@needs_dev
def test_files_of_the_raters_give_the_counts_that_were_made_of_them(tmp_path: Path) -> None:
    answers: dict[str, dict[str, str]] = {}
    with (DEV.parent / "raters.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            answers.setdefault(row["participant"], {})[row["video"]] = row["relation"]
    folder = tmp_path / "responses"
    for n, (rater, given) in enumerate(answers.items()):
        write(folder, f"{rater}.txt", lines_of(given, american=n % 2 == 0))
    some = next(iter(answers.values()))
    write(folder, "left.txt", lines_of(some)[:-1])
    write(folder, "restarted.txt", [*lines_of(some), lines_of(some)[-1]])
    write(folder, "asleep.txt", lines_of(some, wrong="adversarial"))
    events = ppl.load_events(DEV)
    study = ppl.load_judgments(folder, events)
    assert str(study).splitlines() == [
        "50 events, 67 participants, 685 answers (relation 685)",
        "67 of 70 raters' files kept, 2 incomplete, 1 with a wrong attention check",
    ]
    assert study.table["participant"].nunique() == 67
    for event in events:
        counted = (event.judgments or {})["relation_counts"]
        found = study.judgments[event.id].counts["relation"].tolist()
        assert dict(zip(RELATIONS, found, strict=True)) == counted


EVENTS = [make_event(ID.format(1), COLLABORATIVE), make_event(ID_8.format(1), COMPETING)]
SAID = {EVENTS[0].id: "friendly", EVENTS[1].id: "adversarial"}


def test_nothing_about_the_person_is_kept(tmp_path: Path) -> None:
    folder = write(tmp_path / "responses", "5d6f_2021-09-16.txt", lines_of(SAID))
    study = ppl.load_judgments(folder, EVENTS)
    assert set(study.table["participant"]) == {"rater-1"}
    kept = study.table.to_csv() + repr(study) + str(ppl.with_judgments(EVENTS, study))
    for personal in ("33", "none of them", "5d6f", "ethnicity"):
        assert personal not in kept
    lines = ["[personal, and no JSON", *lines_of(SAID)[1:]]
    study = ppl.load_judgments(write(folder, "5d6f_2021-09-16.txt", lines), EVENTS)
    assert study.table["answer"].tolist() == ["friendly", "adversarial"]


def test_a_file_with_a_wrong_check_is_left_out(tmp_path: Path) -> None:
    lines = lines_of(SAID, wrong="adversarial")
    path = write(tmp_path / "responses", "a.txt", lines)
    with pytest.raises(InvalidEventError, match=r"0 of 1 raters' files kept, 1 with a wrong att"):
        ppl.load_judgments(path, EVENTS)


def test_what_is_no_raters_file_is_named(tmp_path: Path) -> None:
    good = lines_of(SAID)
    for line, message in {
        "{": "is no JSON list of [key, value] pairs",
        "[1, 2]": "is no JSON list of [key, value] pairs",
        "[" * 100_000: "is no JSON list of [key, value] pairs",
        '[["video_name", "x.mp4"]]': "likert_response is None, expected a string",
        '[["video_name", 7], ["likert_response", "neutral"]]': "is no JSON list",
        good[4].replace('"friendly"', '"nice"'): "unknown relation 'nice'",
    }.items():
        folder = write(tmp_path / "responses", "a.txt", [*good[:4], line, *good[5:]])
        with pytest.raises(PhasePPLError) as raised:
            ppl.load_judgments(folder, EVENTS)
        assert str(raised.value).startswith(f"{folder / 'a.txt'}, line 5: {message}")
    write(folder, "a.txt", ["[" + "x" * 2**20])
    with pytest.raises(InvalidEventError, match=r"a.txt: is larger than the 1 MB"):
        ppl.load_judgments(folder, EVENTS)
    (folder / "a.txt").unlink()
    with pytest.raises(InvalidEventError, match=r"responses: the folder holds no raters' files"):
        ppl.load_judgments(folder, EVENTS)
    with pytest.raises(InvalidEventError, match="holds no judgments of these events"):
        ppl.load_judgments(write(folder, "a.txt", good), [make_event("other", COMPETING)])
