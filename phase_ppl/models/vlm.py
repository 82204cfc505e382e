"""A vision-language model that watches the animation (paper, Appendix "Gemini 2.5 Pro").

Requests, replies, and how answers are read.

Answers are read strictly. Unambiguous faults are repaired, and every repair is noted; anything else
is refused. Four faults are repaired: a code fence around the object, case and spaces in names,
extra keys, and sums that differ from 1 by up to 0.05, the rounding error of ten two-decimal
numbers.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from phase_ppl.data.documents import parse_document
from phase_ppl.world.arrays import FloatArray
from phase_ppl.world.errors import (
    AnswerError,
    InvalidEventError,
    number_or_nan,
    shown,
    unknown_name,
)
from phase_ppl.world.event import Observation
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.names import AGENTS, ITEMS, LANDMARKS
from phase_ppl.world.scene import Scene

QUESTIONS: Final = {"goal_red": GOALS, "goal_green": GOALS, "relation": RELATIONS}

N_NAMED: Final = 10  # goals that an answer names for each agent

_EXCERPT: Final = 200  # characters of a line about a request, at most
_SUM_TOLERANCE: Final = 0.05
_SUM_EXACT: Final = 1e-6
_FENCE: Final = re.compile(r"```[ \t]*(?:\w+[ \t]*)?\r?\n(.*?)```", re.DOTALL)

_MEANING: Final = {
    "friendly": "they work together on a goal",
    "neutral": "their goals have nothing to do with each other",
    "adversarial": "for instance, one hinders the other, or they compete",
}

_AGENTS: Final = " and ".join(AGENTS)

TEXT: Final = f"""\
{{shown}} Two agents act in a two-dimensional world. What does each of them want, and how do they \
stand to each other?

What there is to see:
- {len(AGENTS)} agents, {_AGENTS}: trapezoids.
- {len(ITEMS)} items, {" and ".join(ITEMS)}: circles.
- Agents and items come in several colours and sizes; the larger, the heavier.
- {len(LANDMARKS)} landmarks, {", ".join(LANDMARKS)}: coloured squares ("lm"), places \
where an agent may want to be or to have something.
- Walls: black lines. Neither agents nor items get through them.

What an agent may want: to be at a landmark; to have an item at a landmark; to be near the other \
agent; or to prevent something of that kind, for instance to keep an agent or an item away from a \
landmark. For every choice of who or what and where there is one goal, {N_GOALS} in all. These are \
their names, and no others may be used:
{{goals}}

How the agents may stand to each other:
{{relations}}

Answer with a single JSON object and nothing before or after it. It has exactly three keys:
- "goal_red": the {N_NAMED} goals that the {AGENTS[0]} most probably has, each \
name with its probability; exactly {N_NAMED} different names, spelled as above, and probabilities \
that sum to 1.
- "goal_green": the same for the {AGENTS[1]}.
- "relation": the probabilities of {", ".join(f'"{name}"' for name in RELATIONS)}, all three of \
them, which sum to 1.

Its form, with the names and numbers still to be put in:
{{"goal_red": {{"<goal>": <probability>, and nine more}}, \
"goal_green": {{"<goal>": <probability>, and nine more}}, \
"relation": {{"friendly": <probability>, "neutral": <probability>, \
"adversarial": <probability>}}}}
"""
"""The facts of the paper's prompt (Appendix D), in our own words.

Here and in a user's own prompt ``{goals}`` (``{goals_str}`` in the paper's) stands for the names of
the goals, ``{relations}`` for the relations with their meanings, and ``{shown}`` for how the
animation is shown.
"""

_PAPERS_KEYS: Final = {"red_agent_goals": "goal_red", "green_agent_goals": "goal_green"}
"""Question in the paper's prompt -> its name here."""


