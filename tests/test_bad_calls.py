"""Calls that cannot work: one line that names the value, and nothing begun."""

from __future__ import annotations

import functools
import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest

import phase_ppl as ppl
from phase_ppl.cli import main
from phase_ppl.inference import sampler
from phase_ppl.world.errors import PhasePPLError
from phase_ppl.world.hypothesis import Hypothesis
from tests.inference.runs import EVENT, MODEL, OPTIONS
from tests.inference.toy import walkers

LONG = "x" * 5000
sample = functools.partial(ppl.infer, kernel="local_mh")
GO = Hypothesis("Get red agent to red lm", "Get green agent to blue lm")

CALLS: dict[str, tuple[Callable[[], Any], str]] = {
    "event": (lambda: ppl.infer(3), "3 is no event; phase_ppl.load_event reads one"),
    "model": (lambda: ppl.infer(EVENT, model="simple"), "model='simple', expected a phase_ppl.M"),
    "checkpoint": (lambda: sample(EVENT, checkpoint=3), "3 is no path"),
    "chains": (lambda: sample(EVENT, MODEL, chains=10**9, workers=1), "GB of memory"),
    "workers": (lambda: sample(EVENT, MODEL, workers=10**6), "expected at most 1024"),
    "load": (lambda: ppl.load_event(None), "None is no path"),
    "load long": (lambda: ppl.load_event(LONG), "(5000 characters) is a name that no file can"),
    "save no event": (lambda: ppl.save_event(3, "a.json"), "event=3, expected a phase_ppl.Event"),
    "watch": (lambda: ppl.watch(None), "scene=None, expected"),
    "cells": (lambda: ppl.generate("no", cells="chasing"), "cells='chasing', expected a mapping"),
    "frames": (lambda: ppl.simulate(EVENT.scene, GO, frames=10**12), "frames=1000000000000 would"),
    "wall": (
        lambda: ppl.Scene(EVENT.scene.start, EVENT.scene.radius, [[[16, 12], [16, 12]]]),
        "wall [[16.0, 12.0], [16.0, 12.0]] has no length",
    ),
    "figure": (lambda: ppl.plot.posterior(None), "posterior of None, expected a phase_ppl.Post"),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_call_that_cannot_work_is_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, message = CALLS[name]
    with pytest.raises(PhasePPLError, match=re.escape(message)) as raised:
        call()
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 300
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    numbers = {"chains": np.int64(4), "iterations": np.int32(1), "seed": np.uint8(3)}
    options = {**OPTIONS, **numbers, "weights": "count"}
    post = ppl.infer(EVENT, MODEL, checkpoint=tmp_path / "run.ckpt", **options)
    assert post.settings["chains"] == 4
    assert ppl.resume(tmp_path / "run.ckpt", model=MODEL, workers=1).settings["seed"] == 3


def unseeded(scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
    yield from walkers(scene, hypothesis, np.random.default_rng())


def late(scene: Any, hypothesis: Any, rng: Any) -> Iterator[Any]:
    yield from (frame + np.array([2.0, 0.0, 0.0]) for frame in walkers(scene, hypothesis, rng))


@pytest.mark.parametrize(
    ("simulator", "message"),
    [(unseeded, "another result for the same seed"), (late, "2 units off the start of the scene")],
)
def test_an_unsound_simulator_is_told_of_once(simulator: Any, message: str) -> None:
    options = {**OPTIONS, "iterations": 1, "weights": "count"}
    with pytest.warns(UserWarning, match=message):
        post = ppl.infer(EVENT, ppl.Model(simulator=simulator), **options)
    assert post.cost["simulations"] == len(post.tree["simulations"]["seed"]) == 8
    ppl.infer(EVENT, ppl.Model(simulator=simulator), **options)
    assert simulator in sampler._known_simulators


@pytest.fixture(scope="module")
def event(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("event") / "walk.json"
    ppl.save_event(ppl.Event(EVENT.scene, EVENT.observation, id="Bär"), path)
    return str(path)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device that is always full")
def test_an_output_may_be_full_closed_or_of_few_letters_and_its_reader_gone(
    event: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def export(output: IO[str] | None) -> tuple[int, str]:
        monkeypatch.setattr(sys, "stdout", output)
        code = main(["export", event, "--out", f"{tmp_path}/Bär.json"])
        return code, capsys.readouterr().err

    with open("/dev/full", "w") as full:
        said = "phase-ppl: error: [Errno 28] No space left on device\n"
        assert export(full) == (2, said)
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as gone:
        assert export(gone) == (141, "")
    assert export(None) == (0, "")
    letters = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    assert export(letters) == (0, "")
    assert rb"B\xe4r.json" in letters.buffer.getvalue()


def test_ctrl_c_is_heard_while_the_commands_are_loaded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupts:
        def find_spec(self, name: str, *_: Any) -> None:
            if name == "phase_ppl.cli.commands":
                os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.delitem(sys.modules, "phase_ppl.cli.commands", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupts(), *sys.meta_path])
    assert main(["--version"]) == 130
    assert capsys.readouterr().err == "phase-ppl: interrupted\n"


def test_a_platform_that_jax_does_not_have_is_not_blamed_on_the_prior(event: str) -> None:
    environment = {**os.environ, "JAX_PLATFORMS": "abacus"}
    command = [sys.executable, "-m", "phase_ppl", "infer", event, "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 2
    assert "JAX_PLATFORMS='abacus'" in done.stderr
    assert "prior" not in done.stderr
    assert done.stderr.count("\n") == 1
