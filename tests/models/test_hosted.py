"""Compiled programs that are left at each simulation, and kept on disk."""

from __future__ import annotations

import functools
import itertools
import pickle
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax, random
from jax.experimental.compilation_cache import compilation_cache

from phase_ppl.models import density, hosted
from phase_ppl.models.bridge import SimulatorBridge
from phase_ppl.models.hosted import Hosted
from phase_ppl.models.program import EventProgram
from tests.models.test_bridge import MODEL, N_FRAMES, Counting, sites_of

LENGTH = 6
"""Of the arrays of frames; the observation has fewer."""


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
    monkeypatch.setattr(hosted, "folder", lambda: tmp_path)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Return a folder in which a chain of simulations is kept, and what it computed."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hosted, "folder", lambda: folder)
        found, runner = called(Hosted(chain, "a chain"), KEYS)
    assert [len(batch) for batch in runner.batches] == [5, 5]
    return folder, found


@pytest.fixture
def first(made: tuple[Path, Any], tmp_path: Path) -> Any:
    """Return what the chain computed, which is kept in the test's folder."""
    shutil.copytree(made[0], tmp_path, dirs_exist_ok=True)
    return made[1]


def simulated(handle: Any, seed: Any) -> jax.Array:
    sites = {name: values[0] for name, values in sites_of(1).items()}
    return EventProgram(MODEL, handle, LENGTH).simulate(sites, jnp.float32(0.0), seed)


def chain(keys: jax.Array, handle: Any) -> dict[str, jax.Array]:
    """Two simulations one after the other, the second with a seed that the first decides."""

    @jax.jit
    def one(key: jax.Array) -> dict[str, jax.Array]:
        key, key_seed = random.split(key)
        first = simulated(handle, random.randint(key_seed, (), 0, 100))
        second = simulated(handle, first.sum().astype(jnp.int32) + 1)
        return {"key": key, "first": first, "both": first + 2 * second}

    return jax.vmap(one)(keys)


def in_a_loop(n: jax.Array, handle: Any) -> jax.Array:
    def step(i: jax.Array, total: jax.Array) -> jax.Array:
        return total + simulated(handle, i)

    return lax.fori_loop(0, n, step, jnp.zeros(LENGTH))


def called(function: Callable[..., Any], *args: Any) -> tuple[Any, Counting]:
    runner = Counting()
    bridge = SimulatorBridge(runner, N_FRAMES)
    found = jax.block_until_ready(function(*args, bridge.handle))
    assert bridge.failure is None
    return jax.tree.map(_bits, found), runner


def _bits(leaf: jax.Array) -> Any:
    is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(random.key_data(leaf) if is_key else leaf).tolist()


KEYS = random.split(random.key(3), 5)


def test_cut_at_its_simulations_a_program_computes_what_it_does_as_a_whole(
    first: Any, tmp_path: Path
) -> None:
    assert called(jax.jit(chain), KEYS)[0] == first
    assert list(tmp_path.glob(f"*{hosted.SUFFIX}"))


def test_errors_beyond_the_observation_are_0() -> None:
    found, _ = called(Hosted(lambda seed, handle: simulated(handle, seed)), jnp.int32(7))
    assert found == [7.0] * N_FRAMES + [0.0] * (LENGTH - N_FRAMES)


def test_simulations_in_a_loop_are_run_from_within(tmp_path: Path) -> None:
    found, runner = called(Hosted(in_a_loop), jnp.int32(4))
    assert found[:N_FRAMES] == [6.0] * N_FRAMES
    assert len(runner.batches) == 4
    assert not list(tmp_path.glob(f"*{hosted.SUFFIX}"))


def test_what_is_kept_is_not_made_again(first: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax.stages.Lowered, "compile", None)
    assert called(Hosted(chain), KEYS)[0] == first
    # what is identified is not even traced again
    monkeypatch.setattr(jax, "make_jaxpr", None)
    assert called(Hosted(chain, "a chain"), KEYS)[0] == first
    for other in (Hosted(chain, "another"), Hosted(chain)):
        with pytest.raises(TypeError):
            called(other, KEYS)
    with pytest.raises(TypeError):  # other arguments
        called(Hosted(chain, "a chain"), KEYS[:3])
    monkeypatch.setattr(hosted, "versions", lambda: {"source": "another"})
    with pytest.raises(TypeError):
        called(Hosted(chain, "a chain"), KEYS)


def test_a_damaged_file_is_reported_and_made_anew(first: Any, tmp_path: Path) -> None:
    files = list(tmp_path.glob(f"*{hosted.SUFFIX}"))
    # the second one is found out by its checksum alone
    damages = (lambda _: b""), (lambda content: bytes(32) + content[32:]), (lambda c: c[:-1])
    for file, damaged in zip(files, itertools.cycle(damages), strict=False):
        file.write_bytes(damaged(file.read_bytes()))
    with pytest.warns(RuntimeWarning, match="compiled anew") as told:
        assert called(Hosted(chain, "a chain"), KEYS)[0] == first
    assert len(told) == len(files) >= 3
    assert called(Hosted(chain, "a chain"), KEYS)[0] == first  # without a warning


def test_the_files_not_used_for_longest_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hosted, "MOST", 3)
    for number in range(5):
        hosted.write(f"{number}", pickle.dumps(number))
        hosted.read("0")
    names = {file.stem for file in tmp_path.iterdir()}
    assert len(names) == 3
    assert "4" in names


def test_a_folder_that_cannot_be_written_changes_nothing(
    first: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(hosted, "folder", lambda: tmp_path / "file" / "folder")
    assert called(Hosted(chain, "a chain"), KEYS)[0] == first
    monkeypatch.setattr(hosted, "folder", lambda: None)
    assert hosted.read("a chain") is None
    hosted.write("a chain", b"nowhere")


def test_what_jax_keeps_itself_is_left_to_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.undo()
    assert hosted.folder() == hosted.cache_folder()
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    try:
        assert hosted.folder() is None
    finally:
        jax.config.update("jax_compilation_cache_dir", None)


def test_code_that_was_changed_since_it_was_imported_is_not_remembered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert hosted.outline_name("a function") is not None
    monkeypatch.setattr(hosted, "_IMPORTED", 0.0)
    assert hosted.outline_name("a function") is None


# --- small programs -------------------------------------------------------------------------------


def test_options_that_this_version_does_not_know_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known, asked = dict(density._WANTED), density._known_options.__wrapped__
    monkeypatch.setattr(density, "_known_options", functools.cache(asked))
    monkeypatch.setattr(density, "_WANTED", {"xla_no_such_option": True, **known})
    assert density.compiled_quickly(lambda x: 2 * x)(jnp.float32(3.0)) == 6.0
    assert density._known_options()
    assert density._known_options().items() <= known.items()
