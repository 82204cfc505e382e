"""Studies of people's judgments: tables of answers, and raters' files.

::

    participant,video,goal_red,goal_green,relation,response_time
    p01,collaborate,Get pink item to red lm,Get pink item to red lm,friendly,12.4
    p01,oppose,get to green agent,get away from red agent,adversarial,8.1
    p02,collaborate,Get pink item to red lm,,friendly,

A table has a row per participant and video. It names ``participant`` and ``video`` (the id of the
event), and at least one of the questions (:func:`~phase_ppl.evaluation.prediction.questions_of`);
goals are effective. ``response_time`` [s] is optional. Cells of all but ``participant`` may be
empty; nothing is assumed in their place. Case and spaces around an answer do not matter.

Graded answers have a column for each label, such as ``friendly`` or ``relation friendly``, with
numbers of at least 0. ``at`` [s] is the moment of the film until which a person had seen it.
``confidence`` is kept beside the answers. ``rehearsal``, true or false, marks answers of scripted
people; participants named ``scripted-...`` count as marked. A table may also have a row per answer,
with the columns ``question`` and ``answer``, and for graded ones ``value``.

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
import difflib
import functools
import math
import os
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
import pandas as pd

from phase_ppl.data.authors.videos import parse_name
from phase_ppl.data.documents import (
    Faults,
    checked_rows,
    in_front,
    of_kind,
    read_rows,
    reading_bytes,
    too_large,
)
from phase_ppl.evaluation.evaluation import all_events
from phase_ppl.evaluation.metrics import participant_accuracy
from phase_ppl.evaluation.prediction import checked_answer, questions_of, reference_predictions
from phase_ppl.evaluation.ratings import REHEARSAL, Given, Judgments, Rows
from phase_ppl.evaluation.table import world_of
from phase_ppl.world.errors import (
    InvalidEventError,
    PhasePPLError,
    UnknownNameError,
    check_name,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path
from phase_ppl.world.scene import PHASE, World, check_is_phase

Source: TypeAlias = "str | os.PathLike[str] | pd.DataFrame"


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """Participants' judgments of videos. ``print`` says what was read, and how.

    Attributes:
        table: a row per participant, event, question, answer and moment. Columns are
            ``participant``, ``event``, ``question`` and ``answer``, as the labels spell it;
            ``value``, its share of the person's answer: 1 for a label; ``at``, seconds of the film
            until which it had been seen (NaN: all of it); ``response_time`` in seconds, NaN if
            missing. Where they were given, there are ``confidence``; ``rehearsal``, true for
            scripted people; and further columns of the file, as text or None.
        world: world of the events.
        summary: what was done with the file: what was left out, and why; which of raters' files
            were kept. A line each.
    """

    table: pd.DataFrame
    world: World = PHASE
    summary: str = ""

    @functools.cached_property
    def judgments(self) -> Mapping[str, Judgments]:
        """Video -> judgments of the participants who answered a question about it."""
        found = {}
        for event, rows in self.table.groupby("event", sort=False):
            said: dict[float | None, dict[str, dict[str, dict[str, float]]]] = {None: {}}
            of_event = rows[["at", "participant", "question", "answer", "value"]]
            for at, who, question, answer, value in of_event.itertuples(index=False):
                of_moment = said.setdefault(None if math.isnan(at) else at, {})
                if value > 0:
                    of_moment.setdefault(who, {}).setdefault(question, {})[answer] = value
            given: dict[Any, Rows] = {
                at: {
                    who: {question: _label_or_shares(one) for question, one in row.items()}
                    for who, row in of_moment.items()
                }
                for at, of_moment in said.items()
            }
            one = Judgments.of_responses(given.pop(None), self.world, given)
            found[event] = dataclasses.replace(one, rehearsal=marked(rows))
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

    def __str__(self) -> str:
        return "\n".join(filter(None, [summed_up(self.table, self.world), self.summary]))

    def __repr__(self) -> str:
        return f"<Study: {summed_up(self.table, self.world)}>"


def _label_or_shares(shares: Mapping[str, float]) -> Given:
    """Return an answer as a label if it has the whole share, alone."""
    return next(iter(shares)) if [*shares.values()] == [1] else shares


def load_judgments(
    path: Source, events: str | os.PathLike[str] | Sequence[Event] | None = None
) -> Study:
    """Read a study from a table or from raters' files, in the formats that the module describes.

    Cells are separated by commas, semicolons or tabs. Columns of other names are kept. Rows without
    an answer or a video are left out. Ratings of the labels are divided by their sum.

    Args:
        path: of the file, or a :class:`pandas.DataFrame`; or the folder of raters' files of the
            public study.
        events: events that may be judged, or their file or folder, of one world; it decides the
            questions. A row about another video is an error; a rater's answer about one is left
            out. Default: any events of PHASE.

    Raises:
        InvalidEventError: there is no such file, or it is no such table: columns are missing, a
            row has too many or too few cells, no participant, a time or rating that is no number,
            or a participant judges a video twice; or nothing is answered.
        UnknownNameError: a column, goal, relation or video is unknown; the message names close
            matches. Messages begin with the file, and the line where it is one.
    """
    judged = None if events is None else all_events(events)
    videos = None if judged is None else [event.id for event in judged]
    world = world_of(judged or ())
    if not isinstance(path, pd.DataFrame):
        source = as_path(path)
        if source.is_dir():
            check_is_phase(world, "a rater's file")
            return read_raters(source, videos)
    table, notes = _read_table(path, world, videos)
    if table.empty:
        name = "the table" if isinstance(path, pd.DataFrame) else path
        raise InvalidEventError(": ".join([f"{name}: holds no judgments", *notes]))
    return Study(table, world, "\n".join(notes))


def with_judgments(events: Sequence[Event], study: Study) -> list[Event]:
    """Return the events with a study's judgments; events that it lacks have none.

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


