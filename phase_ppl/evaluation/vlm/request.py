"""What passes between this package and whoever answers: an animation, a question, a reply."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import json
import numbers
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from phase_ppl.evaluation.prediction import GOAL_QUESTIONS
from phase_ppl.render.frames import HEIGHT, WIDTH, Painter
from phase_ppl.render.video import FRAMES_PER_SECOND, FRAMES_PER_STEP, video
from phase_ppl.world.errors import AnswerError
from phase_ppl.world.event import Event
from phase_ppl.world.goals import GOALS, N_GOALS
from phase_ppl.world.hypothesis import RELATIONS
from phase_ppl.world.identity import event_digest
from phase_ppl.world.names import AGENTS, ITEMS, LANDMARKS
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

_EXCERPT: Final = 200
"""Characters of a line about a request, at most."""

RENDERING: Final = {
    "size": [WIDTH, HEIGHT],
    "fps": FRAMES_PER_SECOND,
    "frames_per_step": FRAMES_PER_STEP,
}
"""How videos are drawn: as people saw them, a step in 0.25 s."""

_SECONDS_PER_STEP: Final = FRAMES_PER_STEP / FRAMES_PER_SECOND

N_NAMED: Final = 10
"""Goals that an answer names for each agent."""

_MEANING: Final = {
    "friendly": "they work towards the same goal",
    "neutral": "each minds its own business",
    "adversarial": "one hinders the other, or they are rivals",
}

_AGENTS: Final = " and ".join(AGENTS)

TEXT: Final = f"""\
{{shown}} Two agents move about a room, seen from above. What does each of them want, and how do \
they stand to each other?

What there is to see:
- {len(AGENTS)} agents, {_AGENTS}: trapezoids with two eyes. They move by themselves and can push, \
hold and carry things.
- {len(ITEMS)} items, {" and ".join(ITEMS)}: discs in light colours, which move only when an agent \
moves them.
- Agents and items come in several sizes; the larger, the heavier.
- {len(LANDMARKS)} landmarks, {", ".join(LANDMARKS)}: coloured squares ("lm") on the floor, places \
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
- "{GOAL_QUESTIONS[AGENTS[0]]}": the {N_NAMED} goals that the {AGENTS[0]} most probably has, each \
name with its probability; exactly {N_NAMED} different names, spelled as above, and probabilities \
that sum to 1.
- "{GOAL_QUESTIONS[AGENTS[1]]}": the same for the {AGENTS[1]}.
- "relation": the probabilities of {", ".join(f'"{name}"' for name in RELATIONS)}, all three of \
them, which sum to 1.

Its form, with the names and numbers still to be put in:
{{{{"goal_red": {{{{"<goal>": <probability>, and nine more}}}}, \
"goal_green": {{{{"<goal>": <probability>, and nine more}}}}, \
"relation": {{{{"friendly": <probability>, "neutral": <probability>, \
"adversarial": <probability>}}}}}}}}
"""
"""The content of the paper's prompt, in words of our own."""


class Picture(NamedTuple):
    """A frame of the animation.

    Attributes:
        seconds: when the video shows it.
        png: 640 x 480 pixels.
    """

    seconds: float
    png: bytes


