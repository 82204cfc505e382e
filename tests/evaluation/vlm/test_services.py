"""Google's and OpenAI's libraries against a server on this machine that misbehaves."""

from __future__ import annotations

import base64
import logging
import re
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest

from phase_ppl.evaluation.registry import is_installed, ready
from phase_ppl.evaluation.vlm.request import NoReply, Picture, Reply, Request, parse
from phase_ppl.evaluation.vlm.services import SERVICES, Service, make_service
from phase_ppl.world.errors import AnswerError, InvalidSettingError
from tests.evaluation.toys import still
from tests.evaluation.vlm.answers import from_google, from_openai
from tests.evaluation.vlm.server import Server, hangs_up, running, says_nothing, sends

KEY = "sk-secret-0123456789abcdef"
VARIABLES = ("GOOGLE_API_KEY", "GEMINI_API_KEY", "OPENAI_API_KEY")
ENVELOPES: dict[str, Callable[..., Any]] = {"google": from_google, "openai": from_openai}
HERE = {name: is_installed(module) for name, module in SERVICES.items()}


class Asked(NamedTuple):
    """A service and the server that stands for it."""

    name: str
    server: Server

    def service(self, timeout: float = 20.0, **more: Any) -> Service:
        given = {"base_url": self.server.url, "timeout": timeout, **more}
        show = given.pop("show", None)
        return make_service(self.name, "the-model", show, given, to_be_asked=True)

    def envelope(self, content: str | None, **more: Any) -> Any:
        return ENVELOPES[self.name](content, **more)

    def reply(self, body: Any, **more: Any) -> Reply:
        """Return the reply to what the server sends."""
        self.server.behaviours = [sends(body)]
        return self.service(**more)(request())

    def failure(self, *behaviours: Any, timeout: float = 20.0, retries: int = 0) -> NoReply:
        """Return the failure that comes of what the server does."""
        self.server.behaviours = list(behaviours)
        with pytest.raises(NoReply) as caught:
            self.service(timeout)(request(), retries)
        return caught.value


@pytest.fixture(scope="module")
def listening() -> Iterator[Server]:
    with running() as server:
        yield server


@pytest.fixture
def server(listening: Server, monkeypatch: pytest.MonkeyPatch) -> Server:
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    monkeypatch.setenv("GEMINI_API_KEY", KEY)
    listening.seen.clear()
    return listening


def installed(name: str, server: Server) -> Asked:
    if not HERE[name]:
        pytest.skip(f"{SERVICES[name]} is not installed (extra vlm)")
    return Asked(name, server)


@pytest.fixture(params=list(SERVICES))
def asked(request: pytest.FixtureRequest, server: Server) -> Asked:
    return installed(request.param, server)


@pytest.fixture
def google(server: Server) -> Asked:
    return installed("google", server)


@pytest.fixture
def openai(server: Server) -> Asked:
    return installed("openai", server)


def request() -> Request:
    event = still()
    asked = Request(event.scene, event.observation, "the-model", 2, as_video=True)
    asked.__dict__["video"] = b"a video"
    asked.__dict__["pictures"] = (Picture(0.0, b"first"), Picture(0.5, b"last"))
    return asked


def test_an_answer_comes_back_with_what_the_service_counts(asked: Asked) -> None:
    reply = asked.reply(asked.envelope("{}"))
    assert (reply.text, reply.model) == ("{}", "the-model-001")
    assert reply.finish is not None
    assert reply.finish.lower() == "stop"
    assert (reply.tokens_in, reply.tokens_out) == (1000, 230)
    assert len(asked.server.seen) == 1


@pytest.mark.parametrize("show", ["video", "pictures"])
def test_google_gets_what_is_shown_then_the_question(google: Asked, show: str) -> None:
    settings = {"video_fps": 5, "temperature": 0.5} if show == "video" else {}
    google.reply(google.envelope("{}"), show=show, **settings)
    seen = google.server.seen[0]
    assert seen.path.endswith("/models/the-model:generateContent")
    assert KEY not in seen.path
    assert seen.headers["x-goog-api-key"] == KEY
    *shown, question = seen.body["contents"][0]["parts"]
    assert question == {"text": request().prompt}
    config = {"responseMimeType": "application/json"}
    if show == "video":
        assert "video/mp4" in shown[0]["inlineData"].values()
        data = shown[0]["inlineData"]["data"].replace("-", "+").replace("_", "/")
        assert base64.b64decode(data) == b"a video"
        assert shown[0]["videoMetadata"] == {"fps": 5.0}
        config["temperature"] = 0.5
    else:
        assert [part.get("text") for part in shown] == ["0 s", None, "0.5 s", None]
        assert "image/png" in shown[1]["inlineData"].values()
    assert seen.body["generationConfig"] == config


