"""OpenAI's models, and whatever speaks its chat completions, through the library openai."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Iterator
from typing import Any, ClassVar, Final

from phase_ppl.evaluation.vlm.film import PICTURE_TYPE
from phase_ppl.evaluation.vlm.request import NoReply, Reply, Request
from phase_ppl.evaluation.vlm.service import Service

BASE_URL: Final = "https://api.openai.com/v1"
VARIABLES: Final = ("OPENAI_API_KEY",)


@dataclasses.dataclass(frozen=True)
class OpenAIClient(Service):
    """Asks an OpenAI-compatible API, which takes pictures and no video."""

    name: ClassVar[str] = "openai"

    def _ask(self, request: Request, key: str) -> Reply:
        import openai

        message = {"role": "user", "content": list(_parts(request))}
        chosen = {} if self.temperature is None else {"temperature": self.temperature}
        with openai.OpenAI(
            api_key=key, base_url=self.base_url, timeout=self.timeout, max_retries=0
        ) as client:
            found = client.chat.completions.create(
                model=self.model, messages=[message], stream=False, **chosen
            )
        return _reply(found)

    def _error(self, error: Exception, key: str) -> Exception:
        import openai

        if isinstance(error, openai.APIStatusError):
            return self._refused(error.status_code, error.body, error.response.headers, key)
        if isinstance(error, openai.APIConnectionError) and error.__cause__ is not None:
            error = error.__cause__ if isinstance(error.__cause__, Exception) else error
        return self._broken(error, key)


def _parts(request: Request) -> Iterator[dict[str, Any]]:
    for picture in request.pictures:
        yield {"type": "text", "text": f"{picture.seconds:g} s"}
        content = base64.b64encode(picture.png).decode()
        url = f"data:{PICTURE_TYPE};base64,{content}"
        yield {"type": "image_url", "image_url": {"url": url}}
    yield {"type": "text", "text": request.prompt}


def _reply(found: Any) -> Reply:
    """Return an answer in our terms; one without text is an empty one, with the reason."""
    # the library hands on, unchecked, whatever else a server sends
    choices = getattr(found, "choices", None)
    choice: Any = choices[0] if isinstance(choices, list) and choices else None
    if not hasattr(choice, "message"):
        what = "text that is no chat completion" if isinstance(found, str) else "no choices"
        error = getattr(found, "error", None)  # some servers send one with status 200
        beside = f", but {error}" if error else ""
        raise NoReply(f"the service sent {what}{beside}", again=True)
    message, usage = choice.message, getattr(found, "usage", None)
    refusal = getattr(message, "refusal", None)
    finish = getattr(choice, "finish_reason", None)
    content = getattr(message, "content", None)
    return Reply(
        text="" if content is None else content,
        finish=f"refusal: {refusal}" if refusal else finish,
        model=getattr(found, "model", None),
        tokens_in=getattr(usage, "prompt_tokens", None),
        tokens_out=getattr(usage, "completion_tokens", None),
    )
