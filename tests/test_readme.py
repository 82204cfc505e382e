"""The examples of the README and of docs/ run as they stand, as plain scripts."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import phase_ppl as ppl

README = Path(__file__).parent.parent / "README.md"
DOCS = README.parent / "docs"


def examples(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


EXAMPLES = {page.stem: examples(page)[0] for page in sorted(DOCS.glob("*.md")) if examples(page)}


def saved(example: str, folder: Path) -> Path:
    script = folder / "example.py"
    script.write_text(example, encoding="utf-8")
    return script


def run(example: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, saved(example, folder)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_each_page_with_an_example_has_one_and_all_are_known() -> None:
    assert sum(len(examples(page)) for page in DOCS.glob("*.md")) == len(EXAMPLES)
    pages = "closed_loop first_posterior long_runs many_events priors_and_simulators what_if"
    assert sorted(EXAMPLES) == pages.split()


def test_the_readme_shows_lines_of_the_first_example_in_their_order() -> None:
    (shown,) = examples(README)
    lines = iter(EXAMPLES["first_posterior"].splitlines())
    assert all(line in lines for line in shown.splitlines())


def test_every_public_name_is_in_the_reference() -> None:
    shown = set(re.findall(r"^::: (.+)$", (DOCS / "reference.md").read_text("utf-8"), re.MULTILINE))
    missing = [
        name
        for name in set(ppl.__all__) - {"__version__"}
        for module, original in [ppl._PLACES[name]]
        if not {module, f"{module}.{original}"} & shown
    ]
    assert not missing


@pytest.mark.parametrize("page", [README, *sorted(DOCS.glob("*.md"))], ids=lambda page: page.stem)
def test_links_lead_to_files_that_are_there(page: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    for link in links:
        assert link.startswith("http") or (page.parent / link).exists(), link


def shorten(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    """Let bundled events be their first frames only."""
    load = ppl.load_event

    def begins(name: str) -> ppl.Event:
        event = load(name)
        return dataclasses.replace(
            event, observation=ppl.Observation(event.observation.trajectory[:frames])
        )

    monkeypatch.setattr(ppl, "load_event", begins)


def test_the_main_example_prints_a_posterior_and_writes_its_files(
    tmp_path: Path, run_script: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shorten(monkeypatch, 30)
    printed = run_script(saved(EXAMPLES["first_posterior"], tmp_path))
    assert "Get pink item to red lm" in printed
    for name in ("run.nc", "run.png", "why.mp4"):
        assert (tmp_path / name).stat().st_size > 1000


def test_an_event_is_watched(
    tmp_path: Path, run_script: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shorten(monkeypatch, 13)
    printed = run_script(saved(EXAMPLES["closed_loop"], tmp_path))
    assert printed.count("±") == 9
    for name in ("why.png", "watch.mp4"):
        assert (tmp_path / name).stat().st_size > 1000


def test_a_prior_and_a_simulator_defined_in_a_script_work(tmp_path: Path) -> None:
    printed = run(EXAMPLES["priors_and_simulators"] + "\nprint(post)\n", tmp_path)
    assert "15 particles x 6 iterations" in printed


def test_a_model_of_ones_own_is_evaluated(tmp_path: Path, run_script: Callable[..., str]) -> None:
    assert "collaborative" in run_script(saved(EXAMPLES["many_events"], tmp_path))


def test_a_scene_from_scratch_is_explained(tmp_path: Path, run_script: Callable[..., str]) -> None:
    assert "the green agent goes up to the red agent" in run_script(
        saved(EXAMPLES["what_if"], tmp_path)
    )
    assert (tmp_path / "explained.mp4").stat().st_size > 1000


@pytest.mark.slow
def test_a_run_on_a_cluster_is_kept_and_extended(tmp_path: Path) -> None:
    printed = run(EXAMPLES["long_runs"] + "\n    print(post)\n", tmp_path)
    assert "4 particles x 2 iterations" in printed
    assert (tmp_path / "run.ckpt").stat().st_size > 1000


@pytest.mark.parametrize("name", ["make demo", "make test"])
def test_the_two_commands_are_named_and_exist(name: str) -> None:
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    assert name in README.read_text(encoding="utf-8")
    assert f"\n{name.removeprefix('make ')}:" in makefile
