"""Scripted participants, for planning: they go through a copy of a study over HTTP.

They answer by a model's posterior, with lapses at random. A lab can so see its export and figures
before anybody is paid. The results say nothing about people.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import http.client
import itertools
import json
import os
import queue
import shutil
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np

import phase_ppl as ppl
from phase_study import plan
from phase_study.experiments import LABELS, Likeness, Tags
from phase_study.settings import Settings
from phase_study.store import FILE, Store
from phase_study.study import CLIPS_FOLDER, VIDEOS, Served, Study

AT_ONCE: Final = 20  # participants at the same time

_LIKELY: Final[Mapping[str, Mapping[str, float]]] = {
    "collaborative": {
        "collaborating": 0.8,
        "helping": 0.6,
        "guiding": 0.15,
        "gathering together": 0.15,
    },
    "independent": {"not interacting": 0.7, "interacting unintentionally": 0.25, "avoiding": 0.1},
    "competing": {"competing": 0.8, "fighting": 0.4, "stealing": 0.35, "playing tug of war": 0.25},
    "opposing": {"hindering": 0.7, "blocking": 0.5, "attacking": 0.2, "protecting an object": 0.25},
}
_BY_GOAL: Final[Mapping[str, Mapping[str, float]]] = {
    "get to": {"approaching": 0.6, "chasing": 0.5, "following the lead (of another agent)": 0.2},
    "get away": {"running away": 0.7, "avoiding": 0.5},
}
"""Probability that scripted people choose a label, by the scenario and by a goal they see.
These are guesses of ours: nobody published such shares."""

_RATING: Final = (4.0, 0.8)
"""Mean and standard deviation of scripted ratings; the paper's means are 4.06 and 3.98."""


def simulate(
    study: Study,
    out: str | os.PathLike[str],
    people: int = 200,
    *,
    model: str = "closed_loop",
    predictions: str | os.PathLike[str] | Mapping[str, ppl.Prediction] | None = None,
    options: Mapping[str, Any] | None = None,
    lapse: float = 0.1,
    drop_outs: float = 0.1,
    seed: int = 0,
    progress: bool | None = None,
) -> str:
    """Send scripted people through a copy of a study, and export their answers.

    Args:
        study: it stays unchanged.
        out: folder of the export.
        people: number of people who enter.
        model: the model whose posterior gives the answers.
        predictions: an evaluation of the study's events, or its folder, instead of ``model``.
        options: of the model.
        lapse: share of random answers.
        drop_outs: share of people who leave midway.
        seed: of the people; the study itself draws who gets which video.
        progress: whether to show bars; None: where stderr is a terminal.

    Returns:
        The state of the copy at the end, in words; and how many were turned away, as the study had
        no place for them.

    Raises:
        InvalidSettingError: a setting is out of range, or the study is one of play.
        SimulationError: the server refused a request that its own page would make.
    """
    ppl.errors.whole_number("people", people)
    for name, value in (("lapse", lapse), ("drop_outs", drop_outs)):
        if ppl.errors.nonnegative_number(name, value) > 1:
            raise ppl.errors.InvalidSettingError(
                f"{name}={ppl.errors.shown(value)}, expected a share"
            )
    if study.settings.kind == "play":
        raise ppl.errors.InvalidSettingError(
            "sessions are played by people; their partner can be the computer"
        )
    study.check()
    beliefs = _beliefs(study, model, predictions, dict(options or {}), progress)
    with copied(study) as copy, serving(copy) as address:
        events = copy.events_by_digest()
        with ThreadPoolExecutor(AT_ONCE) as pool:
            seeds = np.random.SeedSequence(seed).spawn(people)

            def one(number: int) -> str | None:
                rng = np.random.default_rng(seeds[number])
                person = Person(copy.settings, address, beliefs, events, rng, lapse, drop_outs)
                person.take_part()
                return person.outcome

            asked = pool.map(one, range(people))
            outcomes = [*ppl.counted(asked, progress, "person", "asking", people)]
        # nobody is taking part any more
        copy.settings = dataclasses.replace(copy.settings, place_kept=0)
        copy.export(out)
        stands = copy.status()
        lines = [str(stands)]
        if refused := Counter(outcomes)["full"]:
            asked_for = f"{copy.settings.raters} raters a video, {copy.settings.trials} videos each"
            lines.append(
                f"\n{refused} of {people} were turned away: with {asked_for}, there was no place "
                "left for them"
            )
        if not stands.counts["finished"]:
            lines.append("\nNobody finished: there is nothing to draw.")
        else:
            lines += _figures(study.settings.kind, Path(out), copy)
    return "\n".join(lines)


