"""Settings and texts of a study: ``study.toml``, whose defaults are the template's."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import secrets
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import phase_ppl as ppl
from phase_study.clips import clips_of

if TYPE_CHECKING:
    import jinja2

FILE: Final = "study.toml"
KINDS: Final = ("judgment", "tagging", "likeness", "play")
_CHARACTERS: Final = "ABCDEFGHJKLMNPQRSTUVWXYZ23456789"
_COUNTS: Final = ("trials", "raters", "tries", "resume_within", "place_kept",
                  "entries_per_minute", "most_entries")  # fmt: skip
_RANGES: Final[Mapping[str, tuple[int, float]]] = {
    **dict.fromkeys(_COUNTS, (1, math.inf)), "min_width": (0, math.inf),
    "steps_per_second": (1, 12), "limit": (1, 5000), "hold": (1, 100), "wait_at_most": (1, 3600),
    "ready_within": (1, 600), "rejoin_within": (1, 60), "practice_at_most": (1, 3600),
    "rooms": (1, 50),
}  # fmt: skip
"""Least and greatest values of whole numbers."""

_CHOICES: Final = {
    "answers": ("labels", "sliders", "confidence"),
    "view": ("own", "all"),
    "partner": ("either", "person", "computer"),
}
"""Allowed values of texts with a choice."""


@dataclasses.dataclass(frozen=True)
class PlaySettings:
    """Settings of sessions: the table ``[play]`` of ``study.toml``, which describes them."""

    steps_per_second: int
    limit: int
    hold: int
    view: Literal["own", "all"]
    resets_velocity: bool
    partner: Literal["either", "person", "computer"]
    wait_at_most: int
    ready_within: int
    rejoin_within: float
    practice_at_most: int
    rooms: int

    @property
    def step(self) -> float:
        """Seconds of a planner step."""
        return 1 / self.steps_per_second

    @property
    def seconds(self) -> float:
        """Longest duration of a session."""
        return self.limit * self.step

    def scene(self, scene: ppl.Scene) -> ppl.Scene:
        """Return a scene as played: people can turn both ways, and the study's rule holds."""
        return dataclasses.replace(scene, turning="both", resets_velocity=self.resets_velocity)


@dataclasses.dataclass(frozen=True)
class Settings:
    """The contents of ``study.toml``; the file describes each of them.

    Attributes:
        text: of the file.
        All others: as in the file. ``quiz`` has (question, options, right answer), ``tutorial``
        (Markdown, name of a clip or ""), ``checks`` event id -> question -> accepted answers.
        ``play`` exists only in a study of play.
        world: of the events; it is not in the file.
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
    checks: Mapping[str, Mapping[str, tuple[str, ...]]] = dataclasses.field(default_factory=dict)
    play: PlaySettings = None  # type: ignore[assignment]
    self_goals: bool = False
    answers: Literal["labels", "sliders", "confidence"] = "labels"
    moments: Sequence[float] = ()
    text: str = ""
    world: ppl.World = ppl.worlds.PHASE

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of the file."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @classmethod
    def read(cls, path: Path, world: ppl.World = ppl.worlds.PHASE) -> Settings:
        """Read ``study.toml`` of a study of events of a world."""
        source = ppl.files.existing_file(path)
        try:
            return cls.parse(source.read_text("utf-8"), world)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ppl.errors.InvalidSettingError(f"{source}: {error}") from None
        except ValueError as error:
            raise type(error)(f"{source}: {error}") from None

    @classmethod
    def parse(cls, text: str, world: ppl.World = ppl.worlds.PHASE) -> Settings:
        """Parse the text of ``study.toml``; missing values are the template's."""
        given = tomllib.loads(text)
        ppl.errors.check_name("kind", given.get("kind"), KINDS)
        found = _table("", given, tomllib.loads(template(given["kind"], title="", world=world)))
        for name, check in (("tutorial", functools.partial(_step, world)), ("quiz", _question)):
            found[name] = [check(f"[[{name}]] number {n}", e) for n, e in enumerate(found[name], 1)]
        if "checks" in found:
            found["checks"] = {e: _accepted(e, a, world) for e, a in found["checks"].items()}
        moments = found.get("moments", [])
        numbers = [ppl.errors.positive_number("a moment in moments", at) for at in moments]
        if numbers != sorted(set(numbers)):
            raise ppl.errors.InvalidSettingError(
                f"moments is {ppl.errors.shown(moments)}, expected seconds in order"
            )
        if "play" in found:
            found["play"] = PlaySettings(**found["play"])
        return cls(**found, text=text, world=world)


