"""Studies of people's judgments: a CSV file, one row per participant and video.

::

    participant,video,goal_red,goal_green,relation,response_time
    p01,collaborate,Get pink item to red lm,Get pink item to red lm,friendly,12.4
    p01,oppose,get to green agent,get away from red agent,adversarial,8.1
    p02,collaborate,Get pink item to red lm,,friendly,

``participant`` and ``video`` (the id of the event) are required, and at least one of the questions
``goal_red``, ``goal_green`` (effective goals, the paper's strings) and ``relation`` (friendly,
neutral, adversarial). ``response_time`` [s] is optional. Columns come in any order; others are
refused. Cells of all but the first two may be empty; nothing is assumed in their place. The file is
UTF-8, with cells separated by commas. Case and spaces around an answer do not matter. Other worlds
than PHASE have their own questions (:func:`~phase_ppl.evaluation.prediction.questions_of`), such as
``goal_purple`` and ``relation_red_purple``.

Raters' files of a public study of PHASE are read too: a folder with a text file per rater. The
repository Isik-lab/SocialGNN has them; those of the test videos are in
``PHASE/Human_Experiment_Files/responses_genset``. The first line of a file is about the person and
is not read. 23 lines follow, one per film, each a JSON list of [key, value] pairs. Only
``video_name`` and ``likert_response``, the relation, are read. Three films, whose names end in
``_mm.mp4``, are attention checks: the right answer is the relation of the goals in the name. As in
that study, only complete files with all three checks right are kept.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import pandas as pd

from phase_ppl.data.authors.videos import parse_name
from phase_ppl.data.documents import Faults, in_front, of_kind, read_rows, reading_bytes, too_large
from phase_ppl.data.generated import MANIFEST, PLAN, GeneratedEvents
from phase_ppl.data.load import load_events
from phase_ppl.evaluation.evaluation import EVENTS, SETTINGS
from phase_ppl.evaluation.metrics import participant_accuracy
from phase_ppl.evaluation.prediction import checked_answer, questions_of, reference_predictions
from phase_ppl.evaluation.ratings import Judgments
from phase_ppl.evaluation.table import world_of
from phase_ppl.world.errors import (
    InvalidEventError,
    UnknownNameError,
    check_name,
    instance_of,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, existing_file
from phase_ppl.world.scene import PHASE, World, check_is_phase

_NOT_AVAILABLE: Final = ("NA", "N/A", "NaN", "nan", "None", "null", "NULL")
"""Texts that R, pandas, spreadsheets and JSON write for missing values."""


def columns_of(world: World) -> tuple[str, ...]:
    """Return all columns of the table of a study about events of a world."""
    return ("participant", "video", *questions_of(world), "response_time")


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """Participants' judgments of videos.

    Attributes:
        table: a row per participant and video, with the columns :func:`columns_of`; answers as the
            labels spell them, None if missing; response times in seconds, NaN if missing.
        world: world of the events.
        summary: which of the raters' files were kept, and why others were not; "" for a CSV file.
    """

    table: pd.DataFrame
    world: World = PHASE
    summary: str = ""

    @property
    def participants(self) -> tuple[str, ...]:
        """The participants, in order of appearance."""
        return tuple(self.table["participant"].unique().tolist())

    @functools.cached_property
    def judgments(self) -> Mapping[str, Judgments]:
        """Video -> judgments of the participants who answered a question about it."""
        answers = self.table.set_index("participant")[["video", *questions_of(self.world)]]
        found = {
            video: Judgments.of_responses(
                {who: dict(row.dropna()) for who, row in rows.drop(columns="video").iterrows()},
                self.world,
            )
            for video, rows in answers.groupby("video", sort=False)
        }
        return {video: judgments for video, judgments in found.items() if judgments.n_raters}

    def accuracy(self, events: Sequence[Event]) -> dict[str, Any]:
        """Return people's accuracy as in the paper: per participant, then averaged.

        Args:
            events: with their truth; events without answers in the study do not count.

        Returns:
            As :func:`~phase_ppl.evaluation.metrics.participant_accuracy`.

        Raises:
            InvalidEventError: the study has answers to none of the events.
        """
        return participant_accuracy(with_judgments(events, self))

    def __repr__(self) -> str:
        return (
            f"<Study of {len(self.judgments)} videos, {len(self.participants)} participants, "
            f"{len(self.table)} rows{self.summary and f': {self.summary}'}>"
        )


def load_judgments(
    path: str | os.PathLike[str],
    events: str | os.PathLike[str] | Sequence[Event] | None = None,
) -> Study:
    """Read a study from a CSV file or from raters' files, in the formats that the module describes.

    Args:
        path: of the file; or the folder of raters' files of the public study, or one of them.
        events: events that may be judged, or their file or folder, of one world; it decides the
            questions. A CSV row about another video is an error; a rater's answer about one is
            left out. Default: any events of PHASE.

    Raises:
        InvalidEventError: there is no such file, or it is no such table: columns are missing, a
            row has too many or too few cells, no participant or video, a time that is no number
            of seconds, or a participant judges a video twice; or nothing is answered.
        UnknownNameError: a column, goal, relation or video is unknown; the message names close
            matches. Messages begin with the file, and the line where it is one.
    """
    judged = None if events is None else all_events(events)
    videos = None if judged is None else [event.id for event in judged]
    world = world_of(judged or ())
    source = as_path(path)
    if source.is_dir() or _begins_a_list(source):
        check_is_phase(world, "a rater's file")
        return _study(path, *read_raters(source, videos))

    def check(cells: dict[str, str]) -> dict[str, Any]:
        row = _row(cells, world)
        if videos is not None:
            check_name("video", row["video"], videos)
        return row

    check_header = functools.partial(_check_header, world, events is not None)
    rows = read_rows(path, check, check_header, once=("participant", "video"))
    return _study(path, rows, "", world)


def _study(
    path: str | os.PathLike[str],
    rows: Sequence[Mapping[str, Any]],
    summary: str,
    world: World = PHASE,
) -> Study:
    if not any(row.get(question) for row in rows for question in questions_of(world)):
        raise InvalidEventError(f"{path}: holds no judgments{' of these events' * bool(summary)}")
    # plain objects: pandas' own text would make NaN of None
    cells = [[row.get(name) for name in columns_of(world)] for row in rows]
    table = pd.DataFrame(cells, columns=list(columns_of(world)), dtype=object)
    return Study(table.astype({"response_time": float}), world, summary)


def with_judgments(events: Sequence[Event], study: Study) -> list[Event]:
    """Return the events with their judgments replaced by those of a study.

    Raises:
        InvalidEventError: the study has answers to none of the events.
    """
    if (world := world_of(events)) != study.world:
        of = ("another " if world.name == study.world.name else "") + repr(world.name)
        raise InvalidEventError(
            f"the study is about the world {study.world.name!r}, the events are of {of}"
        )
    records = {video: given.to_record() for video, given in study.judgments.items()}
    found = [dataclasses.replace(event, judgments=records.get(event.id)) for event in events]
    if all(event.judgments is None for event in found):
        some = ", ".join(shown(video) for video in list(study.judgments)[:3])
        raise InvalidEventError(f"the study is of none of the {len(events)} events, but of {some}")
    return found


def _check_header(world: World, of_events: bool, header: Sequence[str]) -> None:
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        raise InvalidEventError(f"is {shown(header[0])}, expected cells separated by commas")
    faults = Faults()
    for name in dict.fromkeys(header):
        with faults.noted():
            if not name:
                raise InvalidEventError(
                    "has a column without a name, as pandas writes its index (index=False leaves "
                    "it out) and Excel empty ones"
                )
            if name not in columns_of(world):
                error = unknown_name("column", name, columns_of(world))
                why = f"the events are of the world {world.name!r}"
                raise UnknownNameError(
                    f"{error} "
                    f"({why if of_events else 'without its events a study is one of PHASE'})"
                )
            if header.count(name) > 1:
                raise InvalidEventError(f"names the column {name} twice")
    faults.check()
    missing = [name for name in ("participant", "video") if name not in header]
    if missing:
        raise InvalidEventError(f"names no column {' and no column '.join(missing)}")
    if not any(name in questions_of(world) for name in header):
        raise InvalidEventError(f"names none of the columns {', '.join(questions_of(world))}")


def _row(cells: Mapping[str, str], world: World) -> dict[str, Any]:
    row: dict[str, Any] = {}
    faults = Faults()
    for name in ("participant", "video"):
        with faults.noted():
            if not cells[name] or not cells[name].isprintable():
                raise InvalidEventError(f"{name} is {shown(cells[name])}, expected printable text")
            row[name] = cells[name]
    for question in questions_of(world):
        answer = cells.get(question)
        with faults.noted(f"{question}: "):
            if answer in _NOT_AVAILABLE:
                raise InvalidEventError(f"{answer}, expected an empty cell where there is none")
            row[question] = checked_answer(question, answer, world) if answer else None
    seconds = cells.get("response_time", "")
    with faults.noted():
        row["response_time"] = math.nan
        is_number = re.fullmatch(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", seconds)
        if seconds and not (is_number and math.isfinite(float(seconds))):
            raise InvalidEventError(
                f"response_time is {shown(seconds)}, expected seconds, such as 12.4"
            )
        if seconds:
            row["response_time"] = float(seconds)
    faults.check()
    return row


# --- raters' files --------------------------------------------------------------------------------

FILMS: Final = 23  # answers in a complete file
CHECKS: Final = 3  # attention checks among them
_CHECK: Final = "_mm.mp4"
_MAX_BYTES: Final = 2**20


def _begins_a_list(path: Path) -> bool:
    source = existing_file(path)
    with in_front(f"{path}: "), reading_bytes("a file of judgments"), open(source, "rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \r\n").startswith(b"[")


def read_raters(path: Path, videos: Collection[str] | None) -> tuple[list[dict[str, str]], str]:
    """Return raters' answers about ``videos`` (None: all) as rows of a study, and a summary.

    Raises:
        InvalidEventError: there is no rater's file, none is kept, or a complete one has an invalid
            line; the message names file and line.
        UnknownNameError: a relation is unknown.
    """
    files = sorted(path.glob("*.txt")) if path.is_dir() else [path]
    if not files:
        raise InvalidEventError(f"{path}: the folder holds no raters' files (.txt)")
    kept: list[dict[str, str]] = []
    left_out: Counter[str] = Counter()
    for file in files:
        answers, checks = _read_rater(file)
        if (len(answers), len(checks)) != (FILMS - CHECKS, CHECKS):
            left_out["incomplete"] += 1
        elif not all(checks.values()):
            left_out["with a wrong attention check"] += 1
        else:
            kept.append(answers)
    reasons = [f"{n} {reason}" for reason, n in sorted(left_out.items())]
    summary = ", ".join([f"{len(kept)} of {len(files)} raters' files kept", *reasons])
    if not kept:
        raise InvalidEventError(f"{path}: {summary}")
    width = len(str(len(kept)))
    rows = [
        {"participant": f"rater-{number:0{width}}", "video": video, "relation": relation}
        for number, answers in enumerate(kept, 1)
        for video, relation in answers.items()
        if videos is None or video in videos
    ]
    return rows, summary


def _read_rater(file: Path) -> tuple[dict[str, str], dict[str, bool]]:
    """Return video -> relation and check -> whether it is right; empty without 24 lines."""
    with in_front(f"{file}: "), reading_bytes("a rater's file"), open(file, "rb") as opened:
        content = opened.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise InvalidEventError(f"{file}: {too_large(_MAX_BYTES)}")
    answers: dict[str, str] = {}
    checks: dict[str, bool] = {}
    lines = content.splitlines()
    for number, line in enumerate(lines[1:] if len(lines) == 1 + FILMS else [], 2):
        with in_front(f"{file}, line {number}: "):
            try:
                given = dict(msgspec.json.decode(line, type=list[tuple[str, str]]))
            except msgspec.DecodeError:
                raise InvalidEventError("is no JSON list of [key, value] pairs") from None
            film = of_kind("video_name", given.get("video_name"), str)
            answer = of_kind("likert_response", given.get("likert_response"), str)
            relation = checked_answer("relation", answer, PHASE)
            said = parse_name(film)
            if film.endswith(_CHECK):
                checks[film] = said.truth is not None and relation == said.truth.relation
            else:
                answers[said.id] = relation
    return answers, checks


# --- the events of an evaluation, and people's judgments of them ----------------------------------

GENERATED: Final = (MANIFEST, PLAN)  # files that mark the folder of a generated data set
EVENT_FILES: Final = (".json", ".nc")  # endings of the files that are read from a folder of events


def all_events(
    events: str | os.PathLike[str] | Event | Sequence[Event], split: str | None = None
) -> list[Event]:
    """Return the events of a file or folder, or the given events, checked.

    Args:
        events: a file, a folder of files or a generated data set; an event, or several.
        split: of a generated data set, only the events of that part.

    Raises:
        InvalidEventError: a file cannot be read, two events have one id, or there are no splits.
        InvalidSettingError: ``events`` are none of these.
    """
    if split is not None:
        path = events if isinstance(events, str | os.PathLike) else None
        generated = events if path is None else load_events(path)
        if not isinstance(generated, GeneratedEvents):
            raise InvalidEventError(f"split {split!r}: only generated data sets have splits")
        return list(generated.split(split))
    if isinstance(events, Event):
        sources: list[tuple[str, Sequence[Event]]] = [("", [events])]
    elif isinstance(events, str | os.PathLike):
        sources = [(f" in {file}", load_events(file)) for file in _files(events)]
    else:
        instance_of("events", events, Iterable, "a file, a folder or events")
        sources = [("", list(events))]
    seen: dict[str, str] = {}
    for where, found in sources:
        for event in found:
            if not isinstance(event, Event):
                raise InvalidEventError(f"{shown(event)} is no event; phase_ppl.load_events reads")
            if event.id in seen:
                both = f"{seen[event.id]} and{where}" if where else ""
                raise InvalidEventError(f"there are two events with the id {event.id!r}{both}")
            seen[event.id] = where
    if not seen:
        raise InvalidEventError("there are no events to evaluate")
    return [event for _, found in sources for event in found]


def _files(path: str | os.PathLike[str]) -> list[Path]:
    source = Path(path)
    if not source.is_dir() or any((source / name).is_file() for name in GENERATED):
        return [source]
    if (source / SETTINGS).is_file() and (source / EVENTS).is_file():
        raise InvalidEventError(
            f"{source} holds an evaluation; its events are in {source / EVENTS}"
        )
    files = sorted(file for file in source.iterdir() if file.suffix.lower() in EVENT_FILES)
    if not files:
        endings = ", ".join(EVENT_FILES)
        raise InvalidEventError(f"{source}: the folder holds no event files ({endings})")
    return files


def judged(
    events: list[Event], judgments: str | os.PathLike[str] | Study | None
) -> Sequence[Event]:
    """Return the events with people's judgments; judgments that cannot be scored raise now."""
    if judgments is not None:
        study = judgments if isinstance(judgments, Study) else load_judgments(judgments, events)
        events = with_judgments(events, study)
    reference_predictions(events)
    for event in events:
        Judgments.of(event)
    return events
