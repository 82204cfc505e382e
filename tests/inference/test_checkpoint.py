"""A run that was left goes on as if it had not been, and a file cannot do any harm."""

from __future__ import annotations

import io
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import textwrap
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.inference import checkpoint, sampler
from phase_ppl.inference.checkpoint import Checkpoint, read_archive, write_archive
from phase_ppl.world import identity
from phase_ppl.world.errors import InvalidEventError, InvalidSettingError, OutputError
from phase_ppl.world.files import locked
from tests.inference.runs import EVENT, MODEL, OPTIONS, assert_same_draws, infer, stops_at
from tests.inference.toy import walkers, walking_event

ROOT = Path(ppl.__file__).parents[1]


def resume(path: Path, **options: Any) -> ppl.Posterior:
    return ppl.resume(path, **{"model": MODEL, "workers": 1, "progress": False, **options})


@pytest.fixture(scope="module")
def whole() -> ppl.Posterior:
    return infer()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("finished") / "run.ckpt"
    infer(iterations=2, checkpoint=path)
    return path.read_bytes()


@pytest.fixture
def path(tmp_path: Path, finished: bytes) -> Path:
    file = tmp_path / "run.ckpt"
    file.write_bytes(finished)
    return file


def test_a_finished_run_is_extended_by_any_workers_to_what_a_longer_one_gives(
    path: Path, whole: ppl.Posterior
) -> None:
    before = Checkpoint(path)
    rivals = sum(record.iteration > before.done for record in before.records)
    longer = resume(path, iterations=4, workers=2)
    assert_same_draws(whole.tree, longer.tree)
    assert longer.settings == whole.settings
    assert longer.cost["simulations"] == whole.cost["simulations"] + rivals
    assert rivals > 0, "those of the first answer are paid for, and forgotten"
    assert longer.cost["frames"] > whole.cost["frames"]
    assert longer.cost["calls"] == 2


@pytest.mark.parametrize("call", [1, 3])
def test_an_interrupted_run_goes_on_bit_for_bit(
    call: int, tmp_path: Path, whole: ppl.Posterior, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.ckpt"
    with monkeypatch.context() as patch:
        patch.setattr(sampler, "Runner", stops_at(call))
        with pytest.raises(ppl.Interrupted) as caught:
            infer(checkpoint=path)
    assert caught.value.posterior is not None
    assert Checkpoint(path).done == call - 1
    assert_same_draws(whole.tree, resume(path).tree)
    assert Checkpoint(path).done == 4
    assert list(tmp_path.iterdir()) == [path]


def test_a_population_goes_on_from_its_initial_particles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, options = tmp_path / "run.ckpt", {"kernel": "smc", "move": "prior_mh", "iterations": 1}
    settings = ppl.SimpleSettings(proposal="learned")
    with monkeypatch.context() as patch:
        patch.setattr(sampler, "Runner", stops_at(1))
        with pytest.raises(ppl.Interrupted) as caught:
            infer(**options, settings=settings, checkpoint=path)
    assert caught.value.posterior is not None
    assert_same_draws(infer(**options, settings=settings).tree, resume(path).tree)


@pytest.mark.parametrize("kernel", ["aies", pytest.param("sa", marks=pytest.mark.slow)])
def test_a_sampler_of_numpyro_goes_on_bit_for_bit(kernel: str, tmp_path: Path) -> None:
    options: dict[str, Any] = {"kernel": kernel, "chains": 12, "weights": "count"}
    infer(**options, iterations=2, checkpoint=tmp_path / "run.ckpt")
    again = resume(tmp_path / "run.ckpt", iterations=5)
    assert_same_draws(infer(**options, iterations=5).tree, again.tree)
    assert (again.tree["sample_stats"]["accepted"]).any()


def test_a_complete_run_gives_its_posterior_without_simulating(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampler, "Runner", stops_at(0))
    before = path.read_bytes()
    assert resume(path).tree["posterior"].sizes["draw"] == 2
    assert path.read_bytes() == before


@pytest.mark.filterwarnings("ignore:event 'walk'")  # no agent of the joint simulator moves so
def test_event_and_parts_of_the_package_need_not_be_given_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ppl.Model, "build_simulator", lambda self: walkers)  # for speed
    path = tmp_path / "run.ckpt"
    settings = ppl.SimpleSettings(eta=0.2)
    options = {**OPTIONS, "planner": "paper", "settings": settings, "weights": "count"}
    ppl.infer(EVENT, **{**options, "iterations": 2}, checkpoint=path)
    longer = ppl.resume(path, iterations=4, workers=1, progress=False)
    assert_same_draws(ppl.infer(EVENT, **options).tree, longer.tree)
    assert (longer.event_id, longer.weights) == ("walk", "count")
    assert longer.settings["simple"]["eta"] == 0.2


