"""What holds for all tests."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import io
import os
import runpy
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from phase_ppl.physics import jit

LONGEST = ("test_readme.py", "test_cli.py")
"""Files of tests of which one alone can take most of a minute."""

COMPILED = Path(__file__).parents[1] / ".pytest_cache" / "xla"

# Most of the tests' time is XLA compiling small programs, each of which then runs for
# milliseconds; these flags take a third off it, in the scripts that tests start too. jaxlib ends
# the process at a flag that it does not know, hence only the version whose flags they are known to
# be.
if metadata.version("jaxlib").startswith("0.10."):
    os.environ.setdefault(
        "XLA_FLAGS",
        "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
        " --xla_llvm_disable_expensive_passes=true --xla_cpu_parallel_codegen_split_count=1",
    )

# Where a test does not say how many processes are to work, it is its own that does: starting
# others takes longer than what they would do, and the tests themselves run side by side.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")

# What XLA has compiled is kept, so that the processes of a run, the scripts that tests start and
# the next run share it.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(COMPILED))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

# what is traced fills the heap with objects that stay: it is looked through less often
gc.set_threshold(50_000, 20, 100)

# how long an example takes is the machine's affair; and they are the same in every run
settings.register_profile(
    "any_pace", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any_pace")

# a shell that runs something in the background has it ignore Ctrl-C, which is then tested in vain
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


COMPILE = """
from phase_ppl.closed_loop.goal_filter import warm_up
from phase_ppl.simulator.joint import JointSimulator
JointSimulator().warm_up()
warm_up()
"""
"""Compiles the kernels of the simulator and of the closed loop, unless that was done before."""

WITHOUT_KERNELS = ("models", "analysis")
"""Folders of tests that hardly need them, and take longer than compiling them."""

WITH_KERNELS = (
    "test_plots.py",
    "test_predicate.py",
    "test_closed_loop_posterior.py",
    "test_what_if.py",
)
"""Files in these folders that do, and would compile them a second time."""


def pytest_configure(config: pytest.Config) -> None:
    """Do once what several processes would do at the same time, to the same files."""
    if hasattr(config, "workerinput"):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # version 0.23 notes the day of its first import in a file; processes that do so at the
        # same moment take it from each other, and the import fails
        import arviz  # noqa: F401
    if config.getoption("numprocesses", None):
        compiling = subprocess.Popen([sys.executable, "-c", COMPILE])
        config.add_cleanup(compiling.wait)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let each process begin with tests that need no kernels, while these are compiled.

    Then comes what takes longest, so that no process is left alone with it at the end.
    """
    items.sort(key=lambda item: item.path.name not in LONGEST)
    first, then = [], []
    for item in items:
        without = item.path.parent.name in WITHOUT_KERNELS and item.path.name not in WITH_KERNELS
        (first if without else then).append(item)
    n = getattr(config, "workerinput", {}).get("workercount", 1)
    items[:] = [
        item
        for worker in range(n)
        for part in (first, then)
        for item in part[len(part) * worker // n : len(part) * (worker + 1) // n]
    ]


_WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))

MOST_MEMORY = max(
    1.3e9, min(0.1, 0.5 / _WORKERS) * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
)
"""Bytes of a process, beyond which what XLA has compiled is forgotten after a file of tests."""


def resident() -> int:
    """Return the bytes that this process has in memory; 0 where it cannot be told."""
    file = Path("/proc/self/statm")
    pages = int(file.read_text().split()[1]) if file.exists() else 0
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.fixture(scope="session")
def _kept() -> list[float]:
    """The bytes that were left when memory was given back last."""
    return [0.0]


@pytest.fixture(scope="module", autouse=True)
def _memory_is_given_back(_kept: list[float]) -> Iterator[None]:
    """Forget compiled programs once they fill a process; they are read again from the disk."""
    yield
    # not after every file where nothing is gained, as what is forgotten is traced again
    if "jax" not in sys.modules or resident() < max(MOST_MEMORY, 1.2 * _kept[0]):
        return
    import jax

    jax.clear_caches()
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
    if trim is not None:
        trim(0)
    _kept[0] = resident()


@pytest.fixture(scope="session", autouse=True)
def _figures_of_few_pixels() -> Iterator[None]:
    """Drawing them well takes most of the time, and tests look at what is in them."""
    from matplotlib.figure import Figure

    save = Figure.savefig

    def coarsely(self: Figure, *arguments: Any, **options: Any) -> None:
        save(self, *arguments, **{**options, "dpi": 50})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", coarsely)
        yield


@contextlib.contextmanager
def nothing_painted() -> Iterator[None]:
    """Figures are made but not painted, which is most of their work: each file is the same PNG."""
    from matplotlib.figure import Figure

    save, painted = Figure.savefig, io.BytesIO()
    Figure(figsize=(6, 4), facecolor="red").savefig(painted, format="png")
    content = painted.getvalue().ljust(20_000, b"\0")

    def keep(self: Figure, target: Any, **options: Any) -> None:
        if isinstance(target, io.BytesIO):
            target.write(content)
        elif Path(target).suffix == ".png":
            Path(target).write_bytes(content)
        else:
            save(self, target, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", keep)
        yield


@pytest.fixture
def unpainted() -> Iterator[None]:
    with nothing_painted():
        yield


@pytest.fixture
def own_models(monkeypatch: pytest.MonkeyPatch) -> None:
    from phase_ppl.evaluation import registry

    registry.available_models()
    monkeypatch.setattr(registry.MODELS, "entries", dict(registry.MODELS.entries))


@pytest.fixture
def run_script(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Run a script with arguments, as Python would, in the tests' own process; return its output.

    What was compiled for one serves the next. It runs in an empty folder, and what it registers
    is forgotten.
    """
    from phase_ppl.inference.registry import KERNELS

    KERNELS.names()
    monkeypatch.setattr(KERNELS, "entries", dict(KERNELS.entries))
    monkeypatch.chdir(tmp_path)

    def run(script: Path, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [str(script), *arguments])
        monkeypatch.syspath_prepend(script.parent)
        runpy.run_path(str(script), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.fixture(autouse=True, scope="session")
def _nothing_said_of_compiling() -> Iterator[None]:
    """Have what a test says not depend on whether it is the first to need a kernel."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jit, "_announce", lambda line: None)
        yield
