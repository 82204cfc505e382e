"""The model vlm: asked, asked again, kept, replayed, and what a wrong setting gets to hear."""

from __future__ import annotations

import dataclasses
import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation import registry
from phase_ppl.evaluation.models import vlm as vlm_model
from phase_ppl.evaluation.models.vlm import vlm
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.models.vlm import Google, NoReply, Reply, Request
from phase_ppl.world.errors import (
    AnswerError,
    InvalidSettingError,
    UnknownNameError,
)
from tests.evaluation.toys import still
from tests.models.vlm.answers import from_google, goals, text
from tests.models.vlm.server import running, sends

EVENT = still()


class Says:
    """Answers by one thing after the other, the last for ever; exceptions are raised."""

    def __init__(self, *what: Any) -> None:
        self.what = what
        self.asked: list[Request] = []

    def __call__(self, request: Request) -> Any:
        self.asked.append(request)
        found = self.what[min(len(self.asked), len(self.what)) - 1]
        if isinstance(found, Exception):
            raise found
        return found


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    found: list[float] = []
    monkeypatch.setattr(vlm_model, "pause", found.append)
    return found


def predict(client: Any, seed: int = 0, event: ppl.Event = EVENT, **options: Any) -> Prediction:
    model = vlm(client=client, name="toy", **options)
    given = model(event.scene, event.observation, seed).given
    assert isinstance(given, Prediction)
    return given


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.json"))


# --- what is asked ---------------------------------------------------------------------------


def test_a_function_gets_the_question_the_video_and_pictures() -> None:
    client = Says(text())
    found = predict(client, event=still(n_frames=4), frames=3)
    (request,) = client.asked
    assert found.answers["goal_red"] == ppl.GOALS[0]
    assert request.model == "toy"
    assert request.video[4:8] == b"ftyp"
    assert [picture.seconds for picture in request.pictures] == [0, 0.5, 0.75]
    shown = np.asarray(Image.open(io.BytesIO(request.pictures[0].png)))
    assert shown.shape == (480, 640, 3)
    red, landmark = shown[240, 160], shown[100, 170]
    assert (tuple(red), tuple(landmark)) == ((255, 0, 0), (45, 45, 180))


def test_the_prompt_has_the_content_of_the_papers() -> None:
    client = Says(text())
    predict(client)
    predict(client, show="pictures")
    video, pictures = (request.prompt for request in client.asked)
    for words in (*ppl.GOALS, "friendly", "neutral", "adversarial", "exactly 10", "JSON"):
        assert words in video
    assert "heavier" in video
    assert video.startswith("The video")
    assert pictures.startswith("The 3 pictures are frames of one animation of 0.5 seconds")
    assert "{{" not in video, "a brace of the template was left"


def test_a_prompt_of_ones_own_is_asked_and_known_by_its_text(tmp_path: Path) -> None:
    own = tmp_path / "own.txt"
    own.write_text('Choose from:\n{goals_str}\nAnswer as {"red_agent_goals": {...}}')
    answers = json.dumps({
        "red_agent_goals": goals(), "green_agent_goals": goals(5),
        "relation": {"Friendly": 0.7, "Neutral": 0.2, "Adversarial": 0.1},
    })  # fmt: skip
    client = Says(answers)
    found = predict(client, prompt=own, store=tmp_path / "kept")
    asked = client.asked[0].prompt
    assert asked.startswith("Choose from:\n- Get blue item to blue lm\n")
    assert asked.endswith('{"red_agent_goals": {...}}')
    assert found.answers["goal_red"] == next(iter(goals()))
    assert found.answers["relation"] == "friendly"
    usual = Says(text())
    predict(usual, store=tmp_path / "kept")  # another prompt is another request
    assert len(usual.asked) == 1
    made: list[Any] = [vlm(client=usual, name="toy", prompt=given) for given in (None, own)]
    one, other = (model.settings()["prompt_sha256"] for model in made)
    assert one != other


# --- asking again ----------------------------------------------------------------------------


def test_an_answer_that_cannot_be_read_is_asked_for_again(waits: list[float]) -> None:
    client = Says("no", text(relation=None), Reply(f"```json\n{text()}\n```", tokens_in=5))
    cost = predict(client).cost
    assert len(client.asked) == 3
    assert waits == [], "only failures are worth waiting"
    seconds = cost["answer_seconds"]
    expected = {"requests": 3, "failures": 0, "refused": 2, "repairs": 1, "from_store": False}
    assert cost == {**expected, "tokens_in": 5, "answer_seconds": seconds}


def test_failures_that_may_pass_are_waited_for_ever_longer(waits: list[float]) -> None:
    busy = NoReply("HTTP 500", again=True)
    client = Says(busy, busy, TimeoutError("slow"), ConnectionError("gone"), busy, text())
    cost = predict(client, retries=5).cost
    assert waits == [2, 4, 8, 16, 32]
    assert (cost["requests"], cost["failures"], cost["refused"]) == (6, 5, 0)


# --- kept and replayed -----------------------------------------------------------------------