class Request:
    """A question about one event, whose animation is drawn when it is first asked for.

    Args:
        scene, observation: what is shown.
        model: who is asked, as the service or the user calls it.
        n_pictures: how many frames :attr:`pictures` has, at most.
        as_video: whether the question speaks of a video; else of pictures.
    """

    def __init__(
        self,
        scene: Scene,
        observation: Observation,
        model: str,
        n_pictures: int,
        as_video: bool,
    ) -> None:
        self.model = model
        self._scene, self._observation, self._as_video = scene, observation, as_video
        last = observation.n_frames - 1
        count = min(n_pictures, last + 1)
        self._chosen = np.linspace(0, last, count).round().astype(int).tolist()

    @property
    def prompt(self) -> str:
        """The question; it says how the animation is shown."""
        seconds = self._seconds
        shown = (
            "The video shows an animation."
            if self._as_video
            else f"The {len(seconds)} pictures are frames of one animation of {seconds[-1]:g} "
            "seconds, in the order of time, each with its time before it."
        )
        return TEXT.format(
            shown=shown,
            goals="\n".join(f"- {goal}" for goal in GOALS),
            relations="\n".join(f"- {name}: {_MEANING[name]}" for name in RELATIONS),
        )

    @functools.cached_property
    def video(self) -> bytes:
        """The animation as MP4, 20 frames a second."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "event.mp4"
            video(self._observation, path, self._scene)
            return path.read_bytes()

    @functools.cached_property
    def pictures(self) -> tuple[Picture, ...]:
        """Frames from the first to the last, PNG, each with its second in the video."""
        painter = Painter(self._scene)
        found = []
        for index, seconds in zip(self._chosen, self._seconds, strict=True):
            content = io.BytesIO()
            painter.draw(self._observation.trajectory[index]).save(content, "PNG")
            found.append(Picture(seconds, content.getvalue()))
        return tuple(found)

    @property
    def _seconds(self) -> tuple[float, ...]:
        return tuple(index * _SECONDS_PER_STEP for index in self._chosen)

    @property
    def digest(self) -> str:
        """A hash of what is drawn and how.

        Not of the files: other versions of an encoder write other bytes of the same animation.
        """
        seen = event_digest(Event(self._scene, self._observation))
        record = json.dumps([seen, RENDERING, self._chosen])
        return hashlib.sha256(record.encode()).hexdigest()

    def drawn(self) -> dict[str, object]:
        """Return what has been asked for until now: its size in bytes and a hash of its bytes."""
        found: dict[str, object] = {}
        for name in ("video", "pictures"):
            if name in vars(self):
                parts = [self.video] if name == "video" else [each.png for each in self.pictures]
                content = b"".join(parts)
                found[name] = {
                    "files": len(parts),
                    "bytes": len(content),
                    "sha256": hashlib.sha256(content).hexdigest(),
                }
        return found


@dataclasses.dataclass(frozen=True)
class Reply:
    """What came back.

    Attributes:
        text: as it came; empty where there is none.
        finish: why the text ends there, in the service's words.
        model: what answered, in the service's words, such as a version.
        tokens_in, tokens_out: as the service counts them; None where it does not say, or
            something that is no whole number.
        requests: how many were made until it came.

    Raises:
        AnswerError: ``text`` is no text.
    """

    text: str
    finish: str | None = None
    model: str | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None
    requests: int = 1

    def __post_init__(self) -> None:
        # servers send what they like, and one field of another type must not cost the answer
        if not isinstance(self.text, str):
            kind = type(self.text).__name__
            raise AnswerError(f"the text of a reply is of type {kind}, expected str")
        for name in ("finish", "model"):
            given = getattr(self, name)
            object.__setattr__(self, name, None if given is None else str(given))
        for name in ("tokens_in", "tokens_out"):
            object.__setattr__(self, name, _count(getattr(self, name)))


Client: TypeAlias = Callable[[Request], str | Reply]
"""Who answers. A ``ConnectionError`` or ``TimeoutError`` that it raises is worth another try."""


class NoReply(AnswerError):
    """A request to which no answer came.

    Attributes:
        again: whether the same request may succeed later.
        requests: how many were made.
    """

    def __init__(self, reason: str, again: bool = False) -> None:
        super().__init__(reason)
        self.again, self.requests = again, 1


def writable(text: str) -> str:
    """Return a text without halves of surrogate pairs, which no file can hold."""
    return text.encode("utf-8", "replace").decode()


def in_a_line(text: str) -> str:
    """Return a text, or its beginning, in one line that a file can hold."""
    words = " ".join(writable(text).split())
    return words if len(words) <= _EXCERPT else words[: _EXCERPT - 3] + "..."


def _count(given: object) -> int | None:
    whole = isinstance(given, numbers.Integral) and not isinstance(given, bool)
    if whole or (isinstance(given, float) and given.is_integer()):
        return int(given)  # type: ignore[call-overload]
    return None
