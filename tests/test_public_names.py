"""What `import phase_ppl` offers, and that it loads nothing before it is used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import phase_ppl as ppl

HEAVY = {"arviz", "jax", "matplotlib", "numba", "numpy", "numpyro", "pandas", "torch", "xarray"}


@pytest.mark.parametrize("name", ppl.__all__)
def test_every_public_name_is_there_and_is_what_it_is_called(name: str) -> None:
    found = getattr(ppl, name)
    called = getattr(found, "__name__", name).split(".")[-1]
    others = {"plot": "plots"}
    assert called == others.get(name, name)


def test_names_are_those_of_the_stub_which_type_checkers_read() -> None:
    assert {"infer", "Posterior", "render", "plot", "GOALS", "__version__"} <= set(dir(ppl))
    with pytest.raises(AttributeError, match="'phase_ppl' has no attribute 'infers'"):
        _ = ppl.infers  # type: ignore[attr-defined]


def test_nothing_is_imported_before_it_is_used() -> None:
    text = (
        "import sys, phase_ppl\n"
        f"print(sorted({HEAVY!r} & set(sys.modules)))\n"
        "print([name for name in sys.modules if name.startswith('phase_ppl.')])\n"
    )
    run = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert run.stdout.split("\n")[:2] == ["[]", "[]"]