_TYPES: Final = {str: "text", int: "a whole number", bool: "true or false", dict: "a table",
                 list: "a list"}  # fmt: skip


def template(
    kind: str, title: str, *, trials: int = 10, raters: int = 20, n_videos: int = 100,
    world: ppl.World = ppl.worlds.PHASE,
) -> str:  # fmt: skip
    """Return the text of a new ``study.toml``, with codes of its own."""

    def code() -> str:
        return "".join(secrets.choice(_CHARACTERS) for _ in range(8))

    names = ("finished", "quiz_failed", "waited", "partner_left")
    people = -(-n_videos * raters // trials)
    return _template().render(
        kind=kind,
        title=title,
        trials=trials,
        raters=raters,
        most_entries=max(100, 3 * people),
        codes={name: code() for name in names},
        world=world,
        of_phase=world == ppl.worlds.PHASE,
        alone=len(world.agents) == 1,
        pair=next(iter(ppl.pairs_of(world)), None),
        minutes=12 + trials if kind == "play" else max(5, 5 + -(-trials * 3 // 4)),
    )


@functools.cache
def _template() -> jinja2.Template:
    import jinja2

    environment = jinja2.Environment(keep_trailing_newline=True, undefined=jinja2.StrictUndefined)
    environment.filters["toml"] = _quoted
    source = resources.files("phase_study") / "templates" / FILE
    return environment.from_string(source.read_text("utf-8"))


def _quoted(text: str) -> str:
    """Return a TOML string; JSON's escapes are among TOML's."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _table(
    where: str, given: Any, default: Mapping[str, Any], required: Sequence[str] = ()
) -> dict[str, Any]:
    """Return a checked table of the file; missing values, unless required, are the default."""
    if not isinstance(given, dict):
        raise ppl.errors.InvalidSettingError(
            f"{where} is {ppl.errors.shown(given)}, expected a table"
        )
    found, inside = {**default, **dict.fromkeys(required), **given}, f" in {where}" if where else ""
    for name, value in found.items():
        ppl.errors.check_name(f"setting{inside}", name, default)
        expected = _TYPES[type(default[name])]
        fits = type(value) is type(default[name])
        if name in _RANGES:
            least, most = _RANGES[name]
            expected += f" >= {least}" if most == math.inf else f" in [{least}, {most}]"
            fits = fits and least <= value <= most
        if not fits:
            raise ppl.errors.InvalidSettingError(
                f"{name}{inside} is {ppl.errors.shown(value)}, expected {expected}"
            )
        if name in _CHOICES:
            ppl.errors.check_name(f"{name}{inside}", value, _CHOICES[name])
        if isinstance(value, dict) and name != "checks":  # its keys are names of videos
            found[name] = _table(f"[{name}]", value, default[name])
    return found


def _step(world: ppl.World, where: str, given: Any) -> tuple[str, str]:
    entry = _table(where, given, {"text": "", "clip": ""}, ["text"])
    ppl.errors.check_name(f"clip in {where}", entry["clip"], ("", *clips_of(world)))
    return entry["text"], entry["clip"]


def _question(where: str, given: Any) -> tuple[str, tuple[str, ...], str]:
    kinds = {"question": "", "options": [], "answer": ""}
    entry = _table(where, given, kinds, list(kinds))
    options = tuple(map(str, entry["options"]))
    if len(options) < 2 or len(set(options)) < len(options):
        raise ppl.errors.InvalidSettingError(
            f"{where}: options are {ppl.errors.shown(options)}, expected two or more"
        )
    ppl.errors.check_name(f"answer in {where}", entry["answer"], options)
    return entry["question"], options, entry["answer"]


def _accepted(event: str, given: Any, world: ppl.World) -> dict[str, tuple[str, ...]]:
    """Return question -> accepted answers; with one pair, a list is about the relation."""
    pairs = list(ppl.pairs_of(world))
    if isinstance(given, list) and len(pairs) == 1:
        given = {pairs[0]: given}
    lists = given.values() if isinstance(given, dict) else ()
    if not lists or not all(isinstance(one, list) and one for one in lists):
        expected = "relations" if len(pairs) == 1 else "a table of questions with lists of answers"
        raise ppl.errors.InvalidSettingError(
            f"[checks] {event} is {ppl.errors.shown(given)}, expected {expected}"
        )
    return {
        question: tuple(_spelled(question, answer, world) for answer in answers)
        for question, answers in given.items()
    }


def _spelled(question: str, answer: object, world: ppl.World) -> str:
    """Return an answer spelled as the label of a question of the world."""
    said = ppl.Prediction("", answers={question: str(answer)}, world=world)
    return said.answers[question]
