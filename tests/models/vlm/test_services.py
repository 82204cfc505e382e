"""Google's library against a server on this machine that misbehaves."""

from __future__ import annotations

import base64
import logging
import re
import time
import traceback
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from phase_ppl.evaluation.registry import is_installed, ready
from phase_ppl.models.vlm import LIBRARY, Google, NoReply, Picture, Reply, Request
from phase_ppl.world.errors import InvalidSettingError
from tests.evaluation.toys import still
from tests.models.vlm.answers import from_google
from tests.models.vlm.server import (
    Server,
    running,
    says_nothing,
    sends,
)

KEY = "sk-secret-0123456789abcdef"


class Asked(NamedTuple):
    """The server that stands for the service."""

    server: Server

    def service(self, **more: Any) -> Google:
        return Google("the-model", **{"base_url": self.server.url, "timeout": 20.0, **more})

    def reply(self, *behaviours: Any, retries: int = 0, **more: Any) -> Reply:
        """Return the reply to what the server does, or sends."""
        self.server.seen.clear()
        self.server.behaviours = [one if callable(one) else sends(one) for one in behaviours]
        return self.service(**more)(request(), retries)

    def failure(self, *behaviours: Any, **more: Any) -> NoReply:
        """Return the failure that comes of what the server does."""
        with pytest.raises(NoReply) as caught:
            self.reply(*behaviours, **more)
        return caught.value


@pytest.fixture(scope="module")
def listening() -> Iterator[Server]:
    with running() as server:
        yield server


@pytest.fixture
def asked(listening: Server, monkeypatch: pytest.MonkeyPatch) -> Asked:
    if not is_installed(LIBRARY):
        pytest.skip(f"{LIBRARY} is not installed (extra vlm)")
    monkeypatch.delenv("GOOGLE_API_KEY", raising=False)
    monkeypatch.setenv("GEMINI_API_KEY", KEY)
    listening.seen.clear()
    return Asked(listening)


def request() -> Request:
    event = still()
    asked = Request(event.scene, event.observation, "the-model", 2, as_video=True)
    asked.__dict__["video"] = b"a video"
    asked.__dict__["pictures"] = (Picture(0.0, b"first"), Picture(0.5, b"last"))
    return asked


def test_google_gets_what_is_shown_then_the_question(asked: Asked) -> None:
    reply = asked.reply(from_google("{}"), show="video", video_fps=5, temperature=0.5)
    assert (reply.text, reply.model) == ("{}", "the-model-001")
    assert (reply.tokens_in, reply.tokens_out) == (1000, 230)
    (seen,) = asked.server.seen
    assert seen.path.endswith("/models/the-model:generateContent")
    assert KEY not in seen.path
    assert seen.headers["x-goog-api-key"] == KEY
    video, question = seen.body["contents"][0]["parts"]
    assert question == {"text": request().prompt}
    assert "video/mp4" in video["inlineData"].values()
    assert base64.urlsafe_b64decode(video["inlineData"]["data"]) == b"a video"
    assert video["videoMetadata"] == {"fps": 5.0}
    config = {"responseMimeType": "application/json"}
    assert seen.body["generationConfig"] == {**config, "temperature": 0.5}
    asked.reply(from_google("{}"), show="pictures")
    body = asked.server.seen[0].body
    *shown, _ = body["contents"][0]["parts"]
    assert [part.get("text") for part in shown] == ["0 s", None, "0.5 s", None]
    assert "image/png" in shown[1]["inlineData"].values()
    assert body["generationConfig"] == config


@pytest.fixture
def sleeps(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What the libraries, which sleep by the clock of Python, would have slept."""
    found: list[float] = []
    real = time.sleep
    monkeypatch.setattr(time, "sleep", lambda s: found.append(s) if s > 0.05 else real(s))
    return found


def test_the_library_tries_again_where_a_failure_may_pass_up_to_a_limit(
    asked: Asked, sleeps: list[float]
) -> None:
    busy = sends({"error": {"message": "slow down"}}, 429, retry_after="7")
    oops = sends({"error": {"message": "oops"}}, 503)
    reply = asked.reply(busy, oops, from_google("{}"), retries=3)
    assert (reply.text, reply.requests, len(asked.server.seen)) == ("{}", 3, 3)
    assert len(sleeps) == 2
    assert sleeps[0] >= 4, "Google's library does not heed the header"
    found = asked.failure(busy, retries=2)
    assert (str(found), found.again) == ("HTTP 429: slow down", False)
    assert found.requests == len(asked.server.seen) == 3


INVALID = {"code": 400, "message": "API key not valid.", "details": [{"reason": "API_KEY_INVALID"}]}


REFUSALS: list[tuple[int, Any, type[Exception], str]] = [
    (400, {"error": {"message": "video too long"}}, NoReply, "^HTTP 400: video too long$"),
    (401, {"error": {"message": f"bad {KEY[:9]}***"}}, InvalidSettingError, "KEY is refused"),
    (404, {"error": {"message": "none such"}}, InvalidSettingError, "name='the-model': none"),
    (400, {"error": INVALID}, InvalidSettingError, "is refused"),
]


def test_a_refusal_ends_it_and_says_why(asked: Asked) -> None:
    for status, body, error, reason in REFUSALS:
        with pytest.raises(error, match=reason) as caught:
            asked.reply(sends(body, status), retries=0)
        assert not getattr(caught.value, "again", False)
        assert KEY[:9] not in str(caught.value)
        assert len(asked.server.seen) == 1


CUT = from_google(None, finish="MAX_TOKENS")
del CUT["usageMetadata"]["candidatesTokenCount"]


def test_an_answer_that_takes_too_long_is_given_up(asked: Asked) -> None:
    asked.service()  # imports the library
    with running() as server:  # of its own: what is given up may come to it later
        found = asked._replace(server=server).failure(says_nothing, timeout=0.2)
    assert found.again
    assert re.search(r"[Tt]imeout|timed out", str(found))


def test_a_redirection_is_not_followed_and_where_nobody_listens_may_somebody_later(
    asked: Asked,
) -> None:
    with running() as other:
        other.behaviours = [sends(from_google("{}"))]
        elsewhere = other.url.replace("127.0.0.1", "localhost") + "/"
        for status in (302, 307):
            found = asked.failure(sends("", status, location=elsewhere))
            assert f"HTTP {status}" in str(found)
        assert other.seen == []
    assert asked.failure(base_url="http://127.0.0.1:9").again


def test_the_key_is_in_nothing_that_comes_back(
    asked: Asked, caplog: pytest.LogCaptureFixture
) -> None:
    echo = {"error": {"message": f"you sent {KEY}"}}
    at_the_cut = {"error": {"message": "x" * 190 + KEY}}
    service = asked.service()
    shown = [repr(service), str(service.named()), repr(ready("vlm", {"client": service.__call__}))]
    with caplog.at_level(logging.DEBUG):
        for body, status in ((echo, 500), (echo, 400), (echo, 404), (at_the_cut, 500), (KEY, 200)):
            asked.server.behaviours = [sends(body, status)]
            with pytest.raises((NoReply, InvalidSettingError)) as caught:
                service(request())
            shown.append("".join(traceback.format_exception(caught.value)))
        asked.server.behaviours = [sends(from_google(f"the key is {KEY}"))]
        reply = service(request())
    assert reply.text == "the key is [key]"
    assert KEY[:8] not in "".join([*shown, repr(reply), caplog.text])
