"""What `import phase_ppl` offers, and that it loads nothing before it is used."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import phase_ppl as ppl

ROOT = Path(__file__).parent.parent
NAMESPACES = (
    "plot", "render", "figures", "priors", "cues", "sites", "worlds", "observers",
    "errors", "files", "goals",
)  # fmt: skip
APPLICATIONS = ("phase_films", "phase_people", "phase_study")


def test_every_public_name_is_there_and_is_what_it_is_called() -> None:
    for name in ppl.__all__:
        found = getattr(ppl, name)
        called = getattr(found, "__name__", name).split(".")[-1]
        others = {
            "plot": "figures",
            "roles": "world_priors",
            "study": "phase_study",
            "watch": "Watch",
        }
        assert called == others.get(name, name)
    assert {"infer", "Posterior", "render", "plot", "GOALS", "__version__"} <= set(dir(ppl))
    with pytest.raises(AttributeError, match="'phase_ppl' has no attribute 'infers'"):
        _ = ppl.infers  # type: ignore[attr-defined]


def test_completion_in_a_module_shows_what_is_meant_for_users() -> None:
    for name in (*NAMESPACES, "study"):
        module = getattr(ppl, name)
        shown = dir(module)
        assert shown == sorted(module.__all__)
        assert not {"np", "os", "Any", "jax", "annotations"} & set(shown)
        assert None not in [getattr(module, one) for one in shown]


@pytest.mark.parametrize("application", APPLICATIONS)
def test_an_application_uses_public_names_only(application: str) -> None:
    used: set[str] = set()
    for file in (ROOT / application).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Attribute):
                used.add(ast.unparse(node))
    names = {name.split("(")[0] for name in used if name.startswith("ppl.")}
    assert names
    for _, name, *inner in (found.split(".") for found in names):
        assert name in ppl.__all__, name
        assert not inner or name not in NAMESPACES or inner[0] in getattr(ppl, name).__all__, inner


@pytest.mark.slow
def test_whether_a_kernel_is_named_says_what_infer_returns(tmp_path: Path) -> None:
    lines = (
        "ppl.infer(event).at(3).why('alpha=(0, 0)')",
        "ppl.infer(event, ppl.Model(prior='uniform'), seed=1).surprise()",
        "ppl.infer(event, ppl.Model(prior='uniform'), kernel='smc').untried",
        "ppl.infer(ppl.infer(event), kernel='smc').untried",
        "ppl.Scene([[8, 20, 0]] * 4, radius=[0.8] * 4, walls=[[[16, 12], [16, 17]]]).start.shape",
        "ppl.Hypothesis('Get blue item to blue lm', 'get to red agent').goal_red + 1",
        "ppl.Observation([[[8.0, 20, 0]] * 4] * 2).n_frames",
    )
    wrong = "ppl.infer(event).burn_in"
    file = tmp_path / "user.py"
    text = "import phase_ppl as ppl\n\nevent = ppl.load_event('collaborate')\n"
    file.write_text(text + "\n".join((*lines, wrong)) + "\n")
    options = ["--strict", "--config-file=", "--follow-imports=silent"]
    command = [sys.executable, "-m", "mypy", *options, "--cache-dir", tmp_path / "cache", file]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    errors = [line for line in run.stdout.splitlines() if "user.py" in line]
    assert len(errors) == 1, run.stdout
    assert '"ClosedLoopPosterior" has no attribute "burn_in"' in errors[0]
