"""Nothing heavy is loaded before it is needed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from phase_ppl.analysis.closed_loop_posterior import ClosedLoopPosterior
from phase_ppl.analysis.posterior import Posterior
from tests.analysis.factory import random_tree
from tests.analysis.readings import reading

STEPS = {
    "import phase_ppl as ppl": "numpy pandas xarray numba jax numpyro arviz matplotlib torch",
    "try: ppl.cli.main(['--help'])\nexcept SystemExit: pass": "pandas xarray numba jax matplotlib",
    "import phase_ppl.render, phase_ppl.data": (
        "pandas xarray numba jax numpyro arviz matplotlib torch"
    ),
    "for name in ('a.nc', 'b.nc'):\n"
    "    ppl.cli.main(['query', name, 'P(relation=friendly)', 'E[strength_red]'])": (
        "arviz jax matplotlib numba numpyro pymunk scipy.stats torch"
    ),
    "import phase_ppl.analysis.figures": "jax numpyro arviz matplotlib",
    "import phase_study.study, phase_ppl.cli.commands, phase_study.experiments": (
        "starlette uvicorn websockets markdown_it"
    ),
    "assert 'vlm' in ppl.available_models()": "torch jax",
    "print(ppl.evaluate('collaborate', 'last_frame', progress=False))": (
        "jax numpyro arviz matplotlib"
    ),
}
"""What is done, one after the other in a process, and what is not loaded then."""


def test_each_step_loads_no_more_than_it_needs(tmp_path: Path) -> None:
    Posterior(random_tree()).save(tmp_path / "a.nc")
    ClosedLoopPosterior(reading()).save(tmp_path / "b.nc")
    script = "import sys\n"
    for done, heavy in STEPS.items():
        script += f"{done}\nfound = set({heavy.split()}) & set(sys.modules)\n"
        script += f"assert not found, ({done!r}, found)\n"
        if heavy.startswith("numpy"):
            script += "assert not [name for name in sys.modules if name.startswith('phase_ppl.')]\n"
            script += "import phase_ppl.cli\n"
    command = [sys.executable, "-c", script]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("P(relation=friendly) = ") == 2
    assert "last_frame: 1 of 1 events" in run.stdout
