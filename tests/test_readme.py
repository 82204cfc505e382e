"""The examples of the README, of docs/ and of examples/ run as they stand, as plain scripts.

Pages that are notebooks are run by ``make docs``, and as scripts by a slow test.
"""

from __future__ import annotations

import ast
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
EXAMPLES_FOLDER = README.parent / "examples"
PAGES = sorted(DOCS.glob("*.md"))


def examples(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


NOTEBOOKS = [page for page in PAGES if page.read_text("utf-8").startswith("---\njupyter:")]
EXAMPLES = {page.stem: examples(page) for page in PAGES if page not in NOTEBOOKS and examples(page)}


def saved(example: str, folder: Path) -> Path:
    script = folder / "example.py"
    script.write_text(example, encoding="utf-8")
    return script


def test_all_pages_with_examples_are_known() -> None:
    assert {name: len(found) for name, found in EXAMPLES.items()} == {
        "cost": 1,
        "judgments": 3,
        "long_runs": 1,
        "many_events": 1,
    }
    notebooks = "closed_loop design diagnostics films first_posterior how_it_works making_events"
    notebooks += " own_kernel own_prior own_simulator own_video queries what_if worlds"
    assert [page.stem for page in NOTEBOOKS] == notebooks.split()


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, which GitHub and the site make alike."""
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8"))
    heads = re.findall(r"(?m)^#+ (.*)", text)
    return {re.sub(r"[^\w\s-]", "", head).strip().lower().replace(" ", "-") for head in heads}


def test_links_lead_to_files_and_headings_that_are_there() -> None:
    for page in (README, *PAGES):
        for link in re.findall(r"\]\(([^)\s]+)", page.read_text(encoding="utf-8")):
            name, _, anchor = link.partition("#")
            if name.startswith("http"):
                continue
            target = page.parent / name if name else page
            assert target.exists(), (page, link)
            assert not anchor or anchor in anchors(target), (page, link)


def labels(printed: str) -> set[str]:
    return {line[:13].strip() for line in printed.splitlines()}


def checks(printed: str) -> list[str]:
    return re.findall(r"^.{13}[+!x?] (.{24})", printed, re.MULTILINE)


def shorten(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    """Let bundled events be their first frames only, and the usual planner a faster one."""
    load = ppl.load_event

    def begins(name: str) -> ppl.Event:
        event = load(name)
        return dataclasses.replace(
            event, observation=ppl.Observation(event.observation.trajectory[:frames])
        )

    monkeypatch.setattr(ppl, "load_event", begins)
    faster = ppl.PlannerConfig(simulations=10, particles=5, paired=True)
    monkeypatch.setattr(ppl.PlannerConfig, "fast", lambda: faster)


def test_the_readmes_first_lines_print_a_posterior_and_write_its_files(
    tmp_path: Path, run_script: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shorten(monkeypatch, 7)
    printed = run_script(saved(examples(README)[0], tmp_path))
    assert "posterior    collaborate: closed loop, 7 frames" in printed
    (shown,) = re.findall(r"```text\n(.*?)```", README.read_text("utf-8"), re.DOTALL)
    assert labels(shown) <= labels(printed)
    assert checks(shown) == checks(printed)
    for name in ("run.nc", "run.png"):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.slow
def test_the_readmes_further_lines_sample_and_compare(
    tmp_path: Path, run_script: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shorten(monkeypatch, 7)
    closed_loop, sampled, _ = examples(README)
    shown = closed_loop + sampled.replace("20_000", "60").replace("=3", "=1").replace("1000", "15")
    printed = run_script(saved(shown, tmp_path))
    assert "posterior    collaborate: 15 particles x 6 iterations" in printed
    assert "reference: the exact sum over the table that the closed loop has read" in printed
    assert (tmp_path / "why.mp4").stat().st_size > 1000


def test_the_readmes_scene_is_drawn(tmp_path: Path, run_script: Callable[..., str]) -> None:
    *_, shown = examples(README)
    run_script(saved(shown.replace("frames=50", "frames=8"), tmp_path))
    for name in ("helps.png", "hinders.png"):
        assert (tmp_path / name).stat().st_size > 1000
        assert (DOCS / "images" / name).is_file()


def as_a_cell(example: str) -> str:
    """Return an example that prints what a notebook would show below it."""
    tree = ast.parse(example)
    if isinstance(last := tree.body[-1], ast.Expr):
        last.value = ast.Call(ast.Name("print"), [last.value], [])
    return ast.unparse(tree)


@pytest.mark.slow
@pytest.mark.parametrize("page", NOTEBOOKS, ids=lambda page: page.stem)
# a notebook shows the picture that it opens
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
@pytest.mark.filterwarnings("ignore:Exception ignored:pytest.PytestUnraisableExceptionWarning")
def test_a_notebook_runs(page: Path, tmp_path: Path, run_script: Callable[..., str]) -> None:
    assert run_script(saved("\n".join(map(as_a_cell, examples(page))), tmp_path))


def test_a_model_of_ones_own_is_evaluated(tmp_path: Path, run_script: Callable[..., str]) -> None:
    assert "collaborative" in run_script(saved(EXAMPLES["many_events"][0], tmp_path))


def test_people_with_graded_answers_or_in_another_world_are_shown_beside_a_model(
    tmp_path: Path, run_script: Callable[..., str]
) -> None:
    printed = [run_script(saved(example, tmp_path)) for example in EXAMPLES["judgments"]]
    sliders, moments, trio = printed
    assert "agreement with people on relations, at moments of the film" in moments
    assert (tmp_path / "over_time.png").stat().st_size > 1000
    for printed in (sliders, trio):
        assert "people, majority" in printed
    assert "[0.8   0.125 0.075]" in sliders
    assert "agreement with people on relations" in trio


@pytest.mark.slow
def test_a_run_on_a_cluster_is_kept_and_extended(tmp_path: Path) -> None:
    script = saved(EXAMPLES["long_runs"][0] + "\n    print(post)\n", tmp_path)
    printed = subprocess.check_output(
        [sys.executable, script], cwd=tmp_path, text=True, timeout=500
    )
    assert "4 particles x 2 iterations" in printed
    assert (tmp_path / "run.ckpt").stat().st_size > 1000


def test_citation_and_changelog_are_of_this_version() -> None:
    citation = (README.parent / "CITATION.cff").read_text(encoding="utf-8")
    released = dict(re.findall(r"^(version|date-released): (\S+)$", citation, re.MULTILINE))
    changes = (README.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    assert released["version"] == ppl.__version__
    assert f"\n## [{ppl.__version__}] - {released['date-released']}\n" in changes


SHOWN: dict[str, list[str]] = {
    "alternative_prior": ["sparse_social", "E[kindness] = "],
    "chain_diagnostics": ["fail    enough simulations", "move_rate", "diagnostics.png"],
    "compare_kernels": ["reference: enumeration", "prior_mh", "comparison.png"],
    "glide": ["<event glide: 12 frames"],
    "numpyro_native": ["sim_seed        sample", "strong red: off by", "simulations,", "friendly"],
    "own_kernel": ["from_prior ('", "prior_mh ('"],
    "own_observer": ["the model: r = ", "timid: r = "],
    "own_simulator": ["200 whole videos", "goal_red Get red agent to red lm 0.9"],
    "own_world": ["goals, such as", "Ann: ('", "nursery.png", "over_time.png"],
    "posterior_queries": ["P(both are after the same thing) = ", "I(goal_red; goal_green) = "],
    "real_videos": ["videos in Videos_Test_humanratings", "people say ", "    relation: ('"],
}
"""Example -> what it prints, and the pictures that it draws."""

LONG = ("compare_kernels", "numpyro_native", "own_observer", "own_simulator", "real_videos")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in SHOWN]
)
def test_an_example_shows_its_point(
    name: str, run_script: Callable[..., str], tmp_path: Path
) -> None:
    said = run_script(EXAMPLES_FOLDER / f"{name}.py")
    if name == "real_videos" and "git clone" in said:
        pytest.skip("the original recordings (../shared/phase-test) are not here")
    for expected in SHOWN[name]:
        if expected.endswith(".png"):
            assert (tmp_path / expected).stat().st_size > 1000
        else:
            assert expected in said


def test_real_videos_are_read_from_what_is_given_or_it_is_said_where_to_get_them(
    run_script: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = EXAMPLES_FOLDER / "real_videos.py"
    monkeypatch.setenv("PHASE_TEST", str(tmp_path))
    said = run_script(script)
    assert "git clone https://github.com/Isik-lab/SocialGNN" in said
    (tmp_path / "Videos_Test_humanratings").write_bytes(b"\x80\x02]q\x00.")  # an empty list
    for arguments in ((), (str(tmp_path / "Videos_Test_humanratings"),)):
        with pytest.raises(ppl.PhasePPLError, match="the list is empty"):
            run_script(script, *arguments)
