"""The data of a study: a SQLite database that one server process writes.

Every answer is on the disk (``synchronous=FULL``) before it is confirmed. Uploads are idempotent:
the first answer to a page and attempt counts, and a repeated one changes nothing.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import hmac
import json
import os
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import phase_ppl as ppl
from phase_study.settings import Settings

FILE: Final = "study.db"
_VERSION: Final = 1
_SCHEMA: Final = """
CREATE TABLE study(name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE config(sha256 TEXT PRIMARY KEY, text TEXT NOT NULL, first_used REAL NOT NULL);
CREATE TABLE stimulus(
  id INTEGER PRIMARY KEY, event TEXT UNIQUE NOT NULL,
  grp TEXT, pair INTEGER,          -- likeness: who made it, and which belong together
  copies TEXT,                     -- reflected copies of one event: a person sees one of them
  file TEXT, sha256 TEXT);         -- the film in videos/; none for played scenes
CREATE TABLE participant(
  id TEXT PRIMARY KEY, token TEXT UNIQUE, config TEXT NOT NULL REFERENCES config(sha256),
  grp TEXT, repeat TEXT UNIQUE, created REAL NOT NULL, consented REAL, assigned REAL,
  seen REAL NOT NULL, finished REAL, outcome TEXT, excluded REAL, reason TEXT);
CREATE TABLE assignment(
  participant TEXT NOT NULL REFERENCES participant(id), position INTEGER NOT NULL,
  stimulus INTEGER NOT NULL REFERENCES stimulus(id), role TEXT NOT NULL,
  name TEXT UNIQUE NOT NULL,       -- of the film, for this person
  PRIMARY KEY(participant, position)) WITHOUT ROWID;
CREATE INDEX assigned_stimulus ON assignment(stimulus);
CREATE TABLE response(
  participant TEXT NOT NULL REFERENCES participant(id), page TEXT NOT NULL,
  attempt INTEGER NOT NULL, answers TEXT NOT NULL, correct INTEGER,
  rt_ms REAL, shown_ms REAL, plays INTEGER, first_end_ms REAL,
  received REAL NOT NULL, PRIMARY KEY(participant, page, attempt)) WITHOUT ROWID;
CREATE TABLE note(
  participant TEXT NOT NULL REFERENCES participant(id), at REAL NOT NULL, what TEXT NOT NULL,
  page TEXT, detail REAL);
CREATE TABLE person(
  participant TEXT PRIMARY KEY REFERENCES participant(id), age INTEGER, gender TEXT) WITHOUT ROWID;
CREATE TABLE session(
  id TEXT PRIMARY KEY, kind TEXT NOT NULL,  -- "session"
  event TEXT NOT NULL, goal_red TEXT NOT NULL, goal_green TEXT NOT NULL,
  strength_red REAL NOT NULL, strength_green REAL NOT NULL,
  settings TEXT NOT NULL,          -- JSON: rate, view, rule and what else it was made under
  started REAL NOT NULL, ended REAL, outcome TEXT, slip_ms REAL,
  sha256 TEXT);                    -- of the trajectory, which the steps give again
CREATE TABLE player(
  session TEXT NOT NULL REFERENCES session(id), agent INTEGER NOT NULL,
  participant TEXT REFERENCES participant(id),  -- none: the computer
  rtt_ms REAL, PRIMARY KEY(session, agent)) WITHOUT ROWID;
CREATE TABLE step(
  session TEXT NOT NULL REFERENCES session(id), number INTEGER NOT NULL,
  red INTEGER NOT NULL, green INTEGER NOT NULL,  -- values of Action
  keys TEXT NOT NULL,              -- JSON: what each player held
  lag_ms REAL NOT NULL, PRIMARY KEY(session, number)) WITHOUT ROWID;
"""
_COUNTS: Final = """p.excluded IS NULL
  AND (p.outcome='finished' OR p.outcome IS NULL AND p.assigned>?)"""
"""Condition on participants p whose viewings count: they finished, or began after a time."""

COMPLETE: Final = ("goals", "time")
"""Outcomes of complete sessions; "left" and others are kept but marked."""


class Stimulus(NamedTuple):
    """A video, or a scene to be played; columns as in the table."""

    event: str
    grp: str | None = None
    pair: int | None = None
    copies: str | None = None
    file: str | None = None
    sha256: str | None = None


class Answer(NamedTuple):
    """An answered page, the attempt, and for a quiz whether all was right."""

    page: str
    attempt: int
    correct: bool | None


@dataclasses.dataclass(frozen=True)
class Participant:
    """A participant, and how far they are."""

    id: str  # as in exports
    seen: float  # time of their last request, seconds since 1970
    outcome: str | None  # how it ended; None: it has not
    answers: Sequence[Answer]  # to pages, oldest first
    trials: Sequence[str] | None  # names of their videos; None: not drawn yet

    @property
    def passed(self) -> set[str]:
        """The pages that they have passed; a quiz with wrong answers is not."""
        return {answer.page for answer in self.answers if answer.correct is not False}

    def attempts(self, page: str) -> int:
        """Return how often a page was answered."""
        return sum(answer.page == page for answer in self.answers)


class Refused(Exception):
    """A person is refused: "full", "repeated" or "busy"."""


class Store:
    """The database. Use it in one thread only; each method is a transaction of its own.

    Raises:
        InvalidEventError: it is no database of a study, or has another version.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise ppl.errors.InvalidEventError(
                f"{path.parent} holds no study: there is no {path.name}"
            )
        self.path = path
        self._db = sqlite3.connect(path, isolation_level=None, timeout=10)
        self._db.row_factory = sqlite3.Row
        try:
            version = self._value("PRAGMA user_version")
            self._db.executescript(
                "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;"
                "PRAGMA secure_delete=ON;"
            )
        except sqlite3.DatabaseError as error:
            self._db.close()
            raise ppl.errors.InvalidEventError(f"{path} is no study: {error}") from None
        if version != _VERSION:
            self._db.close()
            raise ppl.errors.InvalidEventError(
                f"{path} is of version {version}, expected {_VERSION}"
            )

    @classmethod
    def create(
        cls, path: Path, kind: str, stimuli: Iterable[Stimulus], *, scripted: bool = False
    ) -> Store:
        """Make a new database, which only its owner can read; of a rehearsal, if ``scripted``."""
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        db = sqlite3.connect(path, isolation_level=None)
        with contextlib.closing(db):
            db.execute("PRAGMA journal_mode=WAL")
            db.executescript(f"BEGIN;{_SCHEMA}COMMIT;")  # waits for the disk once
            db.execute(f"PRAGMA user_version={_VERSION}")
        store = cls(path)
        facts = {"id": secrets.token_hex(8), "kind": kind, "version": ppl.__version__,
                 "created": str(time.time()), "secret": secrets.token_hex(32)}  # fmt: skip
        if scripted:
            facts["scripted"] = "yes"
        with store._writing() as run:
            for name, value in facts.items():
                run("INSERT INTO study VALUES(?,?)", (name, value))
            for stimulus in stimuli:
                run("INSERT INTO stimulus VALUES(NULL,?,?,?,?,?,?)", stimulus)
        return store

    def close(self) -> None:
        self._db.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[Callable[..., sqlite3.Cursor]]:
        """One transaction: all of it, or nothing."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield self._db.execute
            self._db.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):  # a full disk may have rolled back already
                self._db.execute("ROLLBACK")
            raise

    def rows(self, query: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """Return the rows of a SELECT."""
        return [dict(row) for row in self._db.execute(query, values)]

    def _value(self, query: str, *values: Any) -> Any:
        """Return the first column of the first row of a SELECT; None: there is no row."""
        row = self._db.execute(query, values).fetchone()
        return None if row is None else row[0]

    def fact(self, name: str) -> str:
        """Return "id", "kind", "version" or "created" of the study."""
        return str(self._value("SELECT value FROM study WHERE name=?", name))

    @functools.cached_property
    def scripted(self) -> bool:
        """Whether it is of a rehearsal, whose participants are scripted."""
        return self._value("SELECT 1 FROM study WHERE name='scripted'") is not None

    def snapshot(self, path: Path) -> Store:
        """Return a copy of the present data; the study may go on meanwhile."""
        self._db.execute("VACUUM INTO ?", (str(path),))
        path.chmod(0o600)
        return Store(path)

    def use_settings(self, settings: Settings) -> None:
        """Store the settings that apply to people from now on."""
        values = settings.sha256, settings.text, time.time()
        with self._writing() as run:
            run("INSERT OR IGNORE INTO config VALUES(?,?,?)", values)

    def stimuli(self) -> dict[int, Stimulus]:
        """Return number -> video or scene."""
        found = self._db.execute("SELECT * FROM stimulus ORDER BY id")
        return {row[0]: Stimulus(*row[1:]) for row in found}

    # --- people -----------------------------------------------------------------------------------

    def enter(self, settings: Settings, person: str = "") -> tuple[str, str]:
        """Admit somebody; return their id and a secret token.

        Only a keyed hash of ``person``, the id on a platform, is stored.
        """
        now, repeat = time.time(), None
        if person:
            key = self.fact("secret").encode()
            repeat = hmac.new(key, person.encode(errors="replace"), "sha256").hexdigest()
        who, token = secrets.token_hex(8), secrets.token_urlsafe(24)
        who = f"{ppl.Judgments.SCRIPTED}{who}" if self.scripted else who
        with self._writing() as run:
            if repeat and self._value("SELECT 1 FROM participant WHERE repeat=?", repeat):
                raise Refused("repeated")
            recent = self._value("SELECT count(*) FROM participant WHERE created>?", now - 60)
            if recent >= settings.entries_per_minute:
                raise Refused("busy")
            total = self._value("SELECT count(*) FROM participant")
            if total >= settings.most_entries or self._places(settings) <= 0:
                raise Refused("full")
            run(
                "INSERT INTO participant(id,token,config,repeat,created,seen) VALUES(?,?,?,?,?,?)",
                (who, hashed(token), settings.sha256, repeat, now, now),
            )
        return who, token

    def _places(self, settings: Settings) -> float:
        """Return how many more people can enter, beside those whose places are reserved."""
        since = time.time() - 60 * settings.place_kept
        if self.fact("kind") == "play":
            seen, share = [*self.played(since).values()], 2
        else:
            seen, share = [*self._viewings(settings).values()], 1
        coming = self._value(
            """SELECT count(*) FROM participant
            WHERE outcome IS NULL AND assigned IS NULL AND created>?""",
            since,
        )
        wanted = share * sum(max(0, settings.raters - n) for n in seen)
        return wanted / settings.trials - float(coming)

    def _viewings(self, settings: Settings) -> dict[int, int]:
        """Return main video -> viewings by people who finished, or whose places are reserved."""
        found = self._db.execute(
            f"""SELECT s.id, s.event, count(p.id) FROM stimulus s
            LEFT JOIN assignment a ON a.stimulus=s.id AND a.role='main'
            LEFT JOIN participant p ON p.id=a.participant AND {_COUNTS} GROUP BY s.id""",
            (time.time() - 60 * settings.place_kept,),
        )
        return {row[0]: row[2] for row in found if row[1] not in settings.checks}

    def assign(self, who: str, settings: Settings) -> None:
        """Draw a participant's videos, once: those with the fewest viewings, ties at random.

        In a study with groups, the group with the fewest people comes first. Of reflected copies, a
        person sees one. Checks are placed among the others.
        """
        chance = secrets.SystemRandom()
        with self._writing() as run:
            if not self._value("SELECT assigned IS NULL FROM participant WHERE id=?", who):
                return
            stimuli, load = self.stimuli(), self._viewings(settings)
            group = self._group(settings, {s.grp for s in stimuli.values()} - {None})
            order = sorted(
                (number for number in load if stimuli[number].grp == group),
                key=lambda number: (load[number], chance.random()),
            )
            chosen: list[tuple[int, str]] = []
            copies: set[str | None] = set()
            for number in order:
                if len(chosen) < settings.trials and stimuli[number].copies not in copies:
                    chosen.append((number, "main"))
                    copies |= {stimuli[number].copies} - {None}
            chance.shuffle(chosen)
            for number, stimulus in stimuli.items():
                if stimulus.event in settings.checks and stimulus.grp in (None, group):
                    chosen.insert(chance.randint(0, len(chosen)), (number, "check"))
            for position, (number, role) in enumerate(chosen):
                name = secrets.token_urlsafe(12)
                run("INSERT INTO assignment VALUES(?,?,?,?,?)", (who, position, number, role, name))
            now = time.time()
            run("UPDATE participant SET assigned=?, grp=? WHERE id=?", (now, group, who))

    def _group(self, settings: Settings, groups: set[str | None]) -> str | None:
        if not groups:
            return None
        found = self._db.execute(
            f"SELECT grp, count(*) FROM participant p WHERE {_COUNTS} GROUP BY grp",
            (time.time() - 60 * settings.place_kept,),
        )
        people = dict.fromkeys(groups, 0) | {row[0]: row[1] for row in found if row[0] in groups}
        fewest = min(people.values())
        return secrets.choice(sorted(str(name) for name, n in people.items() if n == fewest))

    def by_token(self, token: str) -> Participant | None:
        """Return the participant with that token; None: nobody has it."""
        who = self._value("SELECT id FROM participant WHERE token=?", hashed(token))
        return None if who is None else self.participant(who)

    def participant(self, who: str) -> Participant:
        """Return a participant, by id."""
        found = self.rows("SELECT * FROM participant WHERE id=?", (who,))
        if not found:
            raise ppl.errors.UnknownNameError(f"there is no participant {ppl.errors.shown(who)}")
        (row,) = found
        answers = self._db.execute(
            "SELECT page,attempt,correct FROM response WHERE participant=? ORDER BY received",
            (who,),
        )
        trials = self._db.execute(
            "SELECT name FROM assignment WHERE participant=? ORDER BY position", (who,)
        )
        return Participant(
            who, row["seen"], row["outcome"],
            [Answer(page, n, None if ok is None else bool(ok)) for page, n, ok in answers],
            None if row["assigned"] is None else [name for (name,) in trials],
        )  # fmt: skip

    def answer(
        self, who: str, page: str, attempt: int, answers: Mapping[str, Any], *,
        correct: bool | None = None, times: Mapping[str, float | None] | None = None,
        outcome: Callable[[Participant], str | None] = lambda participant: None,
    ) -> bool:  # fmt: skip
        """Store an answer; return whether it is the first to this page and attempt.

        Args:
            who: the participant.
            page, attempt: the answered page, and the attempt, from 1.
            answers: question -> answer. Age and gender, of the page "person", go into a table of
                their own.
            correct: whether all answers of a quiz were right, or consent was given.
            times: ``rt_ms``, ``shown_ms``, ``plays``, ``first_end_ms``.
            outcome: returns how the study ended with this answer; None: it has not. It belongs to
                the same transaction.
        """
        now, given = time.time(), dict(answers)
        times = times or {}
        with self._writing() as run:
            if page == "person":
                run("INSERT OR IGNORE INTO person VALUES(?,?,?)",
                    (who, given.pop("age", None), given.pop("gender", None)))  # fmt: skip
            new = run(
                "INSERT OR IGNORE INTO response VALUES(?,?,?,?,?,?,?,?,?,?)",
                (who, page, attempt, json.dumps(given), correct, times.get("rt_ms"),
                 times.get("shown_ms"), times.get("plays"), times.get("first_end_ms"), now),
            ).rowcount == 1  # fmt: skip
            if new:
                if page == "consent" and correct:
                    run("UPDATE participant SET consented=? WHERE id=?", (now, who))
                run("UPDATE participant SET seen=? WHERE id=?", (now, who))
                self._end(who, outcome(self.participant(who)))
        return new

    def end(self, who: str, outcome: str) -> None:
        """Store how the study ended for somebody, unless it is stored already."""
        with self._writing():
            self._end(who, outcome)

    def _end(self, who: str, outcome: str | None) -> None:
        if outcome is not None:
            self._db.execute(
                "UPDATE participant SET finished=?, outcome=? WHERE id=? AND outcome IS NULL",
                (time.time(), outcome, who),
            )

    def note(
        self, who: str, what: str, page: str | None = None, detail: float | None = None
    ) -> None:
        """Store a note beside the answers; at most 500 notes a participant."""
        with self._writing() as run:
            if self._value("SELECT count(*) FROM note WHERE participant=?", who) < 500:
                run("INSERT INTO note VALUES(?,?,?,?,?)", (who, time.time(), what, page, detail))

    def video(self, who: str, name: str) -> str | None:
        """Return the file of a video that a participant may see; None: there is none."""
        query = """SELECT s.file FROM assignment a JOIN stimulus s ON s.id=a.stimulus
            WHERE a.participant=? AND a.name=?"""
        return self._value(query, who, name)

    def exclude(self, who: str, reason: str) -> None:
        """Exclude a participant from exports; their videos are shown to others instead."""
        self.participant(who)
        query = "UPDATE participant SET excluded=?, reason=? WHERE id=?"
        with self._writing() as run:
            run(query, (time.time(), reason, who))

    def withdraw(self, who: str) -> None:
        """Delete all data of a participant, for good; only the fact of the withdrawal remains.

        Their sessions are deleted too, including the other player's part.
        """
        self.participant(who)
        with self._writing() as run:
            played = self.rows("SELECT session FROM player WHERE participant=?", (who,))
            for table, column in (("step", "session"), ("player", "session"), ("session", "id")):
                for row in played:
                    run(f"DELETE FROM {table} WHERE {column}=?", (row["session"],))
            for table in ("response", "note", "person", "assignment"):
                run(f"DELETE FROM {table} WHERE participant=?", (who,))
            run(
                "UPDATE participant SET token=NULL, outcome='withdrawn', grp=NULL WHERE id=?",
                (who,),
            )
        self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    # --- played sessions --------------------------------------------------------------------------

    def least_played(self, since: float, players: Sequence[str] = ()) -> str:
        """Return the event whose scene has the fewest sessions, ties at random.

        Running sessions count if they began after ``since``. Scenes that one of the players has
        played already are taken only if no other is left.
        """
        query = f"""SELECT s.event FROM session s JOIN player p ON p.session=s.id
            WHERE p.participant IN ({_marks(players)})"""
        load, known = self.played(since), {row[0] for row in self._db.execute(query, players)}
        chance = secrets.SystemRandom()
        return min(load, key=lambda event: (event in known, load[event], chance.random()))

    def played(self, since: float) -> dict[str, int]:
        """Return event -> number of complete sessions, and of those that began after ``since``."""
        query = f"""SELECT s.event, count(g.id) FROM stimulus s LEFT JOIN session g
            ON g.event=s.event AND (g.outcome IN ({_marks(COMPLETE)})
              OR g.outcome IS NULL AND g.started>?)
            GROUP BY s.event"""
        return dict(self._db.execute(query, (*COMPLETE, since)))

    def open_session(
        self, event: str, goals: tuple[str, str], strengths: tuple[float, float],
        settings: Mapping[str, Any], players: Sequence[str | None],
    ) -> str:  # fmt: skip
        """Begin a session; return its id.

        ``goals`` are effective ones; ``players`` are None for the computer; ``settings`` are all
        that it is made under.
        """
        session = secrets.token_hex(8)
        with self._writing() as run:
            run(
                "INSERT INTO session VALUES(?,'session',?,?,?,?,?,?,?,NULL,NULL,NULL,NULL)",
                (session, event, *goals, *strengths, json.dumps(settings), time.time()),
            )
            for agent, who in enumerate(players):
                run("INSERT INTO player VALUES(?,?,?,NULL)", (session, agent, who))
        return session

    def add_steps(
        self, session: str, steps: Iterable[tuple[int, Sequence[int], Any, float]]
    ) -> None:
        """Store steps: number, actions of red and green, keys (JSON), lag in milliseconds."""
        with self._writing() as run:
            for number, (red, green), keys, lag in steps:
                values = session, number, red, green, json.dumps(keys), lag
                run("INSERT OR IGNORE INTO step VALUES(?,?,?,?,?,?)", values)

    def end_session(
        self,
        session: str,
        outcome: str,
        *,
        slip_ms: float = 0.0,
        rtt_ms: Sequence[float | None] = (),
        sha256: str | None = None,
    ) -> None:
        """End a session: "goals", "time", or why it was broken off."""
        with self._writing() as run:
            run("UPDATE session SET ended=?, outcome=?, slip_ms=?, sha256=? "
                "WHERE id=? AND outcome IS NULL",
                (time.time(), outcome, slip_ms, sha256, session))  # fmt: skip
            for agent, rtt in enumerate(rtt_ms):
                run("UPDATE player SET rtt_ms=? WHERE session=? AND agent=?", (rtt, session, agent))

    def sessions(self) -> list[dict[str, Any]]:
        """Return all sessions, oldest first, each with its ``players`` and ``steps`` as dicts."""
        found = self.rows("SELECT * FROM session ORDER BY started")
        for session in found:
            where = "WHERE session=? ORDER BY"
            session["settings"] = json.loads(session["settings"])
            session["players"] = self.rows(f"SELECT * FROM player {where} agent", (session["id"],))
            session["steps"] = self.rows(f"SELECT * FROM step {where} number", (session["id"],))
        return found


def _marks(values: Sequence[str]) -> str:
    return ",".join("?" * len(values))


def hashed(token: str) -> str:
    """Return the hash of a token that is stored."""
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()


def trajectory_sha256(trajectory: NDArray[np.float64]) -> str:
    """Return a hash of a trajectory's numbers, to the last bit."""
    return hashlib.sha256(np.ascontiguousarray(trajectory, np.float64).tobytes()).hexdigest()
