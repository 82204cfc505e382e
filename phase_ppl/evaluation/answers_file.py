"""Tables of people's answers, as pandas, R, spreadsheets and survey tools leave them.

They become one tidy table: a row per participant, event, question, answer and moment.
"""

from __future__ import annotations

import difflib
import functools
import os
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
import pandas as pd
from scipy import optimize, special

from phase_ppl.data.documents import Faults, Keep, checked_rows, in_front, read_rows
from phase_ppl.evaluation.prediction import checked_answer, questions_of
from phase_ppl.evaluation.ratings import REHEARSAL, Judgments
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    InvalidEventError,
    InvalidSettingError,
    UnknownNameError,
    check_name,
    instance_of,
    positive_number,
    shown,
    unknown_name,
)
from phase_ppl.world.scene import World

COLUMNS: Final = ("participant", "event", "question", "answer", "value", "at", "response_time")
"""Columns of the tidy table that are always there."""

Graded: TypeAlias = Literal["divide", "softmax"]
"""How ratings of all answers become shares: divided by their sum, or exp(rating / temperature)."""

Source: TypeAlias = "str | os.PathLike[str] | pd.DataFrame"

_NOT_AVAILABLE: Final = frozenset(
    ("NA", "N/A", "n/a", "NaN", "nan", "None", "null", "NULL", "#N/A", "#NULL!", "<NA>", ".", "NaT")
)
"""Texts that R, pandas, spreadsheets, statistics programs and JSON write for missing values."""

_MARKED: Final = ("true", "t", "1", "1.0", "yes")
_NOT_MARKED: Final = ("false", "f", "0", "0.0", "no", "")

_INDEX: Final = re.compile(r"|Unnamed: \d+")
"""Names that pandas and Excel give to columns that have none."""

_MILLISECONDS: Final = 300.0
"""Median from which times are taken as milliseconds: five minutes for one answer, or a moment."""

_MOST: Final = 1e15  # of ratings, seconds and milliseconds
_CLOSE: Final = 0.8  # similarity from which a name of a column is taken as misspelt
_FIELDS: Final = ("participant", "video", *COLUMNS[2:])
_ONCE: Final = ("participant", "video", "question", "answer", "at")
_PAIR: Final = ["participant", "event", "question", "at"]


class _Column(NamedTuple):
    """What a column holds."""

    field: str  # "participant", "label", "rating" or another; "further"; "": not read
    question: str = ""
    label: str = ""
    video: str = ""  # of a table with a row per participant and columns for each video


@functools.lru_cache(8)
def _known(world: World) -> Mapping[str, _Column]:
    """Return name -> column, of all that have a meaning."""
    found = {name: _Column(name) for name in (*_FIELDS, "confidence", "rehearsal")}
    found |= {"event": found["video"], "rt": found["response_time"]}
    labels = Counter(label for of in questions_of(world).values() for label in of)
    for question, answers in questions_of(world).items():
        found[_plain(question)] = _Column("label", question)
        for name in (f"{question}_confidence", f"confidence_{question}"):
            found[_plain(name)] = _Column("confidence", question)
        for label in answers:
            found[_plain(f"{question} {label}")] = _Column("rating", question, label)
            if labels[label] == 1:
                found.setdefault(_plain(label), _Column("rating", question, label))
    return found


def _plain(name: str) -> str:
    """Return a name without case, spaces and marks: R writes "relation..friendly"."""
    return re.sub(r"\W+", "_", name.lower()).strip("_")


