"""The examples run from anywhere, and print and draw what they promise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"

PROMISED: dict[str, tuple[list[str], list[str]]] = {
    "alternative_prior": (["sparse_social", "mostly_related", "friendliness 0."], []),
    "own_simulator": (["15 particles", "verdict"], ["own_simulator.png"]),
    "own_kernel": (["local_mh", "whole_video"], []),
    "own_observer": (["timid: r = ", "saturating: r = ", "nats more than"], []),
    "compare_kernels": (
        ["SIMPLE", "prior", "TV goals"],
        ["compare_kernels.json", "compare_kernels.png"],
    ),
    "diagnostics": (
        ["between_chain_tv", "r_hat", "goal_red["],
        ["diagnostics.png", "over_time.png"],
    ),
    "watch": (["3.0 s  red: ", "What decided most between"], []),
    "queries": (["P(friendly) = ", "E[strength_red | ", "Best single hypothesis: red: "], []),
}


@pytest.mark.parametrize("name", PROMISED)
def test_example_prints_and_draws_what_it_promises(
    name: str, tmp_path: Path, run_script: Callable[..., str]
) -> None:
    said = run_script(EXAMPLES / f"{name}.py", "--quick")
    printed, drawn = PROMISED[name]
    for text in printed:
        assert text in said
    for file in drawn:
        assert (tmp_path / file).stat().st_size > 1000


def test_every_example_is_listed_and_says_how_to_run_it() -> None:
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    scripts = sorted(EXAMPLES.glob("*.py"))
    assert set(PROMISED) < {script.stem for script in scripts}
    for script in scripts:
        assert f"[{script.name}]({script.name})" in listed
        assert f"python examples/{script.name}" in script.read_text(encoding="utf-8")


def test_kernel_and_prior_are_as_short_as_they_say() -> None:
    kernel = (EXAMPLES / "own_kernel.py").read_text(encoding="utf-8")
    assert kernel[kernel.index("class State") : kernel.index("@ppl.register")].count("\n") <= 42
    prior = (EXAMPLES / "alternative_prior.py").read_text(encoding="utf-8")
    assert prior[prior.index("def mostly") : prior.index("def main")].count("\n") <= 13


def test_an_observer_is_as_short_as_it_says() -> None:
    text = (EXAMPLES / "own_observer.py").read_text(encoding="utf-8")
    assert text[text.index("def timid") : text.index("def judged_events")].count("\n") <= 10