SCRIPT = """
    import os, signal, sys
    from pathlib import Path
    import phase_ppl as ppl
    from tests.inference.toy import walkers, walking_event

    folder = Path(sys.argv[1])
    path = folder / "run.ckpt"

    def fragile(scene, hypothesis, rng):
        number = len(list(folder.glob("begun-*")))
        (folder / f"begun-{number}-{os.getpid()}").touch()
        if number == 14:
            os.kill(os.getpid(), signal.SIGKILL)
        yield from walkers(scene, hypothesis, rng)

    event, model = walking_event(), ppl.Model(simulator=fragile)
    if path.exists():
        post = ppl.resume(path, event, model, workers=2, progress=False)
    else:
        post = ppl.infer(event, model, kernel="prior_mh", chains=4, iterations=4, seed=3,
                         workers=1, progress=False, checkpoint=path)
    post.save(folder / "run.nc")
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a process kills itself")
def test_a_killed_run_goes_on_in_a_fresh_process(tmp_path: Path, whole: ppl.Posterior) -> None:
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(SCRIPT))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script), str(tmp_path)]
    killed = subprocess.run(command, env=environment, capture_output=True, timeout=300)
    assert killed.returncode == -signal.SIGKILL
    assert not (tmp_path / "run.nc").exists()
    again = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert again.returncode == 0, again.stderr
    # 12 before the iteration that was cut off, 3 of it, then the rest, and two rivals a chain
    assert len(list(tmp_path.glob("begun-*"))) == 12 + 3 + 8 + 8
    post = ppl.load_posterior(tmp_path / "run.nc")
    assert isinstance(post, ppl.Posterior)
    assert_same_draws(whole.tree, post.tree)


def strange(scene: Any, hypothesis: Any, rng: Any) -> Any:
    yield from walkers(scene, hypothesis, rng)


OTHERS: list[tuple[dict[str, Any], str]] = [
    ({"event": walking_event(13)}, "another event"),
    ({"model": ppl.Model(simulator=strange)}, "model.simulator is .*strange"),
    ({"model": ppl.Model(simulator=walkers, likelihood=ppl.RadialLikelihood(0.1))},
     r"model.likelihood is 'RadialLikelihood\(beta=0.1\)'"),
    ({"kernel": "local_mh"}, "kernel.name is 'local_mh', was 'prior_mh'"),
    ({"early_reject": False}, "kernel.options.early_reject is False"),
    ({"model": None}, r"simulator tests.inference.toy.walkers.*give it again"),
    ({"iterations": 1}, "has 2 already"),
    ({"iterations": 3, "budget": ppl.simulations(90)}, "not both"),
]  # fmt: skip


def test_what_is_another_run_is_refused_and_the_file_left_alone(path: Path) -> None:
    before = path.read_bytes()
    for given, message in OTHERS:
        with pytest.raises(InvalidSettingError, match=message):
            resume(path, **given)
        assert path.read_bytes() == before


def test_a_kernel_of_ones_own_must_be_given_again(tmp_path: Path) -> None:
    from phase_ppl.inference.kernels.metropolis import PriorMH

    path = tmp_path / "run.ckpt"
    infer(kernel=PriorMH, iterations=1, weights="count", checkpoint=path)
    with pytest.raises(InvalidSettingError, match="kernel prior_mh was given as an object"):
        resume(path)
    assert resume(path, kernel=PriorMH).tree["posterior"].sizes["draw"] == 1


def test_a_file_that_exists_or_cannot_be_written_is_refused_at_once(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampler, "Runner", stops_at(0))
    before = path.read_bytes()
    for name in ("run.ckpt", "nowhere/run.ckpt", "run.npz"):
        with pytest.raises(OutputError, match="run"):
            infer(checkpoint=path.parent / name)
        assert path.read_bytes() == before
        assert list(path.parent.iterdir()) == [path]


def test_a_full_disk_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, write = tmp_path / "run.ckpt", checkpoint.write_checkpoint

    def full(*given: Any) -> None:
        if path.exists() and Checkpoint(path).done == 1:
            raise OutputError("no space left")
        write(*given)

    monkeypatch.setattr(checkpoint, "write_checkpoint", full)
    with pytest.raises(OutputError, match="no space left") as caught:
        infer(checkpoint=path)
    kept = caught.value.posterior  # type: ignore[attr-defined]
    assert kept.tree["posterior"].sizes["draw"] == 2
    assert kept.cost["interrupted"]
    assert Checkpoint(path).done == 1


def rewritten(change: Callable[[dict[str, Any], dict[str, Any]], Any]) -> Callable[[bytes], bytes]:
    """Return what makes a whole, formally sound file of other content."""

    def make(content: bytes) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "run.ckpt"
            target.write_bytes(content)
            document, arrays = read_archive(target)
            change(document, arrays)
            write_archive(target, document, arrays)
            return target.read_bytes()

    return make


def archived(
    array: bytes, document: bytes = b"{}", how: int = zipfile.ZIP_STORED
) -> Callable[[bytes], bytes]:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", how) as archive:
        archive.writestr("run.json", document)
        archive.writestr("state/0.npy", array)
    return lambda content: buffer.getvalue()


def huge() -> bytes:
    array, header = io.BytesIO(), {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(array, header)
    return array.getvalue()


def objects(content: bytes) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, trap=np.array([Path("x")], object))
    return buffer.getvalue()


def odd_frames(document: dict[str, Any], arrays: dict[str, Any]) -> None:
    arrays["records/frames_simulated"] = arrays["records/frames_simulated"] * 1000


def no_numbers(document: dict[str, Any], arrays: dict[str, Any]) -> None:
    state = {name: a for name, a in arrays.items() if name.startswith("state/")}
    name = next(name for name, array in state.items() if array.dtype.kind == "f")
    arrays[name] = np.full_like(arrays[name], np.nan)


HOSTILE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "text": lambda content: b"a run",
    "pickle": lambda content: pickle.dumps({"schema": "phase-ppl-checkpoint-1"}),
    "objects": objects,
    "compressed": archived(bytes(10_000_000), b'{"schema": "x"}', zipfile.ZIP_DEFLATED),
    "huge": archived(huge()),
    "older schema": rewritten(lambda run, arrays: run.update(schema="phase-ppl-checkpoint-4")),
    "no state": rewritten(lambda run, arrays: run.pop("state")),
    "no particles": rewritten(lambda run, arrays: arrays.pop("particles/sim_seed")),
    "more steps": rewritten(lambda run, arrays: run.update(iterations=3)),
    "other event": rewritten(lambda run, arrays: run["identity"].update(event="0")),
    "lists": rewritten(lambda run, arrays: run.update(identity=[], spent=[])),
    "odd frames": rewritten(odd_frames),
    "odd kind": rewritten(lambda run, arrays: run["state"][-1].__setitem__(1, "magic")),
    "odd settings": rewritten(lambda run, arrays: run["again"].update(settings={"x": 1})),
    "list of settings": rewritten(lambda run, arrays: run["again"].update(settings=[3])),
    "no target": rewritten(lambda run, arrays: run.update(target={})),
    "odd versions": rewritten(lambda run, arrays: run.update(versions=3)),
    "no numbers": rewritten(no_numbers),
}


@pytest.mark.parametrize("make", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_file_is_one_clear_error(make: Callable[[bytes], bytes], path: Path) -> None:
    content = make(path.read_bytes())
    path.write_bytes(content)
    said = r"run.ckpt is no checkpoint, or a damaged one"
    with pytest.raises(InvalidEventError, match=said) as raised:
        resume(path, iterations=3)
    assert "\n" not in str(raised.value)
    assert path.read_bytes() == content
    path.unlink()
    with pytest.raises(InvalidEventError, match=r"run.ckpt: no such file"):
        resume(path)


def test_unpickling_never_happens(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: Any) -> Any:
        raise AssertionError("a file was unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    assert Checkpoint(path).done == 2
    path.write_bytes(objects(b""))
    with pytest.raises(InvalidEventError):
        Checkpoint(path)


def test_a_truncated_file_is_noticed_wherever_it_was_cut(path: Path) -> None:
    content = path.read_bytes()
    for length in np.linspace(0, len(content) - 1, 30).astype(int):
        path.write_bytes(content[:length])
        with pytest.raises(InvalidEventError, match="damaged"):
            Checkpoint(path)


def test_a_damaged_file_is_noticed_or_means_the_same(path: Path) -> None:
    content = path.read_bytes()
    document, arrays = read_archive(path)
    noticed = 0
    for position in np.random.default_rng(0).integers(len(content), size=60):
        changed = bytearray(content)
        changed[position] ^= 0x55
        path.write_bytes(changed)
        try:
            again, other = read_archive(path)
        except InvalidEventError:
            noticed += 1
            continue
        # a date, or another number of the container that nobody reads
        assert again == document
        np.testing.assert_equal(other, arrays)
    assert noticed > 40


def test_a_run_is_not_gone_on_with_by_another_version_unless_told_to(
    path: Path, whole: ppl.Posterior, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kept(post: ppl.Posterior, which: str) -> Any:
        return json.loads(post.tree.attrs[which])

    mine = identity.versions()
    monkeypatch.setattr(identity, "code_stamp", lambda: "another")
    before = path.read_bytes()
    with pytest.raises(InvalidSettingError, match=r"other versions: source differs.*records both"):
        resume(path, iterations=4)
    assert path.read_bytes() == before
    # of a complete run nothing is left that could be mixed
    assert kept(resume(path), "versions") == mine
    longer = resume(path, iterations=3, other_versions=True)
    assert kept(longer, "versions")["source"] == "another"
    assert kept(longer, "earlier_versions") == [mine]
    monkeypatch.undo()
    back = resume(path, iterations=4, other_versions=True)
    assert_same_draws(whole.tree, back.tree)
    sources = [one["source"] for one in kept(back, "earlier_versions")]
    assert sources == [mine["source"], "another"]
    assert "earlier_versions" not in whole.tree.attrs


def test_two_do_not_work_on_one_file_at_once(path: Path) -> None:
    with locked(path), pytest.raises(OutputError, match=r"another process is at work in .*run\.c"):
        resume(path, iterations=3)
    resume(path, iterations=3)
    assert list(path.parent.iterdir()) == [path]
