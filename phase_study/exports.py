"""Exports of a study: tables and events that the package reads, and a README."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import statistics
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import phase_ppl as ppl
from phase_study.plan import GREATEST, the
from phase_study.settings import Settings
from phase_study.store import COMPLETE, Store, trajectory_sha256

README: Final = "README.md"
SLIPPED: Final = 500.0
"""Milliseconds of delay of a session's frame above which the session is marked."""

_TITLE: Final = "# Export of a study"
_REHEARSAL: Final = (
    "A rehearsal: these are no people. Participants are scripted, and their names begin with "
    f"`{ppl.Judgments.SCRIPTED}`, in all files; judgments are marked in a column, too."
)
INCLUDE: Final = ("unfinished", "excluded", "flagged")
"""People who can be exported beside those who finished; flagged ones are, unless left out."""

_VIEWING: Final = {
    "participant": "name of a participant, the same in all rows of one person",
    "video": "id of the event in events.json",
}
_COLUMNS: Final[Mapping[str, Mapping[str, str]]] = {
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
        "participant": "name of the participant, made at random",
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
    "sessions.csv": {
        "session": "id of the event in sessions.json",
        "scene": "id of the event in events.json whose scene, goals and strengths were played",
        "goal_red": "effective goal of the red agent, told to both players",
        "goal_green": "likewise of the green agent",
        "relation": "which the two goals imply",
        "strength_red": "newtons",
        "strength_green": "newtons",
        "red": "participant, or computer",
        "green": "participant, or computer",
        "outcome": "goals: both were reached; time: it was up; left: a player was gone; stopped: "
        "the server was ended",
        "steps": "planner steps, one frame each",
        "seconds": "that they took to play",
        "steps_per_second": "as played",
        "view": "own: players saw what their agent sees; all: everything",
        "resets_velocity": "1: agents stood still after each step",
        "rtt_ms_red": "median round trip of a message to the player, milliseconds",
        "rtt_ms_green": "likewise",
        "slip_ms": "most by which a frame was late, milliseconds",
        "slipped": f"1: by more than {SLIPPED:g} ms",
    },
    "steps.csv": {
        "session": "id of the event in sessions.json",
        "step": "planner step, from 1",
        "red": "action of the red agent",
        "green": "action of the green agent",
        "keys_red": "what its player pressed, the latest last",
        "keys_green": "likewise",
        "lag_ms": "most by which a frame of the step was late, milliseconds",
    },
}  # fmt: skip
"""Table -> column -> meaning; :func:`_columns` has those of judgments."""


def _columns(settings: Settings, scripted: bool) -> dict[str, Mapping[str, str]]:
    """Return table -> column -> meaning, for a study with some settings, or its rehearsal."""
    world, said = settings.world, dict[str, str]()
    pairs = ppl.pairs_of(world)
    for question, agent in zip(ppl.questions_of(world), world.agents, strict=False):
        which = ", likewise" if said else f": one of the {len(world.goals)} goals"
        said[question] = f"what {the(agent)} is after{which}"
    for question, pair in pairs.items():
        whose = f"of {' and '.join(map(the, pair))}: " if len(pairs) > 1 else ""
        if settings.answers == "sliders":
            for label in ppl.questions_of(world)[question]:
                said[f"{question} {label}"] = f"{whose}slider of {label}, from 0 to {GREATEST}"
        else:
            said[question] = f"{whose}friendly, neutral or adversarial"
    if settings.answers == "confidence":
        said["confidence"] = f"how sure the participant was, from 0 to {GREATEST}"
    if settings.moments:
        said["at"] = "seconds of the film at which it had stopped; empty: it was seen to its end"
    last = {"response_time": _COLUMNS["viewings.csv"]["response_time"]}
    if scripted:
        last["rehearsal"] = "true: the participant was scripted"
    return {"judgments.csv": {**_VIEWING, **said, **last}, **_COLUMNS}


