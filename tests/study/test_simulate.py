"""Scripted people, pairs of played and generated events, and the command line."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("uvicorn", reason="the extra 'study' is not installed")

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.world.errors import InvalidEventError, OutputError, PhasePPLError
from phase_study import study as study_module
from phase_study.simulate import serving, simulate
from phase_study.study import Study, counterparts
from tests.study.studies import make_study, short_events, still_events, sure_of


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return make_study(tmp_path_factory.mktemp("made") / "study")


def test_some_lapse_and_some_leave(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phase_study.server.Site.allow", lambda *args: True)
    out = tmp_path / "out"
    simulate(
        study, out, 12, predictions=sure_of(study), lapse=0.4, drop_outs=0.5, seed=1, progress=False
    )
    assert "| finished | 12 |" not in (out / "README.md").read_text("utf-8")
    found = ppl.load_judgments(out / "judgments.csv")
    said = found.table[found.table["question"] == "goal_red"]
    assert said["answer"].nunique() > 3


def test_stops_come_out_as_judgments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A film of 0.75 s stops once, and is judged at its end as well."""
    monkeypatch.setattr("phase_study.server.Site.allow", lambda *args: True)
    asked = make_study(tmp_path / "study", answers="sliders", moments=[0.5, 2.0])
    simulate(asked, tmp_path / "out", 4, model="last_frame", drop_outs=0.0, progress=False)
    events = list(asked.events.values())
    study = ppl.load_judgments(tmp_path / "out" / "judgments.csv", events)
    answers = study.table.drop_duplicates(["participant", "event", "question", "at"])
    assert answers["at"].isna().sum() == (answers["at"] == 0.5).sum() == len(answers) / 2 == 36
    sliders = study.table[study.table["question"] == "relation"]
    assert sliders["rating"].between(0, 100).all()
    assert sliders["rating"].nunique() > 10


def test_a_rehearsal_stays_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phase_study.server.Site.allow", lambda *args: True)
    asked = make_study(tmp_path / "study", raters=4)
    out = tmp_path / "out"
    told = simulate(asked, out, 9, predictions=sure_of(asked), drop_outs=0.0, progress=False)
    n = len((out / "participants.csv").read_text("utf-8").splitlines()) - 1
    assert n < 9
    assert f"{9 - n} of 9 were turned away: with 4 raters a video" in told
    for table in ("participants.csv", "judgments.csv", "viewings.csv"):
        _, *rows = (out / table).read_text("utf-8").splitlines()
        assert all(row.startswith("scripted-") for row in rows)
    assert "**A rehearsal: these are no people." in (out / "README.md").read_text("utf-8")
    found = ppl.load_judgments(out / "judgments.csv").table
    assert ppl.load_judgments(found.drop(columns="rehearsal")).table["rehearsal"].all(), "by name"
    names = {who: f"p{i}" for i, who in enumerate(found["participant"].unique())}
    study = ppl.load_judgments(found.replace(names))
    words = "ehearsal, which says nothing about people"
    assert words in str(study)
    found = ppl.evaluate(
        list(asked.events.values()), "majority", judgments=study, workers=1, progress=False
    )
    assert words in " ".join(str(found).splitlines()[2:4])
    compared = ppl.compare_models({"majority": found, "other": found}, resamples=200)
    compared.save(tmp_path / "compared")
    record = ppl.read_json(tmp_path / "compared" / "comparison.json")
    assert any(words in note for note in record["notes"])
    assert record["people"]["scripted"] is True
    page = ppl.report(tmp_path / "compared").read_text("utf-8")
    assert page.count(words) >= 2
    assert "scripted people" in page
    for figure in (ppl.figures.accuracy(compared), ppl.figures.people(compared)):
        assert words in " ".join(figure.get_supxlabel().split())


def test_settings_of_a_simulation_are_checked(study: Study, tmp_path: Path) -> None:
    with pytest.raises(PhasePPLError, match="lapse=2, expected a share"):
        simulate(study, tmp_path / "out", 1, lapse=2)
    with pytest.raises(PhasePPLError, match="people=0"):
        simulate(study, tmp_path / "out", 0)
    with pytest.raises(PhasePPLError, match="event in the predictions"):
        simulate(study, tmp_path / "out", 1, predictions={})
    assert not (tmp_path / "out").exists()