# --- tables of answers ----------------------------------------------------------------------------

COLUMNS: Final = ("participant", "event", "question", "answer", "value", "at", "response_time")
"""Columns of the tidy table that are always there."""

_NOT_AVAILABLE: Final = frozenset(
    ("NA", "N/A", "n/a", "NaN", "nan", "None", "null", "NULL", "#N/A", "#NULL!", "<NA>", ".", "NaT")
)
"""Texts that R, pandas, spreadsheets, statistics programs and JSON write for missing values."""

_MARKED: Final = ("true", "t", "1", "1.0", "yes")
_NOT_MARKED: Final = ("false", "f", "0", "0.0", "no", "")

_INDEX: Final = re.compile(r"|Unnamed: \d+")
"""Names that pandas and Excel give to columns that have none."""

_MOST: Final = 1e15  # of ratings and seconds
_CLOSE: Final = 0.8  # similarity from which a name of a column is taken as misspelt
_FIELDS: Final = ("participant", "video", *COLUMNS[2:])
_NUMBERS: Final = {
    **dict.fromkeys(("response_time", "at"), "seconds, such as 12.4"),
    **dict.fromkeys(("value", "confidence"), "a number of 0 or more, such as 70"),
}
"""Columns of numbers -> what they should hold."""

_ONCE: Final = ("participant", "video", "question", "answer", "at")
_PAIR: Final = ["participant", "event", "question", "at"]


class _Column(NamedTuple):
    """What a column holds."""

    field: str  # "participant", "label", "rating" or another; "further"; "": not read
    question: str = ""
    label: str = ""