@dataclasses.dataclass(frozen=True)
class Status:
    """The state of a study.

    Attributes:
        counts: how far people got -> number of people who entered, consented, declined, failed the
            quiz, are at it now, left, came back too late, finished, withdrew, were excluded or were
            flagged by attention checks.
        viewings: video -> number of answers by people who finished and were not excluded; in a
            study of play, scene -> number of completed sessions.
    """

    counts: Mapping[str, int]
    viewings: Mapping[str, int]

    def __str__(self) -> str:
        width = max(map(len, self.counts))
        lines = [f"{name:<{width}}  {n}" for name, n in self.counts.items()]
        fewest, most = min(self.viewings.values()), max(self.viewings.values())
        often = f"{most}" if fewest == most else f"{fewest} to {most}"
        times = f"{often} time{'s' * (most != 1)}"
        lines += ["", f"{len(self.viewings)} videos or scenes, each seen {times}"]
        return "\n".join(lines)


def status(store: Store, settings: Settings) -> Status:
    """Return the state of a study."""
    people = _people(store, settings)
    outcomes = Counter(person["outcome"] for person in people)
    consented = sum(person["minutes"] is not None for person in people)
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
    counts |= {
        shown: outcomes[name]
        for name, shown in names.items()
        if outcomes[name] or name not in ("expired", "waited", "partner_left")
    }
    counts["excluded"] = sum(person["excluded"] for person in people)
    counts["flagged"] = sum(person["checks_missed"] > 0 for person in people)
    if settings.kind == "play":
        return Status(counts, store.played(since=math.inf))
    whole = {
        person["participant"]
        for person in people
        if person["outcome"] == "finished" and not person["excluded"]
    }
    seen = Counter(
        one["video"]
        for one in _viewings(store)
        if one["role"] == "main" and one["participant"] in whole
    )
    events = [s.event for s in store.stimuli().values() if s.event not in settings.checks]
    return Status(counts, {event: seen[event] for event in events})


def check_folder(out: Path) -> None:
    """Raise OutputError if a folder holds other files than an export's."""
    readme = out / README
    ours = readme.is_file() and readme.read_text("utf-8", "replace").startswith(_TITLE)
    if any(out.iterdir()) and not ours:
        raise ppl.errors.OutputError(f"{out} holds other files: an export gets a folder of its own")


def write(
    store: Store, settings: Settings, events: Mapping[str, ppl.Event], out: Path,
    include: Sequence[str], demographics: bool,
) -> None:  # fmt: skip
    """Write all files of an export; arguments as for :meth:`phase_study.Study.export`."""
    people, is_play = _people(store, settings), settings.kind == "play"
    outcomes = ("finished", *(("left", "at it", "expired") * ("unfinished" in include)))
    for person in people:
        person["included"] = (
            person["outcome"] in outcomes
            and (not person["excluded"] or "excluded" in include)
            and (not person["checks_missed"] or "flagged" in include)
        )
    included = {person["participant"] for person in people if person["included"]}
    asked = [r for r in store.rows("SELECT * FROM person ORDER BY participant")
             if r["participant"] in included]  # fmt: skip
    tables: dict[str, Iterable[Mapping[str, Any]]] = {
        "participants.csv": [
            {**p, "minutes": _number(p["minutes"]), "included": str(p["included"]).lower()}
            for p in people if p["outcome"] != "withdrawn"
        ]
    }  # fmt: skip
    if not is_play:
        tables |= _answers(settings, [v for v in _viewings(store) if v["participant"] in included])
    if demographics:
        tables["people.csv"] = asked
    files = dict.fromkeys(tables, "")
    ppl.save_events(list(events.values()), out / "events.json")
    files["events.json"] = "the events that were shown" + " or played" * is_play
    for config in store.rows("SELECT sha256, text FROM config ORDER BY first_used"):
        name = f"study-{config['sha256'][:12]}.toml"
        ppl.files.write_bytes(out / name, (".toml",), config["text"].encode())
        files[name] = "settings and texts that participants saw; participants.csv says who"
    if is_play:
        found, counts = played(store, events, "unfinished" in include, "excluded" in include)
        tables |= {"sessions.csv": [_row(*one) for one in found],
                   "steps.csv": [row for one in found for row in _steps(*one)]}  # fmt: skip
        if found:
            ppl.save_events([event for _, event in found], out / "sessions.json")
            files["sessions.json"] = "the sessions as events with their truth, for load_events"
        said = ", ".join(f"{name} {n}" for name, n in counts.items())
        files |= {
            "sessions.csv": f"a row for each session in sessions.json; of all there were: {said}",
            "steps.csv": "what was done and pressed, from which trajectories follow bit for bit",
        }
    for name, rows in tables.items():
        columns = list(_columns(settings, store.scripted)[name])
        cells = ([row[column] for column in columns] for row in rows)
        ppl.files.write_bytes(out / name, (".csv",), _csv_bytes(columns, cells))
    readme = _readme(store, settings, len(included), include, files, _totals(asked))
    ppl.files.write_bytes(out / README, (".md",), readme.encode())


