"""Models by name: what can be registered, what a wrong name or option gets to hear."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation import registry
from phase_ppl.evaluation.registry import ready
from phase_ppl.world.errors import InvalidSettingError
from tests.evaluation.toys import right, still


@pytest.fixture(autouse=True)
def _registered_for_this_test_only(monkeypatch: pytest.MonkeyPatch) -> None:
    registry.available_models()
    monkeypatch.setattr(registry.MODELS, "entries", dict(registry.MODELS.entries))


def make(answer: str = "friendly") -> Any:
    """Say one thing."""
    return lambda scene, observation, seed: {"relation": answer}


def test_a_registered_model_is_made_with_its_options_and_asked_by_name() -> None:
    ppl.register_model("one_thing")(make)
    found = ppl.evaluate(still(), "one_thing", workers=1, answer="adversarial")
    assert found.predictions["still"].answers == {"relation": "adversarial"}
    assert found.settings["model"] == "one_thing"
    assert found.settings["options"] == {"answer": "adversarial"}


def test_an_option_that_a_model_does_not_have_is_refused() -> None:
    with pytest.raises(InvalidSettingError, match=r"'last_frame'.*planner"):
        ready("last_frame", {"planner": "fast"})


def test_what_a_model_needs_is_said_with_the_extra_that_brings_it() -> None:
    needs = ("numpy", "no_such_module", "no_such_package.module")
    ppl.register_model("heavy", needs=needs, extra="neural")(make)
    with pytest.raises(
        InvalidSettingError, match=r"needs no_such_module, no_such_package.*phase_ppl\[neural\]"
    ):
        ready("heavy", {})


def two(scene: Any, observation: Any) -> Any:
    """Lack the seed."""


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        (3, {}, "neither a name"),
        (two, {}, "cannot be called as"),
        (right, {"chains": 3}, "chains: options are for models given by name"),
    ],
)
def test_what_is_no_model_is_refused(model: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSettingError, match=message):
        ready(model, options)


def test_the_baseline_needs_no_jax() -> None:
    code = (
        "import sys, phase_ppl as ppl; "
        "print(ppl.evaluate('collaborate', 'last_frame', progress=False)); "
        "assert not {'jax', 'numpyro', 'arviz', 'matplotlib'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