@functools.lru_cache(8)
def _known(world: World) -> Mapping[str, _Column]:
    """Return name -> column, of all that have a meaning."""
    found = {name: _Column(name) for name in (*_FIELDS, "confidence", "rehearsal")}
    found["event"] = found["video"]
    labels = Counter(label for of in questions_of(world).values() for label in of)
    for question, answers in questions_of(world).items():
        found[_plain(question)] = _Column("label", question)
        for label in answers:
            found[_plain(f"{question} {label}")] = _Column("rating", question, label)
            if labels[label] == 1:
                found.setdefault(_plain(label), _Column("rating", question, label))
    return found


def _plain(name: str) -> str:
    """Return a name without case, spaces and marks: R writes "relation..friendly"."""
    return re.sub(r"\W+", "_", name.lower()).strip("_")


def _read_table(
    source: Source, world: World, videos: Sequence[str] | None
) -> tuple[pd.DataFrame, list[str]]:
    """Return the tidy table of a file or table, and what was done with it, a line each."""
    reader = _Reader(world, videos)
    try:
        if isinstance(source, pd.DataFrame):
            with in_front("the table"):
                rows = checked_rows(_cells(source), reader.row, reader.header, _ONCE)
        else:
            rows = read_rows(source, reader.row, reader.header, _ONCE)
    except PhasePPLError as error:
        if reader.unknown:
            why = "all events of the study may be given, evaluate takes fewer"
            raise type(error)(f"{error} ({why})") from None
        raise
    columns = [*COLUMNS, "confidence", "rehearsal", *reader.further]
    # plain objects: pandas' own text would make NaN of None
    cells = [[one.get(name) for name in columns] for row in rows for one in row["rows"]]
    table = pd.DataFrame(cells, columns=columns, dtype=object)
    table = table.astype({**dict.fromkeys(_NUMBERS, float), "rehearsal": bool})
    left_out = Counter({"without an answer or a video": reader.left_out})
    rated = table["value"].notna()
    groups = [table[name] for name in _PAIR]
    graded = rated.groupby(groups, dropna=False).transform("any")
    total = table["value"].groupby(groups, dropna=False).transform("sum")
    left_out["of graded answers, without a number"] = int((graded & ~rated).sum())
    zeros = rated & (total == 0)
    left_out["graded answers of zeros only"] = table[zeros].drop_duplicates(_PAIR).shape[0]
    table["value"] = (table["value"] / total.where(total > 0)).where(graded, 1.0)
    table = table[(rated | ~graded) & ~zeros].reset_index(drop=True)
    table["rehearsal"] |= table["participant"].str.startswith(Judgments.SCRIPTED)
    if table["confidence"].isna().all():
        table = table.drop(columns="confidence")
    if not table["rehearsal"].any():
        table = table.drop(columns="rehearsal")
    notes = ["ratings were divided by their sum, answer by answer"] if rated.any() else []
    if dropped := [f"{n} {why}" for why, n in left_out.items() if n]:
        notes.append(f"rows left out: {', '.join(dropped)}")
    if reader.further:
        notes.append(f"kept as they are: {', '.join(reader.further)}")
    return table, notes


def _cells(table: pd.DataFrame) -> list[tuple[int, list[str]]]:
    """Return the cells of a table as text; rows are numbered as the lines of its CSV file."""
    named = [name for name in table.index.names if name is not None and name not in table.columns]
    given = table.reset_index(named) if named else table
    text = given.astype(object).where(given.notna(), "").map(lambda cell: str(cell).strip())
    rows = [[str(name).strip() for name in given.columns], *text.to_numpy().tolist()]
    return [(line, cells) for line, cells in enumerate(rows, 1) if line == 1 or any(cells)]


