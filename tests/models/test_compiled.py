"""Compiled functions that are kept on disk."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import random
from jax.experimental.compilation_cache import compilation_cache

from phase_ppl.models import compiled
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.compiled import Compiled
from phase_ppl.models.program import EventProgram
from tests.models.test_bridge import MODEL, N_FRAMES, Counting, sites_of

LENGTH = 6
"""Of the arrays of frames; the observation has fewer."""

KEYS = random.split(random.key(3), 5)


@pytest.fixture(scope="module", autouse=True)
def _not_by_jax() -> Iterator[None]:
    """What JAX keeps itself cannot be kept once more."""
    config: Any = jax.config
    before = config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    yield
    jax.config.update("jax_compilation_cache_dir", before)
    compilation_cache.reset_cache()


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "folder", lambda: tmp_path)


def drawn(keys: jax.Array, more: dict[str, Any]) -> dict[str, Any]:
    found = jax.vmap(lambda key: random.normal(key) + more["by"])(keys)
    return {"keys": jax.vmap(random.split)(keys)[:, 0], "drawn": (found, found.sum())}


def called(function: Any, keys: jax.Array = KEYS) -> Any:
    found = function(keys, {"by": 2.0})
    data = jnp.asarray(random.key_data(found["keys"]))
    return jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), {**found, "keys": data})


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Return a folder in which two functions are kept, and what they computed."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "folder", lambda: folder)
        found = called(Compiled(drawn, "a draw"))
        assert called(Compiled(drawn)) == found == called(jax.jit(drawn))
    return folder, found


@pytest.fixture
def first(made: tuple[Path, Any], tmp_path: Path) -> Any:
    shutil.copytree(made[0], tmp_path, dirs_exist_ok=True)
    return made[1]


def test_what_is_kept_is_not_made_again(first: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax.stages.Lowered, "compile", None)
    assert called(Compiled(drawn)) == first
    # what is identified is not even traced again
    assert called(Compiled(lambda keys, more: None, "a draw")) == first
    with pytest.raises(TypeError):
        called(Compiled(drawn, "another"))
    with pytest.raises(TypeError):  # other arguments
        called(Compiled(drawn, "a draw"), KEYS[:3])
    monkeypatch.setattr(compiled, "versions", lambda: {"source": "another"})
    with pytest.raises(TypeError):
        called(Compiled(drawn, "a draw"))


def test_what_calls_python_is_not_kept(tmp_path: Path) -> None:
    runner = Counting()
    bridge = SimulatorBridge(runner, N_FRAMES)
    sites = {name: values[0] for name, values in sites_of(1).items()}

    def simulated(handle: Any, seed: Any) -> jax.Array:
        return EventProgram(MODEL, handle, LENGTH).simulate(sites, jnp.float32(0.0), seed)

    for _ in range(2):
        found = Compiled(simulated, "a simulation")(bridge.handle, jnp.int32(7))
        # errors beyond the observation are 0
        assert found.tolist() == [7.0] * N_FRAMES + [0.0] * (LENGTH - N_FRAMES)
    assert bridge.failure is None
    assert not list(tmp_path.glob(f"*{compiled.SUFFIX}"))


def test_a_damaged_file_is_reported_and_made_anew(first: Any, tmp_path: Path) -> None:
    # the second one is found out by its checksum alone
    for damaged in (lambda _: b""), (lambda content: bytes(32) + content[32:]), (lambda c: c[:-1]):
        for file in tmp_path.glob(f"*{compiled.SUFFIX}"):
            file.write_bytes(damaged(file.read_bytes()))
        with pytest.warns(RuntimeWarning, match="compiled anew"):
            assert called(Compiled(drawn, "a draw")) == first
        assert called(Compiled(drawn, "a draw")) == first  # without a warning


def test_a_folder_that_cannot_be_written_changes_nothing(
    first: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    for nowhere in (tmp_path / "file" / "folder", None):
        monkeypatch.setattr(compiled, "folder", lambda nowhere=nowhere: nowhere)
        assert called(Compiled(drawn, "a draw")) == first


def test_code_that_was_changed_since_it_was_imported_is_not_remembered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "_IMPORTED", 0.0)
    called(Compiled(drawn, "a draw"))
    assert not list(tmp_path.iterdir())
