"""Small studies, and somebody who takes part in one."""

from __future__ import annotations

import atexit
import csv
import dataclasses
import functools
import json
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

import phase_ppl as ppl
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.table import true_answers
from phase_ppl.physics.actions import Action
from phase_ppl.world.hypothesis import Hypothesis
from phase_study.clips import CLIPS, Clip, clips_of
from phase_study.study import Study

HOST = "http://localhost"
EVENTS = ("collaborate", "compete", "independent")
PHASE = ppl.worlds.PHASE
NURSERY = ppl.World(
    ["red agent", "Anna"], ["ball"], {"cot": (4, 4), "window": (20, 16)}, arena=(0, 24, 0, 20),
    predicates=[ppl.Predicate("agents near", "red agent", "Anna", within=6),
                ppl.Predicate("get cosy", "ball", "cot", within=3)],
    name="nursery",
)  # fmt: skip
EMPTY = ppl.World(["Bo", "Mia"], [], {"home": (4, 4)}, arena=(0, 12, 0, 12), name="empty")
GOALS = {
    "solo": {"red agent": "ball to home"},
    "trio": {"red agent": "get to green agent", "green agent": "blue ball to home",
             "purple agent": "get to blue ball"},
    "nursery": {"red agent": "agents near", "Anna": "not get cosy"},
}  # fmt: skip
JUDGED = {
    "goal_red": "Get blue item to red lm",
    "goal_green": "get away from red agent",
    "relation": "neutral",
}


STILL = Clip(CLIPS["moving"].start, [(Action.NO_FORCE, 1)], [(Action.NO_FORCE, 1)])


def short_events(n: int = 3) -> list[ppl.Event]:
    """Bundled events of a few frames, at most three."""
    events = [ppl.load_event(name) for name in EVENTS[:n]]
    begins = [ppl.Observation(event.observation.trajectory[:4]) for event in events]
    return [dataclasses.replace(e, observation=o) for e, o in zip(events, begins, strict=True)]


def still_events(world: ppl.World, n: int = 2) -> list[ppl.Event]:
    """Events in which nobody moves, and what the agents would be after."""
    found = []
    for seed in range(n):
        scene = world.random_scene(seed)
        hinders = {("purple agent", "green agent"): "hinder"} if world is ppl.worlds.TRIO else None
        roles = Hypothesis.of(world, GOALS[world.name], hinders)
        track = ppl.Observation(np.repeat(scene.start[None], 4, axis=0))
        found.append(ppl.Event(scene, track, id=f"{world.name}-{seed}", truth=roles))
    return found


def sure_of(study: Study) -> dict[str, Prediction]:
    """What somebody believes who knows the truth."""
    world = study.settings.world
    return {
        name: Prediction(name, answers=true_answers(event), world=world)
        for name, event in study.events.items()
    }


def empty_clips(folder: Path, world: ppl.World = PHASE) -> None:
    folder.mkdir()
    for name in clips_of(world):
        (folder / f"{name}.mp4").touch()


def unseen_films(events: Sequence[ppl.Event], folder: Path, **_: Any) -> list[Path]:
    """Stand for films: files that are all different, and begin as MP4 does."""
    folder.mkdir()
    films = [folder / f"{event.id}.mp4" for event in events]
    for film in films:
        film.write_bytes(b"\0\0\0\x18ftyp" + film.name.encode())
    return films


@functools.cache
def _made(kind: str, world: ppl.World, filmed: bool) -> Path:
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    events = short_events() if world is PHASE else still_events(world)
    generated = events[::-1] if kind == "likeness" and world is PHASE else None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phase_study.study.make_clips", empty_clips)
        if not filmed:
            patch.setattr("phase_ppl.render.videos", unseen_films)
        given: Any = {"generated": generated, "workers": 1, "progress": False}
        Study.new(folder / "study", events, kind, **given)
    return folder / "study"


def make_study(
    folder: Path, kind: str = "judgment", world: ppl.World = PHASE, *, filmed: bool = False,
    **given: Any,
) -> Study:  # fmt: skip
    """Make a study of short events, perhaps with their films; those of the introduction are empty.

    It has other settings than the template where they are given.
    """
    shutil.copytree(_made(kind, world, filmed), folder)
    return change(folder, **given)


def edit(study: Study, old: str, new: str) -> Study:
    """Return a study with another text in place of one of its file's."""
    file = study.folder / "study.toml"
    text = file.read_text("utf-8")
    assert old in text
    file.write_text(text.replace(old, new), "utf-8")
    return Study(study.folder)


def change(folder: Path, **given: Any) -> Study:
    """Return a study with other settings, in place of those in its file or before them."""
    file = folder / "study.toml"
    text = file.read_text("utf-8")
    for name, value in given.items():
        line = f"{name} = {json.dumps(value)}"
        text, known = re.subn(rf"(?m)^{name} = .*$", line, text)
        text = text if known else f"{line}\n{text}"
    file.write_text(text, "utf-8")
    return Study(folder)


def table(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def rows(study: Study, query: str) -> list[dict[str, Any]]:
    """Return what is in the database of a study."""
    with study.store() as store:
        return store.rows(query)


def serving(study: Study, url: str = "") -> TestClient:
    return TestClient(study.app(url), base_url=HOST)


class Person:
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
        """Agree, read the introduction, answer the quiz if there is one, ask what comes next."""
        self.answer("consent", {"agree": True})
        self.answer("device", {})
        self.answer("tutorial", {"views": [1000.0]})
        if study.settings.quiz:
            self.answer("quiz", quiz(study, right))
        self.state()

    def finish(self, study: Study, given: Mapping[str, Any] = JUDGED) -> None:
        """Go through a study, giving the same answers throughout."""
        self.prepare(study)
        for page in self.state()["pages"]:
            is_person = page["page"] == "person"
            self.answer(page["page"], {"age": 30, "gender": ""} if is_person else given)


def quiz(study: Study, right: bool = True) -> dict[str, str]:
    """Answers to the quiz; one of them wrong, unless all are to be right."""
    given = {f"question_{n}": a for n, (_, _, a) in enumerate(study.settings.quiz, 1)}
    if not right:
        _, options, answer = study.settings.quiz[0]
        given["question_1"] = next(option for option in options if option != answer)
    return given