class _Reader:
    """Reads the rows of a table, given what its columns mean."""

    def __init__(self, world: World, videos: Sequence[str] | None) -> None:
        self.world, self.videos = world, videos
        self.columns: dict[str, _Column] = {}
        self.left_out = 0  # rows without an answer or a video
        self.unknown = False  # whether a video has no event

    @property
    def further(self) -> list[str]:
        """The columns that are kept as they are."""
        return [name for name, column in self.columns.items() if column.field == "further"]

    def header(self, header: Sequence[str]) -> None:
        """Note what the columns mean (InvalidEventError, UnknownNameError: it cannot be told)."""
        faults = Faults()
        by_meaning: dict[_Column, str] = {}
        for name in dict.fromkeys(header):
            with faults.noted():
                found = self.columns[name] = self._column(name)
                if found.field in ("", "further"):
                    continue
                if header.count(name) > 1:
                    raise InvalidEventError(f"names the column {name} twice")
                other = by_meaning.setdefault(found, name)
                if other != name:
                    raise InvalidEventError(f"the columns {other} and {name} mean the same")
        faults.check()
        fields = {column.field for column in self.columns.values()}
        missing = [name for name in ("participant", "video") if name not in fields]
        if missing:
            raise InvalidEventError(f"names no column {' and no column '.join(missing)}")
        if "question" in fields and "answer" not in fields:
            raise InvalidEventError("names a column question, but no column answer")
        if not fields & {"label", "rating", "question"}:
            questions = ", ".join(questions_of(self.world))
            raise InvalidEventError(f"names none of the columns {questions}")

    def _column(self, name: str) -> _Column:
        """Return what a column means (UnknownNameError: its name looks misspelt)."""
        if _INDEX.fullmatch(name):
            return _Column("")
        plain = _plain(name)
        found = _known(self.world).get(plain)
        if found is not None:
            return found
        allowed = (*_FIELDS, *questions_of(self.world), "confidence")
        asks = plain.startswith(("goal_", "relation"))
        if not asks and not difflib.get_close_matches(plain, allowed, 1, _CLOSE):
            return _Column("further")
        why = f"the events are of the world {self.world.name!r}"
        if self.videos is None:
            why = "without its events a study is one of PHASE"
        raise UnknownNameError(f"{unknown_name('column', name, allowed)} ({why})")

    def row(self, cells: Mapping[str, str]) -> dict[str, Any]:
        """Return what identifies a row, and its ``rows`` of the tidy table."""
        faults = Faults()
        given = {n: "" if cells[n] in _NOT_AVAILABLE else cells[n] for n in self.columns if n}
        by_field = {self.columns[n].field: cell for n, cell in given.items()}
        found: dict[str, Any] = dict.fromkeys(_ONCE)
        for name in ("participant", "video"):
            with faults.noted():
                found[name] = by_field[name]
                missing = not found[name] and name == "participant"
                if missing or not found[name].isprintable():
                    raise InvalidEventError(f"{name} is {shown(found[name])}, expected printable "
                                            "text")  # fmt: skip
        numbers: dict[str, float | None] = dict.fromkeys(_NUMBERS)
        for name, expected in _NUMBERS.items():
            with faults.noted():
                numbers[name] = _number(name, by_field.get(name, ""), expected)
        value = numbers.pop("value")
        answers = self._answers(given, by_field, value, found, faults)
        found["at"] = numbers["at"]
        shared: dict[str, Any] = {n: given[n] or None for n in self.further}
        shared |= {**numbers, "participant": found["participant"], "event": found["video"]}
        with faults.noted():
            said = by_field.get("rehearsal", "").lower()
            shared["rehearsal"] = said in _MARKED
            if said not in (*_MARKED, *_NOT_MARKED):
                raise InvalidEventError(f"rehearsal is {shown(said)}, expected true or false")
        rows = [
            {**shared, "question": question, "answer": label, "value": rating}
            for question, of_question in answers.items()
            for label, rating in of_question.items()
        ]
        if not rows or not found["video"]:
            self.left_out += 1
            rows = []
            found["answer"] = object()  # is like no other
        elif self.videos is not None:
            self.unknown |= found["video"] not in self.videos
            with faults.noted():
                check_name("video", found["video"], self.videos)
        faults.check()
        return {**found, "rows": rows}

    def _answers(
        self,
        given: Mapping[str, str],
        by_field: Mapping[str, str],
        value: float | None,
        found: dict[str, Any],
        faults: Faults,
    ) -> dict[str, dict[str, float | None]]:
        """Return question -> label -> rating; None: it is the answer."""
        answers: dict[str, dict[str, float | None]] = {}
        for name, column in self.columns.items():
            cell = given.get(name)
            if not cell or not column.question:
                continue
            of_question = answers.setdefault(column.question, {})
            with faults.noted(f"{column.question}: " if column.field == "label" else ""):
                if column.field == "rating":
                    of_question[column.label] = _number(name, cell, _NUMBERS["value"])
                else:
                    of_question[checked_answer(column.question, cell, self.world)] = None
                if len({rating is None for rating in of_question.values()}) > 1:
                    raise InvalidEventError(f"has an answer and ratings of {column.question}")
        asked, answer = by_field.get("question", ""), by_field.get("answer", "")
        if asked and answer and by_field["video"]:
            with faults.noted():
                plain = {_plain(one): one for one in questions_of(self.world)}
                question = plain.get(_plain(asked))
                if question is None:
                    raise unknown_name("question", asked, tuple(plain.values()))
                label = checked_answer(question, answer, self.world)
                answers[question] = {label: value}
                found["question"] = question
                found["answer"] = None if value is None else label
        return answers