def _beliefs(
    study: Study, model: str, given: Any, options: dict[str, Any], progress: bool | None
) -> Mapping[str, ppl.Prediction]:
    if given is None:
        events = [_asked_at(event, study.settings.moments) for event in study.events.values()]
        found = ppl.evaluate(events, model, progress=progress, **options)
        given = found.predictions
    elif isinstance(given, str | os.PathLike):
        given = ppl.Evaluation.load(given).predictions
    for event in study.events:
        ppl.errors.check_name("event in the predictions", event, given)
    return dict(given)


def _asked_at(event: ppl.Event, moments: Sequence[float]) -> ppl.Event:
    """Return an event whose judgments are at the moments at which its film stops.

    A model is then asked about these. The answers themselves are not used.
    """
    seconds = (event.observation.n_frames - 1) * ppl.SHOWN_SECONDS_PER_FRAME
    question, labels = next(iter(ppl.questions_of(event.scene.world).items()))
    rows = [
        {"participant": "nobody", "at": at, question: labels[0]} for at in moments if at < seconds
    ]
    return dataclasses.replace(event, judgments={"responses": rows} if rows else None)


@contextlib.contextmanager
def copied(study: Study) -> Iterator[Study]:
    """Yield a copy of a study without participants, and without limits of entries."""
    with tempfile.TemporaryDirectory(prefix="phase-ppl-study-") as folder:
        target = Path(folder) / "copy"
        target.mkdir(mode=0o700)
        for name in (VIDEOS, CLIPS_FOLDER):
            if (study.folder / name).is_dir():
                shutil.copytree(study.folder / name, target / name)
        for name in ("events.json", "study.toml"):
            shutil.copy(study.folder / name, target)
        with study.store() as store:
            of = store.fact("kind"), store.stimuli().values()
            Store.create(target / FILE, *of, scripted=True).close()
        found = Study(target)
        found.settings = dataclasses.replace(
            found.settings,
            entries_per_minute=10**6,
            most_entries=10**6,
            refuse_repeats="",
            open=True,
        )
        yield found


@contextlib.contextmanager
def serving(study: Served) -> Iterator[str]:
    """Serve a study, or a live game, from a thread of this process; yield its address."""
    told: queue.SimpleQueue[str] = queue.SimpleQueue()
    server: list[Any] = []

    def work() -> None:
        try:
            study.run(0, ready=told.put, keep=server.append)
        finally:
            told.put("")

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    address = told.get()
    if not address:
        raise ppl.errors.SimulationError("the server did not start")
    try:
        yield address
    finally:
        server[0].should_exit = True
        thread.join()


class Visitor:
    """A browser as the server sees it: one connection, a cookie, and retries of every request."""

    def __init__(self, address: str, patience: float = 30.0) -> None:
        self.host = urlsplit(address).netloc
        self.patience = patience
        self.cookie = ""
        self._connection: http.client.HTTPConnection | None = None

    def get(self, path: str) -> bytes:
        """Return what is at a path."""
        return self._insist("GET", path, None)

    def post(self, path: str, body: Mapping[str, Any]) -> Any:
        """Send a JSON object; return what comes back."""
        return json.loads(self._insist("POST", path, json.dumps(body).encode()))

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()

    def _once(self, method: str, path: str, body: bytes | None) -> tuple[int, bytes]:
        """Send one request; return status and content (OSError, HTTPException: no response)."""
        headers = {"Origin": f"http://{self.host}", "Content-Type": "application/json"}
        if self.cookie:
            headers["Cookie"] = self.cookie
        if self._connection is None:
            self._connection = http.client.HTTPConnection(self.host, timeout=30)
            self._connection.connect()
            self._connection.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection.request(method, path, body, headers)
        reply = self._connection.getresponse()
        content = reply.read()
        if given := reply.getheader("Set-Cookie"):
            self.cookie = given.partition(";")[0]
        return reply.status, content

    def _insist(self, method: str, path: str, body: bytes | None) -> bytes:
        until, wait = time.monotonic() + self.patience, 0.05
        while True:
            try:
                status, content = self._once(method, path, body)
                reason = f"{status} {content[:200]!r}"
            except (OSError, http.client.HTTPException) as error:
                self.close()
                self._connection = None
                status, reason = 503, f"{error}"
            if status < 400:
                return content
            if (status < 500 and status != 429) or time.monotonic() > until:
                raise ppl.errors.SimulationError(f"{method} {path.partition('?')[0]}: {reason}")
            time.sleep(wait)
            wait = min(2 * wait, 2.0)


