"""The model vlm: asked, asked again, resumed, and what a wrong setting gets to hear."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.evaluation import registry
from phase_ppl.evaluation.models import vlm as vlm_model
from phase_ppl.evaluation.models.vlm import ANSWER, vlm
from phase_ppl.evaluation.prediction import Prediction
from phase_ppl.models.vlm import Reply, Request
from phase_ppl.world.errors import (
    AnswerError,
    InvalidSettingError,
    UnknownNameError,
)
from tests.evaluation.toys import still
from tests.models.vlm.answers import goals, text

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
    found = predict(client, prompt=own)
    asked = client.asked[0].prompt
    assert asked.startswith("Choose from:\n- Get blue item to blue lm\n")
    assert asked.endswith('{"red_agent_goals": {...}}')
    assert found.answers["goal_red"] == next(iter(goals()))
    assert found.answers["relation"] == "friendly"
    made: list[Any] = [vlm(client=client, name="toy", prompt=given) for given in (None, own)]
    one, other = (model.settings()["prompt_sha256"] for model in made)
    assert one != other


# --- asking again ----------------------------------------------------------------------------


def test_an_answer_that_cannot_be_read_is_asked_for_again(waits: list[float]) -> None:
    client = Says("no", text(relation=None), Reply(f"```json\n{text()}\n```", tokens_in=5))
    cost = predict(client).cost
    assert len(client.asked) == 3
    assert waits == [], "only failures are worth waiting"
    assert cost == {"requests": 3, "failures": 0, "refused": 2, "repairs": 1, "tokens_in": 5}


def test_failures_that_may_pass_are_waited_for_ever_longer(waits: list[float]) -> None:
    slow, gone = TimeoutError("slow"), ConnectionError("gone")
    client = Says(slow, gone, "no", slow, gone, text())
    cost = predict(client, retries=5).cost
    assert waits == [2, 4, 8, 16], "not after what cannot be read"
    assert (cost["requests"], cost["failures"], cost["refused"]) == (6, 4, 1)


# --- settings --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({}, "needs client=, a function"),
        ({"client": "google"}, "a function.*not client='google'"),
        ({"client": text, "retries": -1}, "retries=-1"),
        ({"client": text, "frames": 1}, "frames=1.*>= 2"),
        ({"client": Says()}, "Says has no name of its own"),
        ({"client": lambda request: ""}, "lambda.* has no name"),
    ],
)
def test_a_wrong_setting_is_named(options: Any, reason: str) -> None:
    with pytest.raises((InvalidSettingError, UnknownNameError), match=reason):
        registry.model_info("vlm").make(**options)


# --- in an evaluation ------------------------------------------------------------------------


TWO = [still("a", 4), still("b", 3)]


def test_what_was_said_is_kept_and_not_asked_for_again(tmp_path: Path) -> None:
    half = "\ud83d"  # of a pair: no file can hold it
    client = Says(half, Reply(f"```json\n{text()}\n```", model="m-001"), ValueError("busy"), text())
    asked: dict[str, Any] = {"client": client, "name": "m", "out": tmp_path, "progress": False}
    first = ppl.evaluate(TWO, "vlm", **asked)
    assert list(first.failures) == ["b"]
    again = ppl.evaluate(TWO, "vlm", resume=True, **asked)
    assert len(client.asked) == 4
    assert list(again.predictions) == ["a", "b"]
    assert json.loads((tmp_path / "events" / "0000-a" / ANSWER).read_text()) == {
        "prompt": client.asked[0].prompt,
        "replies": [{"text": "?"}, {"text": f"```json\n{text()}\n```", "model": "m-001"}],
        "repairs": ["code fence removed"],
    }
    with pytest.raises(InvalidSettingError, match=r"options\.name is 'other', was 'm'"):
        ppl.evaluate(TWO, "vlm", resume=True, **{**asked, "name": "other"})


def test_the_command_asks_a_function_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(f"def say(request):\n    return {text()!r}\n")
    asked = ["evaluate", "collaborate", "--model", "vlm", "--quiet"]
    assert main([*asked, f"--option=client={tmp_path / 'own.py'}:say"]) == 0
    assert main([*asked, "--option=client=google"]) == 2


LIMITS: list[tuple[Any, int, int, str]] = [
    (TimeoutError("slow"), 2, 3, "in 3 requests; the last: TimeoutError: slow"),
    (Reply("", finish="SAFETY"), 1, 2, r"the answer is empty \(ended by: SAFETY\)"),
    (b"bytes", 4, 1, "the client returned b'bytes', expected text"),
]


def test_there_is_a_limit(waits: list[float]) -> None:
    for says, retries, asked, reason in LIMITS:
        client = Says(says)
        with pytest.raises(AnswerError, match=reason):
            predict(client, retries=retries)
        assert len(client.asked) == asked
