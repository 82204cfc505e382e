"""The examples run from anywhere, and print what they promise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_an_observer_of_ones_own_is_fitted_beside_others(run_script: Callable[..., str]) -> None:
    said = run_script(EXAMPLES / "own_observer.py", "--quick")
    for text in ("timid: r = ", "saturating: r = ", "nats more than"):
        assert text in said


def test_every_example_is_listed_and_says_how_to_run_it() -> None:
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    for script in EXAMPLES.glob("*.py"):
        assert f"[{script.name}]({script.name})" in listed
        assert f"python examples/{script.name}" in script.read_text(encoding="utf-8")


def test_an_observer_is_as_short_as_it_says() -> None:
    text = (EXAMPLES / "own_observer.py").read_text(encoding="utf-8")
    assert text[text.index("def timid") : text.index("def judged_events")].count("\n") <= 10