# --- answers --------------------------------------------------------------------------------------


def _answers(
    settings: Settings, viewings: Sequence[Mapping[str, Any]]
) -> dict[str, Sequence[Mapping[str, Any]]]:
    main = [row for row in viewings if row["role"] == "main"]
    tables: dict[str, Sequence[Mapping[str, Any]]] = {}
    if settings.kind == "tagging":
        tables["tags.csv"] = [{**row, "label": label} for row in main for label in row["labels"]]
    else:
        tables["judgments.csv"] = [one for row in main for one in _judged(row)]
    if settings.kind == "likeness":
        tables["likeness.csv"] = [{**row, "rating": row["likeness"]} for row in main]
    return {**tables, "viewings.csv": viewings}


def _judged(row: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a row per judgment of a viewing: at each stop of the film, and at its end."""
    stops = [
        {**row, **stop, "response_time": _number(stop["rt"], 1000)}
        for stop in row.get("moments", ())
    ]
    return [_spread(one) for one in [*stops, {**row, "at": None}]]


def _spread(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with a column for each slider."""
    sliders = {name: given for name, given in row.items() if isinstance(given, dict)}
    return {
        **row,
        **{f"{name} {label}": n for name, given in sliders.items() for label, n in given.items()},
    }


def _number(value: float | None, divisor: float = 1.0) -> str:
    return "" if value is None else f"{value / divisor:.3f}".rstrip("0").rstrip(".")


def _viewings(store: Store) -> list[dict[str, Any]]:
    """Return a row per answered animation, in the order of people and positions."""
    found = store.rows(
        """SELECT a.participant, a.position+1 AS position, a.role, s.event AS video,
        s.grp AS "group", s.pair, r.answers, r.rt_ms, r.plays, r.first_end_ms
        FROM assignment a JOIN stimulus s ON s.id=a.stimulus
        JOIN participant p ON p.id=a.participant
        JOIN response r ON r.participant=a.participant AND r.page='trial-'||(a.position+1)
        ORDER BY p.created, p.id, a.position"""
    )
    for row in found:
        row |= json.loads(row["answers"])
        row["rehearsal"] = str(store.scripted).lower()
        row["first_end"] = _number(row["first_end_ms"], 1000)
        row["response_time"] = _number(row["rt_ms"], 1000)
    return found


def _people(store: Store, settings: Settings) -> list[dict[str, Any]]:
    """Return a row per participant: the columns of ``participants.csv``, and ``excluded``."""
    seen: dict[str, list[dict[str, Any]]] = {}
    for row in _viewings(store):
        seen.setdefault(row["participant"], []).append(row)
    found = store.rows(
        """SELECT id AS participant, grp AS "group", outcome, (seen-consented)/60 AS minutes,
        (SELECT count(*) FROM response WHERE participant=p.id AND page='quiz') AS quiz_attempts,
        (SELECT count(*) FROM note WHERE participant=p.id AND what='hidden') AS hidden,
        excluded IS NOT NULL AS excluded, reason, substr(config,1,12) AS settings, seen
        FROM participant p ORDER BY created, id"""
    )
    now = time.time()
    for person in found:
        mine = seen.get(person["participant"], [])
        person["answers"] = len(mine)
        person["checks_missed"] = sum(
            _is_missed(one, settings.checks.get(one["video"])) for one in mine
            if one["role"] == "check"
        )  # fmt: skip
        still = now - person["seen"] < 60 * settings.place_kept
        person["outcome"] = person["outcome"] or ("at it" if still else "left")
    return found


def _is_missed(viewing: Mapping[str, Any], accepted: Mapping[str, Sequence[str]] | None) -> bool:
    if accepted is None:  # a former check
        return True
    return any({*answers}.isdisjoint(_leading(viewing.get(q))) for q, answers in accepted.items())


def _leading(answer: Any) -> list[Any]:
    """Return the label of an answer; of sliders, the labels that are highest."""
    if not isinstance(answer, dict):
        return [answer]
    return [label for label, n in answer.items() if n == max(answer.values())]


def _totals(people: Sequence[Mapping[str, Any]]) -> str:
    """Return totals of people's age and gender, in one line."""
    if not people:
        return "not asked"
    ages = [row["age"] for row in people if row["age"] is not None]
    genders = Counter(row["gender"] or "not said" for row in people)
    parts = [f"{n} {name}" for name, n in sorted(genders.items())]
    if len(ages) > 1:
        parts.insert(0, f"age {statistics.mean(ages):.2f} ± {statistics.stdev(ages):.2f}")
    return ", ".join(parts)


# --- sessions -------------------------------------------------------------------------------------


def replayed(session: Mapping[str, Any], event: ppl.Event) -> ppl.Event:
    """Return the event of a session, by repeating its actions."""
    settings = session["settings"]
    scene = dataclasses.replace(
        event.scene, turning=settings["turning"], resets_velocity=settings["resets_velocity"]
    )
    strengths = session["strength_red"], session["strength_green"]
    stage = ppl.Stage(scene, strengths)
    frames = [scene.start, *(stage.step((one["red"], one["green"])) for one in session["steps"])]
    told = event.truth
    truth = ppl.Truth(
        session["goal_red"], session["goal_green"], told.relation, told.scenario, *strengths
    )
    return ppl.Event(
        scene, ppl.Observation(np.array(frames)), id=f"session-{session['id']}", truth=truth
    )


def played(
    store: Store, events: Mapping[str, ppl.Event], broken_off: bool = False, excluded: bool = False
) -> tuple[list[tuple[dict[str, Any], ppl.Event]], dict[str, int]]:
    """Return the sessions of a study, as recorded and as events, and counts.

    A session is left out if its actions do not reproduce its trajectory to the last bit.
    """
    out = {row["id"] for row in store.rows("SELECT id FROM participant WHERE excluded IS NOT NULL")}
    counts = dict.fromkeys(("sessions", *COMPLETE, "broken off", "excluded", "replay differs"), 0)
    found = []
    for session in store.sessions():
        outcome = session["outcome"] if session["outcome"] in COMPLETE else "broken off"
        is_out = any(player["participant"] in out for player in session["players"])
        counts["sessions"] += 1
        counts[outcome] += 1
        counts["excluded"] += is_out
        if (outcome not in COMPLETE and not broken_off) or not session["steps"]:
            continue
        if is_out and not excluded:
            continue
        event = replayed(session, events[session["event"]])
        kept = session["sha256"]
        if kept is not None and trajectory_sha256(event.observation.trajectory) != kept:
            counts["replay differs"] += 1
        else:
            found.append((session, event))
    return found, counts


def _row(session: Mapping[str, Any], event: ppl.Event) -> dict[str, Any]:
    settings, slip = session["settings"], session["slip_ms"] or 0.0
    people = dict(zip(("red", "green"), session["players"], strict=True))
    return {
        **session,
        "session": event.id,
        "scene": session["event"],
        "relation": event.truth.relation,
        **{agent: one["participant"] or "computer" for agent, one in people.items()},
        "outcome": session["outcome"] or "stopped",
        "steps": len(session["steps"]),
        "seconds": len(session["steps"]) / settings["steps_per_second"],
        **{name: settings[name] for name in ("steps_per_second", "view")},
        "resets_velocity": int(settings["resets_velocity"]),
        **{
            f"rtt_ms_{agent}": None if one["rtt_ms"] is None else round(one["rtt_ms"], 1)
            for agent, one in people.items()
        },
        "slip_ms": round(slip, 1),
        "slipped": int(slip > SLIPPED),
    }


def _steps(session: Mapping[str, Any], event: ppl.Event) -> Iterable[dict[str, Any]]:
    for step in session["steps"]:
        done = {name: ppl.Action(step[name]).recorded for name in ("red", "green")}
        red, green = (" ".join(held) for held in json.loads(step["keys"]))
        yield {"session": event.id, "step": step["number"], **done, "keys_red": red,
               "keys_green": green, "lag_ms": round(step["lag_ms"], 1)}  # fmt: skip


# --- the page about them --------------------------------------------------------------------------


def _readme(
    store: Store, settings: Settings, n: int, include: Sequence[str],
    files: Mapping[str, str], totals: str,
) -> str:  # fmt: skip
    kind, columns = settings.kind, _columns(settings, store.scripted)
    lines = [
        f"{_TITLE} of {kind}: {settings.title}", "",
        *([f"**{_REHEARSAL}**", ""] if store.scripted else []),
        f"Made {time.strftime('%Y-%m-%d')} by phase_ppl {ppl.__version__}; the study was begun "
        f"with {store.fact('version')}, id {store.fact('id')}.", "",
        "## People", "", "| | |", "|---|---|",
        *(f"| {name} | {count} |" for name, count in status(store, settings).counts.items()),
        f"| **in the tables** | {n} |", "",
        f"In the tables are those who finished{_others(include)}. Those who withdrew are in none. "
        "Names of participants are made at random; no address, name or platform's id was stored.",
        "", f"Age and gender of those in the tables: {totals}.", "",
        "## Files", "",
    ]  # fmt: skip
    for name, what in files.items():
        lines += [f"### {name}", "", *([f"{what[0].upper()}{what[1:]}.", ""] if what else [])]
        if name in columns:
            lines += ["| column | content |", "|---|---|"]
            lines += [f"| `{column}` | {text} |" for column, text in columns[name].items()] + [""]
    of = "" if settings.world == ppl.worlds.PHASE else ', ppl.load_events("events.json")'
    reads = {
        "judgment": f'ppl.load_judgments("judgments.csv"{of})',
        "tagging": 'ppl.study.Tags.load("tags.csv").plot()',
        "likeness": 'ppl.study.Likeness.load("likeness.csv").summary()',
    }
    if kind in reads:
        lines += ["In Python, `import phase_ppl as ppl`:", "", f"    {reads[kind]}", ""]
    return "\n".join(lines)


def _others(include: Sequence[str]) -> str:
    beside = [name for name in ("unfinished", "excluded") if name in include]
    text = f", and those {' or '.join(beside)}" if beside else ""
    return text + ("" if "flagged" in include else ", without those flagged by attention checks")


def _csv_bytes(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Return a CSV file of rows; None becomes an empty cell."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(["" if cell is None else cell for cell in row] for row in rows)
    return text.getvalue().encode()
