"""What a study asks and says: ``study.toml``, whose defaults are those of the template."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import secrets
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

from phase_ppl.evaluation.judgments import checked_answer
from phase_ppl.study.clips import CLIPS
from phase_ppl.world.errors import InvalidSettingError, shown, unknown_name
from phase_ppl.world.files import existing_file

FILE: Final = "study.toml"
KINDS: Final = ("judgment", "tagging", "likeness", "play")
_CHARACTERS: Final = "ABCDEFGHJKLMNPQRSTUVWXYZ23456789"
_LEAST: Final = {"trials": 1, "raters": 1, "tries": 1, "resume_within": 1, "place_kept": 1,
                 "min_width": 0, "entries_per_minute": 1, "most_entries": 1}  # fmt: skip
"""Whole numbers -> the smallest that is allowed."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """The contents of ``study.toml``; the file says what each of them is.

    Attributes:
        text: of the file.
        All others: as in the file. ``quiz`` has (question, options, right answer), ``tutorial``
        (Markdown, name of a clip or ""), ``checks`` event id -> accepted relations, ``play`` what
        the sessions are like, as the file has it.
    """

    kind: str
    title: str
    trials: int
    raters: int
    tries: int
    demographics: bool
    open: bool
    resume_within: int
    place_kept: int
    min_width: int
    entries_per_minute: int
    most_entries: int
    refuse_repeats: str
    return_url: str
    codes: Mapping[str, str]
    texts: Mapping[str, str]
    tutorial: Sequence[tuple[str, str]]
    quiz: Sequence[tuple[str, tuple[str, ...], str]]
    checks: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    play: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    self_goals: bool = False
    text: str = ""

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of the file."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @classmethod
    def read(cls, path: Path) -> Settings:
        """Read ``study.toml``."""
        source = existing_file(path)
        try:
            text = source.read_text("utf-8")
            return cls.parse(text)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InvalidSettingError(f"{source}: {error}") from None
        except (InvalidSettingError, ValueError) as error:
            raise type(error)(f"{source}: {error}") from None

    @classmethod
    def parse(cls, text: str) -> Settings:
        """Read the text of ``study.toml``; what is left out is as in the template."""
        given = tomllib.loads(text)
        kind = given.get("kind")
        if kind not in KINDS:
            raise unknown_name("kind", kind, KINDS)
        default = tomllib.loads(template(kind, title=""))
        merged = {**default, **given}
        for name, value in given.items():
            if name not in default:
                raise unknown_name("setting", name, default)
            if isinstance(default[name], dict) and isinstance(value, dict):
                merged[name] = _table(name, default[name], value)
            elif type(value) is not type(default[name]):
                wanted = _TYPES[type(default[name])]
                raise InvalidSettingError(f"{name} = {shown(value)}, expected {wanted}")
        for name, least in _LEAST.items():
            if merged[name] < least:
                raise InvalidSettingError(f"{name} = {merged[name]}, expected at least {least}")
        merged["tutorial"] = [
            _step(number, entry) for number, entry in enumerate(merged["tutorial"], 1)
        ]
        merged["quiz"] = [
            _question(number, entry) for number, entry in enumerate(merged["quiz"], 1)
        ]
        merged["checks"] = {
            event: _relations(event, accepted)
            for event, accepted in merged.get("checks", {}).items()
        }
        return cls(**merged, text=text)


_TYPES: Final = {str: "text", int: "a whole number", bool: "true or false", dict: "a table",
                 float: "a number with a decimal point", list: "a list"}  # fmt: skip


def template(
    kind: str, title: str, *, trials: int = 10, raters: int = 20, n_videos: int = 100
) -> str:
    """Return the text of a new ``study.toml``, with codes of its own."""
    import jinja2

    def code() -> str:
        return "".join(secrets.choice(_CHARACTERS) for _ in range(8))

    environment = jinja2.Environment(keep_trailing_newline=True, undefined=jinja2.StrictUndefined)
    environment.filters["toml"] = _quoted
    source = resources.files("phase_ppl.study") / "templates" / FILE
    names = ("finished", "quiz_failed", "waited", "partner_left")
    people = -(-n_videos * raters // trials)
    return environment.from_string(source.read_text("utf-8")).render(
        kind=kind,
        title=title,
        trials=trials,
        raters=raters,
        most_entries=max(100, 3 * people),
        codes={name: code() for name in names},
        minutes=12 + trials if kind == "play" else max(5, 5 + -(-trials * 3 // 4)),
    )


def _quoted(text: str) -> str:
    """Return a TOML string; JSON's escapes are among TOML's."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _table(name: str, default: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    if name == "checks":
        return dict(given)
    for key, value in given.items():
        if key not in default:
            raise unknown_name(f"setting in [{name}]", key, default)
        if type(value) is not type(default[key]):
            wanted = _TYPES[type(default[key])]
            raise InvalidSettingError(f"{key} in [{name}] is {shown(value)}, expected {wanted}")
    return {**default, **given}


def _step(number: int, entry: Any) -> tuple[str, str]:
    where = f"[[tutorial]] number {number}"
    _check_keys(where, entry, {"text": str, "clip": str}, optional=("clip",))
    clip = entry.get("clip", "")
    if clip and clip not in CLIPS:
        raise unknown_name(f"clip in {where}", clip, CLIPS)
    return entry["text"], clip


def _question(number: int, entry: Any) -> tuple[str, tuple[str, ...], str]:
    where = f"[[quiz]] number {number}"
    _check_keys(where, entry, {"question": str, "options": list, "answer": str})
    options = entry["options"]
    if len(options) < 2 or len(set(map(str, options))) < len(options):
        raise InvalidSettingError(f"{where}: options are {shown(options)}, expected two or more")
    if entry["answer"] not in options:
        raise unknown_name(f"answer in {where}", entry["answer"], map(str, options))
    return entry["question"], tuple(map(str, options)), entry["answer"]


def _check_keys(
    where: str, entry: Any, kinds: Mapping[str, type], optional: Sequence[str] = ()
) -> None:
    if not isinstance(entry, dict):
        raise InvalidSettingError(f"{where} is {shown(entry)}, expected a table")
    for key in entry:
        if key not in kinds:
            raise unknown_name(f"setting in {where}", key, kinds)
    for key, kind in kinds.items():
        if key not in optional and not isinstance(entry.get(key), kind):
            raise InvalidSettingError(
                f"{where}: {key} is {shown(entry.get(key))}, expected {_TYPES[kind]}"
            )


def _relations(event: str, accepted: Any) -> tuple[str, ...]:
    if not isinstance(accepted, list) or not accepted:
        raise InvalidSettingError(f"[checks] {event} is {shown(accepted)}, expected relations")
    return tuple(checked_answer("relation", answer) for answer in accepted)
