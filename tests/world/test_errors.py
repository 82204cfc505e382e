"""Errors in words that help, checks of numbers, and files that are never half written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phase_ppl.world.errors import (
    OutputError,
    UnknownNameError,
    check_name,
    unknown_name,
)
from phase_ppl.world.files import atomic_output, locked

MANY = [f"D0819_{n}_E{n}" for n in range(30)]


def test_an_unknown_name_is_answered_with_close_ones_or_with_what_there_is() -> None:
    for name, allowed, said in (
        ("freindly", ["friendly", "neutral"], "unknown name 'freindly'; did you mean 'friendly'?"),
        ("E17", MANY, "'D0819_17_E17'"),
        ("of_b_a", ["of_b_c", "of_a_b"], "did you mean 'of_a_b' or 'of_b_c'?"),
        ("xyz", ["a", "b"], "unknown name 'xyz'; allowed: 'a', 'b'"),
        ("?", MANY, "unknown name '?'; 30 names are allowed, such as 'D0819_0_E0'"),
        ("x" * 10**6, ["a"], "...; allowed: 'a'"),
    ):
        message = str(unknown_name("name", name, allowed))
        assert said in message
        assert len(message) < 200
    for odd in (np.array([1.0, 2.0]), ["one"], None, 3):
        with pytest.raises(UnknownNameError, match="unknown thing"):
            check_name("thing", odd, {"one": 1})


def test_a_file_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    with atomic_output(target, (".json",)) as part:
        part.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    # what fails leaves it as it was, and nothing else

    def write_half() -> None:
        with atomic_output(target, (".json",)) as part:
            part.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    # nothing is no result, as of a program that ends well and writes nothing
    with (
        pytest.raises(OutputError, match=r"result\.json: nothing was written"),
        atomic_output(target, (".json",)),
    ):
        pass
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_where_nothing_can_be_written_is_found_out_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "file").write_text("")
    for name in ("result.txt", "result", "folder.json", "none/r.json", "file/r.json"):
        with (
            pytest.raises(OutputError, match=f"cannot write .*{name}: ") as raised,
            atomic_output(tmp_path / name, (".json",)),
        ):
            pytest.fail("it was begun")
        assert "\n" not in str(raised.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.json"]


def test_a_lock_is_for_one_at_a_time_and_leaves_nothing(tmp_path: Path) -> None:
    for target in (tmp_path, tmp_path / "run.ckpt"):
        twice = locked(target), pytest.raises(OutputError, match="another process"), locked(target)
        with twice[0], twice[1], twice[2]:
            raise AssertionError("two at a time")
        with locked(target), locked(None):
            pass
    assert list(tmp_path.iterdir()) == []