def test_a_stored_answer_is_not_asked_for_again(tmp_path: Path, waits: list[float]) -> None:
    first, second = Says(TimeoutError("slow"), "no", Reply(text(), tokens_out=7)), Says(text())
    before = predict(first, store=tmp_path)
    after = predict(second, store=tmp_path)
    assert second.asked == []
    assert np.array_equal(before.probabilities["goal_red"], after.probabilities["goal_red"])
    assert after.cost == {**before.cost, "from_store": True}
    (file,) = files(tmp_path)
    record = json.loads(file.read_text())
    assert record["request"]["model"] == "toy"
    assert record["prompt"] == first.asked[0].prompt
    assert [set(attempt) - {"seconds", "time"} for attempt in record["attempts"]] == [
        {"failure"}, {"text"}, {"text", "tokens_out"},
    ]  # fmt: skip


def test_a_replay_asks_nobody_and_draws_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    predict(Says(text()), store=tmp_path)
    monkeypatch.setattr(Request, "video", property(lambda self: pytest.fail("it was drawn")))
    silent = Says(AssertionError("asked"))
    assert predict(silent, store=tmp_path, replay=True).answers["goal_red"] == ppl.GOALS[0]
    with pytest.raises(AnswerError, match=r"no answer to this request.*for other seeds only"):
        predict(silent, store=tmp_path, replay=True, seed=3)
    with pytest.raises(AnswerError, match=r"no answer to this request: \w+-0\.json is missing$"):
        predict(silent, store=tmp_path, replay=True, event=still(shift=0.1))


# --- settings --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({}, "needs client='google' or a function"),
        ({"client": "gogle"}, "client 'gogle'.*'google'"),
        ({"client": "google", "timeout": 0}, "timeout=0, expected.*> 0"),
        ({"client": "google", "retries": -1}, "retries=-1"),
        ({"client": "google", "frames": 1}, "frames=1.*>= 2"),
        ({"client": "google", "replay": True}, "store is not given"),
        ({"client": "google", "show": "pictures", "video_fps": 2}, "video_fps is for the video"),
        ({"client": Says()}, "Says has no name of its own"),
        ({"client": lambda request: ""}, "lambda.* has no name"),
    ],
)
def test_a_wrong_setting_is_named(options: Any, reason: str) -> None:
    with pytest.raises((InvalidSettingError, UnknownNameError), match=reason):
        registry.model_info("vlm").make(**options)


def test_without_the_extra_only_functions_and_replays_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "is_installed", lambda module: False)
    said = r"needs google\.genai, .*pip install 'phase_ppl\[vlm\]'"
    with pytest.raises(InvalidSettingError, match=said):
        vlm(client="google", name="m")
    predict(Says(text()), store=tmp_path)
    vlm(client="google", store=tmp_path, replay=True)


# --- in an evaluation ------------------------------------------------------------------------


TWO = [still("a", 4), still("b", 3)]


def test_the_command_asks_a_service_and_writes_its_key_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("google.genai", reason="google.genai is not installed (extra vlm)")
    key = "sk-never-written-0123456789"
    monkeypatch.setenv("GOOGLE_API_KEY", key)
    ppl.save_events(TWO, tmp_path / "events.json")
    with running() as server:
        echo = from_google(f"```json\n{text(key=key)}\n```")
        server.behaviours = [sends(echo), sends({"error": f"bad {key}"}, 400)]
        asked = ["evaluate", str(tmp_path / "events.json"), "--model", "vlm", "--quiet"]
        asked += ["--option", "client=google", "--option", "name=the-model"]
        asked += [f"--option=store={tmp_path / 'store'}"]
        field = ("base_url", str, server.url)
        here = dataclasses.make_dataclass("Here", [field], bases=(Google,), frozen=True)
        monkeypatch.setattr(vlm_model, "Google", here)
        first = main([*asked, "--out", str(tmp_path / "one")])
        again = main([*asked, "--option", "replay=true", "--out", str(tmp_path / "two")])
    assert (first, again) == (1, 1), "one event has no answer"
    assert len(server.seen) == 2
    assert key in str(server.seen[0].headers)
    written = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert any(b"the-model-001" in content for content in written)
    assert not any(key.encode() in content for content in written)
    printed = capsys.readouterr()
    assert key not in printed.out + printed.err
    predictions = [
        json.loads((path / "prediction.json").read_text())
        for path in sorted(tmp_path.glob("*/events/0000-a"))
    ]
    assert predictions[0]["probabilities"] == predictions[1]["probabilities"]
    assert predictions[0]["cost"]["repairs"] == 2
    assert [each["cost"]["from_store"] for each in predictions] == [False, True]
    assert key == os.environ["GOOGLE_API_KEY"]


LIMITS: list[tuple[Any, int, int, str]] = [
    (NoReply("HTTP 503", again=True), 2, 3, "in 3 requests; the last: HTTP 503"),
    (Reply("", finish="SAFETY"), 1, 2, r"the answer is empty \(ended by: SAFETY\)"),
    (b"bytes", 4, 1, "the client returned b'bytes', expected text"),
]


def test_there_is_a_limit(waits: list[float]) -> None:
    for says, retries, asked, reason in LIMITS:
        client = Says(says)
        with pytest.raises(AnswerError, match=reason):
            predict(client, retries=retries)
        assert len(client.asked) == asked
