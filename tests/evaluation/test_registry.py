"""Models by name: what can be registered, what a wrong name or option gets to hear."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from typing import Any

import pytest

import phase_ppl as ppl
from phase_ppl.evaluation import registry
from phase_ppl.evaluation.registry import ready
from phase_ppl.world.errors import InvalidSettingError, UnknownNameError
from tests.evaluation.toys import right, still


@pytest.fixture(autouse=True)
def _registered_for_this_test_only(monkeypatch: pytest.MonkeyPatch) -> None:
    registry.available_models()
    monkeypatch.setattr(registry.MODELS, "entries", dict(registry.MODELS.entries))


def make(answer: str = "friendly") -> Any:
    """Say one thing."""
    return lambda scene, observation, seed: {"relation": answer}


def test_ours_are_there_with_a_summary() -> None:
    assert {"simple", "last_frame"} <= set(ppl.available_models())
    for name in ppl.available_models():
        assert len(ppl.model_info(name).summary) > 20


def test_a_registered_model_is_made_with_its_options_and_asked_by_name() -> None:
    ppl.register_model("one_thing")(make)
    found = ppl.evaluate(still(), "one_thing", workers=1, answer="adversarial")
    assert found.predictions["still"].answers == {"relation": "adversarial"}
    assert found.settings["model"] == "one_thing"
    assert found.settings["options"] == {"answer": "adversarial"}


def test_a_name_is_taken_once() -> None:
    ppl.register_model("one_thing")(make)
    ppl.register_model("one_thing")(make)  # as when its module is loaded again
    with pytest.raises(InvalidSettingError, match="'one_thing' exists"):
        ppl.register_model("one_thing")(right)


def test_an_unknown_name_gets_close_ones() -> None:
    with pytest.raises(UnknownNameError, match="'last_frame'"):
        ready("last_fram", {})


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


def test_models_of_other_packages_are_found_and_broken_ones_do_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Entry:
        def __init__(self, name: str, load: Any) -> None:
            self.name, self.load = name, load

    def breaks() -> None:
        raise ImportError("no module named elsewhere")

    entries = [Entry("bad", breaks), Entry("good", lambda: ppl.register_model("good")(make))]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: entries)
    monkeypatch.setattr(registry.MODELS, "_loaded", False)
    with pytest.warns(UserWarning, match=r"'bad' cannot be loaded: no module"):
        assert "good" in ppl.available_models()


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
