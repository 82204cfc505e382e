"""Studies of people's judgments: tables of answers, and raters' files.

A table has a row per participant and video. It names ``participant`` and ``video`` (the id of the
event), and at least one of the questions (:func:`~phase_ppl.evaluation.prediction.questions_of`);
goals are effective. docs/judgments.md has all columns and the other forms that are read.

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
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import pandas as pd

from phase_ppl.data.authors import parse_name
from phase_ppl.data.documents import Keep, in_front, of_kind, reading_bytes, too_large
from phase_ppl.evaluation.answers_file import (
    COLUMNS,
    Graded,
    Source,
    marked,
    read_answers,
    summed_up,
)
from phase_ppl.evaluation.folder import all_events
from phase_ppl.evaluation.metrics import participant_accuracy
from phase_ppl.evaluation.prediction import checked_answer, reference_predictions
from phase_ppl.evaluation.ratings import Given, Judgments, Rows
from phase_ppl.evaluation.table import world_of
from phase_ppl.world.errors import (
    InvalidEventError,
    shown,
)
from phase_ppl.world.event import Event
from phase_ppl.world.files import as_path, existing_file
from phase_ppl.world.scene import PHASE, World, check_is_phase


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """Participants' judgments of videos. ``print`` says what was read, and how.

    Attributes:
        table: a row per participant, event, question, answer and moment. Columns: ``participant``,
            ``event``, ``question``; ``answer``, as the labels spell it; ``value``, the share that
            the person gave to this answer, 1 for a chosen label; ``at``, seconds of the film that
            the person had seen (NaN: all of it); ``response_time``, seconds (NaN: missing). If the
            file has them, also ``rating``, what the share was computed from; ``confidence``;
            ``rehearsal``, true for scripted people; and further columns of the file, as text or
            None.
        world: world of the events.
        summary: what was done with the file: what was left out, and why; which of raters' files
            were kept. A line each.
    """

    table: pd.DataFrame
    world: World = PHASE
    summary: str = ""

    @functools.cached_property
    def judgments(self) -> Mapping[str, Judgments]:
        """Event id -> judgments of the participants who answered a question about the event."""
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
        return {video: one for video, one in found.items() if one.counts or one.moments}

    def accuracy(self, events: Sequence[Event]) -> dict[str, Any]:
        """Return people's accuracy as in the paper: per participant, then averaged.

        Args:
            events: events with their truth; events without answers in the study do not count.

        Returns:
            What :func:`~phase_ppl.evaluation.metrics.participant_accuracy` returns.

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
    path: Source,
    events: str | os.PathLike[str] | Sequence[Event] | None = None,
    *,
    names: Mapping[str, str | None] | None = None,
    na: Sequence[str] = (),
    repeated: Keep = "refuse",
    milliseconds: bool | None = None,
    graded: Graded = "divide",
    temperature: float | None = None,
) -> Study:
    """Read a study from a table or from raters' files (:mod:`phase_ppl.evaluation.judgments`).

    A table has a row per participant and video, with ``participant``, ``video`` and a column per
    question. It may come from pandas, R, Excel, jsPsych or Qualtrics. Cells are separated by
    commas, semicolons or tabs. A column of row numbers, empty columns and the usual texts for
    missing values are allowed. Further columns are kept. Rows without an answer or a video are left
    out.

    Args:
        path: a table's file or a :class:`pandas.DataFrame`; or a rater's file of the public study,
            or the folder of such files. The options after ``events`` are for tables.
        events: the events that were judged, or their file or folder, all of one world. Their world
            decides the questions. In a table, a video that is not among them is an error; in
            raters' files it is left out. Default: any events of PHASE.
        names: name in the table -> the package's name, for columns, questions, answers and videos;
            None leaves a column out.
        na: further texts for missing values, such as "-99".
        repeated: which answer counts if a person answered a question about a video twice: "first"
            or "last". By default, "refuse", such a table is an error that names all such answers.
        milliseconds: whether ``response_time`` and ``at`` are in milliseconds. By default the
            median of each column decides.
        graded: how ratings become shares: "divide" by their sum, or "softmax", exp(rating /
            temperature) divided by its sum.
        temperature: temperature of the softmax, in units of the ratings. By default it is fitted,
            so that ratings best predict other people's leading answers.

    Raises:
        InvalidEventError: there is no such file, or it is not such a table. Columns are missing, a
            row has too many or too few cells, or no participant; a time or rating is no number; a
            participant judges a video twice; or nothing is answered.
        InvalidSettingError: ``temperature`` is not positive, or there are no answers to fit it to.
        UnknownNameError: a column, goal, relation, video or option is unknown; the message names
            close matches.

    Messages begin with the file, and with the line number if one line is at fault.
    """
    judged = None if events is None else all_events(events)
    videos = None if judged is None else [event.id for event in judged]
    world = world_of(judged or ())
    if not isinstance(path, pd.DataFrame):
        source = as_path(path)
        if source.is_dir() or _begins_a_list(source):
            check_is_phase(world, "a rater's file")
            return read_raters(source, videos)
    table, notes = read_answers(
        path, world, videos, names=names, na=na, repeated=repeated, milliseconds=milliseconds,
        graded=graded, temperature=temperature,
    )  # fmt: skip
    if table.empty:
        name = "the table" if isinstance(path, pd.DataFrame) else path
        raise InvalidEventError(": ".join([f"{name}: holds no judgments", *notes]))
    return Study(table, world, "\n".join(notes))


def with_judgments(events: Sequence[Event], study: Study) -> list[Event]:
    """Return the events with their judgments replaced by those of a study.

    Events that the study does not have lose their judgments.

    Raises:
        InvalidEventError: the study has answers to none of the events, or is about another world.
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


# --- raters' files --------------------------------------------------------------------------------

FILMS: Final = 23  # answers in a complete file
CHECKS: Final = 3  # attention checks among them
_CHECK: Final = "_mm.mp4"
_MAX_BYTES: Final = 2**20


def _begins_a_list(path: Path) -> bool:
    source = existing_file(path)
    with in_front(f"{path}: "), reading_bytes("a file of judgments"), open(source, "rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \r\n").startswith(b"[")


def read_raters(path: Path, videos: Collection[str] | None) -> Study:
    """Return the study of raters' answers about ``videos`` (None: all).

    Raises:
        InvalidEventError: there is no rater's file, none is kept, or a complete one has an invalid
            line; the message names file and line. Or none of these videos was judged.
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


# --- events with people's judgments ---------------------------------------------------------------


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
