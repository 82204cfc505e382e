"""Google's models (Gemini) through Google's library google-genai."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Final

from phase_ppl.evaluation.vlm.film import PICTURE_TYPE, VIDEO_TYPE
from phase_ppl.evaluation.vlm.request import NoReply, Reply, Request, in_a_line
from phase_ppl.evaluation.vlm.service import Service

BASE_URL: Final = "https://generativelanguage.googleapis.com"
VARIABLES: Final = ("GOOGLE_API_KEY", "GEMINI_API_KEY")
MODEL: Final = "gemini-2.5-pro"
"""The paper's."""

MAX_FPS: Final = 24.0
_DELAY: Final = re.compile(r"(\d{1,9}(?:\.\d+)?)s")


@dataclasses.dataclass(frozen=True)
class GoogleClient(Service):
    """Asks Google's Gemini API, by default with the video itself."""

    name: ClassVar[str] = "google"

    def _ask(self, request: Request, key: str) -> Reply:
        from google import genai
        from google.genai import types

        options = types.HttpOptions(
            base_url=self.base_url,
            timeout=round(1000 * self.timeout),
            retry_options=types.HttpRetryOptions(attempts=1),
            # the header with the key would go along to wherever the answer points
            client_args={"follow_redirects": False},
        )
        config = types.GenerateContentConfig(temperature=self.temperature)
        with genai.Client(api_key=key, vertexai=False, http_options=options) as client:
            found = client.models.generate_content(
                model=self.model, contents=list(self._parts(request)), config=config
            )
        return _reply(found)

    def _parts(self, request: Request) -> Iterator[Any]:
        from google.genai import types

        if self.show == "video":
            chosen = types.VideoMetadata(fps=self.video_fps) if self.video_fps else None
            blob = types.Blob(data=request.video, mime_type=VIDEO_TYPE)
            yield types.Part(inline_data=blob, video_metadata=chosen)
        else:
            for picture in request.pictures:
                yield types.Part.from_text(text=f"{picture.seconds:g} s")
                yield types.Part.from_bytes(data=picture.png, mime_type=PICTURE_TYPE)
        yield types.Part.from_text(text=request.prompt)

    def _error(self, error: Exception, key: str) -> Exception:
        from google.genai import errors
        from pydantic import ValidationError

        if isinstance(error, ValidationError):
            # its own text has pieces of what was sent, which may be pieces of the key
            wrong = error.errors(include_url=False, include_input=False, include_context=False)
            places = (f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in wrong)
            return NoReply(in_a_line(f"an answer of another form: {'; '.join(places)}"), again=True)
        if not isinstance(error, errors.APIError):
            return self._broken(error, key)
        details = list(_details(error.details))
        if any(entry.get("reason") == "API_KEY_INVALID" for entry in details):
            return self._refused(401, "", {}, key)
        found = self._refused(error.code, error.details, _headers(error), key)
        if isinstance(found, NoReply) and found.again and found.wait is None:
            found.wait = _delay(details)
        return found


def _reply(found: Any) -> Reply:
    """Return an answer in our terms; one without text is an empty one, with the reason."""
    usage = found.usage_metadata
    candidate = found.candidates[0] if found.candidates else None
    finish = _word(candidate.finish_reason) if candidate else None
    if candidate is None and not found.prompt_feedback:
        raise NoReply("the service sent no candidates", again=True)
    if candidate is None:
        finish = f"blocked: {_word(found.prompt_feedback.block_reason)}"
    # what it thought is paid for too, also where it thought until the limit
    counts = (usage.candidates_token_count, usage.thoughts_token_count) if usage else ()
    written = [count for count in counts if count is not None]
    return Reply(
        text=found.text or "",
        finish=finish,
        model=found.model_version,
        tokens_in=usage.prompt_token_count if usage else None,
        tokens_out=sum(written) if written else None,
    )


def _word(reason: Any) -> str | None:
    return None if reason is None else str(getattr(reason, "value", reason))


def _headers(error: Any) -> Mapping[str, str]:
    return getattr(error.response, "headers", None) or {}


def _details(body: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the details of an error, as Google lists them."""
    inner = body.get("error", body) if isinstance(body, Mapping) else {}
    listed = inner.get("details") if isinstance(inner, Mapping) else None
    for entry in listed if isinstance(listed, list) else []:
        if isinstance(entry, Mapping):
            yield entry


def _delay(details: list[Mapping[str, Any]]) -> float | None:
    """Return how long an error asks to wait, which Google says in its details."""
    for entry in details:
        found = _DELAY.fullmatch(str(entry.get("retryDelay")))
        if found:
            return float(found[1])
    return None