def test_openai_gets_pictures_with_their_times_then_the_question(openai: Asked) -> None:
    openai.reply(openai.envelope("{}"))
    seen = openai.server.seen[0]
    assert seen.path == "/chat/completions"
    assert seen.headers["authorization"] == f"Bearer {KEY}"
    assert set(seen.body) == {"model", "messages", "stream", "response_format"}
    assert seen.body["response_format"] == {"type": "json_object"}
    parts = seen.body["messages"][0]["content"]
    assert [part.get("text") for part in parts] == ["0 s", None, "0.5 s", None, request().prompt]
    first = parts[1]["image_url"]["url"]
    assert first == "data:image/png;base64," + base64.b64encode(b"first").decode()


@pytest.fixture
def sleeps(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What the libraries, which sleep by the clock of Python, would have slept."""
    found: list[float] = []
    real = time.sleep
    monkeypatch.setattr(time, "sleep", lambda s: found.append(s) if s > 0.05 else real(s))
    return found


def test_the_library_tries_again_where_a_failure_may_pass(
    asked: Asked, sleeps: list[float]
) -> None:
    busy = sends({"error": {"message": "slow down"}}, 429, retry_after="7")
    oops = sends({"error": {"message": "oops"}}, 503)
    asked.server.behaviours = [busy, oops, sends(asked.envelope("{}"))]
    reply = asked.service()(request(), 3)
    assert (reply.text, reply.requests, len(asked.server.seen)) == ("{}", 3, 3)
    assert len(sleeps) == 2
    if asked.name == "openai":  # Google's library does not heed the header
        assert sleeps[0] == 7
    else:
        assert sleeps[0] >= 4


def test_the_library_gives_up_at_the_limit(asked: Asked, sleeps: list[float]) -> None:
    found = asked.failure(sends({"error": {"message": "slow down"}}, 429), retries=2)
    assert (str(found), found.again) == ("HTTP 429: slow down", False)
    assert found.requests == len(asked.server.seen) == 3
    assert len(sleeps) == 2


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (sends("<h1>Oh dear</h1>", 503, content_type="text/html"), "HTTP 503: .*Oh dear"),
        (sends({"error": {"message": "video too long"}}, 400), "HTTP 400: video too long$"),
    ],
)
def test_what_the_library_gave_up_is_over(asked: Asked, answer: Any, reason: str) -> None:
    found = asked.failure(answer)
    assert (found.again, found.requests, len(asked.server.seen)) == (False, 1, 1)
    assert re.match(reason, str(found))


@pytest.mark.parametrize("status", [401, 403])
def test_a_refused_key_ends_it_and_is_not_shown(asked: Asked, status: int) -> None:
    masked = f"{KEY[:8]}***{KEY[-4:]}"
    asked.server.behaviours = [sends({"error": {"message": f"bad key {masked}"}}, status)]
    with pytest.raises(InvalidSettingError, match=r"_API_KEY is refused") as caught:
        asked.service()(request())
    assert masked not in str(caught.value)


def test_a_key_that_google_calls_invalid_is_refused_too(google: Asked) -> None:
    details = [{"reason": "API_KEY_INVALID", "domain": "googleapis.com"}]
    body = {"error": {"code": 400, "message": "API key not valid.", "details": details}}
    google.server.behaviours = [sends(body, 400)]
    with pytest.raises(InvalidSettingError, match="is refused"):
        google.service()(request())


def test_an_unknown_model_is_a_setting(asked: Asked) -> None:
    asked.server.behaviours = [sends({"error": {"message": "no such model"}}, 404)]
    with pytest.raises(InvalidSettingError, match=r"404 to name='the-model': no such model"):
        asked.service()(request())


@pytest.mark.parametrize(
    "behaviour",
    [sends("not json"), sends("[1, 2]"), hangs_up, sends(from_openai("{}"), share=0.5)],
    ids=["no JSON", "a list", "nothing", "half an answer"],
)
def test_what_is_no_answer_may_be_one_the_next_time(asked: Asked, behaviour: Any) -> None:
    asked.server.behaviours = [behaviour]
    with pytest.raises(AnswerError) as caught:
        parse(asked.service()(request()).text)
    assert getattr(caught.value, "again", True)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("changes", "text", "finish"),
    [
        ({"choices": [None]}, "", None),
        ({"choices": None, "error": {"message": "busy"}}, "", "{'message': 'busy'}"),
        ({"choices": [{"message": {"content": [{"text": ""}]}}]}, "[{'text': ''}]", None),
    ],
    ids=["null", "an error that is called a success", "parts"],
)
def test_what_openais_library_hands_on_unchecked_is_no_answer(
    openai: Asked, changes: dict[str, Any], text: str, finish: str | None
) -> None:
    reply = openai.reply({**openai.envelope("{}"), **changes})
    assert (reply.text, reply.finish) == (text, finish)


def test_what_stands_beside_an_answer_does_not_cost_it(openai: Asked) -> None:
    odd = {"usage": {"prompt_tokens": "12", "completion_tokens": 3.0}, "model": 3}
    reply = openai.reply({**openai.envelope("{}"), **odd})
    assert (reply.text, reply.model, reply.tokens_in, reply.tokens_out) == ("{}", "3", None, 3)


def test_google_counts_what_was_thought_until_the_limit(google: Asked) -> None:
    body = google.envelope(None, finish="MAX_TOKENS")
    del body["usageMetadata"]["candidatesTokenCount"]
    assert google.reply(body).tokens_out == 30


def test_an_answer_of_another_form_does_not_show_pieces_of_the_key(google: Asked) -> None:
    text = "x" * 15 + KEY + "y" * 60  # a cut would go through the key
    found = google.failure(sends({"candidates": [{"content": {"parts": text}}]}))
    assert found.again
    assert "of another form" in str(found)
    assert KEY[:6] not in str(found)


def test_an_answer_that_takes_too_long_is_given_up(asked: Asked) -> None:
    found = asked.failure(says_nothing, timeout=0.4)
    assert found.again
    assert re.search(r"[Tt]imeout|timed out", str(found))


def test_nobody_listens(asked: Asked) -> None:
    with pytest.raises(NoReply) as caught:
        asked.service(base_url="http://127.0.0.1:9")(request())
    assert caught.value.again


@pytest.mark.parametrize("status", [302, 307])
def test_a_redirection_is_not_followed(asked: Asked, status: int) -> None:
    with running() as other:
        other.behaviours = [sends(asked.envelope("{}"))]
        elsewhere = other.url.replace("127.0.0.1", "localhost") + "/"
        found = asked.failure(sends("", status, location=elsewhere))
        assert f"HTTP {status}" in str(found)
        assert other.seen == []


@pytest.mark.parametrize("content", [None, ""])
def test_a_text_that_is_missing_is_empty_and_says_why(asked: Asked, content: str | None) -> None:
    finish = {"google": "SAFETY", "openai": "content_filter"}[asked.name]
    reply = asked.reply(asked.envelope(content, finish=finish))
    assert (reply.text, reply.finish) == ("", finish)


def test_refusals_are_told_apart(asked: Asked) -> None:
    body, finish = {
        "google": (
            {"promptFeedback": {"blockReason": "PROHIBITED_CONTENT"}},
            "blocked: PROHIBITED_CONTENT",
        ),
        "openai": (from_openai(None, refusal="I will not."), "refusal: I will not."),
    }[asked.name]
    reply = asked.reply(body)
    assert (reply.text, reply.finish) == ("", finish)


def test_no_key_or_one_that_cannot_be_is_said_before_anything_is_sent(
    asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MY_KEY", "two\nlines-of-secret")
    with pytest.raises(InvalidSettingError, match="MY_KEY has characters") as caught:
        asked.service(key_env="MY_KEY")(request())
    assert "secret" not in str(caught.value)
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    service = make_service(asked.name, "the-model", None, {}, to_be_asked=True)
    with pytest.raises(InvalidSettingError, match=r"needs its key in the environment variable"):
        service(request())


def test_a_server_of_ones_own_may_need_no_key(
    asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    assert asked.reply(asked.envelope("none at all")).text == "none at all"
    monkeypatch.setenv("MY_KEY", "all")
    with pytest.raises(InvalidSettingError, match=r"variable NO_KEY$"):
        asked.service(key_env="NO_KEY")(request())
    reply = asked.service(key_env="MY_KEY")(request())
    assert "all" in str(asked.server.seen[1].headers)
    assert reply.text == "none at all", "what is no secret was hidden"


def test_the_key_is_in_nothing_that_comes_back(
    asked: Asked, caplog: pytest.LogCaptureFixture
) -> None:
    echo = {"error": {"message": f"you sent {KEY}"}}
    at_the_cut = {"error": {"message": "x" * 190 + KEY}}
    service = asked.service()
    shown = [repr(service), str(service.named()), repr(ready("vlm", {"client": service.__call__}))]
    with caplog.at_level(logging.DEBUG):
        for behaviour in (
            sends(echo, 500),
            sends(echo, 400),
            sends(echo, 404),
            sends(at_the_cut, 500),
            sends(KEY),
        ):
            asked.server.behaviours = [behaviour]
            with pytest.raises((NoReply, InvalidSettingError)) as caught:
                service(request())
            shown.append("".join(traceback.format_exception(caught.value)))
        asked.server.behaviours = [sends(asked.envelope(f"the key is {KEY}"))]
        reply = service(request())
    assert reply.text == "the key is [key]"
    assert KEY[:8] not in "".join([*shown, repr(reply), caplog.text])


# --- addresses -------------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["server", "10.0.0.7:8000", "127.0.0.1.server", "[2001:db8::1]"])
def test_nothing_secret_goes_to_another_machine_in_the_open(
    host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    given = {"base_url": f"http://{host}/v1"}
    with pytest.raises(InvalidSettingError, match="could read the key: use https://"):
        make_service("openai", "m", None, {**given, "key_env": "MY_KEY"}, to_be_asked=True)
    with pytest.warns(UserWarning, match="whoever is between can read and change everything"):
        service = make_service("openai", "m", None, given, to_be_asked=True)
    assert service._key() == "none"


@pytest.mark.parametrize("url", ["https://server/v1", "http://localhost:1/v1", "http://[::1]:8/v1"])
def test_a_key_goes_by_https_and_within_this_machine(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    assert make_service("openai", "m", None, {"base_url": url}, to_be_asked=True)._key() == KEY
