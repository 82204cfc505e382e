"""What people said, as files: tables that the package reads, and a page that explains them."""

from __future__ import annotations

import dataclasses
import json
import math
import statistics
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from phase_ppl import __version__
from phase_ppl.dataset.load import save_events
from phase_ppl.evaluation.csv_file import csv_bytes
from phase_ppl.study.settings import Settings
from phase_ppl.study.store import Store
from phase_ppl.world.errors import OutputError
from phase_ppl.world.event import Event
from phase_ppl.world.files import write_bytes

README: Final = "README.md"
_TITLE: Final = "# Export of a study"
INCLUDE: Final = ("unfinished", "excluded", "flagged")
"""People who may be exported beside those who finished; flagged ones are unless left out."""

_VIEWING: Final = {
    "participant": "a random number, the same in all rows of one person",
    "video": "id of the event in events.json",
}
_COLUMNS: Final[Mapping[str, Mapping[str, str]]] = {
    "judgments.csv": {
        **_VIEWING,
        "goal_red": "what the red agent is after: one of the 36 goals",
        "goal_green": "what the green agent is after, likewise",
        "relation": "friendly, neutral or adversarial",
        "response_time": "seconds from when the page was shown until it was answered",
    },
    "tags.csv": {
        **_VIEWING,
        "label": "a label that the participant chose for the video; a row each",
    },
    "likeness.csv": {
        **_VIEWING,
        "group": "played, by people, or generated",
        "rating": "1 (very unlikely) to 5 (very likely): would people behave like this?",
        "pair": "the same for a played event and the generated one that belongs to it",
    },
    "viewings.csv": {
        **_VIEWING,
        "role": "main, or check: an attention check",
        "position": "which of the participant's animations it was, from 1",
        "plays": "how often it was begun",
        "first_end": "seconds until it was seen to its end for the first time",
        "response_time": "seconds from when the page was shown until it was answered",
    },
    "participants.csv": {
        "participant": "a random number",
        "group": "of a study with groups: which videos were seen",
        "outcome": "finished, declined, quiz_failed, expired, or left: came and went",
        "minutes": "from consent to the last answer",
        "quiz_attempts": "how often the quiz was answered",
        "answers": "animations that were judged, attention checks included",
        "checks_missed": "attention checks with another answer than expected",
        "hidden": "how often the page was hidden while it was answered",
        "included": "whether the answers are in the other tables",
        "reason": "why the researcher excluded the participant",
        "settings": "first characters of the hash of the study.toml that the participant saw",
    },
    "people.csv": {
        "participant": _VIEWING["participant"],
        "age": "years",
        "gender": "as chosen",
    },
}  # fmt: skip
"""Table -> column -> what is in it."""


class Person(NamedTuple):
    """A participant as exports see them; the fields are those of ``participants.csv``."""

    participant: str
    group: str | None
    outcome: str
    minutes: float | None
    quiz_attempts: int
    answers: int
    checks_missed: int
    hidden: int
    excluded: bool
    reason: str | None
    settings: str


@dataclasses.dataclass(frozen=True)
class Status:
    """How a study stands.

    Attributes:
        counts: entered, consented, declined, failed the quiz, at it now, left, expired, finished,
            excluded, withdrawn, and flagged by attention checks.
        viewings: video or scene -> answers of people who finished and were not excluded, or
            sessions that went to their end.
    """

    counts: Mapping[str, int]
    viewings: Mapping[str, int]

    def __str__(self) -> str:
        width = max(map(len, self.counts))
        lines = [f"{name:<{width}}  {n}" for name, n in self.counts.items()]
        fewest, most = min(self.viewings.values()), max(self.viewings.values())
        lines += ["", f"{len(self.viewings)} videos or scenes, each seen {fewest} to {most} times"]
        return "\n".join(lines)