class Person:
    """A scripted participant who answers by a model's posterior, with lapses.

    Films are identified by their hash. ``confirmed`` is called with every answer that the server
    has confirmed: person, page, attempt, answers.
    """

    def __init__(
        self,
        settings: Settings,
        address: str,
        beliefs: Mapping[str, ppl.Prediction],
        events: Mapping[str, str],
        rng: np.random.Generator,
        lapse: float = 0.0,
        drop_outs: float = 0.0,
        confirmed: Callable[[str, str, int, Mapping[str, Any]], object] = lambda *_: None,
        patience: float = 30.0,
    ) -> None:
        self.settings, self.beliefs, self.events = settings, beliefs, events
        self.rng, self.lapse, self.confirmed = rng, lapse, confirmed
        self.visitor = Visitor(address, patience)
        total = 4 + settings.trials
        self.leaves_after = int(rng.integers(1, total)) if rng.random() < drop_outs else None
        self.answered = 0
        self.outcome: str | None = None

    def take_part(self) -> None:
        """Go through the study to its end, or leave midway."""
        with contextlib.closing(self.visitor):
            state = self.visitor.post("/api/enter", {})
            while state.get("status") != "over":
                for page in state.get("pages", ()):
                    if self.answered == self.leaves_after:
                        return
                    self._answer(state["participant"], page)
                state = json.loads(self.visitor.get("/api/state"))
                if state.get("status") == "new":
                    raise ppl.errors.SimulationError(
                        "the server does not know this person any more"
                    )
            self.outcome = state["outcome"]

    def _answer(self, who: str, page: Mapping[str, Any]) -> None:
        answers = self._answers(page)
        seconds = float(self.rng.lognormal(np.log(22.0), 0.5))
        asked = {"page": page["page"], "attempt": page["attempt"], "answers": answers}
        times = {"rt_ms": 1000 * seconds, "shown_ms": 1000 * time.time(), "plays": 1,
                 "first_end_ms": 600 * seconds}  # fmt: skip
        self.visitor.post("/api/answer", {"participant": who, **asked, **times})
        self.confirmed(who, *asked.values())
        self.answered += 1

    def _answers(self, page: Mapping[str, Any]) -> dict[str, Any]:
        name = page["page"].partition("-")[0]
        slips = self.rng.random() < self.lapse
        if name == "consent":
            return {"agree": True}
        if name == "device":
            return {}
        if name == "tutorial":
            return {"views": [8000.0 for _ in page["steps"]]}
        if name == "quiz":
            given = [
                list(options) if slips else [answer] for _, options, answer in self.settings.quiz
            ]
            return {f"question_{n}": str(self.rng.choice(o)) for n, o in enumerate(given, 1)}
        if name == "person":
            return {
                "age": int(self.rng.integers(18, 75)),
                "gender": str(self.rng.choice(plan.GENDERS)),
            }
        film = hashlib.sha256(self.visitor.get(page["video"])).hexdigest()
        return self._judged(self.beliefs[self.events[film]], page)

    def _judged(self, belief: ppl.Prediction, page: Mapping[str, Any]) -> dict[str, Any]:
        world, self_goals = self.settings.world, self.settings.self_goals
        allowed: dict[str, Sequence[str]] = {**ppl.questions_of(world)}
        for agent, question in zip(range(len(world.agents)), allowed, strict=False):
            allowed[question] = plan.allowed_goals(agent, self_goals, world)
        drawn = {q: self._drawn(belief, q, options) for q, options in allowed.items()}
        asked = {question["name"] for question in page["questions"]}
        if "labels" in asked:
            return {"labels": self._labels(list(drawn.values())[: len(world.agents)])}
        if "likeness" in asked:
            rating = int(np.clip(round(self.rng.normal(*_RATING)), 1, 5))
            return {**drawn, "likeness": rating}
        moments = page.get("moments", ())
        if not moments:
            return self._rated(belief, drawn)
        stops = []
        for at in moments:
            if belief.moments and at not in belief.moments:
                continue  # the film is shorter
            until = belief.at(at) if belief.moments else belief
            said = {q: self._drawn(until, q, options) for q, options in allowed.items()}
            stops.append({"at": at, "rt": 4000.0, **self._rated(until, said)})
        return {**self._rated(belief, drawn), "moments": stops}

    def _rated(self, belief: ppl.Prediction, drawn: Mapping[str, str]) -> dict[str, Any]:
        """Return answers as the study asks for them: labels, sliders, or how sure as well."""
        found: dict[str, Any] = dict(drawn)
        if self.settings.answers == "confidence":
            found["confidence"] = int(self.rng.integers(30, plan.GREATEST + 1))
        if self.settings.answers == "sliders":
            for question in ppl.pairs_of(self.settings.world):
                labels = ppl.questions_of(self.settings.world)[question]
                even = np.full(len(labels), 1 / len(labels))
                shares = belief.probabilities.get(question, even)
                noisy = shares * plan.GREATEST + self.rng.normal(0, 8, len(labels))
                noisy[labels.index(drawn[question])] += 10
                rounded = np.clip(noisy, 0, plan.GREATEST).round().astype(int)
                found[question] = dict(zip(labels, rounded.tolist(), strict=True))
        return found

    def _drawn(self, belief: ppl.Prediction, question: str, options: Sequence[str]) -> str:
        labels = ppl.questions_of(self.settings.world)[question]
        if question in belief.probabilities:
            shares = np.array([belief.probabilities[question][labels.index(o)] for o in options])
        else:
            shares = np.array([float(o == belief.answers.get(question)) for o in options])
        if self.rng.random() < self.lapse or shares.sum() <= 0:
            shares = np.ones(len(options))
        return str(self.rng.choice(options, p=shares / shares.sum()))

    def _labels(self, goals: Sequence[str]) -> list[str]:
        likely: dict[str, float] = {}
        world, n = self.settings.world, len(goals)
        wanted = ppl.Hypothesis.coded(
            world, tuple(map(world.goal_index, goals)), (None,) * n, (1.0,) * n
        )
        for pair in itertools.combinations(world.agents, 2):
            likely |= _LIKELY[wanted.scenario_between(*pair)]
        for goal in goals:
            for start, labels in _BY_GOAL.items():
                if goal.startswith(start):
                    likely |= labels
        chances = {label: max(likely.get(label, 0.0), self.lapse / 10) for label in LABELS}
        chosen = [label for label, p in chances.items() if self.rng.random() < p]
        return chosen or [max(chances, key=lambda label: chances[label])]


def _figures(kind: str, out: Path, copy: Study) -> list[str]:
    """Draw the possible figures of an export; return lines about them."""
    if kind == "tagging":
        tags = Tags.load(out / "tags.csv")
        tags.plot(out / "tags.png")
        return [f"\nLabels:\n{tags.counts()}", f"Figure: {out / 'tags.png'}"]
    events = [event for event in copy.events.values() if event.truth is not None]
    judged = ppl.load_judgments(out / "judgments.csv", list(copy.events.values()))
    lines = [f"\n{judged}"]
    if kind == "likeness":
        likeness = Likeness.load(out / "likeness.csv")
        likeness.plot(out / "likeness.png")
        lines += [f"{likeness.summary().T}", f"Figure: {out / 'likeness.png'}"]
    if any(event.id in judged.judgments for event in events):
        right = judged.accuracy(events)
        for name in ("goal_accuracy", "relation_accuracy"):
            if right[name] is not None:  # a lone agent has no relation
                lines.append(f"{name}: {right[name]['value']:.2f}")
    return lines