# drawing is imported only where it is used: this module is loaded with every model's name
def rendering() -> dict[str, Any]:
    """Return the settings of drawn videos: as people saw them, 0.25 s per step."""
    from phase_ppl.render.frames import HEIGHT, WIDTH
    from phase_ppl.render.video import FRAMES_PER_SECOND, FRAMES_PER_STEP

    size = [WIDTH, HEIGHT]
    return {"size": size, "fps": FRAMES_PER_SECOND, "frames_per_step": FRAMES_PER_STEP}


class Picture(NamedTuple):
    """A frame of the animation: its time in the video, and a PNG of 640 x 480 pixels."""

    seconds: float
    png: bytes


class Request:
    """A question about one event; its animation is drawn on first use.

    The prompt refers to a video or to at most ``n_pictures`` :attr:`pictures`; ``text`` is as
    :data:`TEXT`.
    """

    def __init__(
        self,
        scene: Scene,
        observation: Observation,
        model: str,
        n_pictures: int,
        as_video: bool,
        text: str = TEXT,
    ) -> None:
        self.model, self._text = model, text
        self._scene, self._observation, self._as_video = scene, observation, as_video
        last = observation.n_frames - 1
        count = min(n_pictures, last + 1)
        self._chosen = np.linspace(0, last, count).round().astype(int).tolist()
        drawn = rendering()
        step = drawn["frames_per_step"] / drawn["fps"]
        self._seconds = [index * step for index in self._chosen]

    @property
    def prompt(self) -> str:
        """The question; it says how the animation is shown."""
        shown = (
            "The video shows an animation."
            if self._as_video
            else f"The {len(self._seconds)} pictures are frames of one animation of "
            f"{self._seconds[-1]:g} seconds, in the order of time, each with its time before it."
        )
        goals = "\n".join(f"- {goal}" for goal in GOALS)
        parts = {
            **{"shown": shown, "goals": goals, "goals_str": goals},
            "relations": "\n".join(f"- {name}: {_MEANING[name]}" for name in RELATIONS),
        }
        told = self._text
        for name, part in parts.items():  # a prompt has braces of its own
            told = told.replace(f"{{{name}}}", part)
        return told

    @functools.cached_property
    def video(self) -> bytes:
        """The animation as MP4, 20 frames a second."""
        from phase_ppl.render.video import video

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "event.mp4"
            video(self._observation, path, self._scene)
            return path.read_bytes()

    @functools.cached_property
    def pictures(self) -> tuple[Picture, ...]:
        """Frames from the first to the last, PNG, each with its second in the video."""
        from phase_ppl.render.frames import Painter

        painter = Painter(self._scene)
        found = []
        for index, seconds in zip(self._chosen, self._seconds, strict=True):
            content = io.BytesIO()
            painter.draw(self._observation.trajectory[index]).save(content, "PNG")
            found.append(Picture(seconds, content.getvalue()))
        return tuple(found)


@dataclasses.dataclass(frozen=True)
class Reply:
    """The reply to a request.

    Raises:
        AnswerError: ``text`` is no text.
    """

    text: str  # as it came; empty where there is none
    finish: str | None = None  # why the text ends there, in the service's words
    model: str | None = None  # what answered, in the service's words, such as a version
    # tokens, as the service counts them; None: not given
    tokens_in: int | None = None
    tokens_out: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.text, str):
            kind = type(self.text).__name__
            raise AnswerError(f"the text of a reply is of type {kind}, expected str")
        object.__setattr__(self, "text", _writable(self.text))


Client: TypeAlias = Callable[[Request], str | Reply]
"""A function that answers requests. Its ``ConnectionError`` or ``TimeoutError`` is retried."""


def _writable(text: str) -> str:
    """Return a text without halves of surrogate pairs, which no file can hold."""
    return text.encode("utf-8", "replace").decode()


def in_a_line(text: str) -> str:
    """Return a text, or its beginning, in one line that a file can hold."""
    words = " ".join(_writable(text).split())
    return words if len(words) <= _EXCERPT else words[: _EXCERPT - 3] + "..."


# --- how an answer is read ------------------------------------------------------------------------


