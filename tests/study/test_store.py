"""The database of a study: who sees what, and what is kept."""

from __future__ import annotations

import contextlib
import dataclasses
import heapq
import json
import random
import sqlite3
import stat
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phase_ppl.world.errors import InvalidEventError, UnknownNameError
from phase_study import store as store_module
from phase_study.settings import Settings
from phase_study.store import Refused, Stimulus, Store


class Clock:
    now = 1e9

    def time(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(store_module, "time", found)
    return found


def videos(n: int) -> list[Stimulus]:
    return [Stimulus(f"event-{k}", file=f"{k}.mp4", sha256=str(k)) for k in range(n)]


@pytest.fixture(autouse=True)
def _by_the_same_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is drawn is the same in every run."""
    chance = random.Random(0)
    monkeypatch.setattr(store_module.secrets, "choice", chance.choice)
    monkeypatch.setattr(store_module.secrets, "SystemRandom", lambda: chance)


Create = Callable[[str, list[Stimulus]], Store]


@pytest.fixture
def create(tmp_path: Path) -> Iterator[Create]:
    with contextlib.ExitStack() as open_ones:

        def make(kind: str, stimuli: list[Stimulus]) -> Store:
            found = Store.create(tmp_path / "study.db", kind, stimuli)
            return open_ones.enter_context(contextlib.closing(found))

        yield make


@pytest.fixture
def store(create: Create) -> Store:
    return create("judgment", videos(6))


SETTINGS = dataclasses.replace(
    Settings.parse('kind = "judgment"'), trials=2, raters=5, most_entries=1000,
    entries_per_minute=1000,
)  # fmt: skip


def enter(store: Store, person: str = "", **given: Any) -> str:
    settings = dataclasses.replace(SETTINGS, **given)
    store.use_settings(settings)
    return store.enter(settings, person)[0]


def assigned(store: Store, who: str, **given: Any) -> list[int]:
    store.assign(who, dataclasses.replace(SETTINGS, **given))
    return [trial["stimulus"] for trial in seen_by(store, who)]


def seen_by(store: Store, who: str) -> list[dict[str, Any]]:
    return store.rows("SELECT * FROM assignment WHERE participant=? ORDER BY position", (who,))


def test_twenty_people_a_video_where_some_leave(create: Create, clock: Clock) -> None:
    # 50 videos, 10 a person, 15 people at a time, 15 % of whom leave, until the study is full
    store = create("judgment", videos(50))
    chance = random.Random(3)
    at_it: list[tuple[float, str]] = []
    entered = 0
    while True:
        with contextlib.suppress(Refused):
            if len(at_it) < 15:
                who = enter(store, trials=10, raters=20)
                assigned(store, who, trials=10)
                heapq.heappush(at_it, (clock.now + chance.uniform(480, 1200), who))
                clock.now += 20
                entered += 1
                continue
        if not at_it:
            break
        clock.now, who = heapq.heappop(at_it)
        if chance.random() > 0.15:
            store.end(who, "finished")
        elif not at_it:
            clock.now += 3600  # the places of those who left are free again
    seen = Counter(
        row["stimulus"]
        for row in store.rows(
            "SELECT a.stimulus FROM assignment a JOIN participant p ON p.id=a.participant "
            "WHERE p.outcome='finished'"
        )
    )
    assert entered > 105
    assert set(seen.values()) <= {18, 19, 20, 21}
    assert seen.total() >= 990


def test_a_person_sees_every_video_once_by_a_name_of_their_own(store: Store) -> None:
    names = set()
    for _ in range(3):
        who = enter(store)
        first = assigned(store, who, trials=6)
        assert sorted(first) == [1, 2, 3, 4, 5, 6]
        assert assigned(store, who, trials=6) == first
        names |= set(store.participant(who).trials or ())
    assert len(names) == 18


def test_reflected_copies_are_not_shown_to_the_same_person(create: Create) -> None:
    copies = [Stimulus(f"{k}", copies=str(k // 3), file=f"{k}.mp4") for k in range(9)]
    store = create("judgment", copies)
    for _ in range(9):
        seen = assigned(store, enter(store), trials=3)
        assert sorted((number - 1) // 3 for number in seen) == [0, 1, 2]


def test_checks_come_among_the_others_for_everybody(store: Store) -> None:
    places = set()
    for _ in range(20):
        who = enter(store, raters=20)
        assigned(store, who, checks=dict.fromkeys(("event-0", "event-1"), ("neutral",)))
        roles = [trial["role"] for trial in seen_by(store, who)]
        assert sorted(roles) == ["check", "check", "main", "main"]
        places.add(tuple(roles))
    assert len(places) > 2
    main = store.rows("SELECT stimulus FROM assignment WHERE role='main'")
    assert {row["stimulus"] for row in main} == {3, 4, 5, 6}


def test_groups_are_equally_large_and_see_their_own_videos(create: Create) -> None:
    pairs = [Stimulus(f"{g}{k}", g, k, file="x") for g in ("played", "generated") for k in range(3)]
    store = create("likeness", pairs)
    groups = []
    for _ in range(20):
        who = enter(store, raters=20)
        seen = assigned(store, who, trials=3)
        (group,) = store.rows("SELECT grp FROM participant WHERE id=?", (who,))[0].values()
        assert {number <= 3 for number in seen} == {group == "played"}
        groups.append(group)
    assert Counter(groups) == {"played": 10, "generated": 10}
    assert any(groups[i] != groups[0] for i in range(2, 20, 2)), "the order is drawn"


def test_the_study_is_full_once_enough_people_are_at_it(store: Store, clock: Clock) -> None:
    # 6 videos, 2 a person, 3 people each: 9 places
    people = [enter(store, raters=3) for _ in range(9)]
    with pytest.raises(Refused, match="full"):
        enter(store, raters=3)
    store.end(people[0], "declined")
    enter(store, raters=3)
    with pytest.raises(Refused, match="full"):
        enter(store, raters=3)
    clock.now += 3601  # those who began have not finished: their places are free again
    enter(store, raters=3)


def test_videos_that_too_many_have_seen_take_no_places_from_others(store: Store) -> None:
    seen: dict[str, list[int]] = {}
    for _ in range(4):  # after three every video has been seen once
        who = enter(store)
        seen[who] = assigned(store, who)
        store.end(who, "finished")
    *first, last = seen
    store.exclude(next(who for who in first if not {*seen[who]} & {*seen[last]}), "slept")
    enter(store, raters=1)
    with pytest.raises(Refused, match="full"):
        enter(store, raters=1)


def test_entries_are_limited_by_minute_and_in_total(store: Store, clock: Clock) -> None:
    enter(store, entries_per_minute=2)
    enter(store, entries_per_minute=2)
    with pytest.raises(Refused, match="busy"):
        enter(store, entries_per_minute=2)
    clock.now += 61
    enter(store, entries_per_minute=2)
    with pytest.raises(Refused, match="full"):
        enter(store, most_entries=3)


def test_answer_and_end_are_one_transaction(store: Store) -> None:
    who = enter(store)

    def crash(participant: object) -> str:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.answer(who, "trial-1", 1, {}, outcome=crash)
    assert store.rows("SELECT * FROM response") == []
    assert store.answer(who, "trial-1", 1, {}, outcome=lambda participant: "finished")
    assert store.participant(who).outcome == "finished"


def test_first_answers_count_attempts_are_kept_age_and_gender_apart(store: Store) -> None:
    who, given = enter(store), [(1, "friendly"), (1, "neutral"), (2, "neutral")]
    new = [store.answer(who, "trial-1", attempt, {"relation": said}) for attempt, said in given]
    assert new == [True, False, True]
    kept = [json.loads(row["answers"]) for row in store.rows("SELECT answers FROM response")]
    assert kept == [{"relation": "friendly"}, {"relation": "neutral"}]
    store.answer(who, "person", 1, {"age": 44, "gender": "female"})
    answers = store.rows("SELECT answers FROM response WHERE page='person'")
    assert answers == [{"answers": "{}"}]
    assert store.rows("SELECT age, gender FROM person") == [{"age": 44, "gender": "female"}]


def test_withdrawal_leaves_nothing_in_the_files(store: Store) -> None:
    for what in (store.withdraw, lambda who: store.exclude(who, "why")):
        with pytest.raises(UnknownNameError, match="nobody"):
            what("nobody")
    who, other = enter(store), enter(store)
    for someone, word in ((who, "remove-this-word"), (other, "keep-this-word")):
        assigned(store, someone)
        store.answer(someone, "trial-1", 1, {"relation": word})
        store.answer(someone, "person", 1, {"age": 44, "gender": word})
    store.withdraw(who)
    store.close()
    everything = b"".join(file.read_bytes() for file in store.path.parent.iterdir())
    assert b"keep-this-word" in everything
    assert b"remove-this-word" not in everything
    again = Store(store.path)
    assert again.participant(who).outcome == "withdrawn"
    assert len(again.rows("SELECT * FROM assignment")) == 2
    again.close()


def test_commits_are_on_the_owners_disk(create: Create, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store_module, "sqlite3", sqlite3)  # that waits for the disk
    store = create("judgment", videos(1))
    enter(store)
    for file in store.path.parent.iterdir():
        assert stat.S_IMODE(file.stat().st_mode) == 0o600, file.name
    assert store.rows("PRAGMA synchronous") == [{"synchronous": 2}]
    assert store.rows("PRAGMA journal_mode") == [{"journal_mode": "wal"}]


def test_a_snapshot_stays_as_it_was(store: Store, tmp_path: Path) -> None:
    enter(store)
    copy = store.snapshot(tmp_path / "copy.db")
    enter(store)
    assert [len(one.rows("SELECT * FROM participant")) for one in (copy, store)] == [1, 2]
    copy.close()


def test_notes_are_limited(store: Store) -> None:
    who = enter(store)
    for number in range(510):
        store.note(who, "blur", "trial-1", number)
    assert store.rows("SELECT count(*) AS n FROM note") == [{"n": 500}]


def test_what_is_no_study_and_another_version_are_refused(store: Store, tmp_path: Path) -> None:
    for name, content in (("a", b""), ("b", b"no database at all, only some text"), ("c", None)):
        (tmp_path / name).mkdir()
        if content is not None:
            (tmp_path / name / "study.db").write_bytes(content)
        with pytest.raises(InvalidEventError, match=r"study\.db"):
            Store(tmp_path / name / "study.db")
    store._db.execute("PRAGMA user_version=99")
    with pytest.raises(InvalidEventError, match="version 99"):
        Store(store.path)


def test_played_scenes_are_shared_out(create: Create) -> None:
    store = create("play", [Stimulus("a"), Stimulus("b")])
    goals, strengths = ("get to green agent", "get to red agent"), (300.0, 300.0)
    for _ in range(4):
        event = store.least_played(0.0)
        session = store.open_session(event, goals, strengths, {}, [None, None])
        store.end_session(session, "goals")
    assert Counter(row["event"] for row in store.sessions()) == {"a": 2, "b": 2}