def read_answers(
    source: Source,
    world: World,
    videos: Sequence[str] | None = None,
    *,
    names: Mapping[str, str | None] | None = None,
    na: Sequence[str] = (),
    repeated: Keep = "refuse",
    milliseconds: bool | None = None,
    graded: Graded = "divide",
    temperature: float | None = None,
) -> tuple[pd.DataFrame, list[str]]:
    """Return the tidy table of a file or table, and what was done with it, a line each.

    Arguments and errors as of :func:`phase_ppl.load_judgments`.
    """
    check_name("value of repeated", repeated, ("refuse", "first", "last"))
    check_name("way of grading", graded, ("divide", "softmax"))
    instance_of("names", names or {}, Mapping, "a mapping from your names")
    if isinstance(na, str) or not isinstance(na, Collection):
        raise InvalidSettingError(f"na={shown(na)}, expected a list of texts")
    reader = _Reader(world, videos, names or {}, {*na, *_NOT_AVAILABLE} - {""})
    if isinstance(source, pd.DataFrame):
        with in_front("the table"):
            rows = checked_rows(_cells(source), reader.row, reader.header, _ONCE, repeated)
    else:
        rows = read_rows(source, reader.row, reader.header, _ONCE, repeated)
    left_out = Counter(reader.left_out)
    left_out[f"repeated (the {repeated} counts)"] = reader.checked - len(rows)
    extra = ["confidence", "rating"]
    columns = [*COLUMNS, *extra, "rehearsal", *reader.further]
    # plain objects: pandas' own text would make NaN of None
    cells = [[one.get(name) for name in columns] for row in rows for one in row["rows"]]
    table = pd.DataFrame(cells, columns=columns, dtype=object)
    numbers = ["value", "at", "response_time", *extra]
    table = table.astype({**dict.fromkeys(numbers, float), "rehearsal": bool})
    rated = table["rating"].notna()
    without = rated.groupby([table[n] for n in _PAIR], dropna=False).transform("any") & ~rated
    left_out["of graded answers, without a number"] = int(without.sum())
    table = table[~without].reset_index(drop=True)
    notes = []
    for name in ("response_time", "at"):
        median = table[name].median()
        if milliseconds or (milliseconds is None and median >= _MILLISECONDS):
            table[name] /= 1000
            if milliseconds is None:
                notes.append(
                    f"{name} was read as milliseconds, as its median is {median:g}; "
                    "milliseconds=False reads it as seconds"
                )
    if table["rating"].notna().any():
        table, said = _graded(table, graded, temperature, left_out)
        notes.append(said)
    table["rehearsal"] |= table["participant"].str.startswith(Judgments.SCRIPTED)
    unused = [name for name in extra if table[name].isna().all()]
    table = table.drop(columns=[*unused, *["rehearsal"] * (not table["rehearsal"].any())])
    dropped = [f"{n} {why}" for why, n in left_out.items() if n]
    if dropped:
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

    def __init__(
        self,
        world: World,
        videos: Sequence[str] | None,
        names: Mapping[str, str | None],
        na: set[str],
    ) -> None:
        self.world, self.videos, self.names, self.na = world, videos, names, na
        self.columns: dict[str, _Column] = {}
        self.left_out: Counter[str] = Counter()
        self.checked = 0  # rows that were kept, repeated ones too

    @property
    def further(self) -> list[str]:
        """The columns that are kept as they are."""
        return [name for name, column in self.columns.items() if column.field == "further"]

    # --- the header

    def header(self, header: Sequence[str]) -> None:
        """Note what the columns mean (InvalidEventError, UnknownNameError: it cannot be told)."""
        own = {name: self._column(name) for name in header}
        named = {column.field for column in own.values() if column}
        spread = "video" not in named
        if "rating" in own and own["rating"] is None and "value" in named:
            own["rating"] = _Column("")  # of a study's table, whose values are shares of it
        faults = Faults()
        for name in dict.fromkeys(header):
            column = own[name] or (self._of_a_video(name) if spread else None)
            with faults.noted():
                self.columns[name] = column or self._kept(name)
                if column is not None and column.field and header.count(name) > 1:
                    raise InvalidEventError(f"names the column {name} twice")
        by_meaning: dict[_Column, str] = {}
        for name, found in self.columns.items():
            if found.field in ("", "further"):
                continue
            with faults.noted():
                other = by_meaning.setdefault(found, name)
                if other != name:
                    raise InvalidEventError(f"the columns {other} and {name} mean the same")
        faults.check()
        fields = {column.field for column in self.columns.values()}
        by_video = any(column.video for column in self.columns.values())
        needed = ["participant", *["video"] * (not by_video)]
        missing = [name for name in needed if name not in fields]
        if missing:
            own_name = {"participant": "subject", "video": "stimulus"}[missing[0]]
            raise InvalidEventError(
                f"names no column {' and no column '.join(missing)}; "
                f"names={{{own_name!r}: {missing[0]!r}}} tells a name of your own"
            )
        if "question" in fields and not fields & {"answer", "responses"}:
            raise InvalidEventError("names a column question, but no column answer")
        if not fields & {"label", "rating", "question", "responses"}:
            questions = ", ".join(questions_of(self.world))
            raise InvalidEventError(f"names none of the columns {questions}")

    def _column(self, name: str) -> _Column | None:
        """Return what a column means by its name; None: it has no meaning."""
        if name not in self.names:
            if _INDEX.fullmatch(name):
                return _Column("")
            if _plain(name) in ("response", "responses"):  # jsPsych's, JSON
                return _Column("responses")
            return _known(self.world).get(_plain(name))
        ours = self.names[name]
        if ours is None:
            return _Column("")
        known = _known(self.world)
        if _plain(str(ours)) not in known:
            raise unknown_name(f"column in names, for {shown(name)},", ours, self._allowed())
        return known[_plain(ours)]

    def _of_a_video(self, name: str) -> _Column | None:
        """Return the meaning of a column such as "collaborate_relation"."""
        plain = _plain(name)
        for suffix, column in sorted(_known(self.world).items(), key=lambda one: -len(one[0])):
            if column.field not in ("label", "rating", "confidence", "response_time"):
                continue
            if not plain.endswith(f"_{suffix}"):
                continue
            before = _plain(plain.removesuffix(suffix))
            if self.videos is not None:
                video = next((one for one in self.videos if _plain(one) == before), None)
            else:
                ends = (name[:end] for end in range(1, len(name)))
                video = next((start for start in ends if _plain(start) == before), None)
            if video is not None:
                return column._replace(video=video)
        return None

    def _kept(self, name: str) -> _Column:
        """Return that a column is kept as it is (UnknownNameError: it looks misspelt).

        InvalidEventError: its name is taken.
        """
        if name == "rating":  # which the tidy table has of its own
            raise InvalidEventError(
                "names the column rating, a reserved name: names={'rating': 'value'} reads it, "
                "names={'rating': None} skips it"
            )
        allowed, plain = self._allowed(), _plain(name)
        asks = plain.startswith(("goal_", "relation"))
        if not asks and not difflib.get_close_matches(plain, allowed, 1, _CLOSE):
            return _Column("further")
        error = unknown_name("column", name, allowed)
        why = f"the events are of the world {self.world.name!r}"
        if self.videos is None:
            why = "without its events a study is one of PHASE"
        raise UnknownNameError(f"{error} ({why}); names={{{name!r}: None}} leaves it out")

    def _allowed(self) -> tuple[str, ...]:
        return (*_FIELDS, *questions_of(self.world), "confidence")

    # --- a row

    def row(self, cells: Mapping[str, str]) -> dict[str, Any]:
        """Return what identifies a row, and its ``rows`` of the tidy table."""
        faults = Faults()
        given = {n: "" if cells[n] in self.na else cells[n] for n in self.columns if n}
        by_field = {
            c.field: given[n] for n, c in self.columns.items() if n and not (c.question or c.video)
        }
        found: dict[str, Any] = dict.fromkeys(_ONCE)
        for name in ("participant", "video"):
            if name not in by_field:
                continue
            with faults.noted():
                said = by_field[name]
                found[name] = (self.names.get(said) or said) if name == "video" else said
                missing = not said and name == "participant"
                if missing or not said.isprintable():
                    raise InvalidEventError(f"{name} is {shown(said)}, expected printable text")
        numbers: dict[str, float | None] = dict.fromkeys(
            ("response_time", "at", "value", "confidence")
        )
        for name in numbers:
            with faults.noted():
                what = "seconds, such as 12.4" if name in ("response_time", "at") else _RATING
                numbers[name] = _number(name, by_field.get(name, ""), what)
        answers = self._answers(given, by_field, numbers["value"], found, faults)
        found["at"] = numbers["at"]
        shared: dict[str, Any] = {n: given[n] or None for n in self.further}
        shared |= {"participant": found["participant"], "at": numbers["at"]}
        with faults.noted():
            said = by_field.get("rehearsal", "").lower()
            shared["rehearsal"] = said in _MARKED
            if said not in (*_MARKED, *_NOT_MARKED):
                raise InvalidEventError(f"rehearsal is {shown(said)}, expected true or false")
        names = {column: name for name, column in self.columns.items()}
        rows = []
        for (video, question), one in answers.items():
            event = video or found["video"]
            confidence, time = numbers["confidence"], numbers["response_time"]
            with faults.noted(f"{question}: "):
                for of in ("", question):
                    cell = given.get(names.get(_Column("confidence", of, "", video), ""), "")
                    confidence = _number("confidence", cell) if cell else confidence
                if cell := given.get(names.get(_Column("response_time", video=video), ""), ""):
                    time = _number("response_time", cell, "seconds")
            of_answer = {"event": event, "question": question, "confidence": confidence}
            for label, rating in one.items():
                of_label = {"answer": label, "rating": rating, "response_time": time}
                rows.append({**shared, **of_answer, **of_label, "value": 1.0})
        if not rows or not all(row["event"] for row in rows):
            self.left_out["without a video" if rows else "without an answer"] += 1
            rows = []
            found["answer"] = object()  # is like no other
        elif self.videos is not None:
            for video in dict.fromkeys(row["event"] for row in rows):
                with faults.noted():
                    if video not in self.videos:
                        error = unknown_name("video", video, self.videos)
                        raise UnknownNameError(f"{error}; give all events of the study")
        faults.check()
        self.checked += 1
        return {**found, "rows": rows}

    def _answers(
        self,
        given: Mapping[str, str],
        by_field: Mapping[str, str],
        value: float | None,
        found: dict[str, Any],
        faults: Faults,
    ) -> dict[tuple[str, str], dict[str, float | None]]:
        """Return (video, question) -> label -> rating; None: it is the answer."""
        answers: dict[tuple[str, str], dict[str, float | None]] = {}
        columns = [(n, c, given[n]) for n, c in self.columns.items() if n and c.question]
        with faults.noted():
            columns += self._in_json(by_field.get("responses", ""))
        for name, column, cell in columns:
            if not cell or column.field not in ("label", "rating"):
                continue
            of_question = answers.setdefault((column.video, column.question), {})
            with faults.noted(f"{column.question}: " if column.field == "label" else ""):
                if column.field == "rating":
                    of_question[column.label] = _number(name, cell)
                else:
                    of_question[self._label(column.question, cell)] = None
                if len({rating is None for rating in of_question.values()}) > 1:
                    raise InvalidEventError(
                        f"has an answer and ratings of {column.question}; "
                        f"names={{{name!r}: None}} leaves one out"
                    )
        asked, answer = by_field.get("question", ""), by_field.get("answer", "")
        if asked and answer and by_field.get("video"):
            with faults.noted():
                plain = {_plain(one): one for one in questions_of(self.world)}
                question = plain.get(_plain(self.names.get(asked) or asked))
                if question is None:
                    raise unknown_name("question", asked, tuple(plain.values()))
                label = self._label(question, answer)
                answers["", question] = {label: value}
                found["question"] = question
                found["answer"] = None if value is None else label
        return answers

    def _label(self, question: str, cell: str) -> str:
        answer = self.names.get(cell) or cell
        return checked_answer(question, answer, self.world)

    def _in_json(self, cell: str) -> list[tuple[str, _Column, str]]:
        """Return the answers that jsPsych writes as a JSON object of question -> answer."""
        if not cell.startswith("{"):
            return []
        try:
            said = msgspec.json.decode(cell, type=dict[str, Any])
        except (msgspec.DecodeError, RecursionError) as error:
            raise InvalidEventError(f"response is no JSON object: {error}") from None
        columns = [(name, self._column(name), value) for name, value in said.items()]
        return [
            (name, column, str(value))
            for name, column, value in columns
            if column is not None and value is not None
        ]


