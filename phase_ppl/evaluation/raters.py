"""The raters of a public study of PHASE: a folder with a text file of each.

The repository Isik-lab/SocialGNN has them, those of the test videos in
``PHASE/Human_Experiment_Files/responses_genset``. The first line of a file is about the person
(age, gender, ethnicity) and is not read. 23 lines follow, one a film, each a JSON list of pairs::

    [["video_name", "D082020_1817530_0_F8_E8.1_G['LMO', 0, 2, 1]_....mp4"], ["likert_response",
    "friendly"], ["time", "6/9/2021 @ 14:2:33"], ["subjectID", "..."], ["csv_name", "..."],
    ["question_name", "..."]]

of which the first two are read. Three films, whose names end in ``_mm.mp4``, are checks of
attention: right is the relation that the name's goals make. As in that study, the files are kept
that are complete and have all three right.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any, Final, NamedTuple

from phase_ppl.data.authors.videos import parse_name
from phase_ppl.data.documents import in_front, reading_bytes, require, too_large
from phase_ppl.evaluation.prediction import checked_answer
from phase_ppl.world.errors import InvalidEventError
from phase_ppl.world.files import existing_file
from phase_ppl.world.scene import PHASE

FILMS: Final = 23  # that a complete file has answers to
CHECKS: Final = 3  # of these
_CHECK: Final = "_mm.mp4"
_MAX_BYTES: Final = 2**20


class Raters(NamedTuple):
    """What the raters said whose files were kept."""

    rows: list[dict[str, Any]]  # participant ("rater-01", ...), video, relation
    summary: str  # how many files were kept, and why the others were not


def is_raters(path: Path) -> bool:
    """Return whether this is a folder, or a file that begins as a rater's does."""
    if path.is_dir():
        return True
    source = existing_file(path)
    with in_front(f"{path}: "), reading_bytes("a file of judgments"), open(source, "rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \r\n").startswith(b"[")


def read_raters(path: Path, videos: Collection[str] | None) -> Raters:
    """Return what raters say of these videos, or of all.

    Raises:
        InvalidEventError: no rater's file is there, none is kept, or a complete one has a line that
            is none; the message names file and line.
        UnknownNameError: a relation is unknown.
    """
    files = sorted(path.glob("*.txt")) if path.is_dir() else [path]
    if not files:
        raise InvalidEventError(f"{path}: the folder holds no raters' files (.txt)")
    kept: list[dict[str, str]] = []
    left_out: Counter[str] = Counter()
    for file in files:
        answers, checks = _read(file)
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
    return Raters(rows, summary)


def _read(file: Path) -> tuple[dict[str, str], dict[str, bool]]:
    """Return video -> relation and check -> whether it is right; both are empty but of 24 lines."""
    with in_front(f"{file}: "), reading_bytes("a rater's file"), open(file, "rb") as opened:
        content = opened.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise InvalidEventError(f"{file}: {too_large(_MAX_BYTES)}")
    answers: dict[str, str] = {}
    checks: dict[str, bool] = {}
    lines = content.splitlines()
    for number, line in enumerate(lines[1:] if len(lines) == 1 + FILMS else [], 2):
        with in_front(f"{file}, line {number}: "):
            given = _pairs(line)
            film = require(given, "video_name", str)
            relation = checked_answer("relation", require(given, "likert_response", str), PHASE)
            said = parse_name(film)
            if film.endswith(_CHECK):
                checks[film] = said.truth is not None and relation == said.truth.relation
            else:
                answers[said.id] = relation
    return answers, checks


def _pairs(line: bytes) -> dict[str, Any]:
    """Return key -> value of a line."""
    try:
        pairs = json.loads(line)
        return {str(key): value for key, value in pairs}
    except (ValueError, TypeError, RecursionError):
        raise InvalidEventError("is no JSON list of [key, value] pairs") from None
