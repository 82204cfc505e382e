"""``study.toml``: what it may say, and what is wrong with it."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import ClassVar

import pytest

import phase_ppl as ppl
from phase_ppl.world.errors import InvalidSettingError, OutputError, PhasePPLError
from phase_study.settings import KINDS, Settings, template
from phase_study.study import Study
from tests.study.studies import PHASE, edit, make_study, short_events, unseen_films

FOLDER = Path(__file__).resolve().parents[2] / "phase_study"


@pytest.mark.parametrize("kind", KINDS)
def test_the_template_is_a_study(kind: str) -> None:
    title = 'What "they" do\\ & \x7f'
    found = Settings.parse(template(kind, title, trials=7, raters=9))
    assert (found.kind, found.title) == (kind, title)
    assert {"finished", "quiz_failed"} <= set(found.codes)
    codes = [code for code in found.codes.values() if code]
    assert len(set(codes)) == len(codes)
    if kind != "play":
        assert (found.trials, found.raters) == (7, 9)
    again = Settings.parse(template(kind, title))
    assert again.codes["finished"] != found.codes["finished"]


def test_what_is_left_out_is_as_in_the_template() -> None:
    short = Settings.parse('kind = "judgment"\n[texts]\nfinished = "Bye"')
    long = Settings.parse(template("judgment", "x"))
    assert short.tries == long.tries
    assert short.quiz == long.quiz
    assert short.texts["consent"] == long.texts["consent"]
    assert short.texts["finished"] == "Bye"


MISTAKES = [
    ("trails = 3", "unknown setting 'trails'; did you mean 'trials'"),
    ("trials = 0", "trials is 0, expected a whole number >= 1"),
    ('trials = "3"', "trials is '3', expected a whole number"),
    ("open = 1", "open is 1, expected true or false"),
    ("trials = ", "line 2"),
    ("[texts]\nconcent = 'x'", "'concent'; did you mean 'consent'"),
    ("[texts]\nconsent = 3", "consent in .texts. is 3, expected text"),
    ("[[quiz]]\nquestion = 'q'\noptions = ['a', 'b']\nanswer = 'c'", "unknown answer in"),
    ("[[quiz]]\nquestion = 'q'\noptions = ['a']\nanswer = 'a'", "two or more"),
    ("[[quiz]]\nquestion = 'q'", "options in .* number 1 is None, expected a list"),
    ("quiz = [3]", "number 1 is 3, expected a table"),
    ("[[tutorial]]\ntext = 'x'\nclip = 'jumping'", "unknown clip in .* 'jumping'"),
    ("[checks]\nx = 'friendly'", "x is 'friendly', expected relations"),
    ("[checks]\nx = ['hostile']", "unknown relation 'hostile'"),
]
OF_PLAY = [
    *((f"{name} = {n}", f"{name} in .play. is {n}, expected") for name, n in
      (("steps_per_second", 0), ("steps_per_second", 60), ("rooms", 1000))),
    ("view = 'some'", "unknown view in .play. 'some'"),
    ("partner = 'robot'", "unknown partner in .play. 'robot'"),
]  # fmt: skip
OF_TRIO = [
    ("[[tutorial]]\ntext = 'x'\nclip = 'carrying'", "unknown clip in .* 'carrying'.*moving"),
    ("[checks]\nx = ['friendly']", "x is .*, expected a table of questions"),
    ("[checks]\nx = {relation_red_green = 'friendly'}", "expected a table of questions"),
    ("[checks]\nx = {}", "expected a table of questions"),
    ("[checks]\nx = {relation = ['friendly']}", "unknown question 'relation'"),
    ("[checks]\nx = {goal_red = ['get to red lm']}", "unknown goal 'get to red lm'"),
]


def test_mistakes_are_named_in_the_worlds_words(tmp_path: Path) -> None:
    cases = [
        ('kind = "judgement"', "unknown kind 'judgement'; did you mean 'judgment'", PHASE),
        *((f'kind = "judgment"\n{line}', message, PHASE) for line, message in MISTAKES),
        *((f'kind = "play"\n[play]\n{line}', message, PHASE) for line, message in OF_PLAY),
        *((f'kind = "judgment"\n{line}', message, ppl.worlds.TRIO) for line, message in OF_TRIO),
    ]
    file = tmp_path / "study.toml"
    for text, message, world in cases:
        file.write_text(f"{text}\n", "utf-8")
        with pytest.raises(PhasePPLError, match=f"study.toml: .*{message}"):
            Settings.read(file, world)


def test_settings_are_of_the_study_that_they_lie_in(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study")
    with pytest.raises(PhasePPLError, match=r"unknown video in \[checks\] 'none'"):
        edit(study, "[checks]", "[checks]\nnone = ['friendly']")
    (study.folder / "study.toml").write_text(template("tagging", "x"))
    with pytest.raises(InvalidSettingError, match="is one of judgment"):
        Study(study.folder)


def test_a_study_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputError, match="not empty"):
        Study.new(tmp_path, short_events())
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]


def test_copies_in_a_set_are_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Generated(list[ppl.Event]):
        entries: ClassVar = [{"id": "collaborate", "group": "a"}, {"id": "compete", "group": "b"},
                             {"id": "independent", "group": "a"}]  # fmt: skip

    monkeypatch.setattr(ppl, "GeneratedEvents", Generated)
    monkeypatch.setattr("phase_study.study.make_clips", lambda folder, world: None)
    monkeypatch.setattr("phase_ppl.render.videos", unseen_films)
    study = Study.new(tmp_path / "study", Generated(short_events()), workers=1, progress=False)
    with study.store() as store:
        assert [s.copies for s in store.stimuli().values()] == ["a", None, "a"]
    assert study.settings.trials == 2, "one of each copy is all that a person can see"


def test_missing_and_changed_films_are_found_before_people_come(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study")
    assert any("who is responsible" in note for note in study.check())
    film = next((study.folder / "videos").iterdir())
    film.write_bytes(b"another film")
    with pytest.raises(PhasePPLError, match=f"{film.name}.*changed"):
        study.run(0)
    film.unlink()
    with pytest.raises(PhasePPLError, match=f"{film.name}.*missing"):
        study.run(0)


@pytest.mark.parametrize("where", [FOLDER / "static" / "vendor", Path(__file__).parent / "vendor"])
def test_scripts_of_others_are_those_that_their_list_says(where: Path) -> None:
    listed = [line.split("  ") for line in (where / "VERSIONS").read_text().splitlines()]
    assert {name for _, name, _ in listed} == {
        file.name for file in where.iterdir() if file.suffix in (".js", ".css")
    }
    for digest, name, package in listed:
        assert hashlib.sha256((where / name).read_bytes()).hexdigest() == digest
        assert package in (FOLDER / "vendor.sh").read_text()
    assert re.search("Permission is hereby granted|Mozilla", (where / "LICENSE").read_text())