_RATING: Final = "a number of 0 or more, such as 70"


def _number(name: str, cell: str, expected: str = _RATING) -> float | None:
    """Return a number of at least 0; None: there is none. Decimal commas and % are understood."""
    if not cell:
        return None
    text = cell.removesuffix("%").rstrip()
    text = text.replace(",", ".") if text.count(",") == 1 and "." not in text else text
    number = float(text) if re.fullmatch(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", text) else np.inf
    if number > _MOST:
        raise InvalidEventError(f"{name} is {shown(cell)}, expected {expected}")
    return number


# --- ratings become shares ------------------------------------------------------------------------


def _graded(
    table: pd.DataFrame, graded: Graded, temperature: float | None, left_out: Counter[str]
) -> tuple[pd.DataFrame, str]:
    """Return the table with shares as values where all answers were rated, and what was done."""
    rated = table["rating"].notna()
    ratings = table[rated]
    found = table["value"].copy()
    if graded == "divide":
        total = ratings.groupby(_PAIR, dropna=False, sort=False)["rating"].transform("sum")
        empty = ratings.index[total == 0]
        found[rated] = ratings["rating"] / total.where(total > 0)
        n = ratings.loc[empty].drop_duplicates(_PAIR).shape[0]
        left_out["graded answers of zeros only"] = n
        changed = table.assign(value=found).drop(index=empty).reset_index(drop=True)
        return changed, "ratings were divided by their sum, answer by answer"
    how = "given"
    if temperature is None:
        temperature, how = _temperature(ratings), "fitted"
    positive_number("temperature", temperature)
    most = ratings.groupby(_PAIR, dropna=False, sort=False)["rating"].transform("max")
    masses = np.exp((ratings["rating"] - most) / temperature)
    groups = masses.groupby([ratings[name] for name in _PAIR], dropna=False, sort=False)
    found[rated] = masses / groups.transform("sum")
    said = f"ratings became shares by softmax, temperature {temperature:.3g} ({how})"
    return table.assign(value=found), said


def _temperature(ratings: pd.DataFrame) -> float:
    """Return the temperature at which ratings best predict other people's leading answers.

    It has the highest log score of them: each person's shares, for every other person's leading
    answer (ties: shared) to the same question about the same event and moment. A label without a
    number has no share, so others' answers with it are not predicted.
    """
    groups: list[tuple[FloatArray, FloatArray]] = []
    for _, group in ratings.groupby(["event", "question", "at"], dropna=False):
        each = group.pivot_table("rating", "participant", "answer", dropna=False)
        given = each.fillna(-np.inf).to_numpy(float)
        if len(given) > 1:
            leads = (given == given.max(axis=1, keepdims=True)).astype(float)
            leads /= leads.sum(axis=1, keepdims=True)
            others = (leads.sum(axis=0) - leads) / (len(given) - 1)
            groups.append((given, np.where(np.isfinite(given), others, 0)))
    groups = [one for one in groups if one[1].any()]
    if not groups:
        raise InvalidSettingError(
            "graded='softmax' fits its temperature to people who rated the same question of an "
            "event, and there are none; temperature=20 sets it"
        )

    def loss(log_temperature: float) -> float:
        logs = [special.log_softmax(given / np.exp(log_temperature), axis=1) for given, _ in groups]
        pairs = zip(logs, groups, strict=True)
        return -sum(float(one[of > 0] @ of[of > 0]) for one, (_, of) in pairs)

    scale = max(float(given.max()) for given, _ in groups) or 1.0
    low, high = np.log(scale) + np.log([1e-3, 1e2])
    best = optimize.minimize_scalar(loss, bounds=(low, high), method="bounded").x
    return float(np.exp(best))


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
