"""Answers kept in a folder, so that an evaluation can be repeated without asking again.

One JSON file for each request and seed, ``KEY-SEED.json``, where KEY is a hash of what determines
the request::

    {
     "schema": "phase-ppl-answer-1",
     "request": {...},         client, model, address, hashes of prompt and film, settings
     "seed": 0,
     "prompt": "...",
     "film": {...},            what was drawn for it: sizes and hashes of the files
     "attempts": [             each request that was made
      {"time": "2026-01-31T12:00:00+00:00", "seconds": 21.3, "text": "...", ...},
      {"time": ..., "seconds": ..., "failure": "..."}
     ]
    }
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from phase_ppl.dataset.documents import read_json
from phase_ppl.world.errors import InvalidEventError, OutputError, shown
from phase_ppl.world.files import write_json
from phase_ppl.world.identity import differences

SCHEMA: Final = "phase-ppl-answer-1"


@dataclasses.dataclass(frozen=True)
class Attempt:
    """One request, and what came of it: a text or a failure.

    Attributes:
        time: when it was sent, UTC, as ISO 8601.
        seconds: until it ended, the drawing of what was looked at included.
        text: of the answer, whether it can be read or not.
        failure: why there is no answer.
        finish, model, tokens_in, tokens_out: as of
            :class:`~phase_ppl.evaluation.vlm.request.Reply`.
    """

    time: str
    seconds: float
    text: str | None = None
    failure: str | None = None
    finish: str | None = None
    model: str | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, without what is not known."""
        given = dataclasses.asdict(self)
        return {name: value for name, value in given.items() if value is not None}

    @classmethod
    def from_dict(cls, record: Any) -> Attempt:
        """Read what :meth:`to_dict` wrote.

        Raises:
            InvalidEventError: it is something else; the message names the field.
        """
        kinds = {
            **dict.fromkeys(("time", "text", "failure", "finish", "model"), str),
            **dict.fromkeys(("tokens_in", "tokens_out"), int),
            "seconds": int | float,
        }
        given = record if isinstance(record, dict) else {}
        if not {"time", "seconds"} <= set(given) or ("text" in given) == ("failure" in given):
            raise InvalidEventError(
                f"an attempt is {shown(record)}, expected time, seconds, and text or failure"
            )
        for name, value in given.items():
            if name not in kinds or not isinstance(value, kinds[name]):
                raise InvalidEventError(f"an attempt has {name}={shown(value)}")
        return cls(**given)


class Store:
    """A folder of answers, made when the first is kept.

    Raises:
        OutputError: there is something else at ``path``.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path} is a file, expected a folder for answers")

    def file_of(self, request: Mapping[str, Any], seed: int) -> Path:
        """Return the file of a request, whether it is there or not."""
        text = json.dumps(request, sort_keys=True)
        return self.path / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}-{seed}.json"

    def find(self, request: Mapping[str, Any], seed: int) -> dict[str, Any] | None:
        """Return the record of a request with its ``attempts``; None where there is none.

        Raises:
            InvalidEventError: the file is damaged, or of another request.
        """
        source = self.file_of(request, seed)
        if not source.exists():
            return None
        record = read_json(source)
        if record.get("schema") != SCHEMA:
            raise InvalidEventError(
                f"{source}: its schema is {shown(record.get('schema'))}, not {SCHEMA!r}"
            )
        was = record.get("request")
        found = differences(was, request) if isinstance(was, dict) else ["request is missing"]
        if found or record.get("seed") != seed:
            words = "; ".join(found) or f"seed is {seed}, was {shown(record.get('seed'))}"
            raise InvalidEventError(f"{source}: is the answer to another request: {words}")
        attempts = record.get("attempts")
        if not isinstance(attempts, list):
            raise InvalidEventError(f"{source}: attempts is {shown(attempts)}, expected a list")
        try:
            return {**record, "attempts": [Attempt.from_dict(each) for each in attempts]}
        except InvalidEventError as error:
            raise InvalidEventError(f"{source}: {error}") from None

    def knows(self, request: Mapping[str, Any]) -> bool:
        """Whether the request has been answered for any seed."""
        key = self.file_of(request, 0).name.partition("-")[0]
        return any(self.path.glob(f"{key}-*.json"))

    def keep(self, record: Mapping[str, Any]) -> None:
        """Write a record, in place of the one before.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write into {self.path}: {error.strerror}") from None
        write_json(self.file_of(record["request"], record["seed"]), as_json(record))


def as_json(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record with its attempts as plain data, as files hold it."""
    attempts = [attempt.to_dict() for attempt in record["attempts"]]
    return {"schema": SCHEMA, **record, "attempts": attempts}
