"""Small studies, and somebody who takes part in one."""

from __future__ import annotations

import atexit
import csv
import dataclasses
import functools
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

import phase_ppl as ppl
from phase_ppl.study.clips import clip_names
from phase_ppl.study.study import Study

HOST = "http://localhost"
EVENTS = ("collaborate", "compete", "independent")


def short_events(n: int = 3) -> list[ppl.Event]:
    """Bundled events of a few frames, at most three."""
    events = [ppl.load_event(name) for name in EVENTS[:n]]
    begins = [ppl.Observation(event.observation.trajectory[:4]) for event in events]
    return [dataclasses.replace(e, observation=o) for e, o in zip(events, begins, strict=True)]


def empty_clips(folder: Path, world: ppl.World = ppl.worlds.PHASE) -> None:
    """Stand for the films of the introduction."""
    folder.mkdir()
    for name in clip_names(world):
        (folder / f"{name}.mp4").touch()


@functools.cache
def _made(kind: str) -> Path:
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phase_ppl.study.study.make_clips", empty_clips)
        Study.new(folder / "study", short_events(), kind, workers=1, progress=False)
    return folder / "study"


def make_study(folder: Path, kind: str = "judgment", **given: Any) -> Study:
    """Make a study of short events, filmed once; the films of the introduction are empty."""
    shutil.copytree(_made(kind), folder)
    return change(Study(folder), **given)


def edit(study: Study, old: str, new: str) -> Study:
    """Return a study with another text in place of one of its file's."""
    file = study.folder / "study.toml"
    text = file.read_text("utf-8")
    assert old in text
    file.write_text(text.replace(old, new), "utf-8")
    return Study(study.folder)


def change(study: Study, **given: Any) -> Study:
    """Return a study with other settings, lines of which take the place of those in its file."""
    file = study.folder / "study.toml"
    lines = file.read_text("utf-8").splitlines()
    for name, value in given.items():
        shown = str(value).lower() if isinstance(value, bool) else repr(value)
        at = next((i for i, line in enumerate(lines) if line.startswith(f"{name} =")), None)
        if at is None:
            lines.insert(0, f"{name} = {shown}")
        else:
            lines[at] = f"{name} = {shown}"
    file.write_text("\n".join(lines), "utf-8")
    return Study(study.folder)


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


class Person:
    """Somebody at a browser of their own."""

    def __init__(self, client: TestClient, enter: bool = True) -> None:
        self.client = client
        self.cookie = ""
        if enter:
            self.enter()

    def enter(self, **body: Any) -> Any:
        reply = self.post("/api/enter", body)
        self.cookie = reply.headers.get("set-cookie", "").partition(";")[0] or self.cookie
        return reply

    def headers(self, **more: str) -> dict[str, str]:
        self.client.cookies.clear()
        return {"Origin": HOST, **({"Cookie": self.cookie} if self.cookie else {}), **more}

    def post(self, path: str, body: Any, **headers: str) -> Any:
        return self.client.post(path, json=body, headers=self.headers(**headers))

    def get(self, path: str, **headers: str) -> Any:
        return self.client.get(path, headers=self.headers(**headers))

    def state(self) -> Any:
        return self.get("/api/state").json()

    def answer(self, page: str, answers: Mapping[str, Any], attempt: int = 1, **more: Any) -> Any:
        body = {"page": page, "attempt": attempt, "answers": answers, "rt_ms": 2000.0, **more}
        return self.post("/api/answer", body)

    def prepare(self, study: Study, right: bool = True) -> None:
        """Agree, read the introduction, answer the quiz, ask what comes next."""
        self.answer("consent", {"agree": True})
        self.answer("device", {})
        self.answer("tutorial", {"views": [1000.0]})
        self.answer("quiz", quiz(study, right))
        self.state()

    def finish(self, study: Study, given: Mapping[str, Any] | None = None) -> list[str]:
        """Go through a study; return the addresses of the films, in the order seen."""
        self.prepare(study)
        films = []
        for page in self.state()["pages"]:
            films.append(page.get("video"))
            is_person = page["page"] == "person"
            self.answer(page["page"], {"age": 30, "gender": ""} if is_person else given or JUDGED)
        return [film for film in films if film]


JUDGED = {
    "goal_red": "Get blue item to red lm",
    "goal_green": "get away from red agent",
    "relation": "neutral",
}


def quiz(study: Study, right: bool = True) -> dict[str, str]:
    """Answers to the quiz; one of them wrong, unless all are to be right."""
    given = {f"question_{n}": a for n, (_, _, a) in enumerate(study.settings.quiz, 1)}
    if not right:
        _, options, answer = study.settings.quiz[0]
        given["question_1"] = next(option for option in options if option != answer)
    return given
