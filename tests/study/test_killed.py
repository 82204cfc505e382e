"""A server that is killed again and again loses no answer that it has confirmed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("uvicorn", reason="the extra 'study' is not installed")

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "study_people.py"


def test_nothing_confirmed_is_lost_or_there_twice(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    sizes = {"videos": 4, "trials": 2, "raters": 4, "at-once": 4, "kills": 2, "drop-outs": 0}
    options = [part for name, value in sizes.items() for part in (f"--{name}", str(value))]
    subprocess.run(
        [sys.executable, str(SCRIPT), *options, "--json", str(file)],
        cwd=SCRIPT.parents[1],
        capture_output=True,
        timeout=300,
        check=True,
    )
    report = json.loads(file.read_text())
    assert report["kills"] == 2
    assert report["outcomes"]["finished"] >= 8
    assert report["confirmed"] >= 8 * 7
    assert (report["lost"], report["doubled"], report["unconfirmed"]) == (0, 0, 0)
    assert report["integrity"] == "ok"
    assert min(map(int, report["raters"])) >= 4
