"""A vision-language model that is asked about events, one answer kept for each request."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, Final

from phase_ppl.evaluation.answer import Answer
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.evaluation.vlm.asking import ask, first_readable
from phase_ppl.evaluation.vlm.film import RENDERING, Film
from phase_ppl.evaluation.vlm.prompt import TEXT, prompt
from phase_ppl.evaluation.vlm.request import Client, Request
from phase_ppl.evaluation.vlm.store import Attempt, Store, as_json
from phase_ppl.world.errors import AnswerError
from phase_ppl.world.files import write_json
from phase_ppl.world.observation import Observation
from phase_ppl.world.scene import Scene

ANSWER: Final = "answer.json"
"""The file in an event's folder that holds the request and all that came of it."""


@dataclasses.dataclass(frozen=True)
class Vlm:
    """A vision-language model, ready to be asked.

    Attributes:
        client: answers.
        named: what of the client determines its answers: ``client``, ``model`` and settings.
        pictures: how many frames there are to see, at most.
        as_video: whether the prompt speaks of a video.
        store: keeps the answers, if they are to be kept.
        replay: whether stored answers are all there is.
        retries: how often an event is asked about again, at most.
        remaining: what becomes of probability that an answer gives to no goal.
    """

    client: Client
    named: Mapping[str, Any]
    pictures: int
    as_video: bool
    store: Store | None
    replay: bool
    retries: int
    remaining: str

    def __call__(self, scene: Scene, observation: Observation, seed: int) -> Answer:
        """Return what the model answers, or has answered to the same request and seed before."""
        film = Film(scene, observation, self.pictures)
        request = Request(prompt(film, self.as_video), str(self.named["model"]), film)
        determines = {
            **self.named,
            "prompt_sha256": hashlib.sha256(request.prompt.encode()).hexdigest(),
            "film_sha256": film.digest,
        }
        found = self.store.find(determines, seed) if self.store else None
        record = found or {"request": determines, "seed": seed, "prompt": request.prompt}
        attempts: list[Attempt] = record.setdefault("attempts", [])

        def keep(attempt: Attempt) -> None:
            attempts.append(attempt)
            record["film"] = film.drawn()
            if self.store and any(each.text is not None for each in attempts):
                self.store.keep(record)

        parsed, place, reason = first_readable(attempts, self.remaining)
        stored = parsed is not None
        if not stored:
            if self.replay:
                raise AnswerError(self._missing(determines, seed, reason))
            ask(self.client, request, self.remaining, self.retries, keep)
            parsed, place, _ = first_readable(attempts, self.remaining)
        assert parsed is not None  # else asking has raised
        cost = _cost(attempts[: place + 1], len(parsed.repairs), stored)
        prediction = Prediction("", probabilities=parsed.probabilities, cost=cost)
        kept = {**record, "repairs": list(parsed.repairs), "remaining": self.remaining}
        return Answer(prediction, {ANSWER: lambda path: write_json(path, as_json(kept))})

    def settings(self) -> dict[str, Any]:
        """Return what is asked, and how the animation is drawn."""
        digest = hashlib.sha256(TEXT.encode()).hexdigest()
        return {**self.named, "prompt_sha256": digest, "rendering": RENDERING}

    def _missing(self, determines: Mapping[str, Any], seed: int, reason: str | None) -> str:
        assert self.store is not None
        name = self.store.file_of(determines, seed).name
        if reason is not None:
            return f"{self.store.path / name} has no answer that can be used; the last: {reason}"
        words = f"{self.store.path} has no answer to this request: {name} is missing"
        other = self.store.knows(determines)
        return f"{words}; it has been answered for other seeds only" if other else words


def _cost(attempts: Sequence[Attempt], repairs: int, stored: bool) -> dict[str, Any]:
    """Return what an answer cost when it was given, even if that was long ago."""
    cost = {
        "requests": len(attempts),
        "failures": sum(each.text is None for each in attempts),
        "refused": sum(each.text is not None for each in attempts[:-1]),
        "repairs": repairs,
        "from_store": stored,
        "answer_seconds": sum(each.seconds for each in attempts),
    }
    for name in ("tokens_in", "tokens_out"):
        counts = [getattr(each, name) for each in attempts]
        known = [count for count in counts if count is not None]
        if known:
            cost[name] = sum(known)
    return cost