def status(store: Store, settings: Settings) -> Status:
    """Return how a study stands."""
    people = _people(store, settings)
    outcomes = Counter(person.outcome for person in people)
    consented = store.rows("SELECT count(consented) AS n FROM participant")[0]["n"]
    counts = {"entered": len(people), "consented": consented}
    names = {
        "declined": "declined",
        "quiz_failed": "failed the quiz",
        "at it": "at it now",
        "left": "left",
        "expired": "came back too late",
        "waited": "waited in vain",
        "partner_left": "partner left",
        "finished": "finished",
        "withdrawn": "withdrawn",
    }
    always = ("declined", "quiz_failed", "at it", "left", "finished", "withdrawn")
    counts |= {
        shown: outcomes[name] for name, shown in names.items() if name in always or outcomes[name]
    }
    counts["excluded"] = sum(person.excluded for person in people)
    counts["flagged"] = sum(person.checks_missed > 0 for person in people)
    if settings.kind == "play":
        return Status(counts, store.played(since=math.inf))
    whole = {p.participant for p in people if p.outcome == "finished" and not p.excluded}
    seen = Counter(
        v["event"] for v in _viewings(store) if v["role"] == "main" and v["participant"] in whole
    )
    events = [s.event for s in store.stimuli().values() if s.event not in settings.checks]
    return Status(counts, {event: seen[event] for event in events})


def check_folder(out: Path) -> None:
    """Raise OutputError where a folder holds other files than those of an export."""
    readme = out / README
    ours = readme.is_file() and readme.read_text("utf-8", "replace").startswith(_TITLE)
    if any(out.iterdir()) and not ours:
        raise OutputError(f"{out} holds other files: an export gets a folder of its own")


def write(
    store: Store, settings: Settings, events: Mapping[str, Event], out: Path,
    include: Sequence[str], demographics: bool,
) -> None:  # fmt: skip
    """Write all files of an export; arguments as of :meth:`phase_ppl.study.Study.export`."""
    people = _people(store, settings)
    included = {
        p.participant
        for p in people
        if p.outcome in ("finished", *(("left", "at it", "expired") * ("unfinished" in include)))
        and (not p.excluded or "excluded" in include)
        and (not p.checks_missed or "flagged" in include)
    }
    tables: dict[str, list[Sequence[Any]]] = {}
    tables["participants.csv"] = [
        [*(p.participant, p.group, p.outcome, _number(p.minutes), p.quiz_attempts, p.answers),
         *(p.checks_missed, p.hidden, str(p.participant in included).lower(), p.reason),
         p.settings[:12]]
        for p in people if p.outcome != "withdrawn"
    ]  # fmt: skip
    viewings = [row for row in _viewings(store) if row["participant"] in included]
    if settings.kind != "play":
        tables |= _answers(settings, viewings)
    if demographics:
        asked = store.rows("SELECT * FROM person ORDER BY participant")
        tables["people.csv"] = [list(r.values()) for r in asked if r["participant"] in included]
    files, columns = {name: "" for name in tables}, dict(_COLUMNS)
    for name, rows in tables.items():
        write_bytes(out / name, (".csv",), csv_bytes(list(_COLUMNS[name]), rows))
    save_events(list(events.values()), out / "events.json")
    files["events.json"] = "the events that were shown" + " or played" * (settings.kind == "play")
    for config in store.rows("SELECT sha256, text FROM config ORDER BY first_used"):
        name = f"study-{config['sha256'][:12]}.toml"
        write_bytes(out / name, (".toml",), config["text"].encode())
        files[name] = "settings and texts that participants saw; participants.csv says who"
    if settings.kind == "play":
        from phase_ppl.study import sessions

        files |= sessions.export(store, events, out, "unfinished" in include, "excluded" in include)
        columns |= sessions.COLUMNS
    totals = _totals(store, included)
    readme = _readme(store, settings, len(included), include, files, columns, totals)
    write_bytes(out / README, (".md",), readme.encode())


