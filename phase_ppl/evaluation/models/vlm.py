"""A vision-language model that watches the animation (paper, Appendix "Gemini 2.5 Pro")."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import time
from pathlib import Path
from typing import Any, Final

from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.registry import Answer, register_model
from phase_ppl.models.vlm import (
    TEXT,
    Client,
    Parsed,
    Reply,
    Request,
    in_a_line,
    parse,
    rendering,
)
from phase_ppl.world.errors import (
    AnswerError,
    InvalidSettingError,
    check_name,
    shown,
    whole_number,
)
from phase_ppl.world.event import Observation
from phase_ppl.world.files import write_json
from phase_ppl.world.identity import qualified_name
from phase_ppl.world.scene import Scene

ANSWER: Final = "answer.json"
"""The file in an event's folder with the prompt, all replies, and how the last was repaired."""

FIRST_WAIT: Final = 2.0
LONGEST_WAIT: Final = 120.0
"""First and longest wait after a failure that may pass, seconds; waits double."""

pause = time.sleep


@dataclasses.dataclass(frozen=True)
class Vlm:
    """A vision-language model, ready to be asked."""

    client: Client  # answers
    who: str  # answers, by name
    name: str  # of the model, which the client may ask for
    show: str  # "video" or "pictures"
    pictures: int  # how many frames there are to see, at most
    retries: int  # how often an event is asked about again, at most
    text: str = TEXT  # of the question, see ``TEXT``

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return what the model answers; it is asked again where that may help."""
        as_video = self.show == "video"
        request = Request(scene, observation, self.name, self.pictures, as_video, self.text)
        replies: list[Reply] = []
        wait = FIRST_WAIT
        for made in range(1, self.retries + 2):
            # the same request, as if for the first time: an answer never knows of another
            try:
                given = self.client(request)
            except (ConnectionError, TimeoutError) as error:
                reason = in_a_line(f"{type(error).__name__}: {error}")
                if made <= self.retries:
                    pause(wait)
                    wait = min(2 * wait, LONGEST_WAIT)
                continue
            reply = Reply(given) if isinstance(given, str) else given
            if not isinstance(reply, Reply):
                raise AnswerError(f"the client returned {shown(reply)}, expected text")
            replies.append(reply)
            try:
                return _answer(request.prompt, replies, parse(reply.text), made)
            except AnswerError as error:
                reason = f"{error} (ended by: {reply.finish})" if reply.finish else str(error)
        requests = f"{made} request{'s' * (made > 1)}"
        raise AnswerError(f"no answer that can be used in {requests}; the last: {reason}")

    def settings(self) -> dict[str, Any]:
        """Return what is asked, and how the animation is drawn."""
        asked = {"client": self.who, "model": self.name, "show": self.show}
        prompt = hashlib.sha256(self.text.encode()).hexdigest()
        return {**asked, "prompt_sha256": prompt, "rendering": rendering()}


def _answer(prompt: str, replies: list[Reply], parsed: Parsed, requests: int) -> Answer:
    """Return the answer in the last reply, with what it cost, and the file that keeps it all."""
    cost = {
        "requests": requests,
        "failures": requests - len(replies),
        "refused": len(replies) - 1,
        "repairs": len(parsed.repairs),
    }
    for name in ("tokens_in", "tokens_out"):
        known = [count for each in replies if (count := getattr(each, name)) is not None]
        if known:
            cost[name] = sum(known)
    kept = {
        "prompt": prompt,
        "replies": [{k: v for k, v in vars(each).items() if v is not None} for each in replies],
        "repairs": list(parsed.repairs),
    }
    prediction = Prediction("", probabilities=parsed.probabilities, cost=cost)
    return Answer(prediction, {ANSWER: lambda path: write_json(path, kept)})


@register_model("vlm", parallel=False)  # one request at a time: services count them
def vlm(
    *,
    client: Client | None = None,
    name: str | None = None,
    show: str = "video",
    frames: int = 24,
    retries: int = 4,
    prompt: str | os.PathLike[str] | None = None,
) -> Vlm:
    """A vision-language model that watches the animation and answers in JSON.

    Args:
        client: a function that takes a :class:`~phase_ppl.models.vlm.Request` and returns a text.
        name: of the model, which the function finds in ``request.model``; by default the
            function's own. An evaluation is resumed with the same name only.
        show: "video" or "pictures"; by default the video. A function may look at both; this is
            what the prompt speaks of.
        frames: how many pictures, evenly spaced, the first and the last frame among them.
        retries: how often the same request is made again after a failure that may pass or an
            answer that cannot be used.
        prompt: a text file with a prompt of one's own, in which ``{goals}`` stands for the names of
            the goals; by default :data:`phase_ppl.models.vlm.TEXT`.
    """
    if not callable(client):
        given = "" if client is None else f", not client={shown(client)}"
        raise InvalidSettingError(f"model 'vlm' needs client=, a function of a request{given}")
    check_name("show", show, ("video", "pictures"))
    if name is not None and not (isinstance(name, str) and name.strip()):
        raise InvalidSettingError(f"name={shown(name)}, expected a name")
    whole_number("frames", frames, minimum=2)
    whole_number("retries", retries, minimum=0)
    who = qualified_name(client)
    if name is None and (not hasattr(client, "__qualname__") or "<lambda>" in who):
        raise InvalidSettingError(
            f"client {who} has no name of its own: give name=, by which it is known when resumed"
        )
    text = TEXT if prompt is None else _users_prompt(prompt)
    return Vlm(client, who, name or who, show, frames, retries, text)


def _users_prompt(path: object) -> str:
    """Return the text of a file; InvalidSettingError: it is none that can be asked."""
    if not isinstance(path, str | os.PathLike):
        raise InvalidSettingError(f"prompt={shown(path)}, expected the name of a text file")
    try:
        text = Path(path).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no UTF-8 text"
        raise InvalidSettingError(f"prompt={path}: {reason}") from None
    if not ("{goals}" in text or "{goals_str}" in text):
        raise InvalidSettingError(
            f"prompt={path} has no {{goals}}, in whose place the names of the goals are put"
        )
    return text