def test_counterparts_are_of_the_same_scene_goals_and_strengths() -> None:
    played = [ppl.load_event("collaborate"), ppl.load_event("compete")]
    other = [dataclasses.replace(event, id=f"g-{event.id}") for event in reversed(played)]
    assert [event.id for event in counterparts(played, other)] == ["g-collaborate", "g-compete"]
    renamed = counterparts(played, list(reversed(played)))
    assert [event.id for event in renamed] == ["collaborate-generated", "compete-generated"]
    with pytest.raises(InvalidEventError, match="'compete' has no counterpart"):
        counterparts(played, other[1:])
    again = [played[0], dataclasses.replace(played[0], id="again")]
    with pytest.raises(InvalidEventError, match=r"'again' has no counterpart \(any more"):
        counterparts(again, other)
    both = [other[1], dataclasses.replace(other[1], id="g-again")]
    assert [event.id for event in counterparts(again, both)] == ["g-collaborate", "g-again"]


def test_missing_counterparts_are_simulated_where_the_truth_is_known(tmp_path: Path) -> None:
    event = short_events(1)[0]
    scene = dataclasses.replace(event.scene, resets_velocity=True)
    (made,) = counterparts([dataclasses.replace(event, scene=scene)], None)
    assert made.truth == event.truth
    assert not made.scene.resets_velocity
    assert np.array_equal(made.scene.start, event.scene.start)
    assert made.observation.n_frames == event.observation.n_frames
    with pytest.raises(InvalidEventError, match="does not say its goals and strengths"):
        Study.new(tmp_path / "study", [dataclasses.replace(event, truth=None)], "likeness")


def test_without_the_extra_one_line_says_what_to_install(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(study_module, "_NEEDS", ("no_such_module",))
    made = str(study.folder)
    for command in (["demo"], ["new", str(tmp_path / "s"), "collaborate"], ["run", made]):
        assert main(["study", *command]) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        assert "pip install 'phase_ppl[study]'" in told
    assert not (tmp_path / "s").exists()


def test_commands_make_look_at_and_export_a_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study_module, "make_clips", lambda folder, world: None)
    made, file, trio = tmp_path / "made", tmp_path / "short.json", ppl.worlds.TRIO
    ppl.save_events(still_events(trio), file)
    arguments = ["--kind", "tagging", "--trials", "1", "--workers", "1", "--quiet"]
    assert main(["study", "new", str(made), str(file), *arguments]) == 0
    assert (Study(made).settings.trials, Study(made).settings.world) == (1, trio)
    assert main(["study", "status", str(made)]) == 0
    assert "entered          0" in capsys.readouterr().out
    assert main(["study", "export", str(made), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "tags.csv").read_text() == "participant,video,label\n"
    for arguments, said in (
        (["withdraw", str(made), "nobody"], "there is no participant 'nobody'"),
        (["status", str(tmp_path)], "study.toml: no such file"),
    ):
        assert main(["study", *arguments]) == 2
        assert said in capsys.readouterr().err


def test_a_port_that_is_taken_is_told(study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for options, said in (
            (f"--port {port}", f"cannot listen at 127.0.0.1, port {port}"),
            ("--host 0.0.0.0", "needs url"),
            ("--url study.example", "expected one such as https://"),
        ):
            assert main(["study", "run", str(study.folder), *options.split()]) == 2
            assert said in capsys.readouterr().err


def test_the_server_ends_when_it_is_told_to(study: Study, tmp_path: Path) -> None:
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with contextlib.ExitStack() as at_the_end:
        running = {}
        for how in (signal.SIGTERM, signal.SIGINT):
            folder = tmp_path / how.name
            shutil.copytree(study.folder, folder)
            command = f"-m phase_ppl study run {folder} --port 0".split()
            run = subprocess.Popen([sys.executable, *command], **pipes)
            running[how] = at_the_end.enter_context(run)
        for how, run in running.items():
            with urllib.request.urlopen(run.stdout.readline().split()[0]) as page:
                assert "<title>Study</title>" in page.read().decode()
            run.send_signal(how)
        for run in running.values():
            out, told = run.communicate(timeout=60)
            assert run.returncode == 0
            assert "who is responsible" in told
            assert (out + told).count("\n") == 1, "the address was read; nothing else is said"


def test_one_server_at_a_time(study: Study, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(study.folder, copy)
    with serving(Study(copy)), pytest.raises(OutputError, match="another process is at work"):
        Study(copy).run(0)