def _answers(settings: Settings, viewings: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    names = {"judgment": ["judgments.csv"], "tagging": ["tags.csv"],
             "likeness": ["judgments.csv", "likeness.csv"]}[settings.kind]  # fmt: skip
    tables: dict[str, list[Any]] = {name: [] for name in [*names, "viewings.csv"]}
    for row in viewings:
        who, video, given = row["participant"], row["event"], json.loads(row["answers"])
        seconds = _number(row["rt_ms"], 1000)
        tables["viewings.csv"].append(
            [who, video, row["role"], row["position"] + 1, row["plays"],
             _number(row["first_end_ms"], 1000), seconds]
        )  # fmt: skip
        if row["role"] != "main":
            continue
        if "tags.csv" in tables:
            tables["tags.csv"] += [[who, video, label] for label in given["labels"]]
        if "judgments.csv" in tables:
            tables["judgments.csv"].append(
                [who, video, given["goal_red"], given["goal_green"], given["relation"], seconds]
            )
        if "likeness.csv" in tables:
            tables["likeness.csv"].append([who, video, row["grp"], given["likeness"], row["pair"]])
    return tables


def _number(value: float | None, divisor: float = 1.0) -> str:
    return "" if value is None else f"{value / divisor:.3f}".rstrip("0").rstrip(".")


def _viewings(store: Store) -> list[dict[str, Any]]:
    """Return a row per animation that somebody answered, in the order of people and positions."""
    return store.rows(
        """SELECT a.participant, a.position, a.role, s.event, s.grp, s.pair, r.answers, r.rt_ms,
        r.plays, r.first_end_ms FROM assignment a JOIN stimulus s ON s.id=a.stimulus
        JOIN participant p ON p.id=a.participant
        JOIN response r ON r.participant=a.participant AND r.page='trial-'||(a.position+1)
        ORDER BY p.created, p.id, a.position"""
    )


def _people(store: Store, settings: Settings) -> list[Person]:
    seen: dict[str, list[dict[str, Any]]] = {}
    for row in _viewings(store):
        seen.setdefault(row["participant"], []).append(row)
    counts = store.rows(
        """SELECT p.*,
        (SELECT count(*) FROM note n WHERE n.participant=p.id AND what='hidden') AS hidden,
        (SELECT count(*) FROM response r WHERE r.participant=p.id AND page='quiz') AS quiz
        FROM participant p ORDER BY created, id"""
    )
    now = time.time()
    found = []
    for row in counts:
        mine = seen.get(row["id"], [])
        missed = sum(
            json.loads(one["answers"]).get("relation") not in settings.checks.get(one["event"], ())
            for one in mine
            if one["role"] == "check"
        )
        still = now - row["seen"] < 60 * settings.place_kept
        minutes = None if row["consented"] is None else (row["seen"] - row["consented"]) / 60
        outcome = row["outcome"] or ("at it" if still else "left")
        found.append(
            Person(row["id"], row["grp"], outcome, minutes, row["quiz"], len(mine), missed,
                   row["hidden"], row["excluded"] is not None, row["reason"], row["config"])
        )  # fmt: skip
    return found


def _totals(store: Store, included: set[str]) -> str:
    """Return age and gender of those whose answers are exported, in one line."""
    people = [r for r in store.rows("SELECT * FROM person") if r["participant"] in included]
    ages = [row["age"] for row in people if row["age"] is not None]
    genders = Counter(row["gender"] or "not said" for row in people)
    if not people:
        return "not asked"
    parts = [f"{n} {name}" for name, n in sorted(genders.items())]
    if len(ages) > 1:
        parts.insert(0, f"age {statistics.mean(ages):.2f} ± {statistics.stdev(ages):.2f}")
    return ", ".join(parts)


def _readme(
    store: Store, settings: Settings, n: int, include: Sequence[str],
    files: Mapping[str, str], columns: Mapping[str, Mapping[str, str]], totals: str,
) -> str:  # fmt: skip
    kind = settings.kind
    lines = [
        f"{_TITLE} of {kind}: {settings.title}", "",
        f"Made {time.strftime('%Y-%m-%d')} by phase_ppl {__version__}; the study was begun with "
        f"{store.fact('version')}, id {store.fact('id')}.", "",
        "## People", "", "| | |", "|---|---|",
        *(f"| {name} | {count} |" for name, count in status(store, settings).counts.items()),
        f"| **in the tables** | {n} |", "",
        f"In the tables are those who finished{_others(include)}. Those who withdrew are in none. "
        "Everybody is under a random number; no address, name or platform's id was ever stored.",
        "", f"Age and gender of those in the tables: {totals}.", "",
        "## Files", "",
    ]  # fmt: skip
    for name, what in files.items():
        lines += [f"### {name}", "", *([f"{what[0].upper()}{what[1:]}.", ""] if what else [])]
        if name in columns:
            lines += ["| column | content |", "|---|---|"]
            lines += [f"| `{column}` | {text} |" for column, text in columns[name].items()] + [""]
    reads = {
        "judgment": 'ppl.load_judgments("judgments.csv")',
        "tagging": 'ppl.load_tags("tags.csv")',
        "likeness": 'ppl.load_likeness("likeness.csv")',
    }
    if kind in reads:
        lines += ["In Python, `import phase_ppl as ppl`:", "", f"    {reads[kind]}", ""]
    return "\n".join(lines)


def _others(include: Sequence[str]) -> str:
    beside = [name for name in ("unfinished", "excluded") if name in include]
    text = f", and those {' or '.join(beside)}" if beside else ""
    return text + ("" if "flagged" in include else ", without those flagged by attention checks")
