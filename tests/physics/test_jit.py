"""Compiled kernels are cached on disk, but never stale."""

from __future__ import annotations

import pickle
import re
import runpy
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numpy as np
import pytest

from phase_ppl.physics import jit

ANNOUNCE = jit._announce  # which no other test is to hear
NESTED = """
from phase_ppl.physics import jit

@jit.inlined_kernel
def root(x, tolerance):
    while abs(x * x - 2.0) > tolerance:
        x = 0.5 * (x + 2.0 / x)
    return x

@jit.linked_kernel
def twice(x, tolerance, squared):
    return 2.0 * root(x, tolerance) ** (2 if squared else 1)

@jit.bare_kernel
def both(x):
    return root(x, 1e-3) - twice(x, 1e-12, False) + twice(x, 1e-12, True)

@jit.bare_kernel
def scaled(values, x):
    for i in range(len(values)):
        values[i] *= both(x)
"""
KERNEL = "from phase_ppl.physics import jit\n\n\n@jit.{decorator}\ndef add(x):\n    return x + 1\n"


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Load a small kernel from a file, with a cache of its own, as a new process would.

    Returns how often it was compiled, and loaded from the cache.
    """
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    file = tmp_path / "small_kernel.py"

    def make(decorator: str = "bare_kernel") -> tuple[int, int]:
        file.write_text(KERNEL.format(decorator=decorator))
        function = runpy.run_path(str(file), run_name="small_kernel")["add"]
        assert function(1.0) == 2.0
        stats = function.stats
        return sum(stats.cache_misses.values()), sum(stats.cache_hits.values())

    return make


@pytest.mark.parametrize("decorator", ["bare_kernel", "inlined_kernel"])
def test_kernels_are_loaded_from_disk_the_second_time(load: Any, decorator: str) -> None:
    assert load(decorator) == (1, 0)
    assert load(decorator) == (0, 1)


@pytest.mark.parametrize("in_parts", [True, False])
def test_kernels_within_kernels_give_what_python_would(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_parts: bool
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(jit, "KNOWN_NUMBA", in_parts)
    (tmp_path / "nested.py").write_text(NESTED)
    for compiled in (1, 0):  # the second time from the disk
        module = runpy.run_path(str(tmp_path / "nested.py"), run_name="nested")
        values = np.array([1.0, -3.0])
        module["scaled"](values, 1.5)
        by_python = {"abs": abs, "root": module["root"].py_func}
        by_python["twice"] = FunctionType(module["twice"].py_func.__code__, by_python)
        both = FunctionType(module["both"].py_func.__code__, by_python)
        assert values.tobytes() == (np.array([1.0, -3.0]) * both(1.5)).tobytes()
        assert sum(module["scaled"].stats.cache_misses.values()) == compiled
        assert (sum(module["twice"].stats.cache_misses.values()) > 0) == compiled
        # what kernels alone have called is not made for Python until it asks
        assert not (in_parts and module["both"].overloads)
        assert module["both"](1.5) == both(1.5)
        assert pickle.loads(pickle.dumps(module["root"]))(1.5, 1e-9) == module["root"](1.5, 1e-9)


def test_kernels_are_compiled_anew_when_any_kernel_file_has_changed(
    load: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    load()
    monkeypatch.setattr(jit, "package_stamp", lambda: "stamp of changed files")
    assert load() == (1, 0)


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", ["cut", "flipped", "empty"])
def test_a_damaged_cache_is_named_and_made_anew(
    load: Any, tmp_path: Path, suffix: str, damage: str
) -> None:
    load()
    (file,) = tmp_path.glob(f"cache/**/*.{suffix}")
    content = file.read_bytes()
    half = len(content) // 2
    flipped = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
    file.write_bytes({"cut": content[:half], "flipped": flipped, "empty": b""}[damage])
    with pytest.warns(RuntimeWarning, match=r"compiled anew, as .*small_kernel.*is damaged"):
        load()
    assert load() == (0, 1)


def test_a_cache_that_cannot_be_written_is_done_without(
    load: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(jit.IndexDataCacheFile, "_save_data", full)
    with pytest.warns(RuntimeWarning, match=r"is not written: .*No space left"):
        assert load() == (1, 0)


def test_compiling_is_said_with_where_it_is_kept(
    load: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jit, "_announce", ANNOUNCE)
    assert load() == (1, 0)
    (line,) = capsys.readouterr().err.splitlines()
    assert f"kept in {tmp_path / 'cache'}" in line
    assert load() == (0, 1)
    assert not capsys.readouterr().err

    def nowhere(*_: object) -> None:
        raise RuntimeError("no locator available")

    monkeypatch.setattr(jit.KernelCache, "__init__", nowhere)
    for _ in range(2):
        load()
    (line,) = capsys.readouterr().err.splitlines()
    assert "in every process" in line
    assert "NUMBA_CACHE_DIR" in line


def test_stamp_covers_names_and_contents_but_not_order(tmp_path: Path) -> None:
    files = [tmp_path / "a.py", tmp_path / "b.py"]
    for file in files:
        file.write_text(f"# {file.name}")
    stamp = jit.source_stamp(files)
    assert stamp == jit.source_stamp(reversed(files))
    files[1].write_text("# changed")
    assert stamp != jit.source_stamp(files)
    assert jit.source_stamp(files) != jit.source_stamp(files[:1])


def test_package_stamp_covers_every_file_with_kernels() -> None:
    package = Path(jit.__file__).parents[1]
    with_kernels = {
        file.parent.name
        for file in package.rglob("*.py")
        if re.search(r"jit import .*kernel", file.read_text())
    }
    assert with_kernels <= set(jit._FOLDERS)