class Parsed(NamedTuple):
    """A readable answer."""

    probabilities: Mapping[str, FloatArray]  # question -> probabilities in label order, sum 1
    repairs: tuple[str, ...]  # what was done to read it, a line each


def parse(text: str) -> Parsed:
    """Return the probabilities that an answer gives.

    What it gives to no goal is spread evenly over the goals that it does not name.

    Raises:
        AnswerError: it has a fault that is not repaired.
    """
    repairs: list[str] = []
    body = _without_fence(text, repairs)
    try:
        document = parse_document(body)
    except InvalidEventError as error:
        raise AnswerError(f"the answer {error}; it begins {shown(body[:60])}") from None
    answers = _asked_for(document, repairs)
    probabilities = {q: _distribution(q, answers[q], repairs) for q in QUESTIONS}
    return Parsed(probabilities, tuple(repairs))


def _without_fence(text: str, repairs: list[str]) -> str:
    body = text.strip()
    if not body:
        raise AnswerError("the answer is empty")
    fenced = _FENCE.findall(body)
    if not fenced:
        return body
    if len(fenced) > 1:
        raise AnswerError(f"the answer has {len(fenced)} blocks of code, expected one JSON object")
    whole = _FENCE.fullmatch(body) is not None
    repairs.append("code fence removed" if whole else "code fence and text around it removed")
    return str(fenced[0]).strip()


def _asked_for(document: Mapping[str, Any], repairs: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in document.items():
        name = _same_name(key, (*QUESTIONS, *_PAPERS_KEYS), repairs)
        question = _PAPERS_KEYS.get(name or "", name)
        if question is None:
            repairs.append(f"key {shown(key)} left out")
        elif question in found:
            raise AnswerError(f"the answer gives {question} twice")
        else:
            found[question] = value
    missing = [question for question in QUESTIONS if question not in found]
    if missing:
        given = ", ".join(shown(key) for key in document) or "nothing"
        raise AnswerError(f"the answer lacks {', '.join(missing)}; it has {given[:200]}")
    return found


def _same_name(given: str, allowed: Iterable[str], repairs: list[str]) -> str | None:
    """Return the allowed name that equals ``given`` up to case and spaces; None: there is none."""
    wanted = " ".join(given.split()).lower()
    name = next((one for one in allowed if one.lower() == wanted), None)
    if name not in (None, given):
        repairs.append(f"{shown(given)} read as {name!r}")
    return name


def _distribution(question: str, shares: object, repairs: list[str]) -> FloatArray:
    labels = QUESTIONS[question]
    if not isinstance(shares, Mapping):
        raise AnswerError(f"{question} is {shown(shares)}, expected names with probabilities")
    values = np.full(len(labels), np.nan)
    for name, share in shares.items():
        label = _same_name(name, labels, repairs)
        if label is None:
            what = "relation" if question == "relation" else "goal"
            raise AnswerError(f"{question}: {unknown_name(what, name, labels)}")
        place = labels.index(label)
        if not np.isnan(values[place]):
            raise AnswerError(f"{question} gives {label!r} twice")
        if not 0 <= number_or_nan(share) <= 1:
            raise AnswerError(
                f"{question}: {label!r} has {shown(share)}, expected a number from 0 to 1"
            )
        values[place] = share
    unnamed, expected = np.isnan(values), min(N_NAMED, len(labels))
    if len(shares) != expected:
        raise AnswerError(f"{question} has {len(shares)} entries, expected exactly {expected}")
    values[unnamed] = 0.0
    total = float(values.sum())
    off = abs(total - 1)
    if off > _SUM_TOLERANCE + _SUM_EXACT:
        raise AnswerError(f"{question} sums to {total:.4g}, expected 1")
    if off > _SUM_EXACT:
        done = "scaled to 1"
        if total < 1 and unnamed.any():
            values[unnamed] = (1 - total) / unnamed.sum()
            done = f"the rest spread over {unnamed.sum()} goals"
        repairs.append(f"{question} sums to {total:.4g}; {done}")
    return np.asarray(values / values.sum())