def _number(name: str, cell: str, expected: str) -> float | None:
    """Return a number of at least 0; None: there is none. Decimal commas and % are understood."""
    if not cell:
        return None
    text = cell.removesuffix("%").rstrip()
    text = text.replace(",", ".") if text.count(",") == 1 and "." not in text else text
    number = float(text) if re.fullmatch(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", text) else np.inf
    if number > _MOST:
        raise InvalidEventError(f"{name} is {shown(cell)}, expected {expected}")
    return number


def marked(table: pd.DataFrame) -> bool:
    """Whether a tidy table, or a part of it, has answers of scripted people."""
    return "rehearsal" in table and bool(table["rehearsal"].eq(True).any())


def summed_up(table: pd.DataFrame, world: World) -> str:
    """Return how many people, events and answers a tidy table has, in a line."""
    answers = table.drop_duplicates(_PAIR)
    counts = answers["question"].value_counts().reindex([*questions_of(world)]).dropna().astype(int)
    asked = [f"{question} {n}" for question, n in counts.items()]
    moments = answers["at"].dropna()
    n = moments.nunique()
    seen = f", {len(moments)} of them at {n} moment{'s' * (n != 1)}" if n else ""
    return (
        f"{REHEARSAL}: "
        * marked(table)
        + f"{table['event'].nunique()} events, {table['participant'].nunique()} participants, "
        f"{len(answers)} answers ({', '.join(asked)}){seen}"
    )


# --- raters' files --------------------------------------------------------------------------------

FILMS: Final = 23  # answers in a complete file
CHECKS: Final = 3  # attention checks among them
_CHECK: Final = "_mm.mp4"
_MAX_BYTES: Final = 2**20


def read_raters(path: Path, videos: Collection[str] | None) -> Study:
    """Return the study of raters' answers about ``videos`` (None: all).

    Raises:
        InvalidEventError: there is no rater's file, none is kept, or a complete one has an invalid
            line; the message names file and line. Or none of these videos was judged.
        UnknownNameError: a relation is unknown.
    """
    files = sorted(path.glob("*.txt"))
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
        (f"rater-{number:0{width}}", video, "relation", relation, 1.0, math.nan, math.nan)
        for number, answers in enumerate(kept, 1)
        for video, relation in answers.items()
        if videos is None or video in videos
    ]
    if not rows:
        raise InvalidEventError(f"{path}: holds no judgments of these events")
    return Study(pd.DataFrame(rows, columns=[*COLUMNS]), PHASE, summary)


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
